"""The driver against an engine whose workers die at random: everything is done, nothing twice."""

from __future__ import annotations

import json
import random
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import Event

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.sweep import driver as driver_module
from skewmi.sweep.driver import ATTEMPTS, Driver, State, Tracked
from skewmi.sweep.engine import BUSY, DONE, INVISIBLE, LOST, REFUSED
from skewmi.sweep.plan import Run
from skewmi.sweep.run_folder import is_done, read_progress
from skewmi.train.presets import default_preset

STEPS = 3


@pytest.fixture(autouse=True, scope="module")
def _at_once() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(driver_module, "POLL_S", 0.0)
        patched.setattr(driver_module, "BUSY_S", 0.0)
        yield


def runs(count: int) -> tuple[Run, ...]:
    config = replace(default_preset("t"), total_steps=STEPS)
    return tuple(Run(f"run-{k}", replace(config, seed=k), {}) for k in range(count))


@dataclass
class Engine:
    """Workers do a step each time that they are looked at, unless `fate` says how they end.

    Attributes:
        fate: (run's folder, steps done) -> exit code, or None to go on.
        room: Workers at the same time.
        working: Runs that are trained now.
        done: Steps done of each run, in order.
    """

    fate: object
    room: int = 2
    working: set[str] = field(default_factory=set)
    done: dict[str, list[int]] = field(default_factory=dict)
    ended: int = 0

    def slots(self) -> int:
        return self.room

    def start(self, run_dir: Path, threads: int) -> Worker:
        assert run_dir.name not in self.working, "no run is trained twice at the same time"
        assert not is_done(run_dir), "no run is trained again"
        assert len(self.working) < self.room
        self.working.add(run_dir.name)
        return Worker(self, run_dir)


@dataclass
class Worker:
    engine: Engine
    run_dir: Path

    def poll(self) -> int | None:
        steps = read_progress(self.run_dir).steps
        code = self.engine.fate(self.run_dir, steps)  # type: ignore[operator]
        if code is None and steps == STEPS:
            code = DONE
        if code is not None:
            if code == DONE:
                (self.run_dir / "result.json").write_text(json.dumps({}))
            self.engine.working.discard(self.run_dir.name)
            return int(code)
        table = self.run_dir / "metrics.csv"
        if not table.exists():
            table.write_text("step,seconds\n")
        with table.open("a") as file:
            file.write(f"{steps + 1},{steps + 1}.0\n")
        self.engine.done.setdefault(self.run_dir.name, []).append(steps + 1)
        return None

    def end(self) -> None:
        self.engine.ended += 1
        self.engine.working.discard(self.run_dir.name)


def drive(folder: Path, engine: Engine, count: int, stop: Event | None = None) -> Driver:
    driver = Driver(runs(count), folder, engine, lambda tracked, word: None)  # type: ignore[arg-type]
    driver.run(stop or Event())
    return driver


def states(driver: Driver) -> set[State]:
    return {tracked.state for tracked in driver.tracked}


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32), count=st.integers(1, 6), room=st.integers(1, 3))
def test_all_is_done_once_whatever_dies(
    tmp_path_factory: pytest.TempPathFactory, seed: int, count: int, room: int
) -> None:
    """Workers are killed, lost with machines and find their run busy; drivers are killed, too."""
    folder, chance = tmp_path_factory.mktemp("runs"), random.Random(seed)
    budget: dict[tuple[str, int], int] = {}

    def fate(run_dir: Path, steps: int) -> int | None:
        key = run_dir.name, steps
        # One loss less than ends a run, between two steps; busy as often as it likes.
        if chance.random() < 0.4 and budget.setdefault(key, ATTEMPTS - 1) > 0:
            code = chance.choice([-9, LOST, 1, BUSY])
            budget[key] -= code != BUSY
            return code
        return None

    engine = Engine(fate, room)
    for _ in range(3):  # drivers that are killed: they neither end workers nor tell anybody
        driver = Driver(runs(count), folder, engine, lambda tracked, word: None)  # type: ignore[arg-type]
        for _ in range(chance.randrange(4)):
            for tracked in list(driver.running):
                driver._look_after(tracked)
            driver._fill()
        engine.working.clear()  # the pipe: workers end with their driver
        budget.clear()
    driver = drive(folder, engine, count)
    assert states(driver) == {State.DONE}
    assert engine.done == {f"run-{k}": list(range(1, STEPS + 1)) for k in range(count)}
    assert drive(folder, Engine(None), count).tracked[0].state is State.DONE  # starts nothing


@pytest.mark.parametrize(
    ("code", "says"),
    [(-11, "signal 11"), (1, "exit code 1"), (LOST, "with its machine")],
)
def test_a_run_that_only_dies_is_given_up_and_the_others_go_on(
    tmp_path: Path, code: int, says: str
) -> None:
    def fate(run_dir: Path, steps: int) -> int | None:
        return code if run_dir.name == "run-1" and steps == 1 else None

    driver = drive(tmp_path, Engine(fate), 3)
    first, second, third = driver.tracked
    assert (first.state, second.state, third.state) == (State.DONE, State.FAILED, State.DONE)
    assert says in second.why
    # The user mends it and calls again: it goes on from where it was.
    engine = Engine(lambda run_dir, steps: None)
    assert states(drive(tmp_path, engine, 3)) == {State.DONE}
    assert engine.done == {"run-1": [2, 3]}


@pytest.mark.parametrize(
    ("code", "says"), [(REFUSED, "no such preset"), (INVISIBLE, "disk that all machines share")]
)
def test_a_run_that_cannot_be_is_not_tried_again(tmp_path: Path, code: int, says: str) -> None:
    calls = []

    def fate(run_dir: Path, steps: int) -> int | None:
        calls.append(steps)
        (run_dir / "worker.log").write_text("a line\nno such preset\n")
        return code

    (tracked,) = drive(tmp_path, Engine(fate), 1).tracked
    assert (tracked.state, len(calls)) == (State.FAILED, 1)
    assert says in tracked.why


def test_a_worker_that_says_done_without_a_result_is_not_believed(tmp_path: Path) -> None:
    class Liar(Worker):
        def poll(self) -> int | None:
            self.engine.working.discard(self.run_dir.name)
            return DONE

    engine = Engine(None)
    engine.start = lambda run_dir, threads: Liar(engine, run_dir)  # type: ignore[method-assign]
    (tracked,) = drive(tmp_path, engine, 1).tracked
    assert tracked.state is State.FAILED
    assert "without a result" in tracked.why


def test_stopping_ends_the_workers_and_says_so(tmp_path: Path) -> None:
    stop = Event()

    def fate(run_dir: Path, steps: int) -> int | None:
        stop.set()

    engine = Engine(fate)
    driver = Driver(runs(3), tmp_path, engine, lambda tracked, word: None)  # type: ignore[arg-type]
    assert not driver.run(stop)
    assert engine.ended == 2
    assert not engine.working


def test_what_happens_is_told(tmp_path: Path) -> None:
    told: list[tuple[str, str]] = []

    def report(tracked: Tracked, word: str) -> None:
        told.append((tracked.run.name, word))

    dead = iter([True])

    def fate(run_dir: Path, steps: int) -> int | None:
        return -9 if steps == 1 and next(dead, False) else None

    Driver(runs(1), tmp_path, Engine(fate), report).run(Event())  # type: ignore[arg-type]
    assert [word for _, word in told] == ["starts", "lost", "goes on", "done"]
