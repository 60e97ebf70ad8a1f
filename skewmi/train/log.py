"""What a run tells: a CSV table, TensorBoard scalars, a progress bar on standard error."""

from __future__ import annotations

import csv
import functools
import math
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from skewmi import progress
from skewmi.outputs import writing
from skewmi.train.files import write_text


class MetricsTable:
    """`metrics.csv` and TensorBoard scalars: one row per iteration, fixed columns.

    A continued run drops the rows after its checkpoint first, so the table is the same whether
    or not a run was interrupted (but for the columns about time).
    """

    def __init__(self, run_dir: Path, columns: Sequence[str], resume_step: int | None) -> None:
        self.path = run_dir / "metrics.csv"
        self.columns = tuple(columns)
        kept: list[dict[str, str]] = []
        if resume_step is not None and self.path.exists():
            with self.path.open(newline="") as file:
                rows = list(csv.DictReader(file))
            # A killed process may leave half a line.
            whole = [row for row in rows if None not in row.values() and row["step"].isdigit()]
            kept = [row for row in whole if int(row["step"]) <= resume_step]
        lines = [",".join(self.columns)]
        lines += [",".join(row.get(name, "") for name in self.columns) for row in kept]
        write_text(self.path, "\n".join(lines) + "\n")
        purge = None if resume_step is None else resume_step + 1
        self._scalars = _Scalars(run_dir / "tb", purge)

    def write(self, row: dict[str, float]) -> None:
        """Append one row; columns without a value stay empty.

        Raises:
            OutputError: It cannot be written.
        """
        cells = [_cell(row[name]) if name in row else "" for name in self.columns]
        with writing(self.path), self.path.open("a") as file:
            file.write(",".join(cells) + "\n")
        self._scalars.write(row)

    def close(self) -> None:
        self._scalars.close()


class _Scalars:
    """TensorBoard's event file: wanted, never needed, since the table has everything.

    However TensorBoard fails (it is missing, another version, its disk is full), it is told once
    and left alone; training goes on.

    Args:
        folder: Where.
        purge_step: Events from this step on are dropped; None keeps all.
    """

    def __init__(self, folder: Path, purge_step: int | None) -> None:
        self._writer: Any = None
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError:  # it is optional
            return
        except Exception as error:
            self._give_up(error)
            return
        self._try(lambda: SummaryWriter(str(folder), purge_step=purge_step), keep=True)

    def write(self, row: dict[str, float]) -> None:
        """Add a point to every curve."""
        for name, value in row.items():
            if name != "step" and math.isfinite(value) and self._writer is not None:
                self._try(functools.partial(self._writer.add_scalar, name, value, int(row["step"])))

    def close(self) -> None:
        """Write what is left."""
        if self._writer is not None:
            self._try(self._writer.close)

    def _try(self, action: Callable[[], Any], *, keep: bool = False) -> None:
        try:
            result = action()
        except Exception as error:  # whatever it raises: it must not end a training
            self._give_up(error)
        else:
            self._writer = result if keep else self._writer

    def _give_up(self, error: Exception) -> None:
        self._writer = None
        words = " ".join(str(error).split()) or type(error).__name__
        warnings.warn(f"no more TensorBoard events, the table goes on: {words}", stacklevel=2)


def _cell(value: float) -> str:
    return str(int(value)) if float(value).is_integer() and abs(value) < 1e15 else repr(value)


def read_metrics(run_dir: Path) -> dict[str, list[float]]:
    """Columns of a run's table; empty cells are NaN."""
    with (run_dir / "metrics.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    names = rows[0].keys() if rows else ()
    return {name: [float(row[name] or "nan") for row in rows] for name in names}


class ProgressBar:
    """How far a training is towards what ends it, and the metrics that matter.

    Args:
        total: Steps.
        enabled: Whether to show anything.
        minutes: That end it, if they come first.
        until_converged: Whether convergence may end it sooner than either.
    """

    def __init__(
        self, total: int, enabled: bool, minutes: float | None = None, until_converged: bool = False
    ) -> None:
        self._total, self._minutes = total, minutes
        what = "training until converged" if until_converged else "training"
        self._bar = progress.ProgressBar(what, enabled=enabled, transient=False)
        self._begun = time.monotonic()
        self._first: int | None = None

    def __enter__(self) -> ProgressBar:
        self._begun = time.monotonic()
        self._bar.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bar.__exit__(kind, error, trace)

    def update(self, step: int, iteration: int, metrics: str) -> None:
        """Move the bar: minutes or steps, whichever will end the training sooner."""
        del iteration
        spent = time.monotonic() - self._begun
        if self._first is None:
            # What a run that goes on did before tells nothing of this computer.
            self._first, self._begun_counting = step, spent
        done = step - self._first
        rate = done / max(spent - self._begun_counting, 1e-9)
        by_steps = math.inf if not done else (self._total - step) / rate
        if self._minutes is not None and 60.0 * self._minutes - spent <= by_steps:
            minutes = min(spent / 60.0, self._minutes)
            left = 60.0 * (self._minutes - minutes)
            self._bar(round(minutes, 1), self._minutes, f"min, {step:,} steps  {metrics}", left)
        else:
            left_s = None if math.isinf(by_steps) else max(by_steps, 0.0)
            self._bar(step, self._total, f"steps  {metrics}", left_s)

    def note(self, text: str) -> None:
        """A line above the bar."""
        self._bar.note(text)
