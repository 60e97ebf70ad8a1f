"""The numbers of soft actor-critic with hindsight."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from skewmi.train.checks import require, require_at_least, require_positive
from skewmi.train.learner import LearnerConfig


@dataclass(frozen=True)
class SacConfig(LearnerConfig):
    """Soft actor-critic (arXiv:1812.05905) on hindsight batches (arXiv:1707.01495)."""

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
    actor_average: float = 0.0
    """Part that an average of the actor's weights keeps of itself at each update (0.999: over the
    last thousand or so). Evaluated episodes and exported policies take it; 0: the latest weights.
    """
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
    future_fraction: float = 0.5
    """Fraction of a batch relabelled with a state reached later in the same episode."""
    proposal_fraction: float = 0.3
    """Fraction of a batch relabelled with a present proposal; the rest keeps its own goal."""
    rewarded_fraction: float = 0.25
    """Fraction of a batch from episodes that met the extrinsic reward, once there are any."""
    burst_updates_per_step: float | None = None
    """`updates_per_step` from the first reward until the run has converged; None: no other."""
    burst_rewarded_fraction: float | None = None
    """`rewarded_fraction` in that time; None: no other."""
    rare_fraction: float = 0.25
    """Fraction of a batch from the episodes in which the present proposals were met."""

    engine: Literal["auto", "eager", "compiled", "captured"] = "auto"
    """How an update is computed: `eager`, operation by operation; `compiled`, in one function of
    C++ code; `captured`, as one CUDA graph; `auto`: compiled on the device cpu where a C++ compiler
    is found, captured on the device cuda. A run that goes on keeps the engine that it began with,
    which its checkpoints name."""
    compile_after: int = 5_000
    """Updates that are computed operation by operation first: to compile takes a minute or less,
    which short runs do better without."""

    def __post_init__(self) -> None:
        super().__post_init__()
        engines = ("auto", "eager", "compiled", "captured")
        require(self.engine in engines, f"engine is {self.engine!r}; allowed: {', '.join(engines)}")
        require(
            len(self.hidden) > 0 and min(self.hidden) >= 1,
            f"hidden is {self.hidden}, needs at least one layer, and at least 1 unit in each",
        )
        require_at_least(1, self, "compile_after", "n_step", "batch_size")
        require_at_least(0, self, "updates_per_step", "burst_updates_per_step")
        require_positive(self, "learning_rate", "initial_temperature")
        require(0.0 < self.polyak <= 1.0, f"polyak is {self.polyak}, needs 0 < it <= 1")
        require(
            self.log_std_min <= self.log_std_max,
            f"log_std_min is {self.log_std_min}, must not be above log_std_max {self.log_std_max}",
        )
        require(0.0 < self.discount < 1.0, f"discount is {self.discount}, needs 0 < it < 1")
        require(
            0.0 <= self.actor_average < 1.0,
            f"actor_average is {self.actor_average}, needs 0 <= it < 1",
        )
        future, proposal = self.future_fraction, self.proposal_fraction
        rewarded, rare = self.rewarded_fraction, self.rare_fraction
        require(
            min(future, proposal, rewarded, rare) >= 0.0
            and future + proposal <= 1.0
            and rewarded + rare <= 1.0,
            f"future_fraction {future}, proposal_fraction {proposal}, rewarded_fraction "
            f"{rewarded} and rare_fraction {rare} must lie in [0, 1]; so must the sum of the "
            "first two, and of the last two",
        )
        burst = rewarded if self.burst_rewarded_fraction is None else self.burst_rewarded_fraction
        require(
            0.0 <= burst <= 1.0 - rare,
            f"burst_rewarded_fraction {burst} must be 0 or more, and at most 1 with rare_fraction "
            f"{rare}",
        )
