"""No plan asks a controller for more joint speed than its program admits."""

from __future__ import annotations

import socket
import threading

import numpy as np
import pytest
from egm_bench import LAB, OURS, Bench
from hypothesis import given, settings
from hypothesis import strategies as st
from robot_servers import description

from skewmi.cli.egm_flags import task_facts
from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.robot.backends import BackendOptions
from skewmi.deploy.robot.backends.egm.options import EgmOptions
from skewmi.deploy.robot.backends.egm.packets import ReferencePacket
from skewmi.deploy.robot.backends.egm.program import ProgramSettings
from skewmi.deploy.robot.description import RobotDescription, admitted
from skewmi.deploy.robot.egm_emulator.control_law import ControlLaw
from skewmi.deploy.robot.gripper.fixed import FixedGripper
from skewmi.deploy.robot.process import free_port
from skewmi.deploy.robot.run import serve_robot
from skewmi.deploy.wire.messages import encode_chunk
from skewmi.deploy.wire.transport import TransportConfig
from skewmi.robot_models import yumi
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import GRID_NS, TrajectoryChunk

START = np.array(yumi.TABLE_CONFIGURATION)
PERIOD_S = 0.004032


def largest_utilization(options: EgmOptions, limits: JointLimits, goal: np.ndarray) -> float:
    """Of an emulated controller that is sent a motion in each of its cycles, from the second on."""
    plan = StartMotion(START, goal, limits, flange_speed=10.0).trajectory
    law = ControlLaw(options.program, START, PERIOD_S, 0.015)
    grid = 0.004 * np.arange(len(plan.q))
    largest = 0.0
    for cycle in range(int(grid[-1] / PERIOD_S) + 60):
        t = max(0.0, (cycle - 40) * PERIOD_S)  # once its ramp-in is over
        q, v = (
            np.array([np.interp(t, grid, part[:, j]) for j in range(7)])
            for part in (plan.q, plan.v)
        )
        law.step(ReferencePacket(cycle, cycle, q, options.feed_forward * v))
        largest = max(largest, law.utilization)
    return largest


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    gain=st.floats(5.0, 20.0),
    share=st.floats(0.0, 1.0),
    speed=st.floats(20.0, 200.0),
)
def test_what_is_planned_is_followed_in_full(
    seed: int, gain: float, share: float, speed: float
) -> None:
    program = ProgramSettings(gain=gain, max_speed_deviation_deg_s=speed)
    options = EgmOptions(program=program, feed_forward=share)
    way = np.random.default_rng(seed).uniform(-0.8, 0.8, 7)
    goal = np.clip(START + way, LAB.position_lower + 0.01, LAB.position_upper - 0.01)
    limits = LAB.no_faster(options.joint_speed)
    assert largest_utilization(options, limits, goal) <= 100.0


def test_the_profile_alone_asks_for_more() -> None:
    options = EgmOptions()
    goal = START + np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.5])
    assert largest_utilization(options, LAB, goal) > 110.0
    assert largest_utilization(options, LAB.no_faster(options.joint_speed), goal) < 100.0


@pytest.mark.parametrize("slow", [False, True])
def test_bridge_refuses_a_faster_plan(slow: bool) -> None:
    with Bench() as bench:
        bench.armed()
        start = np.array(bench.robot.arm_motion.commanded_position())
        goal = start + np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.5])
        limits = LAB.no_faster(bench.backend.joint_speed) if slow else LAB
        chunk = TrajectoryChunk.of(
            (bench.robot.clock_ns // GRID_NS + 3) * GRID_NS,
            bench.backend.joint_names,
            StartMotion(start, goal, limits).trajectory,
        )
        accepted = bench.robot.receive(encode_chunk(chunk), OURS, 1, bench.now_ns)
        assert accepted == slow
        assert slow or "velocity" in bench.robot.refusals.take()[0].reason


def test_bridge_tells_what_sessions_then_keep_to() -> None:
    stop, told = threading.Event(), list[RobotDescription]()
    facts = task_facts("open_press_close")
    right, left = (f"127.0.0.1:{free_port(socket.SOCK_DGRAM)}" for _ in range(2))
    program = ProgramSettings(max_speed_deviation_deg_s=50.0)
    options = BackendOptions(
        task=facts.task,
        egm=EgmOptions(listen=right, listen_left=left, program=program),
        facts=facts,
        gripper=FixedGripper(facts.workspace.gripper_opening),
    )
    ready = threading.Event()

    def note(description: RobotDescription) -> None:
        told.append(description)
        ready.set()

    config = TransportConfig.for_robot(f"tcp/127.0.0.1:{free_port()}")
    thread = threading.Thread(target=serve_robot, args=("egm", options, config, LAB, stop, note))
    thread.start()
    try:
        assert ready.wait(60.0)
    finally:
        stop.set()
        thread.join(60.0)
    limits = admitted(LAB, told[0])
    np.testing.assert_allclose(limits.velocity, 0.9 * np.radians(50.0))
    np.testing.assert_array_equal(limits.jerk, LAB.jerk)
    np.testing.assert_array_equal(admitted(LAB, description()).velocity, LAB.velocity)
