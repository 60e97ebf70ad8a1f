"""Sweeps of runs that are short but are killed in the middle, and how to kill them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from train_runs import assert_same_checkpoint, assert_same_table

from skewmi.cli.train import train
from skewmi.cli.train_options import starting_config
from skewmi.sweep.plan import make_plan
from skewmi.sweep.run_folder import is_done, read_parts, read_progress, read_run
from skewmi.sweep.sweep_file import parse_sweep
from skewmi.train.log import read_metrics

PATIENCE_S = 600.0
"""A busy computer takes a minute to load the tensor library."""

TINY = """
seeds: 2
set:
  total_steps: {steps}
  learner.hidden: [8]
  learner.batch_size: 16
  learner.updates_per_step: 0.05
  rollout.num_envs: 1
  rollout.evaluation_envs: 0
  rollout.random_steps: 200
  exploration.history_points: 200
  exploration.candidates: 200
  metrics.entropy_points: 200
groups:
  maze: {{tasks: [point_maze], configurations: [improved]}}
"""


def write_sweep(folder: Path, steps: int) -> Path:
    """A sweep file of two runs of the maze, an iteration every 200 steps."""
    path = folder / "tiny.yaml"
    path.write_text(TINY.format(steps=steps))
    return path


def run_dirs(file: Path, out: Path) -> list[Path]:
    """Folders of its runs."""
    plan = make_plan(parse_sweep(file.read_text(), "f"), starting_config)
    return [out / "runs" / run.name for run in plan.runs]


def start_driver(file: Path, out: Path, *more: str) -> subprocess.Popen[bytes]:
    """`skewmi sweep` in a process of its own."""
    command = [sys.executable, "-P", "-m", "skewmi.cli.main", "sweep", str(file), "--out", str(out)]
    with (out.parent / "driver.log").open("ab") as log:
        return subprocess.Popen([*command, *more], stdout=log, stderr=log)


def wait_until(condition: Callable[[], bool], what: str) -> None:
    """Wait for something that takes as long as it takes."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, f"waited {PATIENCE_S} s until {what}"
        time.sleep(0.05)


def worker_of(run_dir: Path) -> int:
    """Process that trains a run, or has: it wrote its number into the lock."""
    return int((run_dir / ".lock").read_text() or "0")


def is_alive(pid: int) -> bool:
    """Whether a process runs (one that has ended and that nobody asked about does not)."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state not in "ZX"


def kill(pid: int) -> None:
    """As `kill -9`."""
    os.kill(pid, signal.SIGKILL)


def under_way(run_dir: Path, steps: int) -> bool:
    """Whether a run has done so many steps, but not all."""
    return read_progress(run_dir).steps >= steps and not is_done(run_dir)


def assert_nothing_lost_or_doubled(folders: Sequence[Path], folder: Path) -> None:
    """Every run is what it would have been in one piece: same table, same last checkpoint."""
    for run_dir in folders:
        assert is_done(run_dir)
        steps = read_metrics(run_dir)["step"]
        assert steps == sorted(set(steps))
        begins = [part["step"] for part in read_parts(run_dir)]
        assert begins == sorted(begins)
        whole = folder / f"whole-{run_dir.name}"
        train(read_run(run_dir), whole, progress=False)
        assert_same_table(whole, run_dir)
        assert_same_checkpoint(whole, run_dir)
