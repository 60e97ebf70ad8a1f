"""Learning curves and visited states of a run; figures and tables of a sweep.

Of a run, into its directory or into --out: curves.png (all that was measured), learning.png
(rewarded share with the times of first discoveries, and how often scene and hand were where) and
coverage.png (visited states by when they were met).

Of a sweep (its folder, or results.parquet in it): the figures that its file asks for, each as PNG,
SVG and CSV, with published values beside ours; what a figure lacks is told. docs/sweep.md has the
kinds.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from skewmi.batch_env import BatchEnv
from skewmi.cli import numbers
from skewmi.cli.sweep_figures import as_text, draw_sweep
from skewmi.errors import ConfigurationError
from skewmi.evaluation.figures import draw_coverage, draw_curves
from skewmi.evaluation.learning import draw_learning, read_record
from skewmi.outputs import check_output
from skewmi.sim import tasks
from skewmi.sweep.tables import is_sweep
from skewmi.train.checkpoint import read_run_header
from skewmi.train.config import TrainConfig

PICTURES = ("curves", "learning", "coverage")
MAX_DPI = 2000


@dataclass(frozen=True)
class FiguresCommand:
    """Options of `skewmi figures`."""

    run_dir: Annotated[Path, tyro.conf.Positional]
    """Directory of a run or of a sweep, or results.parquet of a sweep."""
    out: Path | None = None
    """Directory for the pictures; default: the run directory, figures/ in that of a sweep."""
    spec: Path | None = None
    """Sweep file whose figures are drawn; default: the one that the sweep was run with."""
    dpi: int = 110
    """Resolution, dots per inch."""
    overwrite: bool = False
    """Replace existing pictures."""
    json: bool = False
    """Print the names of the files as one JSON document."""


def run_figures(options: FiguresCommand) -> int:
    """Draw and say where. Returns 0."""
    numbers.require("--dpi", options.dpi, 1, MAX_DPI)
    if is_sweep(options.run_dir):
        document = draw_sweep(
            options.run_dir, options.out, spec=options.spec, dpi=options.dpi,
            overwrite=options.overwrite,
        )  # fmt: skip
        print(json.dumps(document) if options.json else as_text(document))
        return 0
    if options.spec is not None:
        raise ConfigurationError(
            f"--spec is for the results of a sweep; {options.run_dir} has none"
        )
    config, layout = read_run_header(options.run_dir)
    out = options.run_dir if options.out is None else options.out
    curves, learning, coverage = (out / f"{name}.png" for name in PICTURES)
    for path in (curves, learning, coverage):
        check_output(path, overwrite=options.overwrite)
    files = [draw_curves(options.run_dir, curves, options.dpi)]
    planes = tasks.find(config.task).planes
    files.append(draw_learning([read_record(options.run_dir)], learning, options.dpi, planes))
    reachable = _environment(config).reachable if layout.state_dim == 2 else None
    files.append(
        draw_coverage(options.run_dir, config, layout, coverage, options.dpi, reachable=reachable)
    )
    names = [str(path) for path in files]
    print(json.dumps({"files": names}) if options.json else "\n".join(names))
    return 0


def _environment(config: TrainConfig) -> BatchEnv:
    options: dict[str, Any] = dict(config.task_options)
    return tasks.make_batch(config.task, 1, num_threads=1, **options)
