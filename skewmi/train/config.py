"""Every number of a training run, resolved before it starts and saved in its directory."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from typing import Any

from skewmi.errors import CheckpointError, ConfigurationError


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise ConfigurationError(message)


@dataclass(frozen=True)
class SacConfig:
    """Soft actor-critic (arXiv:1812.05905)."""

    hidden: tuple[int, ...] = (128, 128)
    """Units of the hidden layers, ReLU, of actor and critics alike."""
    layer_norm: bool = True
    """Normalize each hidden layer of the critics before its ReLU (no learned gain)."""
    normalize_input: bool = True
    """Map observation and goal from the layout's ranges to [-1, 1]."""
    learning_rate: float = 5e-4
    """Of Adam, for actor, critics and temperature."""
    discount: float = 0.99
    """Per control step."""
    polyak: float = 0.005
    """Fraction of the critics that moves into the target critics at each update."""
    batch_size: int = 256
    """Transitions per update."""
    n_step: int = 3
    """Steps of reward summed before the critics take over."""
    bootstrap_at_timeout: bool = True
    """Whether the end of an episode, which is only a time limit, has a future."""
    initial_temperature: float = 0.01
    """Of the entropy bonus; adapted from there."""
    target_entropy: float | None = None
    """Of the squashed policy, nats; None is minus the number of actions."""
    log_std_min: float = -5.0
    """Bounds of the policy's log standard deviation before squashing."""
    log_std_max: float = 2.0
    """See `log_std_min`."""
    updates_per_step: float = 0.14
    """Gradient updates per environment step (of one environment)."""

    def __post_init__(self) -> None:
        _require(len(self.hidden) > 0 and min(self.hidden) > 0, f"hidden layers {self.hidden}")
        _require(self.n_step >= 1, f"n_step is {self.n_step}, needs at least 1")
        _require(0.0 < self.discount < 1.0, f"discount is {self.discount}, needs 0 < it < 1")
        _require(self.batch_size >= 1, f"batch_size is {self.batch_size}, needs at least 1")
        _require(
            self.initial_temperature > 0.0,
            f"initial_temperature is {self.initial_temperature}, needs to be positive",
        )


@dataclass(frozen=True)
class ReplayConfig:
    """Replay of whole episodes with hindsight (arXiv:1707.01495)."""

    capacity_steps: int = 5_000_000
    """Steps kept; whole episodes, oldest dropped first."""
    future_fraction: float = 0.5
    """Fraction of a batch relabelled with a state reached later in the same episode."""
    proposal_fraction: float = 0.3
    """Fraction of a batch relabelled with a present proposal; the rest keeps its own."""
    rewarded_fraction: float = 0.25
    """Fraction of a batch drawn from episodes that met the extrinsic reward, once there are any."""
    rare_fraction: float = 0.25
    """Fraction of a batch drawn from the episodes in which the present proposals were met."""

    def __post_init__(self) -> None:
        fractions = (
            self.future_fraction,
            self.proposal_fraction,
            self.rewarded_fraction,
            self.rare_fraction,
        )
        _require(
            min(fractions) >= 0.0
            and fractions[0] + fractions[1] <= 1.0
            and fractions[2] + fractions[3] <= 1.0,
            f"fractions {fractions} (future, proposal, rewarded, rare) must lie in [0, 1], "
            "future + proposal and rewarded + rare too",
        )


@dataclass(frozen=True)
class SkewConfig:
    """Skew-Explore: goals from a skewed density, reward from two densities."""

    intrinsic: float = 0.005
    """w_int, in front of log p_z(s) - log p_tau(s)."""
    extrinsic: float = 1.0
    """w_ext, in front of the task's reward of 1 per step."""
    sigma: float = 0.7
    """Standard deviation of p_z around the goal, in density units."""
    trajectory_bandwidth: float = 0.2
    """Of the kernels of p_tau, in density units."""
    trajectory_density: str = "prefix"
    """`prefix`: the trajectory up to now (causal); `whole`: all of it (Eqs. 3-4)."""
    goal_clip: float | None = -20.0
    """Lower clip of log p_z."""
    trajectory_clip: float | None = -50.0
    """Lower clip of log p_tau."""
    running_scale: bool = True
    """Density units: running mean and standard deviation (True) or the layout's units (False)."""
    scale_floor: float = 0.1
    """Smallest running standard deviation, as a fraction of half the field's range."""
    field_weights: tuple[tuple[str, float], ...] = ()
    """Fields whose distance counts more when goals are proposed: (name, factor)."""
    weights_in_reward: bool = False
    """Whether the field weights also shape p_z and p_tau."""
    history_points: int = 5_000
    """Visited states behind the kernel density of everything visited."""
    history_bandwidth: float = 0.5
    """Of its kernels, in density units."""
    candidates: int = 12_000
    """States among which the goals are chosen."""
    candidates_from: str = "history"
    """`history`: visited states, thus reachable; `density`: samples of the kernel density."""
    self_count: float = 1.0
    """A candidate's own kernel, added to its density: bounds the weight of an outlier."""
    weight_exponent: float = -2.5
    """Candidates drawn from p are weighted p to this power; the code's alpha plus one."""
    goals: int = 100
    """Goals proposed at a time."""
    refresh_steps: int = 5_000
    """Environment steps between two proposals."""
    first_refresh_steps: int = 2_000
    """Environment steps before the first one."""

    def __post_init__(self) -> None:
        for name, allowed in (
            ("trajectory_density", ("prefix", "whole")),
            ("candidates_from", ("history", "density")),
        ):
            value = getattr(self, name)
            _require(value in allowed, f"{name} is {value!r}; allowed: {', '.join(allowed)}")
        for name in ("sigma", "trajectory_bandwidth", "history_bandwidth"):
            _require(getattr(self, name) > 0.0, f"{name} is {getattr(self, name)}, needs > 0")


@dataclass(frozen=True)
class RolloutConfig:
    """How episodes are collected."""

    num_envs: int = 25
    """Environments stepped together."""
    random_steps: int = 5_000
    """Environment steps of uniform random actions at the start."""
    switch_probability: float = 0.015
    """Chance per step that the goal changes within an episode."""
    noise_probability: float = 0.4
    """Fraction of episodes that end in random motion, from a uniformly drawn step on."""
    noise_correlation: float = 0.85
    """Of that motion from step to step (first-order autoregressive, unit variance)."""
    rewarded_goal_max: float = 0.7
    """Highest probability that an episode gets a rewarded state as its goal."""
    rewarded_goal_per_success: float = 0.01
    """Growth of that probability per rewarded episode."""
    evaluation_envs: int = 2
    """Environments that run the mean action towards the goal to be exported."""


@dataclass(frozen=True)
class Condition:
    """A field inside a closed interval; None leaves that side open."""

    field: str
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True)
class Event:
    """Something whose first time is worth logging: all conditions at one step."""

    name: str
    conditions: tuple[Condition, ...]


@dataclass(frozen=True)
class GridAxis:
    """One axis of the grid that entropy and coverage are measured on."""

    field: str
    low: float
    high: float
    points: int


@dataclass(frozen=True)
class MetricsConfig:
    """What is measured besides returns."""

    grid: tuple[GridAxis, ...] = ()
    """Axes; empty means no entropy and coverage."""
    unit_range: bool = False
    """Scale each axis to [0, 1] before densities and distances (arm tasks)."""
    entropy_bandwidth: float = 0.1
    """Of the kernel density behind the entropy."""
    entropy_points: int = 50_000
    """Visited states behind it."""
    coverage_width: float = 0.1
    """A point at distance d from the nearest visited state is covered exp(-d^2 / 2 width^2)."""
    every_steps: int = 5_000
    """Environment steps between two measurements."""
    events: tuple[Event, ...] = ()
    """First times to log; the first reward always is."""
    convergence_fraction: float = 0.9
    """Rewarded fraction of the last states of the last trajectories that counts as converged."""
    convergence_tolerance: float = 0.03
    """Tolerance of it: the published criterion is 90 +- 3 %, and we take the lower edge."""


@dataclass(frozen=True)
class TrainConfig:
    """A whole run."""

    task: str = ""
    """Name of the task, as the layout calls it."""
    preset: str = "custom"
    """Where the numbers started from."""
    task_options: tuple[tuple[str, bool | int | float | str], ...] = ()
    """Options the environment is made with: (name, value)."""
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
    sac: SacConfig = field(default_factory=SacConfig)
    replay: ReplayConfig = field(default_factory=ReplayConfig)
    skew: SkewConfig = field(default_factory=SkewConfig)
    rollout: RolloutConfig = field(default_factory=RolloutConfig)
    metrics: MetricsConfig = field(default_factory=MetricsConfig)

    def __post_init__(self) -> None:
        _require(self.device in ("cpu", "cuda"), f"device is {self.device!r}; allowed: cpu, cuda")
        _require(self.threads >= 1, f"threads is {self.threads}, needs at least 1")
        _require(self.total_steps >= 1, f"total_steps is {self.total_steps}, needs at least 1")
        _require(
            0 <= self.rollout.evaluation_envs < max(self.rollout.num_envs, 1),
            f"evaluation_envs is {self.rollout.evaluation_envs}, must be below num_envs "
            f"{self.rollout.num_envs}",
        )

    def to_json(self) -> str:
        """Readable JSON at full precision."""
        return json.dumps(asdict(self), indent=1, allow_nan=False)

    @staticmethod
    def from_json(text: str) -> TrainConfig:
        """Inverse of `to_json`.

        Raises:
            CheckpointError: The text is not a configuration of this version.
        """
        try:
            c: dict[str, Any] = json.loads(text)
            sac, replay, skew = c.pop("sac"), c.pop("replay"), c.pop("skew")
            rollout, metrics = c.pop("rollout"), c.pop("metrics")
            c["task_options"] = tuple((n, v) for n, v in c["task_options"])
            sac["hidden"] = tuple(sac["hidden"])
            skew["field_weights"] = tuple((n, w) for n, w in skew["field_weights"])
            metrics["grid"] = tuple(GridAxis(**axis) for axis in metrics["grid"])
            metrics["events"] = tuple(
                Event(e["name"], tuple(Condition(**x) for x in e["conditions"]))
                for e in metrics["events"]
            )
            return TrainConfig(
                sac=SacConfig(**sac),
                replay=ReplayConfig(**replay),
                skew=SkewConfig(**skew),
                rollout=RolloutConfig(**rollout),
                metrics=MetricsConfig(**metrics),
                **c,
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise CheckpointError(f"not a training configuration: {error}") from error
