"""The RAPID modules and configuration say what the bridge and the emulator reckon with."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from skewmi.deploy.robot.backends.egm.program import ProgramSettings
from skewmi.deploy.robot.gripper import rws
from skewmi.robot_models import yumi

RAPID = Path(__file__).parents[1] / "rapid"
EGM = (RAPID / "SkewmiEgm.mod").read_text()
MOC = (RAPID / "moc.cfg").read_text()
SIO = (RAPID / "sio.cfg").read_text()
SYS = (RAPID / "sys.cfg").read_text()
GRIP = (RAPID / "SkewmiGrip.mod").read_text()
CODE = "\n".join(line.split("!")[0] for line in EGM.splitlines())


def number(name: str) -> float:
    match = re.search(rf"CONST num {name} := ([\d.]+);", EGM)
    assert match is not None, name
    return float(match[1])


def test_the_program_sets_what_we_reckon_with() -> None:
    settings = ProgramSettings()
    assert number("SKEWMI_COMM_TIMEOUT") == settings.comm_timeout_s
    assert number("SKEWMI_LP_FILTER") == settings.low_pass_hz
    assert number("SKEWMI_MAX_SPEED_DEVIATION") == settings.max_speed_deviation_deg_s
    assert number("SKEWMI_RAMP_IN_TIME") == settings.ramp_in_s
    assert number("SKEWMI_COND_TIME") == settings.cond_time_s
    minmax = re.search(r"egm_minmax SKEWMI_CONVERGENCE := \[-([\d.]+), ([\d.]+)\]", EGM)
    assert minmax is not None
    assert float(minmax[1]) == float(minmax[2]) == settings.convergence_deg
    assert "MaxPosDeviation" not in CODE
    assert ProgramSettings().max_position_deviation_deg == 1000.0  # ABB's default


@pytest.mark.parametrize("arm", ["ROB_L", "ROB_R"])
def test_the_configuration_does_too(arm: str) -> None:
    settings = ProgramSettings()
    entry = re.search(rf'-name "{arm}".*?(?=\n\n|\Z)', MOC, re.DOTALL)
    assert entry is not None
    values = dict(re.findall(r"-(\w+) ([\d.]+)", entry[0]))
    gain = float(values["ext_motion_Kp"]) * number("SKEWMI_POS_CORR_GAIN")
    assert gain == settings.gain
    assert float(values["ext_motion_filter_bandwidth"]) == settings.low_pass_hz
    assert float(values["ramp_time"]) == settings.ramp_out_s
    assert ("do_not_restart_after_motors_off" in entry[0]) == (
        settings.do_not_restart_after_motors_off
    )
    assert "return_to" not in entry[0]


def test_ports_are_the_usual_ones() -> None:
    assert re.findall(r'-Name "(\w+)".*?-RemotePortNumber (\d+)', SIO, re.DOTALL) == [
        ("ROB_L", "6511"),
        ("ROB_R", "6512"),
    ]


def test_all_seven_axes_are_guided() -> None:
    for axis in range(1, 8):
        assert rf"\J{axis}:=SKEWMI_CONVERGENCE" in CODE
    assert r"\J1 \J2 \J3 \J4 \J5 \J6 \J7" in CODE


def test_what_must_not_be_in_the_program_is_not() -> None:
    assert "EGM_STOP_RAMP_DOWN" not in CODE
    assert "NoWaitCond" not in CODE
    assert CODE.count("EGMRunJoint") == 1
    # From a fine point, and not as the first motion: MoveAbsJ comes first.
    assert CODE.index("MoveAbsJ") < CODE.index("EGMRunJoint")
    assert re.search(r"MoveAbsJ [^;]*\bfine\b", CODE)
    assert "ERR_UDPUC_COMM" in CODE
    assert CODE.index("EGMRunJoint") < CODE.index("ERROR")


def test_the_tool_is_the_gripper_with_its_fingers() -> None:
    numbers = re.search(r"tooldata skewmi_tool := (.*?);", EGM, re.DOTALL)
    assert numbers is not None
    values = [float(x) for x in re.findall(r"-?\d+\.?\d*", numbers[1])]
    fingers = 2 * yumi.GRIPPER.finger_mass
    assert values[7] == pytest.approx(yumi.GRIPPER.base.mass + fingers, abs=1e-9)


def test_the_gripper_task_is_the_one_that_the_bridge_talks_to() -> None:
    assert f"MODULE {rws.MODULE}" in GRIP
    assert f"PERS num {rws.TARGET} " in GRIP
    assert re.search(rf"PERS num {rws.STATE}\{{4\}}", GRIP)
    assert f'-Name "{rws.TASK}"' in SYS


@pytest.mark.parametrize("path", sorted(RAPID.glob("*.mod")), ids=lambda path: path.name)
def test_blocks_are_closed(path: Path) -> None:
    code = "\n".join(line.split("!")[0] for line in path.read_text().splitlines())
    words = re.findall(r"[A-Za-z]+", re.sub(r'"[^"]*"', "", code))
    for opening, closing in (("PROC", "ENDPROC"), ("IF", "ENDIF"), ("WHILE", "ENDWHILE")):
        assert words.count(opening) == words.count(closing) > 0 or opening == "IF"
    assert words[0] == "MODULE"
    assert words[-1] == "ENDMODULE"
    # RAPID's names have at most 32 characters, and strings at most 80.
    assert max(len(word) for word in re.findall(r"\w+", code)) <= 32
