"""From messages to what they show: all of a recording at once, or piece by piece as they come.

Both ways go through `RunAssembler`, so that a live view shows what the replay will show.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from skewmi.deploy.recording.reader import Recording
from skewmi.deploy.replay.buffers import NS_PER_S, CommandBuffer, SeriesBuffer
from skewmi.deploy.replay.data import (
    REGULAR_S,
    Motion,
    Run,
    Series,
    Subject,
    no_motion,
    tracking_error,
)
from skewmi.deploy.replay.timing import TimingBuffer
from skewmi.deploy.replay.told import ToldBuffer
from skewmi.deploy.wire import messages, topics
from skewmi.deploy.wire.messages import JointStates, Status, refused_stamps
from skewmi.errors import ConfigurationError, TransportError
from skewmi.robot_models import yumi
from skewmi.success import first_success_step, inside_region
from skewmi.trajectory import TrajectoryChunk

_COMPARED_S = 10.0
"""Measurements wait for their command for so long, s: in lock-step much happens at once."""


def understand(recording: Recording) -> Run:
    """Decode a recording.

    Raises:
        ConfigurationError: It holds neither commands nor states of our arm.
    """
    assembler = RunAssembler(Subject.from_metadata(recording.metadata, str(recording.path)))
    for topic, recorded in recording.messages.items():
        for message in recorded:
            assembler.feed(topic, message.payload, message.publish_time_ns)
    run = assembler.take(final=True)
    if run is None:
        raise ConfigurationError(
            f"{recording.path} holds neither {topics.YUMI_TRAJECTORY.name} nor "
            f"{topics.YUMI_JOINT_STATES.name} of the right arm; its topics are "
            f"{', '.join(sorted(recording.messages))}"
        )
    return run


class RunAssembler:
    """Takes messages in and hands out stretches of the run.

    Args:
        subject: What is known of the run.
    """

    def __init__(self, subject: Subject) -> None:
        self.subject = subject
        self.malformed = 0
        self._origin_ns: int | None = None
        self._names = yumi.joint_names("right")
        self._joints: list[JointStates] = []
        self._command = CommandBuffer(subject.base)
        self._series = {
            topic.name: SeriesBuffer()
            for topic in (
                topics.YUMI_SCENE_STATES,
                topics.POLICY_OBSERVATION,
                topics.POLICY_ACTION,
            )
        }
        self._fingers = SeriesBuffer(only=yumi.finger_names("right")[:1])
        self._left = SeriesBuffer(only=yumi.joint_names("left"))
        self._torque = SeriesBuffer(only=self._names, quantity="effort")
        self._told = ToldBuffer()
        self._timing = TimingBuffer(lock_step=subject.lock_step)
        self._statuses: list[Status] = []
        self._last_message: dict[str, str] = {}
        self._episode: list[tuple[float, bool]] = []
        self._succeeded = False
        self._lately = no_motion(), no_motion()
        self._duration_s = 0.0
        self._seen_ns: int | None = None
        self._handlers: dict[str, tuple[Callable[[bytes], Any], Callable[[Any], None]]] = {
            topics.YUMI_TRAJECTORY.name: (messages.decode_chunk, self._take_chunk),
            topics.YUMI_JOINT_STATES.name: (messages.decode_joint_states, self._take_joints),
            topics.YUMI_STATUS.name: (messages.decode_status, self._take_status),
            **{
                name: (messages.decode_joint_states, series.add)
                for name, series in self._series.items()
            },
        }

    def feed(self, topic: str, payload: bytes, sent_ns: int | None = None) -> None:
        """Take in one message; each topic's in order. Others than ours are ignored.

        Args:
            topic: Its name.
            payload: What travelled.
            sent_ns: The sender's wall clock, if it is known.
        """
        stamp_ns = None if sent_ns is None else messages.peek_stamp_ns(payload)
        if sent_ns is not None and stamp_ns is not None:
            self._timing.add(topic, stamp_ns, sent_ns)
        if topic not in self._handlers:
            return
        decode, handle = self._handlers[topic]
        try:
            message = decode(payload)
        except TransportError:
            self.malformed += 1
            return
        handle(message)

    def take(self, *, final: bool = False) -> Run | None:
        """What has happened since the last call.

        Args:
            final: Nothing more will come: the last chunk is shown to its end. Otherwise it is
                shown up to what was measured by the last call, as it may still be replaced.

        Returns:
            The stretch, perhaps empty; None before the first command or state of our arm.
        """
        stamps = [joints.stamp_ns for joints in self._joints]
        if self._origin_ns is None:
            known = stamps + self._command.stamps_ns
            if not known:
                return None
            self._origin_ns = min(known)
        if final:
            self._command.advance(None)
        elif self._seen_ns is not None:
            # Not up to the newest: topics are looked at one after the other, so that a state may
            # be seen before a chunk that was sent earlier. It is seen before the next call.
            self._command.advance(self._seen_ns)
        self._seen_ns = stamps[-1] if stamps else self._seen_ns
        origin_ns = self._origin_ns
        measured, commanded = self._measured(origin_ns), self._command.take(origin_ns)
        observation = self._series[topics.POLICY_OBSERVATION.name].take(origin_ns)
        ends = [float(m.time_s[-1]) for m in (measured, commanded) if len(m.time_s)]
        self._duration_s = max((self._duration_s, *ends))
        run = Run(
            subject=self.subject,
            commanded=commanded,
            measured=measured,
            fingers=self._fingers.take(origin_ns),
            left=self._left.take(origin_ns),
            scene=self._series[topics.YUMI_SCENE_STATES.name].take(origin_ns),
            observation=observation,
            action=self._series[topics.POLICY_ACTION.name].take(origin_ns),
            error=self._error(commanded, measured),
            events=self._events(origin_ns),
            success_s=self._successes(observation),
            malformed=self.malformed,
            duration_s=self._duration_s,
            torque=self._torque.take(origin_ns),
            forces=self._told.take_forces(origin_ns),
            placements=self._told.take_poses(origin_ns),
            intervals=self._timing.take_intervals(origin_ns),
            spare=self._timing.take_spare(origin_ns, final=final),
            counts=self._told.take_counts(origin_ns),
        )
        self._joints, self._statuses = [], []
        return run

    def _take_chunk(self, chunk: TrajectoryChunk) -> None:
        if chunk.joint_names == self._names and len(chunk.trajectory):
            self._command.add(chunk)

    def _take_joints(self, joints: JointStates) -> None:
        if set(self._names) <= set(joints.names):
            self._joints.append(joints)
            self._fingers.add(joints)
            self._left.add(joints)
            self._torque.add(joints)

    def _take_status(self, status: Status) -> None:
        # States are repeated for those who come late; a refusal is told once.
        news = self._last_message.get(status.name) != status.message
        try:
            refused_ns = refused_stamps(status)
            self._told.add(status)
        except TransportError:
            self.malformed += 1
            return
        for stamp_ns in refused_ns:
            self._command.refuse(stamp_ns)
        if news or status.values.get("refusal"):
            self._last_message[status.name] = status.message
            self._statuses.append(status)

    def _measured(self, origin_ns: int) -> Motion:
        joints = self._joints
        if not joints:
            return no_motion()
        time_s = np.array([(j.stamp_ns - origin_ns) / NS_PER_S for j in joints])
        order = [[j.names.index(name) for name in self._names] for j in joints]
        q = np.array([j.position[o] for j, o in zip(joints, order, strict=True)])
        v = q[:, :0]
        if all(len(j.velocity) for j in joints):
            v = np.array([j.velocity[o] for j, o in zip(joints, order, strict=True)])
        return Motion(time_s, q, v, q[:, :0], q[:, :0], self.subject.base)

    def _error(self, commanded: Motion, measured: Motion) -> Series:
        """Tracking error of the measurements whose command is known by now."""
        before, waiting = self._lately
        commanded, measured = _joined(before, commanded), _joined(waiting, measured)
        error = tracking_error(commanded, measured)
        # Whichever of the two is ahead waits for the other: measurements after the last known
        # command, commands from just before the last measurement on.
        waits = np.ones(len(measured.time_s), dtype=np.bool_)
        kept = np.ones(len(commanded.time_s), dtype=np.bool_)
        if len(commanded.time_s):
            waits &= measured.time_s > commanded.time_s[-1]
            kept &= commanded.time_s > commanded.time_s[-1] - _COMPARED_S
        if len(measured.time_s):
            waits &= measured.time_s > measured.time_s[-1] - _COMPARED_S
            kept &= commanded.time_s > measured.time_s[-1] - REGULAR_S
            kept[-1:] = True
        self._lately = _rows(commanded, kept), _rows(measured, waits)
        return error

    def _events(self, origin_ns: int) -> tuple[tuple[float, Status], ...]:
        # A session that has not heard the robot server's clock yet stamps zero: years before.
        return tuple(
            (max(0.0, (status.stamp_ns - origin_ns) / NS_PER_S), status)
            for status in self._statuses
        )

    def _successes(self, observation: Series) -> tuple[float, ...]:
        """End of the first sufficient stay in the reward region, for each episode."""
        layout = self.subject.layout
        if layout is None or observation.names != layout.observation_names:
            return ()
        if not len(observation.time_s) or not layout.reward_region:
            return ()
        found = []
        inside = inside_region(layout, observation.values)
        for time_s, is_inside in zip(observation.time_s.tolist(), inside.tolist(), strict=True):
            # Observations come once per control step; a pause or a clock set back begins an
            # episode.
            step_s = time_s - self._episode[-1][0] if self._episode else 0.0
            if not -1e-9 <= step_s <= 1.5 * layout.control_dt:
                self._episode, self._succeeded = [], False
            self._episode.append((time_s, is_inside))
            # The first observation is the start, not the end of a step.
            steps = np.array([was for _, was in self._episode[1:]], dtype=np.bool_)
            if not self._succeeded and is_inside and int(first_success_step(layout, steps)) > 0:
                self._succeeded = True
                found.append(time_s)
        return tuple(found)


def _joined(first: Motion, second: Motion) -> Motion:
    """Times and joint angles of two motions, one after the other."""
    if not len(first.time_s):
        return second
    q = np.concatenate([first.q, second.q])
    nothing = q[:, :0]
    time_s = np.concatenate([first.time_s, second.time_s])
    return Motion(time_s, q, nothing, nothing, nothing, first.base)


def _rows(motion: Motion, rows: Any) -> Motion:
    time_s, q, v = motion.time_s[rows], motion.q[rows], motion.v[rows]
    return Motion(time_s, q, v, motion.a[rows], motion.jerk[rows], motion.base)
