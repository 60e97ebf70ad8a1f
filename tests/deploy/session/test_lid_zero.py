"""The zero of a lid's sensor in a session."""

from __future__ import annotations

import dataclasses

from calibrations import full_calibration
from unknown_robots import exact_calibration

from skewmi.calibration.calibration_file import Calibration, Constant
from skewmi.deploy.session.lid_zero import LidZero
from skewmi.sim.tasks.open_press_close.definition import make_layout


def readings(lid: float) -> dict[str, float]:
    return {"lid_angle": lid, "button_depth": 0.004}


def with_bias(degrees: float, assumed: bool) -> Calibration:
    scene = full_calibration().scene
    assert scene is not None
    bias = Constant((degrees,), (degrees,), (degrees,), (assumed,))
    scene = dataclasses.replace(scene, lid_bias_deg=bias)
    return dataclasses.replace(exact_calibration(), scene=scene)


def test_the_first_reading_of_each_episode_is_shut() -> None:
    for known in (exact_calibration(), with_bias(7.0, assumed=True)):
        zero = LidZero(known, make_layout())
        for bias in (0.1, -0.2):
            zero.begin(readings(bias))
            assert zero.taken_off(readings(bias)) == readings(0.0)
            assert zero.taken_off(readings(1.0)) == readings(1.0 - bias)


def test_a_lid_that_is_open_at_first_has_no_zero() -> None:
    zero = LidZero(exact_calibration(), make_layout())
    zero.begin(readings(0.1))
    zero.begin(readings(1.2))
    assert zero.taken_off(readings(1.2)) == readings(1.2)


def test_what_was_measured_counts_more_than_first_readings() -> None:
    zero = LidZero(with_bias(180.0 / 3.141592653589793 * 0.05, assumed=False), make_layout())
    zero.begin(readings(0.1))
    assert abs(zero.taken_off(readings(0.1))["lid_angle"] - 0.05) < 1e-12
