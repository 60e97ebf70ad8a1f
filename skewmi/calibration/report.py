"""A calibration as one page to look at: constants, what they rest on, and what to doubt.

One HTML file with its pictures inside, so that it can be sent and kept beside the calibration.
"""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import Any

import numpy as np

from skewmi.calibration.calibration_file import Calibration, Constant, ServoCalibration
from skewmi.calibration.report_egm import egm_parts
from skewmi.calibration.report_parts import (
    NamedRecording,
    cell,
    draw_overlay,
    draw_residuals,
    figure_of,
    picture,
    row,
    table,
)
from skewmi.calibration.servo_fit import SETTLE_S
from skewmi.calibration.servo_model import DelayedServo, ServoModel
from skewmi.calibration.servo_parameters import ServoUnknowns
from skewmi.calibration.servo_section import servo_start
from skewmi.calibration.uncertainty import inverse_of
from skewmi.robot_models import yumi
from skewmi.robot_models.servo import ServoParameters

_STYLE = (
    "body{font:15px/1.45 sans-serif;max-width:68em;margin:2em auto;padding:0 1em;color:#222}"
    "table{border-collapse:collapse}td,th{padding:.25em .7em;text-align:right;"
    "border-bottom:1px solid #ddd}th:first-child,td:first-child{text-align:left}"
    "img{max-width:100%}.warn{background:#fff4d6;padding:.5em 1em}.dim{color:#777}"
)


def report_html(
    calibration: Calibration,
    recordings: Sequence[NamedRecording],
    model: ServoModel,
    nominal: ServoParameters,
) -> str:
    """The page.

    Args:
        calibration: To show.
        recordings: Motions to compare with; of servos, without which only tables are shown.
        model: That the servos were identified with.
        nominal: Where the search began.
    """
    parts = [
        "<h1>Calibration of a YuMi's right arm</h1>",
        f"<p>Made {html.escape(calibration.created)} by skewmi {html.escape(calibration.version)}; "
        f"robot model {html.escape(calibration.robot_model[:12])}.</p>",
    ]
    if calibration.warnings:
        items = "".join(f"<li>{html.escape(text)}</li>" for text in calibration.warnings)
        parts.append(f"<div class=warn><b>To know before use</b><ul>{items}</ul></div>")
    if calibration.servo is not None:
        parts += _servo_parts(calibration.servo, recordings, model, nominal)
    if calibration.egm is not None:
        parts += egm_parts(calibration.egm, recordings, model, nominal)
    if calibration.scene is not None:
        parts.append("<h2>Scene</h2>")
        rows = [
            (label, getattr(calibration.scene, name), 0)
            for name, label in (
                ("x", "box x, m"),
                ("y", "box y, m"),
                ("yaw_deg", "box yaw, degrees"),
                ("lid_bias_deg", "lid bias, degrees"),
            )
        ]
        parts.append(table(("", "value", "95 % interval"), [row(*entry) for entry in rows]))
    checks = [(name, f"{value:.4g}") for name, value in calibration.checks.items()]
    parts += ["<h2>Checks</h2>", table(("", "value"), checks)]
    files = [(item.file, item.sha256[:16]) for item in calibration.recordings]
    parts += ["<h2>Made from</h2>", table(("recording", "sha256"), files)]
    body = "\n".join(parts)
    return (
        "<!DOCTYPE html><html lang=en><head><meta charset=utf-8><title>Calibration</title>"
        f"<style>{_STYLE}</style></head><body>{body}</body></html>\n"
    )


def _servo_parts(
    servo: ServoCalibration,
    recordings: Sequence[NamedRecording],
    model: ServoModel,
    nominal: ServoParameters,
) -> list[str]:
    joints = yumi.joint_names("right")
    head = (
        "joint",
        "stiffness, N m/rad",
        "damping, N m s/rad",
        "friction, N m",
        "kd / kp, ms",
        "friction / kp, mrad",
    )
    rows = [
        (
            joint,
            cell(servo.kp, index),
            cell(servo.kd, index),
            cell(servo.frictionloss, index),
            cell(servo.kd_over_kp, index, 1e3),
            cell(servo.frictionloss_over_kp, index, 1e3),
        )
        for index, joint in enumerate(joints)
    ]
    parts = [
        "<h2>Servos</h2>",
        "<p>Values with their 95 % intervals.</p>",
        table(head, rows),
        f"<p>Delay {cell(servo.delay_ms, 0)} ms.</p>",
        picture(_draw_constants(servo, nominal), "constants relative to the nominal ones"),
    ]
    if not recordings:
        return [*parts, "<p class=dim>No recordings given: no residuals are shown.</p>"]
    found = servo_start(servo, nominal)
    far = DelayedServo(nominal, 0.0)
    for item in recordings:
        word = " (held out)" if item.held_out else ""
        parts.append(f"<h2>{html.escape(item.name)}{word}</h2>")
        simulated = model.positions([far, found], item.recording)
        parts.append(picture(draw_overlay(item.recording, simulated), "measured and simulated"))
        residual = simulated[1] - item.recording.positions
        rows_ = item.recording.times_s >= item.recording.motion_begins_s + SETTLE_S
        parts.append(picture(draw_residuals(item.recording, residual, rows_), "residuals"))
    parts.append("<h2>Correlations of the estimates</h2>")
    parts.append(picture(_draw_correlations(model, found, recordings, nominal), "correlations"))
    return parts


def _draw_constants(servo: ServoCalibration, nominal: ServoParameters) -> Any:
    figure = figure_of(11.0, 2.6)
    for axes, name, title in zip(
        figure.subplots(1, 3),
        ("kp", "kd", "frictionloss"),
        ("stiffness / nominal", "damping / nominal", "friction, N m"),
        strict=True,
    ):
        constant: Constant = getattr(servo, name)
        unit = getattr(nominal, name) if name != "frictionloss" else np.ones(7)
        value, low, high = (
            np.array(part) / unit for part in (constant.value, constant.low, constant.high)
        )
        axes.errorbar(
            np.arange(1, 8), value, np.stack((value - low, high - value)), fmt="o", capsize=3
        )
        axes.set(title=title, xlabel="joint of the chain")
        axes.set_ylim(bottom=0.0)
        axes.grid(alpha=0.3)
    return figure


def _draw_correlations(
    model: ServoModel,
    found: DelayedServo,
    recordings: Sequence[NamedRecording],
    nominal: ServoParameters,
) -> Any:
    """Of what is fitted: log kp, log kd/kp, friction/kp of each joint, and the delay."""
    unknowns = ServoUnknowns(nominal)
    vector = unknowns.vector(found)
    step = np.diag(1e-3 * np.maximum(1.0, np.abs(vector)))
    candidates = [unknowns.servo(vector), *(unknowns.servo(row) for row in vector + step)]
    information = np.zeros((len(vector), len(vector)))
    for item in recordings:
        if item.held_out:
            continue
        positions = model.positions(candidates, item.recording)
        rows = ((positions[1:] - positions[0]) / np.diag(step)[:, None, None]).reshape(
            len(vector), -1
        )
        information += rows @ rows.T
    covariance = inverse_of(information)
    size = np.sqrt(np.diag(covariance).clip(min=1e-300))
    figure = figure_of(6.5, 5.5)
    axes = figure.subplots()
    image = axes.imshow(covariance / np.outer(size, size), cmap="RdBu_r", vmin=-1.0, vmax=1.0)
    names = [f"{name}{joint}" for name in ("kp", "kd/kp", "f/kp") for joint in range(1, 8)]
    axes.set_xticks(range(22), [*names, "delay"], rotation=90, fontsize=7)
    axes.set_yticks(range(22), [*names, "delay"], fontsize=7)
    figure.colorbar(image)
    return figure
