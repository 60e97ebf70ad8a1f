"""One run of a sweep, as the worker's process does it.

The folder says what the run is, and keeps it between workers.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from skewmi.cli.train import train
from skewmi.errors import SkewmiError
from skewmi.matrix_kernels import name_of_taken
from skewmi.sweep.engine import BUSY, DONE, REFUSED
from skewmi.sweep.run_folder import note_part, read_run, source_version, write_result
from skewmi.train.checkpoint import read_run_header
from skewmi.train.config import TrainConfig
from skewmi.train.lock import BusyError, only_training
from skewmi.train.run import earlier_seconds


def configuration(run_dir: Path) -> TrainConfig:
    """What is to be trained: as it was begun, for what is left of its time."""
    config = read_run(run_dir)
    if (run_dir / "config.json").exists():
        begun, _ = read_run_header(run_dir)
        config = replace(config, threads=begun.threads)
    if config.minutes is not None:
        left = config.minutes - earlier_seconds(run_dir) / 60.0
        config = replace(config, minutes=max(left, 1e-6))
    return config


def work(run_dir: Path) -> int:
    """Train a run to its end. Returns the exit code."""
    try:
        config = configuration(run_dir)
        with only_training(run_dir):  # so that no part is noted which is refused
            note_part(run_dir, source_version(), name_of_taken())
        result = train(config, run_dir, resume=True, progress=False)
        write_result(run_dir, result)
    except BusyError as error:
        print(error, flush=True)
        return BUSY
    except SkewmiError as error:
        print(" ".join(str(error).split()), flush=True)
        return REFUSED
    return DONE
