"""Faults of a controller behind EGM and of the cable to it: only an emulated one can have them."""

from __future__ import annotations

import signal
import time

from fault_cell import FAULT, GOES_ON, Cell, Fault
from fault_egm_robot import EgmRobot
from fault_kinds import Inject
from fault_rows import PATIENT_MS, DoesNotApply, Expect, Row

NO_CONTROLLER = DoesNotApply("not there: the simulated arm has no controller")


def _row(
    name: str,
    inject: Inject,
    expect: Expect,
    go_on: str = "run again",
    *,
    taken: bool | None = None,
) -> Row:
    """One of the controller's; by default a fault is one in which it takes the arm away."""
    if taken is None:
        taken = expect.verdict == FAULT
    fault = Fault(name, inject, lead_ms=PATIENT_MS, taken=taken)
    return Row(fault, NO_CONTROLLER, NO_CONTROLLER, NO_CONTROLLER, go_on=go_on, egm=expect)


def _told(*orders: str, wait_s: float = 0.0) -> Inject:
    """The emulated controller does as it is told: see `fault_egm_robot`."""

    def inject(cell: Cell) -> None:
        robot = cell.robot
        assert isinstance(robot, EgmRobot)

        def tell() -> None:
            for number, order in enumerate(orders):
                time.sleep(wait_s if number else 0.0)
                robot.tell(order)

        cell.spawn(tell)

    return inject


def _killed(cell: Cell) -> None:
    """The emulated controller is killed, scene and all, and another one is started."""
    robot = cell.robot
    assert isinstance(robot, EgmRobot)

    def restart() -> None:
        robot.end_emulator(signal.SIGKILL)
        robot.start()

    cell.spawn(restart)


WENT_ON = Expect(GOES_ON)
NOT_RUNNING = Expect(FAULT, "EGM is not running")

EGM_ROWS = (
    _row("packets lost for 10 ms", _told("silent 0.01"), WENT_ON),
    _row("packets lost for 50 ms", _told("silent 0.05"), WENT_ON),
    _row("packets lost for 0.5 s", _told("silent 0.5"), Expect(FAULT, "no packet")),
    _row("answers lost for 0.5 s", _told("mute 0.5"), NOT_RUNNING),
    _row("every packet twice", _told("doubled 500"), WENT_ON),
    _row("packets in the wrong order", _told("overtaken 500"), WENT_ON),
    _row("packets and answers up to 20 ms late, at random", _told("late 500"), WENT_ON),
    _row("noise between packets", _told("spoiled 500"), WENT_ON),
    _row("another controller's packets between them", _told("foreign 500"), WENT_ON),
    _row("packets with a NaN for 40 ms", _told("not_numbers 10"), WENT_ON),
    _row(
        "packets with a NaN for 0.5 s",
        _told("not_numbers 125"),
        Expect(FAULT, "then the robot server is in fault: not a packet of a YuMi"),
    ),
    _row(
        "more than 100 % utilisation for 0.5 s",
        _told("overload 125"),
        Expect(FAULT, "utilisation beyond 100 %"),
        taken=False,
    ),
    _row("EGM ends, and the program begins again", _told("end"), NOT_RUNNING),
    _row(
        "EGM ends with an error",
        _told("fail", "start", wait_s=1.0),
        Expect(FAULT, "the RAPID program is stopped, after an EGM error"),
        "start the program, run again",
    ),
    _row(
        "motors off",
        _told("motors off", "motors on", "start", wait_s=1.0),
        Expect(FAULT, "no packet"),
        "motors on, start the program, run again",
    ),
    _row(
        "program stopped",
        _told("stop", "start", wait_s=1.0),
        Expect(FAULT, "the RAPID program is stopped"),
        "start the program, run again",
    ),
    _row("controller restarted", _told("restart"), Expect(FAULT, "no packet")),
    _row("controller killed (-9)", _killed, Expect(FAULT, "no packet")),
)
