"""A calibration as one page to look at: constants, what they rest on, and what to doubt.

One HTML file with its pictures inside, so that it can be sent and kept beside the calibration.
"""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skewmi.calibration.calibration_file import Calibration, Constant, ServoCalibration
from skewmi.calibration.servo_identification import SETTLE_S
from skewmi.calibration.servo_model import DelayedServo, ServoModel
from skewmi.calibration.servo_parameters import ServoUnknowns
from skewmi.calibration.servo_recording import ServoRecording
from skewmi.calibration.servo_section import servo_start
from skewmi.calibration.uncertainty import inverse_of
from skewmi.robot_models import yumi
from skewmi.robot_models.servo import ServoParameters
from skewmi.trajectory import Array

SHOWN_S = 6.0
"""Length of the overlay of measured and simulated motion, s."""
_LAGS = 50
_MRAD = 1e3
_STYLE = (
    "body{font:15px/1.45 sans-serif;max-width:68em;margin:2em auto;padding:0 1em;color:#222}"
    "table{border-collapse:collapse}td,th{padding:.25em .7em;text-align:right;"
    "border-bottom:1px solid #ddd}th:first-child,td:first-child{text-align:left}"
    "img{max-width:100%}.warn{background:#fff4d6;padding:.5em 1em}.dim{color:#777}"
)


@dataclass(frozen=True)
class NamedRecording:
    """A recording with what to call it."""

    name: str
    recording: ServoRecording
    held_out: bool = False


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
        parts.append(_table(("", "value", "95 % interval"), [_row(*row) for row in rows]))
    checks = [(name, f"{value:.4g}") for name, value in calibration.checks.items()]
    parts += ["<h2>Checks</h2>", _table(("", "value"), checks)]
    files = [(item.file, item.sha256[:16]) for item in calibration.recordings]
    parts += ["<h2>Made from</h2>", _table(("recording", "sha256"), files)]
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
            _cell(servo.kp, index),
            _cell(servo.kd, index),
            _cell(servo.frictionloss, index),
            _cell(servo.kd_over_kp, index, 1e3),
            _cell(servo.frictionloss_over_kp, index, 1e3),
        )
        for index, joint in enumerate(joints)
    ]
    parts = [
        "<h2>Servos</h2>",
        "<p>Values with their 95 % intervals.</p>",
        _table(head, rows),
        f"<p>Delay {_cell(servo.delay_ms, 0)} ms.</p>",
        _picture(_draw_constants(servo, nominal), "constants relative to the nominal ones"),
    ]
    if not recordings:
        return [*parts, "<p class=dim>No recordings given: no residuals are shown.</p>"]
    found = servo_start(servo, nominal)
    far = DelayedServo(nominal, 0.0)
    for item in recordings:
        word = " (held out)" if item.held_out else ""
        parts.append(f"<h2>{html.escape(item.name)}{word}</h2>")
        simulated = model.positions([far, found], item.recording)
        parts.append(_picture(_draw_overlay(item.recording, simulated), "measured and simulated"))
        residual = simulated[1] - item.recording.positions
        rows_ = item.recording.times_s >= item.recording.motion_begins_s + SETTLE_S
        parts.append(_picture(_draw_residuals(item.recording, residual, rows_), "residuals"))
    parts.append("<h2>Correlations of the estimates</h2>")
    parts.append(_picture(_draw_correlations(model, found, recordings, nominal), "correlations"))
    return parts


def _row(label: str, constant: Constant, index: int) -> tuple[str, str, str]:
    mark = " (assumed)" if constant.assumed[index] else ""
    return (
        label,
        f"{constant.value[index]:.5g}{mark}",
        f"{constant.low[index]:.5g} to {constant.high[index]:.5g}",
    )


def _cell(constant: Constant, index: int, factor: float = 1.0) -> str:
    low, value, high = (
        factor * part[index] for part in (constant.low, constant.value, constant.high)
    )
    return f"{value:.4g} ({low:.4g} to {high:.4g})"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    def line(tag: str, cells: Sequence[str]) -> str:
        inside = "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in cells)
        return f"<tr>{inside}</tr>"

    return "<table>" + line("th", head) + "".join(line("td", row) for row in rows) + "</table>"


def _picture(figure: Any, alt: str) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=90, bbox_inches="tight")
    coded = base64.b64encode(buffer.getvalue()).decode()
    return f'<p><img alt="{html.escape(alt)}" src="data:image/png;base64,{coded}"></p>'


def _figure(width: float, height: float) -> Any:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def _draw_constants(servo: ServoCalibration, nominal: ServoParameters) -> Any:
    figure = _figure(11.0, 2.6)
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


def _draw_overlay(recording: ServoRecording, simulated: Array) -> Any:
    """Measured less commanded, and what the nominal and the calibrated servos would show."""
    times = recording.times_s
    middle = times[0] + 0.5 * (times[-1] - times[0])
    rows = np.abs(times - middle) <= SHOWN_S / 2.0
    commanded = np.array([recording.commands.at(round(1e9 * t)).q for t in times[rows]])
    figure = _figure(11.0, 10.0)
    for joint, axes in enumerate(figure.subplots(7, 1, sharex=True)):
        for values, style, label in (
            (recording.positions, "k.", "measured"),
            (simulated[0], "C1-", "nominal servos"),
            (simulated[1], "C0-", "calibrated servos"),
        ):
            off = _MRAD * (values[rows][:, joint] - commanded[:, joint])
            axes.plot(times[rows], off, style, label=label, markersize=3, linewidth=1)
        axes.set_ylabel(f"joint {joint + 1}")
        axes.grid(alpha=0.3)
        if joint == 0:
            axes.set_title("position less command, mrad")
            axes.legend(loc="upper right", ncols=3, fontsize=8)
    axes.set_xlabel("s")
    return figure


def _draw_residuals(recording: ServoRecording, residual: Array, rows: NDArray[np.bool_]) -> Any:
    figure = _figure(11.0, 8.0)
    grid = figure.subplots(7, 2, sharex="col", width_ratios=(3, 1))
    for joint, (series, lags) in enumerate(grid):
        values = residual[rows][:, joint]
        series.plot(recording.times_s[rows], _MRAD * values, linewidth=0.6)
        rms = _MRAD * float(np.sqrt((values**2).mean()))
        series.set_ylabel(f"joint {joint + 1}\nrms {rms:.2g}", fontsize=8)
        series.grid(alpha=0.3)
        centred = values - values.mean()
        power = float(centred @ centred) or 1.0
        correlation = [
            float(centred[lag:] @ centred[: len(centred) - lag]) / power
            for lag in range(min(_LAGS, len(centred)))
        ]
        lags.plot(0.02 * np.arange(len(correlation)), correlation)
        lags.set_ylim(-0.5, 1.05)
        lags.grid(alpha=0.3)
    grid[0][0].set_title("simulated less measured, mrad")
    grid[0][1].set_title("autocorrelation")
    for axes in grid[-1]:
        axes.set_xlabel("s")
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
    figure = _figure(6.5, 5.5)
    axes = figure.subplots()
    image = axes.imshow(covariance / np.outer(size, size), cmap="RdBu_r", vmin=-1.0, vmax=1.0)
    names = [f"{name}{joint}" for name in ("kp", "kd/kp", "f/kp") for joint in range(1, 8)]
    axes.set_xticks(range(22), [*names, "delay"], rotation=90, fontsize=7)
    axes.set_yticks(range(22), [*names, "delay"], fontsize=7)
    figure.colorbar(image)
    return figure
