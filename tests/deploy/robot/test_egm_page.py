"""The page on EGM and the code say the same."""

from __future__ import annotations

from enum import Enum
from pathlib import Path

import pytest

from skewmi.deploy.robot.backends.egm.options import EgmOptions
from skewmi.deploy.robot.backends.egm.program import ProgramSettings
from skewmi.deploy.robot.backends.egm.states import EGM_TABLE, EgmEvent
from skewmi.deploy.robot.egm_emulator.controller_states import ARM_TABLE, ArmEvent
from skewmi.deploy.state_machine import TransitionTable

PAGE = (Path(__file__).parents[3] / "docs" / "egm.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(("table", "events"), [(EGM_TABLE, EgmEvent), (ARM_TABLE, ArmEvent)])
def test_page_shows_the_tables(table: TransitionTable, events: type[Enum]) -> None:
    assert table.markdown(events) in PAGE
    for state in type(table.initial):
        assert state.value in PAGE


def test_page_tells_the_speeds_that_are_admitted() -> None:
    assert f"{1e3 * EgmOptions().admitted_speed:.0f} mm/s with those values" in PAGE
    abb = ProgramSettings(gain=5.0, comm_timeout_s=1.0, ramp_out_s=0.5, ramp_in_s=0.5)
    ms = 1e3 * EgmOptions(program=abb).admitted_speed
    assert f"{ms:.0f} mm/s with ABB's defaults" in PAGE
