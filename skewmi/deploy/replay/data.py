"""What a recording shows, as arrays on one time axis: seconds of the endpoint's clock."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from skewmi.deploy.recording.reader import LAYOUT, LIMITS, SCENE, Recording
from skewmi.deploy.recording.scene_geometry import SceneGeometry
from skewmi.deploy.wire import messages, topics
from skewmi.deploy.wire.messages import JointStates, Status, TrajectoryChunk
from skewmi.errors import ConfigurationError, TransportError
from skewmi.policy_io import PolicyLayout, first_success_step, inside_region
from skewmi.robot_models import frames, yumi
from skewmi.robot_models.kinematics import ArmKinematics

Array = NDArray[np.float64]

_NS_PER_S = 1e9
_Message = TypeVar("_Message")


@dataclass(frozen=True)
class Motion:
    """Joint motion over time."""

    time_s: Array
    """Shape (n,)."""
    q: Array
    """rad. Shape (n, 7)."""
    v: Array
    """rad/s. Shape (n, 7); (n, 0) if unknown."""
    a: Array
    """rad/s^2. Shape (n, 7); (n, 0) if unknown."""
    jerk: Array
    """rad/s^3, over the interval that ends at each sample. Shape (n, 7) or (n, 0)."""

    @property
    def hand_w(self) -> Array:
        """Flange in world, m. Shape (n, 3)."""
        position, _ = ArmKinematics("right").forward(self.q)
        return np.asarray(position + frames.BASE_IN_WORLD)


_REGULAR_S = 0.010
"""Commanded samples closer than this belong to one uninterrupted motion, s."""


@dataclass(frozen=True)
class Series:
    """Named numbers over time."""

    time_s: Array
    names: tuple[str, ...]
    values: Array
    """Shape (n, len(names))."""


@dataclass(frozen=True)
class Run:
    """A recording, understood."""

    commanded: Motion
    measured: Motion
    fingers: Series
    scene: Series
    observation: Series
    action: Series
    events: tuple[tuple[float, Status], ...]
    """Transitions: (time s, status); repeats of the same message are left out."""
    layout: PolicyLayout | None
    limits: dict[str, Array]
    """Per joint, by name: position_lower, position_upper, velocity, acceleration, jerk."""
    geometry: SceneGeometry | None
    success_s: tuple[float, ...]
    """When the reward region had been held long enough, once per episode at most."""
    malformed: int
    """Messages that could not be decoded, left out."""
    duration_s: float


def understand(recording: Recording) -> Run:
    """Decode a recording.

    Raises:
        ConfigurationError: It holds neither commands nor states of our arm.
    """
    decoder = _Decoder(recording)
    chunks = decoder.all(topics.YUMI_TRAJECTORY.name, messages.decode_chunk)
    joints = decoder.all(topics.YUMI_JOINT_STATES.name, messages.decode_joint_states)
    scene = decoder.all(topics.YUMI_SCENE_STATES.name, messages.decode_joint_states)
    observations = decoder.all(topics.POLICY_OBSERVATION.name, messages.decode_joint_states)
    actions = decoder.all(topics.POLICY_ACTION.name, messages.decode_joint_states)
    statuses = decoder.all(topics.YUMI_STATUS.name, messages.decode_status)
    names = yumi.joint_names("right")
    chunks = [c for c in chunks if c.joint_names == names and len(c.q)]
    joints = [j for j in joints if set(names) <= set(j.names)]
    if not chunks and not joints:
        raise ConfigurationError(
            f"{recording.path} holds neither {topics.YUMI_TRAJECTORY.name} nor "
            f"{topics.YUMI_JOINT_STATES.name} of the right arm; its topics are "
            f"{', '.join(sorted(recording.messages))}"
        )
    stamps = [c.stamp_ns for c in chunks] + [j.stamp_ns for j in joints]
    origin_ns = min(stamps)
    layout = _layout(recording)
    observation = _series(observations, origin_ns)
    measured = _measured(joints, names, origin_ns)
    commanded = _commanded(chunks, origin_ns)
    fingers = [
        name for name in yumi.finger_names("right")[:1] if joints and name in joints[0].names
    ]
    ends = [m.time_s[-1] for m in (measured, commanded) if len(m.time_s)]
    return Run(
        commanded=commanded,
        measured=measured,
        fingers=_series(joints, origin_ns, only=tuple(fingers)),
        scene=_series(scene, origin_ns),
        observation=observation,
        action=_series(actions, origin_ns),
        events=_events(statuses, origin_ns),
        layout=layout,
        limits=_limits(recording),
        geometry=_geometry(recording),
        success_s=_successes(layout, observation),
        malformed=decoder.malformed,
        duration_s=float(max(ends)),
    )


class _Decoder:
    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self.malformed = 0

    def all(self, topic: str, decode: Callable[[bytes], _Message]) -> list[_Message]:
        decoded = []
        for message in self._recording.messages.get(topic, ()):
            try:
                decoded.append(decode(message.payload))
            except TransportError:
                self.malformed += 1
        return decoded


def _commanded(chunks: Sequence[TrajectoryChunk], origin_ns: int) -> Motion:
    """The command as executed: each chunk until the next one is due, the last to its end."""
    times, parts = [], []
    for index, chunk in enumerate(chunks):
        due_ns = chunk.stamp_ns + chunk.time_from_start_ns
        later = [c.stamp_ns for c in chunks[index + 1 : index + 2]]
        keep = due_ns < later[0] if later else np.ones(len(due_ns), dtype=np.bool_)
        times.append(due_ns[keep])
        parts.append(np.stack([chunk.q[keep], chunk.v[keep], chunk.a[keep]]))
    if not parts:
        return _no_motion()
    time_ns = np.concatenate(times)
    q, v, a = np.concatenate(parts, axis=1)
    # An interrupted stream resumes with stamps beyond the last chunk's end: no jerk across it.
    step_s = np.diff(time_ns, prepend=time_ns[0]) / _NS_PER_S
    regular = (step_s > 0) & (step_s < _REGULAR_S)
    jerk = np.diff(a, axis=0, prepend=a[:1]) / np.where(regular, step_s, np.inf)[:, None]
    return Motion((time_ns - origin_ns) / _NS_PER_S, q, v, a, jerk)


def tracking_error(run: Run) -> tuple[Array, Array]:
    """Commanded minus measured hand, while a command is in force.

    Between runs of chunks nothing is commanded, and a simulated arm may be put elsewhere.

    Returns:
        Times, s, shape (n,); differences in world, m, shape (n, 3).
    """
    commanded, measured = run.commanded, run.measured
    if not (len(commanded.time_s) and len(measured.time_s)):
        return np.zeros(0), np.zeros((0, 3))
    after = np.searchsorted(commanded.time_s, measured.time_s)
    last = len(commanded.time_s) - 1
    gap = commanded.time_s[np.minimum(after, last)] - commanded.time_s[np.maximum(after - 1, 0)]
    during = (after > 0) & (after <= last) & (gap < _REGULAR_S)
    time_s, hand = measured.time_s[during], commanded.hand_w
    at_measured = [np.interp(time_s, commanded.time_s, hand[:, axis]) for axis in range(3)]
    return time_s, np.column_stack(at_measured) - measured.hand_w[during]


def _measured(joints: Sequence[JointStates], names: tuple[str, ...], origin_ns: int) -> Motion:
    if not joints:
        return _no_motion()
    time_s = np.array([(j.stamp_ns - origin_ns) / _NS_PER_S for j in joints])
    order = [[j.names.index(name) for name in names] for j in joints]
    q = np.array([j.position[o] for j, o in zip(joints, order, strict=True)])
    known = all(len(j.velocity) for j in joints)
    v = np.array([j.velocity[o] for j, o in zip(joints, order, strict=True)]) if known else q[:, :0]
    return Motion(time_s, q, v, q[:, :0], q[:, :0])


def _no_motion() -> Motion:
    nothing = np.zeros((0, 7))
    return Motion(np.zeros(0), nothing, nothing, nothing, nothing)


def _series(
    states: Sequence[JointStates], origin_ns: int, only: tuple[str, ...] | None = None
) -> Series:
    """Positions of the messages that name the same things as the first one."""
    if not states:
        return Series(np.zeros(0), (), np.zeros((0, 0)))
    names = states[0].names
    columns = [i for i, name in enumerate(names) if only is None or name in only]
    same = [s for s in states if s.names == names]
    return Series(
        np.array([(s.stamp_ns - origin_ns) / _NS_PER_S for s in same]),
        tuple(names[i] for i in columns),
        np.array([s.position[columns] for s in same]),
    )


def _events(statuses: Sequence[Status], origin_ns: int) -> tuple[tuple[float, Status], ...]:
    events, last = [], dict[str, str]()
    for status in statuses:
        if last.get(status.name) != status.message:
            last[status.name] = status.message
            events.append(((status.stamp_ns - origin_ns) / _NS_PER_S, status))
    return tuple(events)


def _successes(layout: PolicyLayout | None, observation: Series) -> tuple[float, ...]:
    """End of the first sufficient stay in the reward region, for each episode."""
    if layout is None or observation.names != layout.observation_names:
        return ()
    if not len(observation.time_s) or not layout.reward_region:
        return ()
    inside = inside_region(layout, observation.values)
    # Observations come once per control step; a pause or a clock set back begins an episode.
    step_s = np.diff(observation.time_s, prepend=observation.time_s[0])
    borders = np.flatnonzero((step_s > 1.5 * layout.control_dt) | (step_s < 0.0))
    found = []
    for episode in np.split(np.arange(len(inside)), borders):
        # The first observation is the start, not the end of a step.
        step = int(first_success_step(layout, inside[episode][1:]))
        if step > 0:
            found.append(float(observation.time_s[episode[step]]))
    return tuple(found)


def _layout(recording: Recording) -> PolicyLayout | None:
    text = recording.metadata.get(LAYOUT)
    return None if text is None else PolicyLayout.from_json(text)


def _limits(recording: Recording) -> dict[str, Array]:
    text = recording.metadata.get(LIMITS)
    if text is None:
        return {}
    try:
        limits = {
            name: np.array(value, dtype=np.float64) for name, value in json.loads(text).items()
        }
    except (ValueError, TypeError, AttributeError) as error:
        raise ConfigurationError(f"limits in {recording.path} are unreadable: {error}") from error
    return {name: value for name, value in limits.items() if value.shape == (7,)}


def _geometry(recording: Recording) -> SceneGeometry | None:
    text = recording.metadata.get(SCENE)
    return None if text is None else SceneGeometry.from_json(text)
