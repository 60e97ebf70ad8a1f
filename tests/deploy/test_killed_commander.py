"""Who commands in the calibration workspace is killed: the arm rests inside, and is free."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from lone_motions import LAB, assert_within_limits

from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.robot.states import ServerState
from skewmi.deploy.safety.flange_space import CALIBRATION, TASK, FlangeSpace
from skewmi.deploy.safety.limits import WORKSPACE_TOLERANCE
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.controller_state import decode_controller_state
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.trajectory import GRID_NS

pytestmark = pytest.mark.slow

COMMANDER = """
import sys, time
import numpy as np
from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.session.robot_client import RobotClient
from skewmi.deploy.session.trust import Trust
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.messages import encode_chunk
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.robot_models import limits
from skewmi.trajectory import CYCLE_NS, TrajectoryChunk

with Link.open(TransportConfig.for_client(sys.argv[1]), "commander") as link:
    commands = link.publisher(topics.YUMI_TRAJECTORY)
    gripper = link.publisher(topics.YUMI_GRIPPER)
    trust = Trust(link, {topics.YUMI_TRAJECTORY.name: (commands.gid,)}, None)
    robot = RobotClient.open(link, trust, commands, gripper, dry_run=False)
    names = trust.meet().joint_names
    robot.arm("calibration")
    for goal in (1.0, 0.0) * 50:
        start = np.array(robot.wait_for_hold())
        to = np.array(eval(sys.argv[2])) + goal * np.array([0.0, 0.3, 0.0, -0.25, 0.0, 0.0, 0.0])
        motion = StartMotion(start, to, limits.profile("lab"), flange_speed=0.2)
        clock, began = robot.describe().clock_ns, time.monotonic()
        begin = clock - clock % CYCLE_NS + 15 * CYCLE_NS
        for cycle in range(motion.cycles):
            chunk = TrajectoryChunk.of(begin + cycle * CYCLE_NS, names, motion.chunk(cycle))
            robot.put_chunk(encode_chunk(chunk))
            print("moving", flush=True)
            time.sleep(max(0.0, began + (cycle + 1) * 0.02 - time.monotonic()))
        time.sleep(0.4)
"""


@pytest.mark.parametrize("seed", range(3))
def test_a_killed_commander_leaves_an_arm_that_rests_inside(robot: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    with Link.open(TransportConfig.for_client(robot), "watcher") as link:

        def ask() -> RobotDescription:
            return RobotDescription.from_json(link.call(topics.YUMI_DESCRIBE, 5.0).message)

        before = ask()
        space = FlangeSpace.from_numbers(CALIBRATION, before.workspaces[CALIBRATION])
        cycles = link.subscribe(topics.YUMI_CONTROLLER_STATE, depth=None)
        child = subprocess.Popen(
            [sys.executable, "-c", COMMANDER, robot, str(list(before.commanded_position))],
            stdout=subprocess.PIPE,
        )
        assert child.stdout is not None
        try:
            for _ in range(int(rng.integers(5, 120))):
                assert child.stdout.readline() == b"moving\n"
            assert ask().workspace == CALIBRATION
        finally:
            child.send_signal(signal.SIGKILL)
            child.wait()
        deadline = time.monotonic() + 10.0
        while (told := ask()).state != ServerState.DISARMED.value:
            assert time.monotonic() < deadline, told
            time.sleep(0.05)
        time.sleep(0.1)
        states = [decode_controller_state(sample.payload) for sample in cycles.drain()]
    assert told.workspace == TASK
    stamps = np.array([state.stamp_ns for state in states])
    reference = np.array([state.reference.q for state in states])
    assert np.abs(states[-1].reference.v).max() == 0.0
    assert np.array_equal(states[-1].reference.q, told.commanded_position)
    for part in np.split(reference, np.flatnonzero(np.diff(stamps) != GRID_NS) + 1):
        if len(part) > 3:
            assert_within_limits(part)
    assert np.ptp(reference, axis=0).max() > 1e-4, "it moved"
    hand = ArmKinematics("right").forward(reference)[0]
    assert np.maximum(space.low - hand, hand - space.high).max() <= WORKSPACE_TOLERANCE
    assert np.abs(np.diff(reference, axis=0)).max() < LAB.velocity.max()
