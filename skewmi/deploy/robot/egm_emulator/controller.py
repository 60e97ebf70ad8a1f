"""The emulated controller: both arms, one cycle after the other.

In each cycle, as the manual's p. 26 has it: tell what is measured, read one message, move. The
clock is the caller's, so that a test needs none.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from skewmi.deploy.robot.egm_emulator.control_law import Target
from skewmi.deploy.robot.egm_emulator.emulated_arm import EmulatedArm
from skewmi.deploy.robot.egm_emulator.wires import Wires
from skewmi.robot_models.yumi import Side
from skewmi.trajectory import Array


class Plant(Protocol):
    """What the servos move."""

    def position(self, side: Side) -> Array:
        """Measured joints of an arm, rad, chain order. Shape (7,)."""

    def follow(self, targets: Mapping[Side, Target]) -> None:
        """Let the servos follow their targets for one cycle."""


class IdealPlant:
    """Arms that are where they are told to be. For tests, and for an arm nothing depends on.

    Args:
        positions: Where they are, rad. Each of shape (7,).
    """

    def __init__(self, positions: Mapping[Side, Array]) -> None:
        self._positions = dict(positions)

    def position(self, side: Side) -> Array:
        return self._positions[side]

    def follow(self, targets: Mapping[Side, Target]) -> None:
        for side, target in targets.items():
            self._positions[side] = target.q


class EmulatedController:
    """Both arms of a controller, or one.

    Args:
        arms: By side.
        wires: The UdpUc device of each.
        plant: What they move.
    """

    def __init__(
        self, arms: Mapping[Side, EmulatedArm], wires: Mapping[Side, Wires], plant: Plant
    ) -> None:
        self.arms = dict(arms)
        self.wires = dict(wires)
        self.plant = plant

    def cycle(self, now_ns: int) -> None:
        """One cycle.

        Args:
            now_ns: By any monotonic clock, for the network.
        """
        targets: dict[Side, Target] = {}
        for side, arm in self.arms.items():
            wires = self.wires[side]
            wires.carry(now_ns)
            reference = wires.read() if arm.sending else None
            if arm.sending:
                wires.send(arm.packet(self.plant.position(side)), now_ns)
            else:
                # The socket comes and goes with EGM.
                wires.clear()
            targets[side] = arm.cycle(reference)
        self.plant.follow(targets)

    def carry(self, now_ns: int) -> None:
        """Between cycles: let datagrams arrive that are due."""
        for wires in self.wires.values():
            wires.carry(now_ns)

    @property
    def next_due_ns(self) -> int | None:
        """When `carry` has to be called next; None if nothing is on its way."""
        dues = [wires.next_due_ns for wires in self.wires.values()]
        return min((due for due in dues if due is not None), default=None)

    def start(self) -> None:
        """Start the programs of all arms."""
        for arm in self.arms.values():
            arm.start()

    def switch_motors(self, *, on: bool) -> None:
        """Motors are switched for all arms at once."""
        for arm in self.arms.values():
            arm.switch_motors(on=on)

    def place(self, side: Side, q: Array) -> None:
        """The scene has put an arm to `q`, shape (7,), rad: its session ends, another begins."""
        self.arms[side].place(q)

    def close(self) -> None:
        for wires in self.wires.values():
            wires.close()
