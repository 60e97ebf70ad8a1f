"""What a run tells: a CSV table, TensorBoard scalars, a progress bar on standard error."""

from __future__ import annotations

import csv
import functools
import math
import sys
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

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
    """A bar with the metrics that matter; silent when not wanted."""

    def __init__(self, total: int, enabled: bool) -> None:
        console = Console(file=sys.stderr)
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.completed:,}/{task.total:,} steps"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[metrics]}"),
            console=console,
            disable=not enabled or not console.is_terminal,
        )
        # Without a terminal a line now and then says more than a bar.
        self._console = console if enabled and not console.is_terminal else None
        self._printed = 0
        self._task = self._progress.add_task("training", total=total, metrics="")

    def __enter__(self) -> ProgressBar:
        self._progress.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._progress.stop()

    def update(self, step: int, iteration: int, metrics: str) -> None:
        """Move the bar."""
        self._progress.update(self._task, completed=step, metrics=metrics)
        if self._console is not None and iteration % 10 == 0:
            self._console.print(f"{step:,} steps  {metrics}", highlight=False)

    def note(self, text: str) -> None:
        """A line above the bar."""
        if not self._progress.disable:
            self._progress.console.print(text, highlight=False)
        elif self._console is not None:
            self._console.print(text, highlight=False)
