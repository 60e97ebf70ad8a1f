"""Where runs are trained: processes of this machine, or whatever else satisfies `Engine`.

An engine only starts processes and says how they ended; what is done, lost or to be begun again
the driver decides.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from skewmi.child import child_command
from skewmi.outputs import writing
from skewmi.sweep.places import LOG

WORKER = "skewmi.cli.sweep_worker"
"""Module that trains one run: its folder is its argument, and it ends with its standard input."""

DONE, REFUSED, BUSY, INVISIBLE = 0, 2, 75, 76
"""Exit codes of a worker: the run is done; the run cannot be; another process trains in its folder;
its folder is not there. Whatever else it is, the worker was lost."""
LOST = -1
"""In the place of an exit code: the machine went away with the worker."""
_END_S = 10.0


class Job(Protocol):
    """A worker."""

    def poll(self) -> int | None:
        """How it ended; None: it has not."""

    def end(self) -> None:
        """End it, wherever it is; what it has saved stays."""


class Engine(Protocol):
    """What starts workers."""

    def slots(self) -> int:
        """How many may work at the same time; may change."""

    def start(self, run_dir: Path, threads: int) -> Job:
        """Start a worker on a run whose folder says what it is."""


def worker_environment(threads: int) -> dict[str, str]:
    """The environment of a worker: its libraries take no more threads than it has."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    return {**os.environ, **dict.fromkeys(names, str(threads))}


def start_worker(run_dir: Path, environment: Mapping[str, str]) -> subprocess.Popen[bytes]:
    """A worker as a child of this process.

    It holds the other end of a pipe: when this process ends, however it does, the worker ends.
    """
    log = run_dir / LOG
    with writing(log), log.open("ab") as output:
        return subprocess.Popen(
            child_command("-m", WORKER, str(run_dir)),
            stdin=subprocess.PIPE,
            stdout=output,
            stderr=output,
            env=dict(environment),
            start_new_session=True,  # a Ctrl-C is for the driver, which ends its workers
        )


def end_worker(process: subprocess.Popen[bytes]) -> None:
    """End a worker and wait for it."""
    process.terminate()
    try:
        process.wait(_END_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    if process.stdin is not None:
        with suppress(OSError):
            process.stdin.close()


class LocalJob:
    """A worker on this machine."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self.process = process

    def poll(self) -> int | None:
        """See `Job`."""
        code = self.process.poll()
        if code is not None and self.process.stdin is not None:
            self.process.stdin.close()
        return code

    def end(self) -> None:
        """See `Job`."""
        end_worker(self.process)


class LocalEngine:
    """So many processes of this machine."""

    def __init__(self, processes: int) -> None:
        self.processes = processes

    def slots(self) -> int:
        """See `Engine`."""
        return self.processes

    def start(self, run_dir: Path, threads: int) -> LocalJob:
        """See `Engine`."""
        return LocalJob(start_worker(run_dir, worker_environment(threads)))


def usable_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
