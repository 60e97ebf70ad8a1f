"""Faults of a controller behind EGM and of the cable to it: only an emulated one can have them."""

from __future__ import annotations

from fault_cell import FAULT, GOES_ON, Fault
from fault_kinds import Inject, controller_restarted, controller_told
from fault_rows import PATIENT_MS, DoesNotApply, Expect, Row

NO_CONTROLLER = DoesNotApply("not there: the simulated arm has no controller")


def _row(name: str, inject: Inject, expect: Expect, go_on: str = "run again") -> Row:
    fault = Fault(name, inject, lead_ms=PATIENT_MS, taken=expect.verdict == FAULT)
    return Row(fault, NO_CONTROLLER, NO_CONTROLLER, NO_CONTROLLER, go_on=go_on, egm=expect)


def _told(*orders: str, wait_s: float = 0.0) -> Inject:
    return controller_told(*orders, wait_s=wait_s)


WENT_ON = Expect(GOES_ON)

EGM_ROWS = (
    _row("packets lost for 10 ms", _told("silent 0.01"), WENT_ON),
    _row("packets lost for 50 ms", _told("silent 0.05"), WENT_ON),
    _row("packets lost for 0.5 s", _told("silent 0.5"), Expect(FAULT, "no packet")),
    _row("answers lost for 0.5 s", _told("mute 0.5"), Expect(FAULT, "EGM is not running")),
    _row("every packet twice", _told("doubled 500"), WENT_ON),
    _row("packets in the wrong order", _told("overtaken 500"), WENT_ON),
    _row("noise between packets", _told("spoiled 500"), WENT_ON),
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
    _row("controller killed (-9)", controller_restarted, Expect(FAULT, "no packet")),
)
