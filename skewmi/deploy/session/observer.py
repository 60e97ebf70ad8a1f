"""What the session knows of the world: newest joint and scene states, and how old they are."""

from __future__ import annotations

from skewmi.calibration.calibration_file import Calibration
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.session.arm_state import ArmState, ArmStateDecoder
from skewmi.deploy.session.arm_states import ArmStates
from skewmi.deploy.session.lid_zero import LidZero
from skewmi.deploy.session.scene_states import MAX_SCENE_AGE_S, SceneStates
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.senders import Senders
from skewmi.deploy.wire.transport import LatestReader, Link
from skewmi.policy_io import TIME_FIELD, Array, PolicyLayout, assemble_observation
from skewmi.robot_models import yumi
from skewmi.robot_models.base_frame import NOMINAL_BASE, BaseFrame
from skewmi.robot_models.kinematics import ArmKinematics

MAX_JOINT_AGE_S = 0.100
"""Joint states older than this stop the arm; with a long lead they may be older."""
MOST_JOINT_AGE_S = 0.300
"""And with the longest lead."""
CROWD = 1_000
"""Unread messages that are kept of everybody, so that a stranger's do not displace the robot
server's: in the longest wait between two looks, 18 ms, somebody may send 55,000 a second."""

_LEADS = 3
"""Ages of a joint state that are allowed, in leads."""

_FIRST_STATES = 10
"""Joint states that may come before the first scene state, which may be another program's: 0.2 s,
as old as scene states may be."""

_SCENE_AFTER_S = 0.1
"""A scene state may be older than a joint state by this."""


def allowed_age_s(lead_s: float) -> float:
    """How old a joint state may become before the arm stops, s.

    Who plans further ahead may wait longer: a chunk that would come too late is not sent anyway,
    and every chunk ends at rest within half a second. So the age grows with the lead, up to a
    bound.

    Args:
        lead_s: From a state to the motion that answers it, s.
    """
    return min(max(MAX_JOINT_AGE_S, _LEADS * lead_s), MOST_JOINT_AGE_S)


class Observer:
    """Receives states and turns them into policy observations; `open` makes one.

    Args:
        joints: Of `topics.YUMI_JOINT_STATES`, of the robot server alone. It keeps all.
        decoder: Finds the arm in them.
        scene: What is known of the scene.
        layout: Of the policy; None if there is none, and nobody asks for observations.
        lock_step: Take every state in order, however old, instead of the newest.
        state_period_s: How often the robot server publishes, s.
        max_age_s: Of a joint state, before the arm stops, s; see `allowed_age_s`.
        zero: Of the scene's hinges, if something is known of the robot.
        base: The robot base in the task's frame, "world" here.
    """

    def __init__(
        self,
        joints: LatestReader,
        decoder: ArmStateDecoder,
        scene: SceneStates,
        layout: PolicyLayout | None,
        *,
        lock_step: bool,
        state_period_s: float,
        max_age_s: float = MAX_JOINT_AGE_S,
        zero: LidZero | None = None,
        base: BaseFrame = NOMINAL_BASE,
    ) -> None:
        self._arms = ArmStates(
            joints,
            decoder,
            lock_step=lock_step,
            state_period_s=state_period_s,
            max_age_s=max_age_s,
        )
        self._scene, self._zero = scene, zero
        self._layout = layout
        self.max_age_s = max_age_s
        self._kinematics, self._base = ArmKinematics("right"), base

    @staticmethod
    def open(
        link: Link,
        layout: PolicyLayout | None,
        server: RobotDescription,
        senders: Senders,
        lead_s: float,
        known: Calibration | None = None,
    ) -> Observer:
        """Subscribe to the states of the right arm and of the scene on an open link.

        Args:
            link: To the robot server.
            layout: Of the policy; without one nothing of the scene has to be known.
            server: What the robot server says about itself and its scene, and where it has the
                task's box: it has to have been agreed on.
            senders: Who is believed.
            lead_s: From a state to the motion that answers it, s.
            known: Of robot and scene.
        """
        lock_step = server.lock_step
        # Not only the newest in real time either: that may be somebody else's.
        depth = None if lock_step else CROWD
        joints = link.subscribe(topics.YUMI_JOINT_STATES, depth, senders)
        scene = link.subscribe(topics.YUMI_SCENE_STATES, depth, senders)
        return Observer(
            joints,
            ArmStateDecoder(yumi.joint_names("right"), yumi.finger_names("right")[0]),
            SceneStates(
                scene,
                server.scene_fields,
                () if layout is None else layout.observation_names,
                lock_step=lock_step,
                max_age_s=max(MAX_SCENE_AGE_S, allowed_age_s(lead_s) + _SCENE_AFTER_S),
            ),
            layout,
            lock_step=lock_step,
            state_period_s=server.state_period_ns / 1e9,
            max_age_s=allowed_age_s(lead_s),
            zero=None if known is None or layout is None else LidZero(known, layout),
            base=server.base_frame,
        )

    def next_state(self) -> ArmState | None:
        """Wait for a joint state that is newer than the last one returned; see `ArmStates.next`.

        Raises:
            StaleStateError: None came in time.
            TransportError: A state is malformed.
        """
        state = self._arms.next()
        if state is not None:
            self._scene.take(state.stamp_ns)
        return state

    def fresh_state(self) -> ArmState:
        """Forget everything, and wait for a joint state with the scene state that belongs to it.

        Raises:
            StaleStateError: One of them does not come.
            TransportError: A state is malformed.
        """
        self.forget()
        self._scene.begin_anew()
        state = self._first_state()
        # Forgetting may fall between a scene state and the joint state that follows it.
        for _ in range(_FIRST_STATES):
            if not self._scene.missing():
                break
            state = self._first_state()
        self.check_scene()
        return state

    def state_from_now(self) -> ArmState:
        """Drop the joint states that have come, and wait for the next one.

        What took a while, such as planning, has made the newest known state as much older; a motion
        whose time counts from that state would have lost this time before its first chunk. What
        is known of the scene stays. Not for lock-step, where every state waits for its answer.

        Raises:
            StaleStateError: None comes.
            TransportError: It is malformed.
        """
        self._arms.drop_unread()
        return self._first_state()

    def forget(self) -> None:
        """Drop whatever has been received: what comes next is newer than this call."""
        self._arms.drop_unread()
        self._scene.forget()
        self._arms.last = None

    def check_scene(self) -> None:
        """Refuse to act on a scene that has not been heard of for too long.

        Raises:
            StaleStateError: Fields that the policy needs are missing or too old.
        """
        last = self._arms.last
        self._scene.check(None if last is None else last.stamp_ns)

    def begin_episode(self) -> None:
        """The policy is about to see its first observation."""
        if self._zero is not None:
            self._zero.begin(self._scene.values)

    def _first_state(self) -> ArmState:
        """The next joint state, be it the last one: in lock-step the same state is repeated."""
        self._arms.last = None
        state = self.next_state()
        assert state is not None
        return state

    def hand_position(self, state: ArmState) -> Array:
        """Measured hand in world by forward kinematics, m. Shape (3,)."""
        return self.hand_of(state.q)

    def hand_of(self, q: Array) -> Array:
        """Hand in world at joint angles, m. Shape (7,) -> (3,)."""
        position, _ = self._kinematics.forward(q)
        return self._base.to_task(position)

    def observation(self, state: ArmState, hand_position_w: Array, step: int) -> Array:
        """What the policy sees. Shape (observation_dim,).

        Args:
            state: Newest arm state.
            hand_position_w: Of `state`, from `hand_position`.
            step: Index of the control step within the episode.
        """
        assert self._layout is not None, "opened without a layout"
        scene = self._scene.values
        fields: dict[str, float] = {
            "hand_x": hand_position_w[0],
            "hand_y": hand_position_w[1],
            "hand_z": hand_position_w[2],
            "gripper": state.gripper,
            TIME_FIELD: step / self._layout.episode_steps,
            **(scene if self._zero is None else self._zero.taken_off(scene)),
        }
        return assemble_observation(self._layout, fields)
