"""The section on a controller guided by EGM is strict, and used on such robots alone."""

from __future__ import annotations

import copy
from dataclasses import replace
from math import pi
from typing import Any

import numpy as np
import pytest
from unknown_robots import exact_calibration, exact_egm_calibration

from skewmi.box_frame import known_stiffness
from skewmi.calibration.calibration_file import Calibration
from skewmi.calibration.calibration_use import (
    known_delay_s,
    low_pass_s,
    require_robot,
    servo_constants,
)
from skewmi.calibration.ranges import variation_ranges
from skewmi.errors import ConfigurationError
from skewmi.robot_models.servo import CONTACT_SERVO
from skewmi.sim.arm.scene import workspace_of
from skewmi.sim.tasks.open_press_close.definition import make_layout

EGM, SERVO = exact_egm_calibration(12.0, 8.0, 25.0), exact_calibration(delay_ms=30.0)


def content() -> dict[str, Any]:
    return copy.deepcopy(dict(EGM.as_mapping()))


def refused(changed: object, match: str) -> None:
    with pytest.raises(ConfigurationError, match=match):
        Calibration.of_mapping(changed)


def test_it_is_read_back_and_every_key_of_it_is_needed_and_known() -> None:
    assert Calibration.of_mapping(content()) == EGM
    for key in content()["egm"]:
        changed = content()
        del changed["egm"][key]
        refused(changed, f"lacks the key '{key}'")
    for where in ((), ("gain",), ("lag_ms",), ("servo",), ("servo", "kp")):
        changed = content()
        holder = changed["egm"]
        for key in where:
            holder = holder[key]
        holder["stiffness"] = 1.0
        refused(changed, "unknown key 'stiffness'")


@pytest.mark.parametrize(
    ("key", "value", "match"),
    [
        ("period_ms", 0.0, "period_ms"),
        ("period_ms", "4", "period_ms"),
        ("speed_share", 1.5, "speed_share"),
        ("gain", 20.0, "egm.gain"),
        ("servo", None, "servo"),
    ],
)
def test_what_makes_no_sense_is_refused(key: str, value: object, match: str) -> None:
    changed = content()
    changed["egm"][key] = value
    refused(changed, match)


@pytest.mark.parametrize("name", ["gain", "low_pass_hz", "lag_ms"])
def test_values_lie_in_their_intervals(name: str) -> None:
    for key, bad in (("low", 99.0), ("high", -99.0)):
        changed = content()
        many = name == "lag_ms"
        changed["egm"][name][key] = [bad] * 7 if many else bad
        refused(changed, f"egm.{name}")
    if name != "lag_ms":
        changed = content()
        changed["egm"][name]["low"] = -1.0
        refused(changed, "at least")


def test_a_robot_is_of_one_kind() -> None:
    refused(content() | {"servo": SERVO.as_mapping()["servo"]}, "both of the sections")
    with pytest.raises(ConfigurationError, match="both of the sections"):
        replace(EGM, servo=SERVO.servo)


def test_a_calibration_of_the_other_kind_of_robot_is_refused_with_what_to_do() -> None:
    require_robot(EGM, "egm")
    require_robot(EGM, "egm", 1.0)
    require_robot(SERVO, "sim")
    for known, robot, told in (
        (SERVO, "egm", "section egm"),
        (EGM, "sim", "section servo"),
        (EGM, "someone_elses", "'someone_elses'"),
    ):
        with pytest.raises(ConfigurationError, match=told):
            require_robot(known, robot)
    with pytest.raises(ConfigurationError, match="--egm-feed-forward 1"):
        require_robot(EGM, "egm", 0.5)


def test_what_is_used_of_it() -> None:
    constants = servo_constants(EGM)
    assert constants is not None
    np.testing.assert_allclose(constants.lead, 0.025)
    np.testing.assert_allclose(constants.friction, CONTACT_SERVO.frictionloss / CONTACT_SERVO.kp)
    assert low_pass_s(EGM) == pytest.approx(1.0 / (2.0 * pi * 8.0))
    assert low_pass_s(SERVO) == 0.0
    assert known_delay_s(EGM) == pytest.approx(0.025)
    assert known_delay_s(SERVO) == pytest.approx(0.030)
    # The part of the speed that is not sent is made of an error: (1 - 0.5) / 12 of the speed.
    half = servo_constants(exact_egm_calibration(12.0, 8.0, 25.0, 0.5))
    assert half is not None
    np.testing.assert_allclose(half.lead, 0.025 + 0.5 / 12.0)
    assert known_stiffness(EGM, workspace_of(make_layout())) is None
    with pytest.raises(ConfigurationError, match="nothing to widen"):
        variation_ranges(EGM, CONTACT_SERVO, 2.0, {})
