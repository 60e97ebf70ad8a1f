"""Train many runs from one file: seeds x configurations x tasks, on this machine or on a cluster.

Everything is in the sweep's folder: runs/ (a run directory each, as of `skewmi train`),
results.parquet and .csv (a row per run), curves.parquet and .csv (a row per measurement). The same
command goes on where it was ended or killed; what is done is not done again. docs/sweep.md shows
the file.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from skewmi.cli import numbers
from skewmi.cli.interrupt import stop_on_signal
from skewmi.cli.sweep_lines import SweepLines
from skewmi.cli.train_config import MAX_STEPS
from skewmi.cli.train_options import starting_config
from skewmi.errors import ConfigurationError, SkewmiError
from skewmi.outputs import make_folder
from skewmi.sim import tasks
from skewmi.sweep.driver import Driver, State
from skewmi.sweep.elsewhere import Elsewhere, read_elsewhere
from skewmi.sweep.engine import Engine, LocalEngine, usable_cores
from skewmi.sweep.plan import Plan, make_plan, require_same_runs
from skewmi.sweep.results import collect
from skewmi.sweep.run_folder import Progress, is_done, read_progress
from skewmi.sweep.sweep_file import MAX_SEEDS, Part, SweepFile, narrowed, read_sweep_file
from skewmi.sweep.tables import SWEEP, write_tables
from skewmi.train.files import write_text
from skewmi.train.lock import BusyError, only_training

MAX_PROCESSES = 4096


@dataclass(frozen=True)
class SweepCommand:
    """Options of `skewmi sweep`."""

    file: Annotated[Path, tyro.conf.Positional]
    """Sweep file (YAML)."""
    out: Path | None = None
    """Folder of the sweep; default: runs/ and the file's name."""
    processes: int | None = None
    """Runs trained at the same time; default: usable cores over threads per run, or what a Ray
    cluster has."""
    engine: Literal["local", "ray"] = "local"
    """`local`: processes of this machine; `ray`: a Ray cluster, which has to see the folder under
    the same name on all its machines."""
    address: str | None = None
    """Of the Ray cluster, as 10.0.0.1:6379; default: the one that this machine belongs to, or one
    of this machine alone."""
    groups: tuple[str, ...] = ()
    """Only these groups of the file; runs that others share with them are not run again later."""
    tasks: tuple[str, ...] = ()
    """Only these tasks of each group."""
    configurations: tuple[str, ...] = ()
    """Only these configurations of each group, by the names that the file gives them."""
    seeds: int | None = None
    """Only so many seeds of each group, the first ones."""
    steps: int | None = None
    """Environment steps of every run, in place of the file's: to try a file out."""
    with_results: tuple[Path, ...] = ()
    """Folders of the same sweep from other machines, or their results.parquet or results.csv: what
    is done there is not run again, and stands in the results."""
    dry_run: bool = False
    """List the runs and how far they are; do nothing."""
    collect: bool = False
    """Write the results as they are now, also while another process runs the sweep; run nothing."""
    json: bool = False
    """Print one JSON document on standard output at the end."""
    quiet: bool = False
    """No progress on standard error."""


def run_sweep(options: SweepCommand) -> int:
    """Run what is left to run. Returns 0; 1 if runs failed; 130 if it was interrupted."""
    numbers.require("--processes", options.processes, 1, MAX_PROCESSES)
    if options.address is not None and options.engine != "ray":
        raise ConfigurationError("--address is of a Ray cluster: give --engine ray, too")
    numbers.require("--seeds", options.seeds, 1, MAX_SEEDS)
    numbers.require("--steps", options.steps, 1, MAX_STEPS)
    part = Part(options.groups, options.tasks, options.configurations, options.seeds, options.steps)
    sweep = narrowed(read_sweep_file(options.file), part)
    numbers.require("threads", sweep.threads, 1, numbers.MAX_THREADS)
    plan = make_plan(sweep, starting_config)
    for run in plan.runs:
        numbers.require_seed(run.config.seed)
    folder = options.out or Path("runs") / options.file.stem
    require_same_runs(plan, folder / "runs")
    work = _Work(sweep, plan, folder, read_elsewhere(plan, folder / "runs", options.with_results))
    if options.dry_run:
        _print(_listing(work), options)
        return 0
    _require_environments(plan)
    if options.collect:
        files = _write_results(work)
        _print({**_listing(work), "files": files}, options)
        return 0
    return _run(options, work)


@dataclass(frozen=True)
class _Work:
    """A sweep file, its runs, where they are, and which are done somewhere else."""

    sweep: SweepFile
    plan: Plan
    folder: Path
    elsewhere: Elsewhere


def _run(options: SweepCommand, work: _Work) -> int:
    own = tuple(run for run in work.plan.runs if run.name not in work.elsewhere.rows)
    with ExitStack() as stack:
        stack.enter_context(_alone(work.folder))
        write_text(work.folder / SWEEP, work.sweep.text)
        engine = stack.enter_context(_engine(options, work.sweep.threads))
        lines = stack.enter_context(SweepLines(engine.slots, quiet=options.quiet))
        driver = Driver(own, work.folder / "runs", engine, lines.happened)
        stop = stack.enter_context(stop_on_signal())
        finished = driver.run(stop, lambda: lines.draw(driver.tracked))
    files = _write_results(work)
    failed = {t.run.name: t.why for t in driver.tracked if t.state is State.FAILED}
    _print({**_listing(work), "failed": failed, "files": files}, options)
    return 130 if not finished else int(bool(failed))


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Hold a sweep's folder: two drivers would only get in each other's way."""
    make_folder(folder)
    try:
        with only_training(folder):
            yield
    except BusyError as error:
        raise ConfigurationError(
            f"another skewmi sweep works in {folder}; wait for it or end it, or give another --out "
            "(--collect writes results meanwhile)"
        ) from error


@contextmanager
def _engine(options: SweepCommand, threads: int) -> Iterator[Engine]:
    if options.engine == "ray":
        from skewmi.sweep.ray_engine import opened_ray

        with opened_ray(options.address, threads, options.processes) as engine:
            yield engine
    else:
        yield LocalEngine(options.processes or max(usable_cores() // threads, 1))


def _require_environments(plan: Plan) -> None:
    """See that every task takes its options, before hours are spent on others.

    Raises:
        ConfigurationError, NotFoundError: One does not.
    """
    seen = set()
    for member in plan.members:
        config = member.run.config
        if (config.task, config.task_options) not in seen:
            seen.add((config.task, config.task_options))
            given: dict[str, Any] = dict(config.task_options)
            try:
                tasks.make_batch(config.task, 1, num_threads=1, **given)
            except SkewmiError as error:
                raise type(error)(f"group {member.group}: {error}") from error


def _write_results(work: _Work) -> list[str]:
    make_folder(work.folder)
    tables = collect(work.plan, work.folder / "runs", work.sweep.figures, work.elsewhere)
    return [str(path) for path in write_tables(tables, work.folder)]


def _listing(work: _Work) -> dict[str, Any]:
    places: dict[str, list[str]] = {}
    for member in work.plan.members:
        places.setdefault(member.run.name, []).append(f"{member.group}/{member.configuration}")
    runs = []
    for run in work.plan.runs:
        state, progress = _standing(run.name, work)
        runs.append(
            {
                "run": run.name,
                "of": places[run.name],
                "seed": run.config.seed,
                "state": state,
                "steps": progress.steps,
                "total_steps": run.config.total_steps,
                "seconds": progress.seconds,
            }
        )
    return {"folder": str(work.folder), "runs": runs}


def _standing(name: str, work: _Work) -> tuple[str, Progress]:
    """Whether a run is done, here or elsewhere, begun or waiting, and how far it is."""
    row = work.elsewhere.rows.get(name)
    if row is not None:
        return "done", Progress(int(row.get("steps") or 0), float(row.get("seconds") or 0))
    run_dir = work.folder / "runs" / name
    progress = read_progress(run_dir)
    return "done" if is_done(run_dir) else "begun" if progress.steps else "waiting", progress


def _print(document: dict[str, Any], options: SweepCommand) -> None:
    if options.json:
        print(json.dumps(document, indent=2))
        return
    runs = document["runs"]
    if options.dry_run:
        width = max(len(run["run"]) for run in runs)
        room = shutil.get_terminal_size((100, 20)).columns
        for run in runs:
            line = f"{run['run']:<{width}}  {run['state']:<7}  {run['steps']:>11,}"
            line += f" of {run['total_steps']:,} steps  {', '.join(run['of'])}"
            print(line if options.out else line[: max(room, width + 40)])
    done = sum(run["state"] == "done" for run in runs)
    print(f"{done} of {len(runs)} runs done; folder: {document['folder']}")
    for name, why in document.get("failed", {}).items():
        print(f"  failed: {name}: {why}")
    for path in document.get("files", []):
        print(f"  {path}")
