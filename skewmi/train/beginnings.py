"""Which beginning the next episodes of a run have: random, taught, handed over, or none."""

from __future__ import annotations

from skewmi.policy_io import Policy
from skewmi.train.beginning import Beginning, HandOver, RandomBeginning, TaughtBeginning
from skewmi.train.config import RolloutConfig


class Beginnings:
    """What acts instead of the learner, over a run.

    Args:
        config: How long, and in how many episodes.
        teacher: The policy that teaches, while one is needed.
        taught: Whether the run is: else random actions begin it.
    """

    def __init__(self, config: RolloutConfig, teacher: Policy | None, *, taught: bool) -> None:
        self._config, self.teacher, self._taught = config, teacher, taught
        self._steps = config.taught_steps if taught else config.random_steps

    def over(self, steps: int) -> bool:
        """Whether so many steps are enough to learn from; a run that ends before learns nothing.

        Args:
            steps: Of the run so far.
        """
        return steps >= self._steps

    def need_teacher(self, steps: int, converged: bool) -> bool:
        """Whether a teacher acts in the next episodes.

        Args:
            steps: Of the run so far.
            converged: Whether the run has, ever.
        """
        if not self._taught:
            return False
        return steps < self._steps or (not converged and self._config.taught_share > 0.0)

    def next(self, steps: int, converged: bool) -> Beginning | None:
        """What acts instead of the learner in the next episodes; None: nothing. See above."""
        c = self._config
        if not self._taught:
            return RandomBeginning() if steps < self._steps else None
        if not self.need_teacher(steps, converged):
            return None
        assert self.teacher is not None  # `run_train` sees to it
        if steps >= self._steps:
            return HandOver(self.teacher, c.taught_share)
        return TaughtBeginning(
            self.teacher,
            noise_probability=c.taught_noise_probability,
            noise_correlation=c.noise_correlation,
        )
