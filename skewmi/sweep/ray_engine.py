"""Runs trained on a Ray cluster; its machines share the sweep's folder.

Ray decides where a run goes. That it ends there unexpectedly, with its process or with its whole
machine, is told to the driver, which begins it again elsewhere; so Ray itself retries nothing.
"""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from skewmi import extras
from skewmi.errors import ConfigurationError
from skewmi.sweep.engine import INVISIBLE, LOST, end_worker, start_worker, worker_environment
from skewmi.sweep.places import RUN

_ANSWER_S = 10.0


def train_here(run_dir: str, threads: int) -> int:
    """Train a run on the machine of a Ray worker, in a process that ends with it.

    Returns:
        Exit code, see `engine`.
    """
    folder = Path(run_dir)
    if not (folder / RUN).exists():
        return INVISIBLE
    process = start_worker(folder, worker_environment(threads))
    try:
        return process.wait()
    finally:
        if process.poll() is None:
            end_worker(process)


class RayJob:
    """A run that has been handed to Ray."""

    def __init__(self, ray: Any, reference: Any) -> None:
        self.ray, self.reference = ray, reference

    def poll(self) -> int | None:
        """See `Job`."""
        ready, _ = self.ray.wait([self.reference], timeout=0)
        if not ready:
            return None
        try:
            return int(self.ray.get(self.reference))
        except self.ray.exceptions.RayError:
            # Its process, its node or the connection to it is gone.
            return LOST

    def end(self) -> None:
        """See `Job`."""
        self.ray.cancel(self.reference, force=True)


class RayEngine:
    """As many runs as the cluster has processors for.

    Args:
        ray: The module, connected.
        threads: Of each run.
        processes: At most so many at the same time; None: as many as there is room for.
    """

    def __init__(self, ray: Any, threads: int, processes: int | None) -> None:
        self.ray, self.threads, self.processes = ray, threads, processes
        # What it asks for is the same on every machine, so it is a name there, not code.
        self._train = ray.remote(train_here).options(
            num_cpus=threads, max_retries=0, scheduling_strategy="SPREAD"
        )

    def slots(self) -> int:
        """See `Engine`; machines may come and go."""
        room = int(self.ray.cluster_resources().get("CPU", 0)) // self.threads
        return max(min(room, self.processes or room), 1)

    def start(self, run_dir: Path, threads: int) -> RayJob:
        """See `Engine`."""
        return RayJob(self.ray, self._train.remote(str(run_dir.resolve()), threads))


@contextmanager
def opened_ray(address: str | None, threads: int, processes: int | None) -> Iterator[RayEngine]:
    """A Ray cluster while the block runs.

    Args:
        address: Of the cluster; None: the one this machine belongs to, or a new one on it alone.
        threads: Of each run.
        processes: See `RayEngine`.

    Raises:
        NotFoundError: Ray is not installed.
        ConfigurationError: No cluster answers there, or no machine of it has so many processors.
    """
    try:
        import ray
    except ModuleNotFoundError as error:
        raise extras.missing("--engine ray", error) from error
    _require_answer(address)
    try:
        ray.init(address=address, log_to_driver=False, logging_level="ERROR")
    except (ConnectionError, ValueError, RuntimeError, OSError) as error:
        raise _no_cluster(address, error) from error
    try:
        most = max(node["Resources"].get("CPU", 0) for node in ray.nodes() if node["Alive"])
        if most < threads:
            raise ConfigurationError(
                f"each run has {threads} threads, but no machine of the Ray cluster has more than "
                f"{most:g} processors"
            )
        yield RayEngine(ray, threads, processes)
    finally:
        ray.shutdown()


def _require_answer(address: str | None) -> None:
    """See that somebody listens at an address; Ray itself would try for minutes."""
    host, colon, port = (address or "").removeprefix("ray://").rpartition(":")
    if not (colon and port.isdigit()):
        return  # "auto" and the like: Ray knows where to look
    try:
        with socket.create_connection((host.strip("[]"), int(port)), timeout=_ANSWER_S):
            pass
    except (OSError, OverflowError) as error:
        raise _no_cluster(address, error) from error


def _no_cluster(address: str | None, error: BaseException) -> ConfigurationError:
    words = " ".join(str(error).split())
    return ConfigurationError(
        f"no Ray cluster at {address or 'this machine'}: {words}; start one with ray start --head, "
        "and give its --address"
    )
