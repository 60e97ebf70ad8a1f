"""Every number of a training run, resolved before it starts and saved in its directory.

What learner and exploration need stands in their own configurations, which are told apart by
their types: `registry` knows which type belongs to which name.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from skewmi.batch_env import TaskMetrics
from skewmi.train.checks import (
    require,
    require_at_least,
    require_between,
    require_finite,
    require_positive,
)
from skewmi.train.exploration.protocol import ExplorationConfig
from skewmi.train.learner import LearnerConfig

OptionValue = bool | int | float | str
"""Of an option that a task's environment is made with."""


_SHARES = (
    "noise_probability",
    "taught_noise_probability",
    "taught_share",
    "evaluation_share",
    "evaluation_from",
)


@dataclass(frozen=True)
class RolloutConfig:
    """How episodes are collected and kept."""

    num_envs: int = 25
    """Environments stepped together."""
    evaluation_envs: int = 2
    """Of these, run the deterministic action, and only they tell whether the task is learned: the
    first towards the goal to be exported, the others towards rewarded states once there are any.
    What random actions or a teacher do at the start does not. 0: all trajectories count, as in the
    publication."""
    evaluation_share: float = 0.4
    """Of the environments, do so while those of the iteration before ended in the reward, so that
    a policy that seems to be done is soon known; 0: never more than evaluation_envs."""
    evaluation_from: float = 1.0
    """Of an iteration's episodes, rewarded ones from which on the next evaluates as many, though
    those evaluated did not end in the reward yet. Exploration reaches a state before the
    deterministic action does; 1: not before that does."""
    random_steps: int = 5_000
    """Environment steps of uniform random actions at the start. Learning begins after them: a run
    that ends before has learned nothing."""
    taught_steps: int = 25_000
    """Environment steps at the start that a teacher acts instead of random ones, if there is one
    (--teacher)."""
    taught_noise_probability: float = 0.5
    """Probability that an episode of the teacher ends in random motion, from a uniformly drawn
    step on: so that the learner sees what the teacher does not do."""
    taught_share: float = 0.5
    """Of the later episodes, the teacher begins and hands over at a uniformly drawn step, until
    the run has converged; 0: none."""
    noise_probability: float = 0.4
    """Probability that an episode ends in random motion, from a uniformly drawn step on."""
    noise_correlation: float = 0.85
    """Of that motion from step to step (first-order autoregressive, unit variance)."""
    history_steps: int = 5_000_000
    """Steps kept; whole episodes, oldest dropped first."""

    def __post_init__(self) -> None:
        require_finite(self)
        require_at_least(1, self, "num_envs", "taught_steps", "history_steps")
        require_at_least(0, self, "evaluation_envs", "random_steps")
        require(
            self.evaluation_envs < self.num_envs,
            f"evaluation_envs is {self.evaluation_envs}, must be below num_envs {self.num_envs}",
        )
        require_between(0.0, 1.0, self, *_SHARES)
        require_between(-1.0, 1.0, self, "noise_correlation")
        require(
            self.most_evaluation_envs < self.num_envs,
            f"evaluation_share is {self.evaluation_share}: that is all of num_envs "
            f"{self.num_envs}, and nothing would explore",
        )

    @property
    def most_evaluation_envs(self) -> int:
        """How many environments run the deterministic action while the policy seems to be done."""
        if self.evaluation_envs == 0:
            return 0
        return max(self.evaluation_envs, round(self.evaluation_share * self.num_envs))


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
    """Environment steps between two measurements of entropy; an unrewarded run measures at every
    refresh of its exploration instead."""
    convergence_fraction: float = 0.9
    """Rewarded fraction of the last states of the last trajectories that counts as converged."""
    convergence_tolerance: float = 0.03
    """What its standard deviation must stay below, see `convergence.py`."""
    convergence_trajectories: int = 50
    """How many trajectories our criterion looks at; the published one looks at ten."""

    def __post_init__(self) -> None:
        require_finite(self)
        require_at_least(1, self, "entropy_points", "convergence_trajectories")
        require_at_least(0, self, "every_steps")
        require_positive(self, "entropy_bandwidth", "coverage_width", "convergence_tolerance")
        require(
            0.0 < self.convergence_fraction <= 1.0,
            f"convergence_fraction is {self.convergence_fraction}, needs 0 < it <= 1",
        )


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
    taught_by: str = ""
    """The policy file whose actions begin this run, and its sha256; empty: random actions do."""
    rewarded: bool = True
    """Whether the task's reward is paid; if not, there is no target: the run explores for its
    whole budget."""
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
        require_finite(self)
        require(self.device in ("cpu", "cuda"), f"device is {self.device!r}; allowed: cpu, cuda")
        require_at_least(1, self, "threads", "total_steps", "checkpoint_every")
        require_at_least(0, self, "seed", "minutes")
        require(
            self.rewarded or not self.stop_on_convergence,
            "stop_on_convergence is asked for, but the run is unrewarded, and without a reward "
            "nothing converges: leave out one of the two",
        )
        require(
            not self.taught_by or self.rollout.evaluation_envs >= 1,
            "a run with a teacher needs episodes that are the learner's own to tell whether the "
            "task is learned: give --rollout.evaluation-envs 1 or more",
        )
