"""What the session knows of the scene, and how old that is."""

from __future__ import annotations

import time
from collections.abc import Mapping

from skewmi.deploy.wire.messages import JointStates, decode_joint_states
from skewmi.deploy.wire.transport import LatestReader
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

    Args:
        reader: Of `topics.YUMI_SCENE_STATES`, of those who are believed. It keeps all.
        scene_fields: Observation field of each joint in the scene states, by the joint's name.
        observation_names: Fields of the policy's observation.
        lock_step: Take states in order, up to the stamp that is asked for; none is ever too old.
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
        self._queue: list[JointStates] = []
        self._received_ns = 0
        self._stamp_ns = 0
        self.values: dict[str, float] = {}
        """By observation field, in the field's unit."""

    def take(self, stamp_ns: int) -> None:
        """Take in the states up to a stamp; the server sends them before the joints'."""
        samples = self._reader.drain()
        for sample in samples if self._lock_step else samples[-1:]:
            self._queue.append(decode_joint_states(sample.payload))
            self._received_ns = sample.received_ns
        while self._queue and (self._queue[0].stamp_ns <= stamp_ns or not self._lock_step):
            message = self._queue.pop(0)
            self._stamp_ns = message.stamp_ns
            for name, value in zip(message.names, message.position, strict=True):
                if name in self._field_of:
                    self.values[self._field_of[name]] = float(value)

    def forget(self) -> None:
        """Drop whatever has been received but not taken in."""
        self._reader.drain()
        self._queue.clear()

    def begin_anew(self) -> None:
        """Know nothing of the scene: what comes next is newer than this call."""
        self.forget()
        self.values.clear()
        self._received_ns = 0

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
            if not self._received_ns:
                raise StaleStateError(
                    f"no scene state came, which the policy needs for {self.missing()}"
                    f"{others}{hint}"
                )
            raise StaleStateError(f"the scene states lack {self.missing()}{others}{hint}")
        age_s = (time.monotonic_ns() - self._received_ns) / 1e9
        if arm_stamp_ns is not None:
            # A publisher that hangs may repeat an old state for ever: its stamp tells.
            age_s = max(age_s, (arm_stamp_ns - self._stamp_ns) / 1e9)
        if self._needed and not self._lock_step and age_s > self._max_age_s:
            raise StaleStateError(
                f"the scene state is {1e3 * age_s:.0f} ms old; at most "
                f"{1e3 * self._max_age_s:.0f} ms are allowed{self._reader.others()}"
            )
