"""The other arm: answered, watched, and compared with where the guard has it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from egm_bench import OURS, RAMP_CYCLES, Bench
from egm_controller import HandController
from egm_wire import Reference

from skewmi.deploy.robot.backends.egm.options import EgmOptions
from skewmi.deploy.robot.states import ServerState
from skewmi.errors import CommandRefusedError
from skewmi.robot_models import yumi


class TestLeftArm:
    """The other arm: answered, watched, and compared with where the guard has it."""

    HOME = (0.0, -130.0, 30.0, 0.0, 40.0, 0.0)

    @pytest.fixture
    def both(self) -> Iterator[tuple[Bench, HandController]]:
        bench = Bench(EgmOptions(listen="127.0.0.1:0", listen_left="127.0.0.1:0"))
        assert bench.backend.left is not None
        bench.backend.left.channel.link.now_ns = lambda: bench.now_ns
        left = HandController(bench.backend.left.channel.link.address, self.HOME, 135.0)
        yield bench, left
        left.socket.close()
        bench.close()

    def run(self, both: tuple[Bench, HandController], cycles: int) -> list[Reference]:
        bench, left = both
        answers = []
        for _ in range(cycles):
            left.send()
            bench.run(1)
            answers += left.collect(1.0)
        return answers

    def test_it_is_held_where_it_is(self, both: tuple[Bench, HandController]) -> None:
        answers = self.run(both, RAMP_CYCLES)
        assert len(answers) == RAMP_CYCLES
        assert answers[-1].chain() == pytest.approx([0.0, -130.0, 135.0, 30.0, 0.0, 40.0, 0.0])
        bench, _ = both
        assert bench.backend.readiness() is None
        assert "at home" in bench.backend.told()["left_arm"]

    def test_its_joints_are_told_behind_the_right_arms(
        self, both: tuple[Bench, HandController]
    ) -> None:
        bench, left = both
        bench.run(3)
        assert len(bench.backend.state_names) == 8
        for step in range(20):
            left.packet.axes = (0.1 * step, *self.HOME[1:])
            self.run(both, 1)
        state = bench.robot.arm_motion.state
        assert state is not None
        assert bench.backend.state_names[8:] == yumi.joint_names("left")
        assert len(state.position) == len(state.velocity) == len(state.effort) == 15
        assert np.degrees(state.position[8]) == pytest.approx(1.8, abs=0.11)
        assert np.degrees(state.velocity[8]) == pytest.approx(0.1 / 0.004032, rel=0.1)

    def test_one_that_is_not_parked_refuses_to_arm(
        self, both: tuple[Bench, HandController]
    ) -> None:
        bench, left = both
        left.packet.axes = (0.0, -110.0, 30.0, 0.0, 40.0, 0.0)
        self.run(both, RAMP_CYCLES)
        with pytest.raises(CommandRefusedError, match=r"left arm's axis 2 is 20\.0 deg"):
            bench.requests.arm(OURS, bench.now_ns)
        left.packet.axes = self.HOME
        self.run(both, 5)
        bench.requests.arm(OURS, bench.now_ns)

    def test_one_that_is_not_heard_of_any_more_may_be_anywhere(
        self, both: tuple[Bench, HandController]
    ) -> None:
        bench, left = both
        self.run(both, RAMP_CYCLES)
        for step in range(20):
            left.packet.axes = (0.05 * step, *self.HOME[1:])
            self.run(both, 1)
        bench.requests.arm(OURS, bench.now_ns)
        bench.run(40)
        assert bench.robot.state is ServerState.DISARMED
        assert "left arm is not heard of any more" in bench.robot.machine.reason
        with pytest.raises(CommandRefusedError, match="start its program again"):
            bench.requests.arm(OURS, bench.now_ns)
        state = bench.robot.arm_motion.state
        assert state is not None
        assert not state.velocity[8:].any(), "an old speed is not one of now"
        left.restart()
        self.run(both, RAMP_CYCLES)
        bench.requests.arm(OURS, bench.now_ns)

    def test_one_that_was_never_heard_of_is_told(self, both: tuple[Bench, HandController]) -> None:
        bench, _ = both
        bench.ready()
        assert "taken to be at home" in bench.backend.told()["left_arm"]
