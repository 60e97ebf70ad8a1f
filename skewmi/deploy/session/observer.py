"""What the session knows of the world: newest joint and scene states, and how old they are."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from skewmi.deploy.wire import topics
from skewmi.deploy.wire.messages import JointStates, decode_joint_states
from skewmi.deploy.wire.transport import LatestReader, Link, Sample
from skewmi.errors import SkewmiError, TransportError
from skewmi.policy_io import TIME_FIELD, Array, PolicyLayout, assemble_observation
from skewmi.robot_models import frames
from skewmi.robot_models.kinematics import ArmKinematics

MAX_JOINT_AGE_S = 0.100
"""Joint states older than this stop the arm."""
MAX_SCENE_AGE_S = 0.200
"""Scene states older than this stop the arm."""
LOCK_STEP_PATIENCE_S = 30.0
"""In lock-step nothing is ever old; a robot server that says nothing for so long is gone."""

_ARM_FIELDS = {"hand_x", "hand_y", "hand_z", "gripper", TIME_FIELD}
"""Observation fields that joint states and clock tell; the rest is the scene's."""

_FIRST_STATES = 5
"""Joint states that may come before the first scene state."""

_POLL_S = 250e-6
_EARLY_S = 0.002


class StaleStateError(SkewmiError):
    """Joint or scene states are too old to act upon."""


@dataclass(frozen=True)
class ArmState:
    """One joint state message, taken apart.

    Attributes:
        stamp_ns: The robot server's clock when it was measured.
        received_ns: Our monotonic clock when it arrived.
        q: Measured arm joints, chain order, rad. Shape (7,).
        v: Measured velocities, rad/s. Shape (7,).
        gripper: Measured travel of each finger from closed, m.
    """

    stamp_ns: int
    received_ns: int
    q: Array
    v: Array
    gripper: float


class Observer:
    """Receives states and turns them into policy observations.

    Args:
        link: An open session.
        layout: Of the policy.
        joint_names: The arm's joints in chain order.
        finger_name: The joint whose position is the gripper's opening.
        scene_fields: Observation field of each joint in the scene states, by the joint's name.
        lock_step: Take every state in order, however old, instead of the newest.
        state_period_s: How often the robot server publishes, s.
        on_repeat: Called when the robot server repeats a state because in lock-step time stands
            still: the place to find out why.
    """

    def __init__(
        self,
        link: Link,
        layout: PolicyLayout,
        joint_names: tuple[str, ...],
        finger_name: str,
        scene_fields: Mapping[str, str],
        *,
        lock_step: bool,
        state_period_s: float,
        on_repeat: Callable[[], None] | None = None,
    ) -> None:
        self._on_repeat = on_repeat
        self._layout = layout
        self._joint_names = joint_names
        self._finger_name = finger_name
        self._lock_step = lock_step
        self._period_ns = round(state_period_s * 1e9)
        self._joints: LatestReader = link.subscribe(
            topics.YUMI_JOINT_STATES, depth=None if lock_step else 1
        )
        self._scene: LatestReader = link.subscribe(
            topics.YUMI_SCENE_STATES, depth=None if lock_step else 1
        )
        self._kinematics = ArmKinematics("right")
        self._arm: ArmState | None = None
        self._queue: list[Sample] = []
        self._scene_queue: list[JointStates] = []
        self._scene_values: dict[str, float] = {}
        self._scene_received_ns = 0
        self._scene_stamp_ns = 0
        self._fields = scene_fields
        self._scene_fields = set(layout.observation_names) - _ARM_FIELDS
        self._order: tuple[tuple[str, ...], list[int], int] | None = None

    def next_state(self) -> ArmState:
        """Wait for a joint state that is newer than the last one returned.

        Sleeps until shortly before it is due: no busy waiting.

        Raises:
            StaleStateError: None came in time.
            TransportError: A state is malformed.
        """
        last = self._arm
        patience_s = LOCK_STEP_PATIENCE_S if self._lock_step else MAX_JOINT_AGE_S
        started_ns = time.monotonic_ns()
        since_ns = started_ns if last is None else max(last.received_ns, 0)
        if last is not None and not self._lock_step:
            early_s = (last.received_ns + self._period_ns - started_ns) / 1e9 - _EARLY_S
            if early_s > 0.0:
                time.sleep(early_s)
        while True:
            state = self._take()
            if state is not None and (last is None or state.stamp_ns > last.stamp_ns):
                self._arm = state
                self._take_scene(state.stamp_ns)
                return state
            if state is not None and self._on_repeat is not None:
                self._on_repeat()
            waited_s = (time.monotonic_ns() - since_ns) / 1e9
            if state is None and waited_s > patience_s:
                raise StaleStateError(
                    f"no new joint state for {1e3 * waited_s:.0f} ms; at most "
                    f"{1e3 * patience_s:.0f} ms are allowed"
                )
            if state is None:
                time.sleep(20e-6 if self._lock_step else _POLL_S)

    def fresh_state(self) -> ArmState:
        """Forget everything, and wait for a joint state with the scene state that belongs to it.

        Raises:
            StaleStateError: One of them does not come.
            TransportError: A state is malformed.
        """
        self.forget()
        self._scene_values.clear()
        state = self.next_state()
        # Forgetting may fall between a scene state and the joint state that follows it.
        for _ in range(_FIRST_STATES):
            if not self._missing():
                break
            self._arm = None  # in lock-step the same state is repeated
            state = self.next_state()
        self.check_scene()
        return state

    def forget(self) -> None:
        """Drop whatever has been received: what comes next is newer than this call."""
        self._joints.drain()
        self._scene.drain()
        self._queue.clear()
        self._scene_queue.clear()
        self._arm = None

    def check_scene(self) -> None:
        """Refuse to act on a scene that has not been heard of for too long.

        Raises:
            StaleStateError: Fields that the policy needs are missing or too old.
        """
        if self._missing():
            raise StaleStateError(f"the scene states lack {self._missing()}")
        age_s = (time.monotonic_ns() - self._scene_received_ns) / 1e9
        if self._arm is not None:
            # A publisher that hangs may repeat an old state for ever: its stamp tells.
            age_s = max(age_s, (self._arm.stamp_ns - self._scene_stamp_ns) / 1e9)
        if self._scene_fields and not self._lock_step and age_s > MAX_SCENE_AGE_S:
            raise StaleStateError(
                f"the scene state is {1e3 * age_s:.0f} ms old; at most "
                f"{1e3 * MAX_SCENE_AGE_S:.0f} ms are allowed"
            )

    def _missing(self) -> list[str]:
        """Fields that the policy needs and that no scene state has told."""
        return sorted(self._scene_fields - set(self._scene_values))

    def hand_position(self, state: ArmState) -> Array:
        """Measured hand in world by forward kinematics, m. Shape (3,)."""
        return self.hand_of(state.q)

    def hand_of(self, q: Array) -> Array:
        """Hand in world at joint angles, m. Shape (7,) -> (3,)."""
        position, _ = self._kinematics.forward(q)
        hand: Array = position + frames.BASE_IN_WORLD
        return hand

    def observation(self, state: ArmState, hand_position_w: Array, step: int) -> Array:
        """What the policy sees. Shape (observation_dim,).

        Args:
            state: Newest arm state.
            hand_position_w: Of `state`, from `hand_position`.
            step: Index of the control step within the episode.
        """
        values: dict[str, float] = {
            "hand_x": hand_position_w[0],
            "hand_y": hand_position_w[1],
            "hand_z": hand_position_w[2],
            "gripper": state.gripper,
            TIME_FIELD: step / self._layout.episode_steps,
            **self._scene_values,
        }
        return assemble_observation(self._layout, values)

    def _take(self) -> ArmState | None:
        """The next unread state: the oldest in lock-step, else the newest."""
        self._queue += self._joints.drain()
        if not self._queue:
            return None
        sample = self._queue.pop(0 if self._lock_step else -1)
        if not self._lock_step:
            self._queue.clear()
        message = decode_joint_states(sample.payload)
        names, order, finger = self._indices(message.names)
        del names
        if not np.isfinite(message.position).all():
            raise TransportError("joint states hold positions that are not finite")
        velocity = message.velocity if len(message.velocity) else np.zeros(len(message.position))
        return ArmState(
            message.stamp_ns,
            sample.received_ns,
            message.position[order],
            velocity[order],
            float(message.position[finger]),
        )

    def _indices(self, names: tuple[str, ...]) -> tuple[tuple[str, ...], list[int], int]:
        """Where arm and finger are in a message with these names."""
        if self._order is None or self._order[0] != names:
            missing = [n for n in (*self._joint_names, self._finger_name) if n not in names]
            if missing:
                raise TransportError(f"joint states lack {missing}")
            order = [names.index(name) for name in self._joint_names]
            self._order = (names, order, names.index(self._finger_name))
        return self._order

    def _take_scene(self, stamp_ns: int) -> None:
        """Take in the scene states up to a stamp; the server sends them before the joints'."""
        for sample in self._scene.drain():
            self._scene_queue.append(decode_joint_states(sample.payload))
            self._scene_received_ns = sample.received_ns
        while self._scene_queue and (
            self._scene_queue[0].stamp_ns <= stamp_ns or not self._lock_step
        ):
            message = self._scene_queue.pop(0)
            self._scene_stamp_ns = message.stamp_ns
            for name, value in zip(message.names, message.position, strict=True):
                if name in self._fields:
                    self._scene_values[self._fields[name]] = float(value)
