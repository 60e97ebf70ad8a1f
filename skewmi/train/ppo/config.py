"""The numbers of proximal policy optimization."""

from __future__ import annotations

from dataclasses import dataclass

from skewmi.train.checks import require, require_at_least, require_between, require_positive
from skewmi.train.learner import LearnerConfig


@dataclass(frozen=True)
class PpoConfig(LearnerConfig):
    """Proximal policy optimization (arXiv:1707.06347) of a policy with an LSTM as its memory."""

    memory: int = 150
    """Units of the LSTM that policy and value share; 0: they see the present step only."""
    heads: tuple[int, ...] = (64, 32)
    """Units of the hidden layers, tanh, of policy and value, on top of the memory."""
    normalize_input: bool = True
    """Map observation and goal from the layout's ranges to [-1, 1]."""
    learning_rate: float = 2.5e-4
    """Of Adam."""
    discount: float = 0.99
    """Per control step."""
    trace_decay: float = 0.95
    """Lambda of the generalized advantage estimate: 0 trusts the value, 1 the rewards."""
    bootstrap_at_timeout: bool = True
    """Whether the end of an episode, which is only a time limit, has a future."""
    steps_per_update: int = 5_000
    """Environment steps (of one environment) collected before the policy learns from them."""
    epochs: int = 15
    """Times that it learns from each step."""
    minibatches: int = 10
    """Gradient updates per epoch; each sees whole sequences."""
    sequence_length: int | None = 50
    """Steps that gradients flow back through; what was before them is in the stored memory. None:
    whole episodes."""
    clip: float = 0.2
    """Bound on how far the density ratio of new to old policy counts, around 1."""
    value_clip: float | None = None
    """Bound on how far the value counts away from the old one, in units of the scaled reward;
    None: no bound."""
    value_weight: float = 0.5
    """Of the value's squared error in the loss."""
    entropy_weight: float = 0.0
    """Of the policy's entropy in the loss."""
    max_gradient_norm: float = 0.5
    """Longer gradients are shortened to this norm."""
    initial_log_std: float = 0.0
    """Of the actions, before they are clipped to [-1, 1]; learned, the same in all states."""
    scale_rewards: bool = True
    """Divide rewards by the running standard deviation of their discounted sum."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_at_least(0, self, "memory", "value_weight")
        require(
            all(units > 0 for units in self.heads), f"heads are {self.heads}, need positive units"
        )
        require_at_least(1, self, "steps_per_update", "epochs", "minibatches")
        length = self.sequence_length
        require(
            length is None or length >= 1,
            f"sequence_length is {length}, needs at least 1, or none for whole episodes",
        )
        require(0.0 < self.discount < 1.0, f"discount is {self.discount}, needs 0 < it < 1")
        require_between(0.0, 1.0, self, "trace_decay")
        require_positive(self, "clip", "max_gradient_norm", "learning_rate", "value_clip")
