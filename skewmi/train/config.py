"""Every number of a training run, resolved before it starts and saved in its directory.

What learner and exploration need stands in their own configurations, which are told apart by
their types: `registry` knows which type belongs to which name.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from skewmi.batch_env import TaskMetrics
from skewmi.train.checks import require
from skewmi.train.exploration.protocol import ExplorationConfig
from skewmi.train.learner import LearnerConfig

OptionValue = bool | int | float | str
"""Of an option that a task's environment is made with."""


@dataclass(frozen=True)
class RolloutConfig:
    """How episodes are collected and kept."""

    num_envs: int = 25
    """Environments stepped together."""
    evaluation_envs: int = 2
    """Of these, run the deterministic action towards the goal to be exported."""
    random_steps: int = 5_000
    """Environment steps of uniform random actions at the start."""
    noise_probability: float = 0.4
    """Probability that an episode ends in random motion, from a uniformly drawn step on."""
    noise_correlation: float = 0.85
    """Of that motion from step to step (first-order autoregressive, unit variance)."""
    history_steps: int = 5_000_000
    """Steps kept; whole episodes, oldest dropped first."""

    def __post_init__(self) -> None:
        require(
            0 <= self.evaluation_envs < max(self.num_envs, 1),
            f"evaluation_envs is {self.evaluation_envs}, must be below num_envs {self.num_envs}",
        )
        require(
            0.0 <= self.noise_probability <= 1.0,
            f"noise_probability is {self.noise_probability}, must lie in [0, 1]",
        )


@dataclass(frozen=True)
class MetricsConfig:
    """How it is measured what a run has visited, and when it has converged."""

    entropy_bandwidth: float = 0.1
    """Of the kernel density behind the entropy."""
    entropy_points: int = 50_000
    """Visited states behind it."""
    coverage_width: float = 0.1
    """A point at distance d from the nearest visited state is covered exp(-d^2 / 2 width^2)."""
    every_steps: int = 5_000
    """Environment steps between two measurements."""
    convergence_fraction: float = 0.9
    """Rewarded fraction of the last states of the last trajectories that counts as converged."""
    convergence_tolerance: float = 0.03
    """Tolerance of it: the published criterion is 90 +- 3 %, and we take the lower edge."""


@dataclass(frozen=True)
class TrainConfig:
    """A whole run."""

    learner: LearnerConfig
    """The numbers of the learner; their type says which it is."""
    exploration: ExplorationConfig
    """The numbers of the exploration; their type says which it is."""
    task: str = ""
    """Name of the task, as the layout calls it."""
    preset: str = "custom"
    """Where the numbers started from."""
    task_options: tuple[tuple[str, OptionValue], ...] = ()
    """Options the environment is made with: (name, value)."""
    task_metrics: TaskMetrics = field(default_factory=TaskMetrics)
    """What is measured in the task besides returns."""
    started_from: str = ""
    """The run whose networks and replay this one began with, and at which step; empty: from
    scratch."""
    seed: int = 0
    """Of networks, sampling and environment."""
    total_steps: int = 2_000_000
    """Environment steps after which the run ends."""
    minutes: float | None = None
    """Wall-clock budget, checked between iterations."""
    stop_on_convergence: bool = False
    """End when the convergence criterion holds."""
    device: str = "cpu"
    """`cpu` or `cuda`."""
    threads: int = 1
    """Threads of the tensor library."""
    checkpoint_every: int = 1
    """Iterations between two checkpoints; what a kill can cost."""
    rollout: RolloutConfig = field(default_factory=RolloutConfig)
    metrics: MetricsConfig = field(default_factory=MetricsConfig)

    def __post_init__(self) -> None:
        require(self.device in ("cpu", "cuda"), f"device is {self.device!r}; allowed: cpu, cuda")
        require(self.threads >= 1, f"threads is {self.threads}, needs at least 1")
        require(self.total_steps >= 1, f"total_steps is {self.total_steps}, needs at least 1")
