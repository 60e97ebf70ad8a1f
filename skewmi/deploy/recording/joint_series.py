"""What an arm did in a recording, as arrays: the reference that was executed, and what it measured.

Only messages of the robot server that the session believed count, if the file tells.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from skewmi.deploy.recording.believed import believed_part
from skewmi.deploy.recording.reader import Recording
from skewmi.deploy.wire.controller_state import decode_controller_state
from skewmi.deploy.wire.messages import decode_joint_states
from skewmi.deploy.wire.topics import YUMI_CONTROLLER_STATE, YUMI_JOINT_STATES, Topic
from skewmi.errors import ConfigurationError, TransportError
from skewmi.trajectory import GRID_NS, Array, JointTrajectory

MOST_MISSING_NS = 100_000_000
"""Longest time without a reference that is filled in; a motion does not change much in it."""


class _Stamped(Protocol):
    @property
    def stamp_ns(self) -> int: ...


_State = TypeVar("_State", bound=_Stamped)


@dataclass(frozen=True, eq=False)
class ExecutedReference:
    """What was written to the arm, cycle by cycle, and what it measured in the same cycles.

    Attributes:
        names: Of the joints, chain order.
        stamps_ns: In the robot server's clock, rising. Shape (n,).
        reference: What was written: it holds from its stamp on. n samples.
        position: Measured at the stamp, before the arm got the sample, rad. Shape (n, 7).
        velocity: rad/s. Shape (n, 7).
        effort: N m. Shape (n, 7).
    """

    names: tuple[str, ...]
    stamps_ns: NDArray[np.int64]
    reference: JointTrajectory
    position: Array
    velocity: Array
    effort: Array

    @property
    def longest_gap_ns(self) -> int:
        """Between two cycles that were recorded; 0 if there is one."""
        return int(np.diff(self.stamps_ns).max(initial=0))

    def on_grid(self) -> tuple[int, JointTrajectory]:
        """The reference every 4 ms, with cycles that are missing, or off the grid, filled in.

        Between two samples stands the polynomial of fifth order that has the positions, velocities
        and accelerations of both.

        Returns:
            Stamp of the first sample, ns, on the grid; and the samples.

        Raises:
            ConfigurationError: More than `MOST_MISSING_NS` are missing at once.
        """
        self._require_whole()
        first = -(-int(self.stamps_ns[0]) // GRID_NS) * GRID_NS
        times = np.arange(first, int(self.stamps_ns[-1]) + 1, GRID_NS, dtype=np.int64)
        return first, _between(self.stamps_ns, self.reference, times)

    def by_cycles(self) -> tuple[float, NDArray[np.int64], JointTrajectory]:
        """The reference of each of the robot's own cycles, those that are missing filled in.

        Returns:
            Length of a cycle, ns; the cycles that were recorded, counted from the first, shape
            (n,); and the reference of every cycle from the first to the last.

        Raises:
            ConfigurationError: More than `MOST_MISSING_NS` are missing at once, or all but one.
        """
        self._require_whole()
        if len(self.stamps_ns) < 3:
            raise ConfigurationError("the recording has less than three cycles of the robot")
        steps = np.diff(self.stamps_ns)
        period_ns = float(np.median(steps))
        counted = np.concatenate(([0], np.cumsum(np.maximum(np.round(steps / period_ns), 1))))
        # Of the whole recording: a median of stamps is as coarse as the clock's corrections.
        period_ns = float(np.polyfit(counted, self.stamps_ns - self.stamps_ns[0], 1)[0])
        cycles = counted.astype(np.int64)
        every = np.arange(cycles[-1] + 1)
        times = np.interp(every, cycles, self.stamps_ns - self.stamps_ns[0])
        filled = _between(
            self.stamps_ns, self.reference, self.stamps_ns[0] + np.rint(times).astype(np.int64)
        )
        return period_ns, cycles, filled

    def _require_whole(self) -> None:
        if self.longest_gap_ns > MOST_MISSING_NS:
            after = int(self.stamps_ns[int(np.argmax(np.diff(self.stamps_ns)))])
            raise ConfigurationError(
                f"the recording has no executed reference for {self.longest_gap_ns * 1e-6:.0f} ms "
                f"after stamp {after} ns; at most {MOST_MISSING_NS * 1e-6:g} ms are filled in: "
                "record it again on a computer that is less busy"
            )


@dataclass(frozen=True, eq=False)
class MeasuredStates:
    """Joint states as they were published, usually every 20 ms.

    Attributes:
        names: Of the joints that every message has, in their order.
        stamps_ns: In the robot server's clock, rising. Shape (m,).
        position: rad, m for fingers. Shape (m, len(names)).
        velocity: rad/s, m/s. Shape (m, len(names)); NaN where a message tells none.
        effort: N m, N. Shape (m, len(names)); likewise.
    """

    names: tuple[str, ...]
    stamps_ns: NDArray[np.int64]
    position: Array
    velocity: Array
    effort: Array


def executed_reference(recording: Recording) -> ExecutedReference:
    """The reference that was executed in a recording.

    Raises:
        ConfigurationError: It has none, as those of older versions and of other robots, or what
            it has cannot be read, or is of two robots.
    """
    states = _decoded(recording, YUMI_CONTROLLER_STATE, decode_controller_state)
    names = states[0].names
    if any(state.names != names for state in states):
        raise ConfigurationError(f"{recording.path} has executed references of different joints")
    states = _in_order(states)
    reference = JointTrajectory(
        *(np.array([state.reference[part] for state in states]) for part in range(3))
    )
    measured = (
        np.array([getattr(state, part) for state in states])
        for part in ("position", "velocity", "effort")
    )
    return ExecutedReference(names, _stamps(states), reference, *measured)


def measured_states(recording: Recording) -> MeasuredStates:
    """The joint states of a recording.

    Raises:
        ConfigurationError: It has none, or what it has cannot be read.
    """
    states = _in_order(_decoded(recording, YUMI_JOINT_STATES, decode_joint_states))
    common = set(states[0].names).intersection(*(state.names for state in states))
    names = tuple(name for name in states[0].names if name in common)
    arrays = []
    for part in ("position", "velocity", "effort"):
        rows = np.full((len(states), len(names)), np.nan)
        for row, state in zip(rows, states, strict=True):
            values = getattr(state, part)
            if len(values):
                row[:] = values[[state.names.index(name) for name in names]]
        arrays.append(rows)
    return MeasuredStates(names, _stamps(states), *arrays)


def _decoded(recording: Recording, topic: Topic, decode: Callable[[bytes], _State]) -> list[_State]:
    """All messages on a topic of who is believed there; at least one."""
    messages = believed_part(recording).recording.messages.get(topic.name, ())
    if not messages:
        raise ConfigurationError(
            f"{recording.path} has no messages on {topic.name}; record the run with robot server "
            "and recorder of this version"
        )
    try:
        return [decode(message.payload) for message in messages]
    except TransportError as error:
        raise ConfigurationError(f"{recording.path}, {topic.name}: {error}") from error


def _in_order(states: Sequence[_State]) -> list[_State]:
    """By stamp, each stamp once: time may stand still, and a state then be told again."""
    newest = {state.stamp_ns: state for state in states}
    return [newest[stamp_ns] for stamp_ns in sorted(newest)]


def _stamps(states: Sequence[_State]) -> NDArray[np.int64]:
    return np.array([state.stamp_ns for state in states], dtype=np.int64)


def _between(
    stamps_ns: NDArray[np.int64], samples: JointTrajectory, times_ns: NDArray[np.int64]
) -> JointTrajectory:
    """The motion at any times within the stamps.

    As `trajectory.JointTrajectory.at`, for steps of different length: with h the step, u the part
    of it that is over, and dq, dv, da what its end differs by from its beginning continued at
    constant acceleration,

        q(u) = q0 + v0 h u + a0 h^2 u^2 / 2 + c3 u^3 + c4 u^4 + c5 u^5
        c3 = 10 dq - 4 h dv + h^2 da / 2,  c4 = -15 dq + 7 h dv - h^2 da,
        c5 = 6 dq - 3 h dv + h^2 da / 2
    """
    if len(stamps_ns) < 2:
        return samples
    row = np.clip(np.searchsorted(stamps_ns, times_ns, side="right") - 1, 0, len(stamps_ns) - 2)
    step_ns = stamps_ns[row + 1] - stamps_ns[row]
    h = (step_ns / 1e9)[:, None]
    u = ((times_ns - stamps_ns[row]) / step_ns)[:, None]
    q, v, a = samples.q[row], samples.v[row], samples.a[row]
    dq = samples.q[row + 1] - (q + h * (v + 0.5 * h * a))
    dv = h * (samples.v[row + 1] - (v + h * a))
    da = h * h * (samples.a[row + 1] - a)
    c3 = 10.0 * dq - 4.0 * dv + 0.5 * da
    c4 = -15.0 * dq + 7.0 * dv - da
    c5 = 6.0 * dq - 3.0 * dv + 0.5 * da
    s = u * h
    return JointTrajectory(
        q + s * (v + 0.5 * s * a) + u**3 * (c3 + u * (c4 + u * c5)),
        v + s * a + u**2 / h * (3.0 * c3 + u * (4.0 * c4 + u * (5.0 * c5))),
        a + u / (h * h) * (6.0 * c3 + u * (12.0 * c4 + u * (20.0 * c5))),
    )
