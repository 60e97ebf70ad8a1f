"""What a session makes of the delay that a robot server has measured, and whose word it takes."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skewmi.deploy.robot.process import free_port
from skewmi.deploy.robot.states import ServerState
from skewmi.deploy.robot.status import DELAY_KEY, RobotStatus
from skewmi.deploy.session.arm_delay import MOST_S, ArmDelay
from skewmi.deploy.session.arm_state import ArmState
from skewmi.deploy.session.hand_commander import HandCommander
from skewmi.deploy.session.robot_client import RobotClient
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.senders import Senders
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.policy_io import Array
from skewmi.sim.tasks.open_press_close.definition import make_layout
from skewmi.trajectory import CYCLE_NS

STEPS = 12


def heard(*texts: str) -> ArmDelay:
    delay = ArmDelay()
    for text in texts:
        delay.hear({DELAY_KEY: text})
    return delay


@given(st.lists(st.floats().map(str) | st.text(max_size=8), max_size=20))
def test_whatever_is_told_the_delay_is_bounded_and_changes_little_by_little(texts) -> None:
    delay, before_ns = ArmDelay(), 0
    for text in texts:
        delay.hear({DELAY_KEY: text})
        assert 0 <= delay.ns <= 1e9 * MOST_S
        assert abs(delay.ns - before_ns) <= 1e9 * MOST_S / 8 + 1
        before_ns = delay.ns


def test_what_is_told_again_and_again_is_believed_and_silence_changes_nothing() -> None:
    delay = heard(*["22.5"] * 60)
    assert delay.ns == pytest.approx(22.5e6, abs=1e5)
    before_ns = delay.ns
    delay.hear({})
    assert delay.ns == before_ns
    assert heard().ns == 0


def status(delay_ms: float) -> bytes:
    told = {DELAY_KEY: f"{delay_ms:.1f}"}
    return RobotStatus(0, ServerState.DISARMED, "started", told=told).encode()


def test_a_stranger_is_not_asked_how_late_the_arm_is() -> None:
    locator = f"tcp/127.0.0.1:{free_port()}"
    client = TransportConfig.for_client(locator)
    with (
        Link.open(TransportConfig.for_robot(locator), "robot") as robot,
        Link.open(client, "stranger") as other,
        Link.open(client, "session") as own,
    ):
        says, lies = robot.publisher(topics.YUMI_STATUS), other.publisher(topics.YUMI_STATUS)
        senders = Senders(own.graph.node_of)
        senders.believe({topics.YUMI_STATUS.name: (says.gid,)})
        trust = cast(Any, SimpleNamespace(senders=senders, server="", look=lambda: None))
        commands = own.publisher(topics.YUMI_TRAJECTORY), own.publisher(topics.YUMI_GRIPPER)
        session = RobotClient.open(own, trust, *commands, dry_run=False)
        deadline = time.monotonic() + 10.0
        while session.delay.ns < 19.9e6 or not senders.strangers():
            assert time.monotonic() < deadline
            lies.put(status(90.0))
            says.put(status(20.0))
            session.check(late_is_final=False)
            assert session.delay.ns <= 20e6
            time.sleep(0.005)


class LateArm:
    """Planner, stream and observer of an arm that shows its commands late, and shows all of them.

    Its joints are the hand's position.

    Args:
        start_w: Where it rests, world, m. Shape (3,).
        delay_ns: How late.
    """

    def __init__(self, start_w: Array, delay_ns: int) -> None:
        self._delay_ns, self.now_ns = delay_ns, 0
        self._knots: list[tuple[float, Array]] = [(0.0, start_w)]
        self.command_position = start_w
        self.lead_s, self.hand_bounds = 0.0, SimpleNamespace(stopping_s=0.0)

    def set_target(self, position_w: Array, duration_s: float) -> None:
        here = self.commanded(self.now_ns)
        self._knots = [knot for knot in self._knots if knot[0] < self.now_ns]
        self._knots += [(self.now_ns, here), (self.now_ns + 1e9 * duration_s, position_w)]

    def hold(self, position_w: Array) -> None:
        self.set_target(position_w, CYCLE_NS / 1e9)

    def commanded(self, stamp_ns: int) -> Array:
        times, positions = zip(*self._knots, strict=True)
        return np.array([np.interp(stamp_ns, times, axis) for axis in np.transpose(positions)])

    def state(self) -> ArmState:
        q = self.commanded(self.now_ns - self._delay_ns)
        return ArmState(self.now_ns, 0, q, np.zeros(3), 0.01)

    def hand_of(self, q: Array) -> Array:
        return q

    def hand_position(self, state: ArmState) -> Array:
        return state.q


def commands(arm: LateArm, delay: ArmDelay) -> Array:
    """To and fro at full speed; where the hand is commanded to be in each cycle."""
    layout = make_layout()
    parts = cast(Any, arm)
    cycles = round(layout.control_dt * 1e9) // CYCLE_NS
    commander = HandCommander(layout, parts, parts, parts, layout.control_dt, delay)
    commander.start()
    positions = []
    for step in range(STEPS):
        action = np.array([0.0, 1.0 if step % 6 < 3 else -1.0, 0.0])
        for cycle in range(cycles):
            if cycle == 0:
                commander.begin_step(action, arm.state())
            else:
                commander.watch(arm.state())
            arm.now_ns += CYCLE_NS
            positions.append(arm.commanded(arm.now_ns))
    return np.array(positions)


def start() -> Array:
    workspace = make_layout().workspace
    assert workspace is not None
    return (np.array(workspace.low) + np.array(workspace.high)) / 2


@pytest.mark.parametrize("delay_ms", [0, 20, 60, 100])
def test_an_arm_that_is_late_by_what_was_measured_is_commanded_as_one_that_is_not(
    delay_ms: int,
) -> None:
    prompt = commands(LateArm(start(), 0), heard())
    late = commands(LateArm(start(), 1_000_000 * delay_ms), heard(*[str(delay_ms)] * 200))
    np.testing.assert_allclose(late, prompt, atol=1e-6)


def test_an_arm_of_which_nobody_tells_that_it_is_late_looks_like_a_blocked_one() -> None:
    prompt = commands(LateArm(start(), 0), heard())
    assert np.abs(commands(LateArm(start(), 100_000_000), heard()) - prompt).max() > 0.005
