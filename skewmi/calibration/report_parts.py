"""What reports are made of: cells, tables, pictures inside the page, motions beside one another."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skewmi.calibration.calibration_file import Constant
from skewmi.calibration.egm_model import EgmRecording
from skewmi.calibration.servo_recording import ServoRecording
from skewmi.trajectory import Array

SHOWN_S = 6.0
"""Length of the overlay of measured and simulated motion, s."""
_LAGS = 50
_MRAD = 1e3


@dataclass(frozen=True)
class NamedRecording:
    """A recording with what to call it."""

    name: str
    recording: ServoRecording
    held_out: bool = False
    egm: EgmRecording | None = None
    """The same in cycles of a controller that was guided by EGM."""


def row(label: str, constant: Constant, index: int) -> tuple[str, str, str]:
    """One line of a table of constants."""
    mark = " (assumed)" if constant.assumed[index] else ""
    return (
        label,
        f"{constant.value[index]:.5g}{mark}",
        f"{constant.low[index]:.5g} to {constant.high[index]:.5g}",
    )


def cell(constant: Constant, index: int, factor: float = 1.0) -> str:
    """A value with its interval, times a factor."""
    low, value, high = (
        factor * part[index] for part in (constant.low, constant.value, constant.high)
    )
    return f"{value:.4g} ({low:.4g} to {high:.4g})"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of texts."""

    def line(tag: str, cells: Sequence[str]) -> str:
        inside = "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in cells)
        return f"<tr>{inside}</tr>"

    return "<table>" + line("th", head) + "".join(line("td", row) for row in rows) + "</table>"


def picture(figure: Any, alt: str) -> str:
    """A figure of matplotlib as an image inside the page."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=90, bbox_inches="tight")
    coded = base64.b64encode(buffer.getvalue()).decode()
    return f'<p><img alt="{html.escape(alt)}" src="data:image/png;base64,{coded}"></p>'


def figure_of(width: float, height: float) -> Any:
    """An empty figure, inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def draw_overlay(recording: ServoRecording, simulated: Array) -> Any:
    """Measured less commanded, and what the nominal and the calibrated servos would show."""
    times = recording.times_s
    middle = times[0] + 0.5 * (times[-1] - times[0])
    rows = np.abs(times - middle) <= SHOWN_S / 2.0
    commanded = np.array([recording.commands.at(round(1e9 * t)).q for t in times[rows]])
    figure = figure_of(11.0, 10.0)
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


def draw_residuals(recording: ServoRecording, residual: Array, rows: NDArray[np.bool_]) -> Any:
    """Simulated less measured, and its autocorrelation, joint by joint."""
    figure = figure_of(11.0, 8.0)
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
