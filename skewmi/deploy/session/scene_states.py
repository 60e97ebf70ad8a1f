"""What the session knows of the scene, and how old that is."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence

from skewmi.deploy.wire.messages import JointStates, decode_joint_states
from skewmi.deploy.wire.transport import LatestReader, Sample
from skewmi.errors import SkewmiError
from skewmi.policy_io import TIME_FIELD

MAX_SCENE_AGE_S = 0.200
"""Scene states older than this stop the arm; with a long lead they may be older."""

_ARM_FIELDS = {"hand_x", "hand_y", "hand_z", "gripper", TIME_FIELD}
"""Observation fields that joint states and clock tell; the rest is the scene's."""


class StaleStateError(SkewmiError):
    """Joint or scene states are too old to act upon."""


class SceneStates:
    """The newest values of the observation fields that the scene tells.

    A message need not tell all of them, and one may fall silent while others go on, as where a
    camera has lost sight of it. So each field has an age of its own.

    Args:
        reader: Of `topics.YUMI_SCENE_STATES`, of those who are believed. It keeps all.
        scene_fields: Observation field of each joint in the scene states, by the joint's name.
        observation_names: Fields of the policy's observation.
        lock_step: Take states in order, up to the stamp that is asked for; none is ever too old,
            but a field may be, if states go on without it.
        max_age_s: Of a scene state, before the arm stops, s.
    """

    def __init__(
        self,
        reader: LatestReader,
        scene_fields: Mapping[str, str],
        observation_names: tuple[str, ...],
        *,
        lock_step: bool,
        max_age_s: float = MAX_SCENE_AGE_S,
    ) -> None:
        self._max_age_s = max_age_s
        self._reader = reader
        self._field_of = scene_fields
        self._needed = set(observation_names) - _ARM_FIELDS
        self._lock_step = lock_step
        self._queue: list[tuple[JointStates, int]] = []
        self._heard = False
        self._stamp_ns = 0
        self._times_ns: dict[str, tuple[int, int]] = {}
        """By observation field: stamp of the state that told it last, and when that came, ns."""
        self.values: dict[str, float] = {}
        """By observation field, in the field's unit."""

    def take(self, stamp_ns: int) -> None:
        """Take in the states up to a stamp; the server sends them before the joints'.

        Args:
            stamp_ns: Of the arm's state; in real time all that has come is taken.

        Raises:
            TransportError: A state is malformed.
        """
        samples = self._reader.drain()
        self._heard = self._heard or bool(samples)
        self._queue += self._decode(samples) if self._lock_step else self._decode_newest(samples)
        while self._queue and (self._queue[0][0].stamp_ns <= stamp_ns or not self._lock_step):
            message, received_ns = self._queue.pop(0)
            self._stamp_ns = message.stamp_ns
            for field, value in self._told_by(message).items():
                self.values[field] = value
                self._times_ns[field] = message.stamp_ns, received_ns

    def forget(self) -> None:
        """Drop whatever has been received but not taken in."""
        self._reader.drain()
        self._queue.clear()

    def begin_anew(self) -> None:
        """Know nothing of the scene: what comes next is newer than this call."""
        self.forget()
        self.values.clear()
        self._times_ns.clear()
        self._heard = False

    def missing(self) -> list[str]:
        """Fields that the policy needs and that no scene state has told."""
        return sorted(self._needed - set(self.values))

    def check(self, arm_stamp_ns: int | None) -> None:
        """Refuse to act on a scene that has not been heard of for too long.

        Args:
            arm_stamp_ns: Of the newest arm state, if there is one.

        Raises:
            StaleStateError: Fields that the policy needs are missing or too old.
        """
        if self.missing():
            others = self._reader.others()
            hint = " (a camera of yours is named by --scene-from)" if others else ""
            if not self._heard:
                raise StaleStateError(
                    f"no scene state came, which the policy needs for {self.missing()}"
                    f"{others}{hint}"
                )
            raise StaleStateError(f"the scene states lack {self.missing()}{others}{hint}")
        ages_s = self._ages_s(arm_stamp_ns)
        old = sorted(field for field, age_s in ages_s.items() if age_s > self._max_age_s)
        if old:
            raise StaleStateError(
                f"the scene state is {1e3 * max(ages_s.values()):.0f} ms old for {old}; at most "
                f"{1e3 * self._max_age_s:.0f} ms are allowed{self._reader.others()}"
            )

    def _ages_s(self, arm_stamp_ns: int | None) -> dict[str, float]:
        """Of the fields that the policy needs, s."""
        times_ns = {field: self._times_ns[field] for field in self._needed}
        if self._lock_step:
            return {field: (self._stamp_ns - stamp) / 1e9 for field, (stamp, _) in times_ns.items()}
        now_ns = time.monotonic_ns()
        ages_ns = {field: now_ns - received for field, (_, received) in times_ns.items()}
        if arm_stamp_ns is not None:
            # A publisher that hangs may repeat an old state for ever: its stamp tells.
            for field, (stamp, _) in times_ns.items():
                ages_ns[field] = max(ages_ns[field], arm_stamp_ns - stamp)
        return {field: age_ns / 1e9 for field, age_ns in ages_ns.items()}

    def _decode(self, samples: Sequence[Sample]) -> list[tuple[JointStates, int]]:
        """States, and when they came, ns."""
        return [(decode_joint_states(s.payload), s.received_ns) for s in samples]

    def _decode_newest(self, samples: Sequence[Sample]) -> list[tuple[JointStates, int]]:
        """The newest states that together tell what is needed, in their order.

        As a rule that is the last one alone, however many have come while we were busy.
        """
        found: list[tuple[JointStates, int]] = []
        lacking = set(self._needed)
        for sample in reversed(samples):
            found += self._decode([sample])
            lacking -= set(self._told_by(found[-1][0]))
            if not lacking:
                break
        return found[::-1]

    def _told_by(self, message: JointStates) -> dict[str, float]:
        """Values by observation field. What is no number tells nothing: it was not measured."""
        return {
            self._field_of[name]: float(value)
            for name, value in zip(message.names, message.position, strict=True)
            if name in self._field_of and math.isfinite(value)
        }
