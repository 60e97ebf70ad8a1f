"""`kill -9` of workers and of drivers of real sweeps: nothing is lost, and nothing runs twice."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest
from tiny_sweeps import (
    assert_nothing_lost_or_doubled,
    is_alive,
    kill,
    run_dirs,
    start_driver,
    under_way,
    wait_until,
    worker_of,
    write_sweep,
)

from skewmi.sweep.run_folder import is_done, read_parts
from skewmi.sweep.tables import read_tables
from skewmi.train.lock import only_training

pytestmark = pytest.mark.slow
STEPS = 8_000


def test_killed_workers_and_killed_drivers_cost_nothing(tmp_path: Path) -> None:
    file, out = write_sweep(tmp_path, STEPS), tmp_path / "sweep"
    first, second = run_dirs(file, out)
    driver = start_driver(file, out, "--processes", "1")
    try:
        # A worker dies: another goes on.
        wait_until(lambda: under_way(first, 800), "the first run is under way")
        dead = worker_of(first)
        kill(dead)
        wait_until(lambda: len(read_parts(first)) == 2 and worker_of(first) != dead, "it goes on")
        # The driver dies: its worker does not outlive it, and another driver goes on.
        wait_until(lambda: under_way(first, 1600) or is_done(first), "it has gone on")
        orphan = worker_of(second if is_done(first) else first)
        driver.kill()
        driver.wait()
        wait_until(lambda: not is_alive(orphan), "the worker has ended with its driver")
        driver = start_driver(file, out, "--processes", "2")
        assert driver.wait() == 0
    finally:
        driver.kill()
        driver.wait()
    assert_nothing_lost_or_doubled([first, second], tmp_path)
    results = read_tables(out).results
    assert results["state"] == ["done", "done"]
    assert results["seed"] == [0, 1]
    assert all(results["commit"])


def test_a_run_that_somebody_else_trains_is_left_alone_until_he_has_ended(tmp_path: Path) -> None:
    file, out = write_sweep(tmp_path, 400), tmp_path / "sweep"
    first, second = run_dirs(file, out)
    first.mkdir(parents=True)
    with only_training(first):
        driver = start_driver(file, out, "--processes", "2")
        wait_until(lambda: is_done(second), "the other run is done")
        log = tmp_path / "driver.log"
        wait_until(lambda: b"another process trains it" in log.read_bytes(), "it is told")
        assert not read_parts(first)
    assert driver.wait() == 0
    assert is_done(first)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_driver_that_is_told_to_end_ends_its_workers_and_writes_results(
    tmp_path: Path, number: signal.Signals
) -> None:
    file, out = write_sweep(tmp_path, 100_000), tmp_path / "sweep"
    first, _ = run_dirs(file, out)
    driver = start_driver(file, out, "--processes", "1")
    wait_until(lambda: under_way(first, 400), "a run is under way")
    worker = worker_of(first)
    driver.send_signal(number)
    assert driver.wait() == 130
    assert not is_alive(worker)
    assert read_tables(out).results["state"] == ["begun", "waiting"]
    # A second driver is refused while one works.
    with only_training(out):
        assert start_driver(file, out).wait() == 2
    assert "another skewmi sweep works in" in (tmp_path / "driver.log").read_text()
