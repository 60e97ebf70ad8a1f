"""Workspaces besides the task's: asked for at arming, granted at rest, given up with the arm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lone_motions import GRIPPER, LAB, OTHER, OURS
from lone_robot import LoneRobot

from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.robot.backends.mujoco.backend import MujocoBackend
from skewmi.deploy.robot.backends.mujoco.simulation import ArmSimulation
from skewmi.deploy.robot.controller import LEASE_NS
from skewmi.deploy.robot.states import ServerState
from skewmi.deploy.robot.workspaces import check_scene_is_shut, spaces_of, workspaces_told
from skewmi.deploy.safety.checks import space_checks
from skewmi.deploy.safety.flange_space import CALIBRATION, TASK, TOUCH
from skewmi.deploy.safety.limits import WORKSPACE_TOLERANCE
from skewmi.deploy.safety.validation import ChunkValidator
from skewmi.deploy.wire.arm_request import ArmRequest
from skewmi.errors import CommandRefusedError
from skewmi.policy_io import Array
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.trajectory import JointTrajectory

FORWARD = ArmKinematics("right").forward
NAMED = st.sampled_from(["", TASK, CALIBRATION, TOUCH])
UP = np.array([0.0, 0.25, 0.0, -0.1, 0.0, 0.0, 0.0])
"""Added to the task's start, this lifts the hand out of the task's box."""


def request(gid: bytes, workspace: str) -> bytes:
    return ArmRequest(gid, GRIPPER, workspace).encode()


def hand(q: Array) -> Array:
    return FORWARD(q)[0]


@pytest.fixture
def roomy(simulation: ArmSimulation) -> LoneRobot:
    """A robot at the task's start whose server can grant every workspace."""
    simulation.reset(seed=0)
    backend = MujocoBackend(simulation, lock_step=True)
    robot = LoneRobot(backend, LAB)
    validator = robot.controller._validator
    others = space_checks(LAB, spaces_of(backend.scene))
    robot.controller._validator = ChunkValidator(validator.rules, validator._checks[TASK], others)
    return robot


def send(robot: LoneRobot, motion: JointTrajectory, sequence: int) -> bool:
    """Have a whole motion accepted and followed to its end, if the robot server does."""
    accepted = robot.controller.receive(robot.payload(motion, robot.due + 3), OURS, sequence, 0)
    robot.run(len(motion.q) + 10)
    return accepted


def way(robot: LoneRobot, goal: Array, speed: float = 0.2) -> JointTrajectory:
    return StartMotion(robot.commanded, goal, LAB, flange_speed=speed).trajectory


@settings(deadline=None)
@given(
    ids=st.sampled_from([0, 1, 2]),
    raw=st.binary(min_size=32, max_size=32),
    name=st.text(min_size=0, max_size=30),
)
def test_requests_to_arm_survive_the_wire(ids: int, raw: bytes, name: str) -> None:
    asked = ArmRequest(raw[:16] if ids else b"", raw[16:] if ids == 2 else b"", name)
    assert ArmRequest.decode(asked.encode()) == asked


@settings(deadline=None)
@given(st.binary(max_size=80))
def test_whatever_bytes_ask_to_arm_it_is_understood_or_refused(extra: bytes) -> None:
    try:
        asked = ArmRequest.decode(extra)
    except CommandRefusedError:
        assert len(extra) not in (0, 16, 32)
    else:
        assert asked.encode() == extra


@given(st.sampled_from([0, 16, 32]))
def test_requests_of_older_senders_ask_for_the_tasks_workspace(count: int) -> None:
    assert ArmRequest.decode(bytes(range(count))).workspace == ""


def test_what_is_told_is_what_is_granted(roomy: LoneRobot) -> None:
    scene = roomy.backend.scene
    told = workspaces_told(scene, spaces_of(scene))
    assert tuple(told) == (TASK, CALIBRATION, TOUCH) == roomy.controller.workspaces
    low, high = np.array(told[CALIBRATION]["low"]), np.array(told[CALIBRATION]["high"])
    assert (low <= told[TASK]["low"]).all()
    assert (high >= told[TASK]["high"]).all()
    assert told[TOUCH]["speed"] == (0.010,)


def test_the_space_opens_what_the_task_keeps_shut(roomy: LoneRobot) -> None:
    start = roomy.commanded
    roomy.requests.arm(OURS, 0)
    assert not send(roomy, way(roomy, start + UP), 1)
    assert "outside the workspace" in roomy.refusals()[0].reason
    roomy.requests.arm(request(OURS, CALIBRATION), 0)
    assert roomy.controller.lease.workspace == CALIBRATION
    assert send(roomy, way(roomy, start + UP), 2), roomy.refusals()
    roomy.requests.disarm(OURS)
    assert roomy.controller.lease.workspace == TASK
    # The way back is a start motion of the task's.
    roomy.requests.arm(OURS, 0)
    assert send(roomy, way(roomy, start), 3), roomy.refusals()
    assert not send(roomy, way(roomy, start + UP), 4)


def test_no_name_of_a_workspace_is_taken_for_another(roomy: LoneRobot) -> None:
    for name in ("Calibration", "calibration ", "x" * 900, "\x1b[2J"):
        with pytest.raises(CommandRefusedError, match="there are: task, calibration, touch") as no:
            roomy.requests.arm(request(OURS, name), 0)
        assert str(no.value).isprintable()
        assert roomy.controller.state is ServerState.DISARMED


def test_it_is_given_up_with_the_arm_however_that_ends(roomy: LoneRobot) -> None:
    def stop() -> None:
        roomy.requests.stop("a test")

    def be_silent() -> None:
        roomy.run(1, now_ns=LEASE_NS + 1)

    def fault() -> None:
        roomy.controller.fault("a test")
        roomy.requests.stop("a test")

    for end in (stop, be_silent, fault, lambda: roomy.requests.disarm(OURS)):
        roomy.requests.arm(request(OURS, CALIBRATION), 0)
        assert roomy.controller.lease.workspace == CALIBRATION
        end()
        assert roomy.controller.state is ServerState.DISARMED
        assert roomy.controller.lease.workspace == TASK
        roomy.requests.arm(OTHER, 0)
        assert roomy.controller.lease.workspace == TASK
        roomy.requests.disarm(OTHER)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.sampled_from([OURS, OTHER]), NAMED), min_size=1, max_size=8))
def test_nobody_takes_or_changes_what_another_was_granted(asked: list[tuple[bytes, str]]) -> None:
    """By the lease alone: what holds is what the holder's last request that was granted named."""
    robot = SHARED[0]
    robot.requests.stop("a test")
    holder, granted = None, TASK
    for gid, name in asked:
        if holder in (None, gid):
            robot.requests.arm(request(gid, name), 0)
            holder, granted = gid, name or TASK
        else:
            with pytest.raises(CommandRefusedError, match="holds the arm"):
                robot.requests.arm(request(gid, name), 0)
        assert (robot.controller.lease.holder, robot.controller.lease.workspace) == (
            holder,
            granted,
        )


SHARED: list[LoneRobot] = []


@pytest.fixture(autouse=True)
def _share(roomy: LoneRobot) -> None:
    SHARED[:] = [roomy]


def test_it_changes_at_rest_only(roomy: LoneRobot) -> None:
    roomy.requests.arm(request(OURS, CALIBRATION), 0)
    motion = way(roomy, roomy.commanded + UP)
    assert roomy.controller.receive(roomy.payload(motion, roomy.due + 3), OURS, 1, 0)
    roomy.run(10)
    for name in ("", TOUCH):
        with pytest.raises(CommandRefusedError, match="moving"):
            roomy.requests.arm(request(OURS, name), 0)
    roomy.requests.arm(request(OURS, CALIBRATION), 0)
    roomy.run(len(motion.q))
    roomy.requests.arm(request(OURS, TOUCH), 0)
    assert roomy.controller.lease.workspace == TOUCH


def test_an_open_lid_keeps_it_shut(roomy: LoneRobot, simulation: ArmSimulation) -> None:
    simulation._data.qpos[simulation.scene.scene_qpos[0]] = 1.0
    for name in (CALIBRATION, TOUCH):
        with pytest.raises(CommandRefusedError, match="lid_hinge is at"):
            roomy.requests.arm(request(OURS, name), 0)
    roomy.requests.arm(OURS, 0)
    assert roomy.controller.lease.workspace == TASK
    roomy.requests.reset_scene(1)
    roomy.requests.arm(request(OURS, CALIBRATION), 0)
    roomy.requests.disarm(OURS)
    # Nor is it inherited from somebody who has not begun: it is another's to ask for.
    roomy.requests.arm(request(b"", CALIBRATION)[16:], 0)
    simulation._data.qpos[simulation.scene.scene_qpos[0]] = 1.0
    with pytest.raises(CommandRefusedError, match="lid_hinge is at"):
        roomy.requests.arm(request(OURS, CALIBRATION), 0)


@pytest.mark.parametrize("position", [np.nan, np.inf, -1.0])
def test_a_lid_that_reads_nonsense_is_not_shut(roomy: LoneRobot, position: float) -> None:
    scene = roomy.backend.scene
    assert scene is not None
    state = scene.state()
    assert state is not None
    odd = replace(state, position=np.full_like(state.position, position))
    with pytest.raises(CommandRefusedError):
        check_scene_is_shut(_Showing(scene, odd))  # type: ignore[arg-type]


class _Showing:
    """A scene that reads something else."""

    def __init__(self, scene: object, state: object) -> None:
        self._scene, self.state = scene, lambda: state

    def __getattr__(self, name: str) -> object:
        return getattr(self._scene, name)


def test_touching_is_slow(roomy: LoneRobot) -> None:
    goal = roomy.commanded + 0.2 * UP
    roomy.requests.arm(request(OURS, TOUCH), 0)
    assert not send(roomy, way(roomy, goal, 0.011), 1)
    assert "speed, m/s" in roomy.refusals()[0].reason
    turned = roomy.commanded + np.array([0, 0, 0, 0, 0, 0.3, 0])
    assert not send(roomy, way(roomy, turned, 0.009), 2), "finger tips count, too"


def test_the_commander_of_a_killed_session_leaves_an_arm_at_rest_inside(roomy: LoneRobot) -> None:
    low, high = (
        np.array(spaces_of(roomy.backend.scene)[CALIBRATION].low),
        np.array(spaces_of(roomy.backend.scene)[CALIBRATION].high),
    )
    roomy.requests.arm(request(OURS, CALIBRATION), 0)
    motion = way(roomy, roomy.commanded + UP)
    assert roomy.controller.receive(roomy.payload(motion, roomy.due + 3), OURS, 1, 0)
    roomy.run(30)
    roomy.run(len(motion.q), now_ns=LEASE_NS + 1)
    assert roomy.controller.state is ServerState.DISARMED
    assert roomy.controller.at_rest
    at = hand(np.array([target.q for target in roomy.targets]))
    assert np.maximum(low - at, at - high).max() <= WORKSPACE_TOLERANCE
