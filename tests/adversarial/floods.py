"""How late a robot server's cycle comes under floods: `python tests/adversarial/floods.py`.

Measures, with a robot server in real time and one kind of flood after the other, the longest time
between two cycles of 4 ms beside the same without a flood; and, as `floods.py watchers 8 16 32`,
how long services and `skewmi stop` take while so many watchers sleep; with `--trials`, each of it
several times, of which all are told.
The commander whom chunks of the floods come from is armed all the time, and its gripper commander
is whoever sends first: every check that a stranger or the commander may get to is got to.
"""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent / "faults"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "support"))

import result_document
from fault_robot import STEP, Robot
from flood_senders import GID, SENDERS

from skewmi.cli.stop import StopCommand, run_stop
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.errors import TransportError
from skewmi.policy_io import Array

SESSIONS = 8
"""Sleeping watchers in one process: to the robot server each session is one."""
SLEEP_S = 40.0
"""Zenoh gives a silent session up after 10 s, and closing some takes as long again."""
LATE_MS = 8.0


@contextmanager
def sending(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    """A process of `flood_senders` that has begun; it is killed in the end."""
    script = str(Path(__file__).parent / "flood_senders.py")
    process = subprocess.Popen(
        [sys.executable, script, *arguments], stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline().strip() == "ready", arguments
        yield process
    finally:
        process.kill()
        process.wait()


@contextmanager
def armed(locator: str) -> Iterator[None]:
    """Keeps the robot server armed for `GID` while the block runs, if it answers."""
    ended = threading.Event()

    def keep() -> None:
        with Link.open(TransportConfig.for_client(locator), "floods") as link:
            while not ended.wait(0.5):
                try:
                    link.call(topics.YUMI_ARM, 1.0, GID)
                except TransportError:
                    continue

    thread = threading.Thread(target=keep)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def gaps(rows: Array, begin_s: float, end_s: float) -> dict[str, float]:
    """Times between two cycles, ms."""
    times = rows[(rows[:, 0] == STEP) & (rows[:, 1] >= begin_s) & (rows[:, 1] <= end_s), 1]
    between = 1e3 * np.diff(times)
    return {
        "max_ms": round(float(between.max()), 2),
        "p99.9_ms": round(float(np.percentile(between, 99.9)), 2),
        f"over_{LATE_MS:g}_ms": int((between > LATE_MS).sum()),
        "cycles": len(between),
    }


def measure(robot: Robot, kind: str | None, seconds: float) -> dict[str, float]:
    """The gaps under one kind of flood, or without any."""
    with armed(robot.locator):
        time.sleep(1.0)
        if kind is None:
            begin_s = time.monotonic()
            time.sleep(seconds)
        else:
            with sending(kind, robot.locator):
                begin_s = time.monotonic()
                time.sleep(seconds)
    return gaps(robot.rows(), begin_s, time.monotonic())


def stopped(locator: str) -> tuple[float, bool]:
    """How long `skewmi stop` takes, s, and whether the arm is disarmed then."""
    began = time.monotonic()
    try:
        with redirect_stdout(io.StringIO()):
            code = run_stop(StopCommand(connect=locator))
    except TransportError:
        code = 2
    return time.monotonic() - began, code == 0


def watchers(robot: Robot, count: int, seconds: float = SLEEP_S) -> dict[str, Any]:
    """What is answered while so many watchers sleep."""
    calls, stops = [], []
    with Link.open(TransportConfig.for_client(robot.locator), "floods") as link:
        link.wait_for_robot(5.0)
        with ExitStack() as stack:
            for _ in range(count // SESSIONS):
                one = stack.enter_context(sending("watch", robot.locator, str(SESSIONS)))
                os.kill(one.pid, signal.SIGSTOP)
            begin_s = time.monotonic()
            while time.monotonic() < begin_s + seconds:
                began = time.monotonic()
                try:
                    link.call(topics.YUMI_ARM, 2.0, GID)
                    calls.append(time.monotonic() - began)
                except TransportError:
                    calls.append(float("inf"))
                stops.append(stopped(robot.locator))
                time.sleep(0.25)
    answered = [call_s for call_s in calls if np.isfinite(call_s)]
    return {
        "calls": len(calls),
        "calls_unanswered": len(calls) - len(answered),
        "longest_answered_s": round(max(answered, default=0.0), 3),
        "stops": len(stops),
        "stops_failed": sum(not good for _, good in stops),
        "longest_stop_s": round(max(duration for duration, _ in stops), 3),
        "loop": gaps(robot.rows(), begin_s, begin_s + seconds),
    }


def trial(what: list[str], seconds: float) -> dict[str, Any]:
    """Each kind of flood, or each number of watchers, once."""
    result: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        if what[:1] == ["watchers"]:
            for count in map(int, what[1:]):
                with Robot(Path(folder) / f"targets-{count}", lock_step=False) as robot:
                    result[f"{count} watchers"] = watchers(robot, count)
        else:
            with Robot(Path(folder) / "targets", lock_step=False) as robot:
                for kind in (None, *(what or SENDERS)):
                    result[kind or "no flood"] = measure(robot, kind, seconds)
                    result_document.progress(f"{kind or 'no flood'}: {result[kind or 'no flood']}")
    return result


def main() -> int:
    """Measure as asked; 0 if nothing is late."""
    parser = result_document.argument_parser((__doc__ or "").splitlines()[0])
    parser.add_argument("what", nargs="*", help="kinds of floods, or: watchers NUMBER ...")
    parser.add_argument("--seconds", type=float, default=5.0, help="of each flood")
    parser.add_argument("--trials", type=int, default=1, help="how often all of it is done")
    options = parser.parse_args()
    trials = [trial(options.what, options.seconds) for _ in range(options.trials)]
    config = {"what": options.what, "seconds": options.seconds, "late_ms": LATE_MS}
    document = result_document.write_result(
        "floods", {"trials": trials}, options.out, seed=options.seed, config=config
    )
    result_document.print_result(document, as_json=options.json)
    late = (one.get("loop", one)["max_ms"] for each in trials for one in each.values())
    return int(max(late, default=0.0) > LATE_MS)


if __name__ == "__main__":
    sys.exit(main())
