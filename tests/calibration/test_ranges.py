"""Ranges of a variation hold what the calibration holds, widened, and are allowed."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from calibrations import full_calibration
from hypothesis import given
from hypothesis import strategies as st

from skewmi.calibration.calibration_file import Constant
from skewmi.calibration.ranges import FLOORS, variation_ranges
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
