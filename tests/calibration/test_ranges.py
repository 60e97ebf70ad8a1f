"""Ranges of a variation hold what the calibration holds, widened, and are allowed."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from calibrations import full_calibration, known_servo
from hypothesis import given
from hypothesis import strategies as st

from skewmi.calibration.calibration_file import Calibration, Constant
from skewmi.calibration.ranges import FLOORS, range_warnings, variation_ranges
from skewmi.robot_models.servo import CONTACT_SERVO
from skewmi.sim import tasks

VARIATIONS = tasks.find("open_press_close").variations
ALLOWED = {key.name: (key.low, key.high) for key in VARIATIONS.keys}


def seven(values: tuple[float, ...], half: float) -> Constant:
    return Constant(
        values,
        tuple(max(v - half, 0.0) for v in values),
        tuple(v + half for v in values),
        (False,) * 7,
    )


def calibrated(**changes: Constant) -> Calibration:
    """Nominal servos, known to 2 %, but for these constants."""
    known = known_servo(CONTACT_SERVO, 12.0, 0.01, np.random.default_rng(0))
    return replace(full_calibration(), servo=replace(known, **changes), scene=None)


@given(
    scale=st.lists(st.floats(0.4, 1.6), min_size=7, max_size=7),
    half=st.floats(0.0, 20.0),
    delay=st.floats(0.0, 40.0),
    widen=st.floats(1.0, 4.0),
)
def test_ranges_are_a_variation_and_hold_the_intervals(
    scale: list[float], half: float, delay: float, widen: float
) -> None:
    calibration = full_calibration()
    assert calibration.servo is not None
    kp = seven(tuple(np.multiply(scale, CONTACT_SERVO.kp).tolist()), half)
    servo = replace(
        calibration.servo,
        kp=kp,
        frictionloss=seven(tuple(scale), 0.01),
        delay_ms=Constant((delay,), (max(delay - 0.1, 0.0),), (delay + 0.1,), (False,)),
    )
    content = variation_ranges(replace(calibration, servo=servo), CONTACT_SERVO, widen, ALLOWED)
    VARIATIONS.parse(json.dumps(content))
    for joint, (low, high) in enumerate(content["servo"]["kp_scale"]):  # type: ignore[call-overload]
        floor = FLOORS["servo.kp_scale"]
        unit = CONTACT_SERVO.kp[joint]
        least, most = ALLOWED["servo.kp_scale"]
        assert low <= max(min(kp.low[joint] / unit, scale[joint] - floor), least) + 1e-6
        assert high >= min(max(kp.high[joint] / unit, scale[joint] + floor), most) - 1e-6
    low, high = content["servo"]["delay_ms"]  # type: ignore[misc]
    assert low <= max(delay - 2.0, 0.0) + 1e-6
    assert high >= delay + 2.0 - 1e-6


def test_what_a_task_cannot_vary_is_left_out() -> None:
    content = variation_ranges(full_calibration(), CONTACT_SERVO, 2.0, {"servo.kp_scale": (0.2, 5)})
    assert list(content) == ["servo"]
    assert list(content["servo"]) == ["kp_scale"]


@pytest.mark.parametrize("widen", [1.0, 3.0])
def test_wider_means_wider(widen: float) -> None:
    narrow, wide = (
        variation_ranges(full_calibration(), CONTACT_SERVO, factor, ALLOWED)
        for factor in (widen, 2.0 * widen)
    )
    for section, entries in narrow.items():
        for name, rows in entries.items():
            for a, b in zip(np.atleast_2d(rows), np.atleast_2d(wide[section][name]), strict=True):  # type: ignore[arg-type]
                assert b[0] <= a[0]
                assert a[1] <= b[1]


def test_what_a_variation_can_hold_is_no_reason_to_warn() -> None:
    assert range_warnings(calibrated(), CONTACT_SERVO, ALLOWED) == ()


def test_what_a_variation_cannot_hold_is_told_with_what_it_allows() -> None:
    kp = tuple((CONTACT_SERVO.kp * (1.0, 1.0, 5.8, 1.0, 1.0, 1.0, 0.25)).tolist())
    odd = calibrated(
        kp=Constant(kp, (*kp[:6], 0.6 * kp[6]), kp, (False,) * 7),
        delay_ms=Constant((140.0,), (137.2,), (142.8,), (False,)),
    )
    assert range_warnings(odd, CONTACT_SERVO, ALLOWED) == (
        "servo.kp_scale of yumi_joint_7_r is 5.8 (5.8 to 5.8) by the calibration; a variation "
        "allows 0.2 to 5: the range ends there, and no robot of it is like the calibrated",
        "servo.kp_scale of yumi_joint_6_r is 0.25 (0.15 to 0.25) by the calibration; a variation "
        "allows 0.2 to 5: the range ends there",
        "servo.delay_ms is 140 (137.2 to 142.8) by the calibration; a variation allows 0 to 100: "
        "the range ends there, and no robot of it is like the calibrated",
    )
    assert range_warnings(odd, CONTACT_SERVO, {"servo.kd_scale": (0.2, 5.0)}) == ()
    content = variation_ranges(odd, CONTACT_SERVO, 2.0, ALLOWED)
    assert content["servo"]["delay_ms"] == [100.0, 100.0]


def test_joints_that_stick_do_so_in_the_robots_of_the_ranges() -> None:
    # F_c and F_m, N m: one that sticks, one that does not, and one with nearly no friction.
    moving, more = (0.5,) * 5 + (0.5, 0.001), (0.25,) * 5 + (0.005, 0.005)
    sticky = calibrated(
        frictionloss=seven(moving, 0.1),
        stiction=seven(more, 0.05),
        stribeck_velocity=Constant(
            (0.05,) * 7, (0.04,) * 5 + (1e-6,) * 2, (0.06,) * 5 + (9.0,) * 2, (False,) * 7
        ),
    )
    assert range_warnings(sticky, CONTACT_SERVO, ALLOWED) == ()
    content = variation_ranges(sticky, CONTACT_SERVO, 1.0, ALLOWED)
    VARIATIONS.parse(json.dumps(content))
    scale = content["servo"]["stiction_scale"]
    # 1 + 0.25 / 0.5, as much to both sides as (0.3 / 0.4) is more.
    np.testing.assert_allclose(np.array(scale)[0], [1.25, 1.75])
    np.testing.assert_allclose(np.array(scale)[5], [1.0, 1.1375])
    assert content["servo"]["stribeck_velocity"][0] == [0.04, 0.06]  # type: ignore[index]
    assert content["servo"]["stribeck_velocity"][5] == [0.001, 1.0]  # type: ignore[index]
    assert (
        "stiction_scale" not in variation_ranges(calibrated(), CONTACT_SERVO, 1.0, ALLOWED)["servo"]
    )
    far = calibrated(
        frictionloss=seven((0.1,) * 7, 0.0),
        stiction=seven((0.1,) * 6 + (0.5,), 0.0),
        stribeck_velocity=seven((0.05,) * 7, 0.0),
    )
    (told,) = range_warnings(far, CONTACT_SERVO, ALLOWED)
    assert told.startswith("servo.stiction_scale of yumi_joint_6_r is 6 (6 to 6)")
