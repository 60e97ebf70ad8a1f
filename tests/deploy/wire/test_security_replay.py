"""Old commands put again: whoever sends them, and whenever, the server does not follow them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from lone_robot import LoneRobot

from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.robot.backend import fresh_start_ns
from skewmi.deploy.robot.backends.mujoco.backend import MujocoBackend
from skewmi.deploy.robot.backends.mujoco.simulation import ArmSimulation
from skewmi.deploy.wire.messages import (
    decode_chunk,
    encode_chunk,
)
from skewmi.errors import CommandRefusedError
from skewmi.policy_io import Array
from skewmi.robot_models import limits as joint_limits
from skewmi.trajectory import GRID_NS, TrajectoryChunk

LAB = joint_limits.profile("lab")
SIZE = 0.08 * np.array([1, -0.5, 0, 0.5, 0, 1, 0])
GIDS = (b"a" * 16, b"b" * 16)
GRIPPER = b"g" * 16


def make_robot(simulation: ArmSimulation, start_ns: int) -> LoneRobot:
    """A robot server that was just started, its arm at the task's start."""
    simulation.reset(seed=0)
    return LoneRobot(MujocoBackend(simulation, lock_step=True), LAB, start_ns=start_ns)


def chunks(start: Array, stamp_ns: int, names: tuple[str, ...], back: bool = False) -> list[bytes]:
    """A motion as the session streams it: a chunk every 20 ms, each with its own braking tail."""
    motion = StartMotion(start, start + (-SIZE if back else SIZE), LAB)
    payloads = []
    for cycle in range(len(motion.trajectory) // 5):
        stamp = stamp_ns + 5 * cycle * GRID_NS
        payloads.append(encode_chunk(TrajectoryChunk.of(stamp, names, motion.chunk(cycle))))
    return payloads


@pytest.fixture(scope="module")
def simulation() -> ArmSimulation:
    return ArmSimulation()


def execute(robot: LoneRobot, payloads: list[bytes], gid: bytes, first: int = 1) -> int:
    """Send each chunk 12 ms before it is due, as a recording that is played; how many passed."""
    passed = 0
    sequence = first
    for payload in payloads:
        due = decode_chunk(payload).stamp_ns // GRID_NS
        for _ in range(min(max(0, due - 3 - robot.due), 25)):
            robot.run(1)
        passed += robot.controller.receive(payload, gid, sequence, 0)
        sequence += 1
    return passed


STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("wait"), st.integers(1, 40)),
        st.tuples(st.just("stop"), st.just(0)),
        st.tuples(st.just("arm"), st.sampled_from([0, 1, 2])),
        st.tuples(st.just("move"), st.just(0)),
        st.tuples(st.just("replay"), st.integers(0, 2**32)),
    ),
    min_size=3,
    max_size=25,
)


@settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
    max_examples=150,
    deadline=None,
)
@example(steps=[("stop", 0), ("arm", 1), ("replay", 2869)], first=0)
@given(steps=STEPS, first=st.integers(0, 1000))
def test_no_chunk_is_ever_followed_twice(
    simulation: ArmSimulation, steps: list[tuple[str, int]], first: int
) -> None:
    """Whatever happens in between, and with whatever sender and number it is put again."""
    robot = make_robot(simulation, first * GRID_NS)
    arms = (*GIDS, b"")
    followed: list[bytes] = []
    sequence, back, holder = 0, False, GIDS[0]
    for what, number in [("arm", 0), ("move", 0), *steps, ("replay", 0)]:
        if what == "wait":
            for _ in range(number):
                robot.run(1)
        elif what == "stop":
            robot.requests.stop("test")
            # What it takes back before it has begun counts as never given.
            begun_ns = robot.controller.arm_motion.executed_ns
            followed = [p for p in followed if decode_chunk(p).stamp_ns <= begun_ns]
        elif what == "arm":
            try:
                robot.requests.arm(arms[number], 0)
                holder = arms[number] or GIDS[0]
            except CommandRefusedError:
                pass
        elif what == "move" and robot.controller.at_rest:
            start = robot.commanded
            stamp_ns = (robot.due + 3) * GRID_NS
            for payload in chunks(start, stamp_ns, robot.backend.joint_names, back)[:6]:
                sequence += 1
                if robot.controller.receive(payload, holder, sequence, 0):
                    followed.append(payload)
            back = not back
        elif what == "replay" and followed:
            random = np.random.default_rng(number)
            payload = followed[int(random.integers(len(followed)))]
            gid = [*GIDS, bytes(random.bytes(16))][int(random.integers(3))]
            forged = int(random.choice([1, sequence, sequence + 1, 2**62]))
            before = robot.planned(60)
            assert not robot.controller.receive(payload, gid, forged, 0)
            assert robot.refusals()[-1].reason
            np.testing.assert_array_equal(before, robot.planned(60))
    assert robot.controller.accepted, "nothing was followed: this shows nothing"


@settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=10, deadline=None
)
@given(gid=st.sampled_from([*GIDS, b""]), data=st.data())
def test_a_recording_is_not_followed_by_a_restarted_robot_server(
    simulation: ArmSimulation, gid: bytes, data: st.DataObject
) -> None:
    """Even by one that is armed for the recorded sender, at rest at the recorded start."""
    first_ns = fresh_start_ns()
    robot = make_robot(simulation, first_ns)
    robot.requests.arm(GIDS[0], 0)
    start = robot.commanded
    recorded = chunks(start, first_ns + 50 * GRID_NS, robot.backend.joint_names)
    assert execute(robot, recorded, GIDS[0]) == len(recorded)

    restarted = make_robot(simulation, fresh_start_ns())
    # It may have been up for any time.
    for _ in range(data.draw(st.integers(0, 100))):
        restarted.run(1)
    restarted.requests.arm(gid, 0)
    assert execute(restarted, recorded, GIDS[0], data.draw(st.integers(1, 2**62))) == 0
    assert restarted.controller.refusals.count == len(recorded)
    why = "is not the commander" if gid == GIDS[1] else "the robot server's clock"
    assert all(why in refusal.reason for refusal in restarted.refusals())
    np.testing.assert_array_equal(restarted.commanded, start)


def test_it_is_the_clock_that_tells_runs_apart(simulation: ArmSimulation) -> None:
    """The test above can fail: had both clocks started alike, the arm would have moved."""
    robot = make_robot(simulation, 0)
    recorded = chunks(robot.commanded, 50 * GRID_NS, robot.backend.joint_names)
    robot.requests.arm(GIDS[0], 0)
    assert execute(robot, recorded, GIDS[0]) == len(recorded)
    alike = make_robot(simulation, 0)
    alike.requests.arm(GIDS[0], 0)
    assert execute(alike, recorded, GIDS[0]) == len(recorded)


def test_clocks_start_years_apart_and_fit_a_ros_stamp() -> None:
    starts = sorted(fresh_start_ns() / 1e9 for _ in range(200))
    assert starts[0] > 0.0
    assert starts[-1] + 3600 * 24 * 365 * 30 < 2**31
    assert len(set(starts)) == 200
    assert all(start == int(start) for start in starts)
