"""What the robot did to its surroundings while a policy acted: forces, tilt, tracking.

The environment's diagnostics of every step, collected as an observer of `run_episodes` and
reduced to distributions and to the share of episodes that stayed gentle all the way. The hand is
where the joint sensors put it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from skewmi.batch_env import BatchEnv, StepResult
from skewmi.contact import QUANTITIES, STANDING_S
from skewmi.errors import ConfigurationError
from skewmi.policy_io import Array, PolicyLayout

if TYPE_CHECKING:
    from skewmi.sim.arm.diagnostics import Diagnostics


@runtime_checkable
class HasDiagnostics(Protocol):
    """An environment that says what its last step did to the robot."""

    def diagnostics(self) -> Diagnostics:
        """Each field has shape (num_envs,)."""


class ContactRecorder:
    """Collects `QUANTITIES`; give it to `run_episodes` as its observer."""

    def __init__(self, layout: PolicyLayout, diagnostics: Callable[[], Diagnostics]) -> None:
        """Start with nothing recorded.

        Args:
            layout: Of the environment; must have a workspace and observe hand_x, hand_y, hand_z.
            diagnostics: Of the environment's last step.

        Raises:
            ConfigurationError: The layout knows no hand in a workspace.
        """
        names = layout.observation_names
        hand = [f"hand_{axis}" for axis in "xyz"]
        if layout.workspace is None or not set(hand) <= set(names):
            raise ConfigurationError(
                f"task {layout.task!r} observes no hand in a workspace; fields are {list(names)}"
            )
        self._columns = [names.index(name) for name in hand]
        self._low, self._high = np.array(layout.workspace.low), np.array(layout.workspace.high)
        self._steps = layout.episode_steps
        self._window = max(1, round(STANDING_S / layout.control_dt))
        self._diagnostics = diagnostics
        self._rows: list[Array] = []
        self._means: list[Array] = []
        self._rounds: list[Array] = []

    def __call__(self, result: StepResult, counted: int) -> None:
        """Record the step of the first `counted` environments."""
        now = self._diagnostics()
        hand = result.observation[:, self._columns]
        outside = np.maximum(np.maximum(self._low - hand, hand - self._high), 0.0)
        self._means = [*self._means, now.hand_force_mean][-self._window :]
        row = np.stack(
            (
                now.hand_force_peak,
                now.hand_force_mean,
                # An episode begins without contact.
                np.sum(self._means, axis=0) / self._window,
                now.arm_force_peak,
                np.rad2deg(now.hand_tilt),
                1e3 * np.linalg.norm(outside, axis=1),
                1e3 * now.hand_to_command,
            )
        )
        self._rows.append(row[:, :counted])
        if result.truncated:
            self._rounds.append(np.stack(self._rows))
            self._rows, self._means = [], []

    @property
    def values(self) -> Array:
        """All finished episodes. Shape (episode_steps, len(QUANTITIES), episodes)."""
        if not self._rounds:
            return np.zeros((self._steps, len(QUANTITIES), 0))
        return np.concatenate(self._rounds, axis=-1)


def recorder_for(env: BatchEnv) -> ContactRecorder | None:
    """A recorder of this environment, or None if it has no diagnostics."""
    if not isinstance(env, HasDiagnostics):
        return None
    return ContactRecorder(env.layout, env.diagnostics)


def summarise_contact(values: Array) -> dict[str, Any]:
    """Figures of `ContactRecorder.values`, JSON-serialisable.

    Args:
        values: Shape (episode_steps, len(QUANTITIES), episodes), at least one episode.

    Returns:
        Per quantity "p50", "p99", "max" over all steps of all episodes and, if it has a limit,
        "limit" and "share_of_episodes_within" (no step above it); "share_of_episodes_gentle" of
        those within every limit.

    Raises:
        ConfigurationError: No episode was recorded.
    """
    if values.shape[-1] == 0:
        raise ConfigurationError("no finished episode was recorded")
    figures: dict[str, Any] = {}
    gentle: NDArray[np.bool_] = np.ones(values.shape[-1], dtype=np.bool_)
    for (name, quantity), column in zip(QUANTITIES.items(), values.swapaxes(0, 1), strict=True):
        median, high = np.percentile(column, (50.0, 99.0))
        figures[name] = {"p50": float(median), "p99": float(high), "max": float(column.max())}
        if quantity.limit is not None:
            within = column.max(axis=0) <= quantity.limit
            gentle &= within
            figures[name] |= {
                "limit": quantity.limit,
                "share_of_episodes_within": float(within.mean()),
            }
    figures["share_of_episodes_gentle"] = float(gentle.mean())
    return figures


def contact_text(figures: Mapping[str, Any]) -> list[str]:
    """The figures of `summarise_contact` as a table, line by line."""
    width = max(len(quantity.label) for quantity in QUANTITIES.values())
    head = f"  {'contact, all steps':<{width + 2}}{'p50':>9}{'p99':>9}{'max':>9}"
    lines = [f"{head}{'limit':>9}  episodes within"]
    for name, quantity in QUANTITIES.items():
        values = figures[name]
        line = f"    {quantity.label:<{width}}"
        line += "".join(f"{values[key]:9.2f}" for key in ("p50", "p99", "max"))
        if quantity.limit is not None:
            line += f"{quantity.limit:9.0f}  {values['share_of_episodes_within']:.1%}"
        lines.append(line)
    return [*lines, f"  within all limits: {figures['share_of_episodes_gentle']:.1%} of episodes"]
