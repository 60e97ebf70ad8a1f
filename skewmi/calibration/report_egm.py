"""The part of a report on a controller that is guided by EGM."""

from __future__ import annotations

import html
from collections.abc import Sequence

import numpy as np

from skewmi.calibration.calibration_file import EgmCalibration
from skewmi.calibration.egm_law import EgmLaw
from skewmi.calibration.egm_model import EgmArm, EgmModel
from skewmi.calibration.egm_section import egm_arm
from skewmi.calibration.report_parts import (
    NamedRecording,
    cell,
    draw_overlay,
    draw_residuals,
    picture,
    table,
)
from skewmi.calibration.servo_fit import settled
from skewmi.calibration.servo_model import DelayedServo, ServoModel
from skewmi.robot_models import yumi
from skewmi.robot_models.servo import ServoParameters


def egm_parts(
    egm: EgmCalibration,
    recordings: Sequence[NamedRecording],
    model: ServoModel,
    nominal: ServoParameters,
) -> list[str]:
    """Law, lags and servos as tables, and what an arm like this makes of the recorded motions.

    Args:
        egm: Of a calibration.
        recordings: To compare with; those that were not made through EGM are left out.
        model: Of the servos.
        nominal: What no calibration tells.
    """
    law = (
        ("gain of the law, 1/s", cell(egm.gain, 0)),
        ("corner of its low-pass, Hz", cell(egm.low_pass_hz, 0)),
        ("lag that all joints share, ms", cell(egm.servo.delay_ms, 0)),
        ("cycle, ms", f"{egm.period_ms:.4g}"),
        ("part of the speed that was sent", f"{egm.speed_share:g}"),
    )
    joints = [
        (
            joint,
            cell(egm.lag_ms, index),
            cell(egm.servo.frictionloss_over_kp, index, 1e3),
            cell(egm.servo.kp, index),
            cell(egm.servo.kd, index),
        )
        for index, joint in enumerate(yumi.joint_names("right"))
    ]
    head = ("joint", "lag, ms", "friction / kp, mrad", "stiffness, N m/rad", "damping, N m s/rad")
    parts = [
        "<h2>Controller guided by EGM</h2>",
        "<p>Values with their 95 % intervals. The controller obeys speed = low-pass(gain "
        "(reference - desired position) + speed reference); its servos follow that later.</p>",
        table(("", "value"), law),
        "<p>Joints: how late at a steady speed, servo included, and the servos behind the law.</p>",
        table(head, joints),
    ]
    shown = [item for item in recordings if item.egm is not None]
    if not shown:
        return [*parts, "<p class=dim>No recordings given: no residuals are shown.</p>"]
    return [*parts, *_compared(egm, shown, model, nominal)]


def _compared(
    egm: EgmCalibration,
    shown: Sequence[NamedRecording],
    model: ServoModel,
    nominal: ServoParameters,
) -> list[str]:
    """What nominal servos behind the law make of each motion, and those found."""
    parts = []
    found = egm_arm(egm, nominal)
    plain = EgmArm(EgmLaw(egm.gain.value[0], egm.low_pass_hz.value[0]), DelayedServo(nominal, 0.0))
    for item in shown:
        assert item.egm is not None
        motion, own = item.egm.motion, EgmModel(model, item.egm.speed_share)
        faster = 1.0 / item.egm.stretch
        simulated = own.positions([plain.slower(faster), found.slower(faster)], motion)
        word = " (held out)" if item.held_out else ""
        parts.append(f"<h2>{html.escape(item.name)}{word}</h2>")
        parts.append(
            "<p>In cycles of the controller, each taken for 4 ms; nominal servos without a lag, "
            "and those found.</p>"
        )
        parts.append(picture(draw_overlay(motion, simulated), "measured and simulated"))
        residual = simulated[1] - motion.positions
        parts.append(picture(draw_residuals(motion, residual, settled(motion)), "residuals"))
        rms = 1e3 * np.sqrt((residual[settled(motion)] ** 2).mean())
        parts.append(f"<p>Residual {rms:.3g} mrad.</p>")
    return parts
