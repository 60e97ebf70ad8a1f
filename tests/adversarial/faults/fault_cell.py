"""One cell of the matrix: a run with one fault in one phase, what was seen, and a run after it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from fault_bench import Bench
from fault_link import MOVING, FaultLink
from fault_motion import GUIDED_VELOCITY, VELOCITY, Motion, assert_safe
from fault_proxy import TcpProxy
from fault_robot import Robot

from skewmi.deploy.realtime import hot_loop
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.policy_io import Array

SPREAD = 0.05
"""Of the start: a start motion of several centimetres, long enough for a fault in it, m."""
STEPS = 18
"""Control steps after which a run ends by itself."""
RESUMED_STEPS = 5
REST_TIMEOUT_S = 10.0
ATTEMPTS = 5
"""For runs that a busy machine spoils."""
MOVED = 0.005
"""Way of the hand that shows that it can be used, m."""
RESUMED_SPREAD = 0.01
"""m"""
RESUMED_LEAD_MS = 60.0


class Phase(Enum):
    START = "start motion"
    RUNNING = "running"
    STOPPING = "stopping"


GOES_ON = "goes on"
RESTS_GOES_ON = "rests, goes on"
STOPPED = "stopped"
FAULT = "fault"
AS_ASKED = "rests as asked"
DISARMED = "rests, disarmed"
"""Of an arm whose session is dead."""


BUSY = (
    "no new joint state for",
    "start motions came too late",
    "missed ",
    "in the past of the robot server's clock",
)
"""What is said of a run on a machine that has no time for it."""
BUSY_AGAIN = (*BUSY, "the scene state", "the robot is not ready")
"""The same of the run afterwards, whose scene may be a process of its own."""


class NotReachedError(Exception):
    """The cell was not brought about; on a busy machine the arm may stop before."""


@dataclass(frozen=True)
class Observed:
    """What a cell came to."""

    verdict: str
    said: str
    """Everything that report and robot server told the user, and the intruder if there is one."""
    shares: dict[str, float]
    """Largest use of each limit by the commanded motion."""
    times: dict[str, list[tuple[int, int]]]
    """See `FaultLink.times`."""


class Cell:
    """What faults act on.

    Args:
        bench: A running robot server and a session that is about to run.
        link: Between them.
        proxy: Between the session and the link, or None.
    """

    def __init__(self, bench: Bench, link: FaultLink, proxy: TcpProxy | None) -> None:
        self.robot, self.session, self.clock = bench.robot, bench.session, bench.clock
        self.link, self.proxy = link, proxy
        self.told: list[str] = []
        """What others than the session were told."""
        self.fault_s: float | None = None
        """When the fault began, monotonic clock."""
        self.server_died_s: float | None = None
        self.over = threading.Event()
        """Set when the run has ended."""
        self._threads: list[threading.Thread] = []

    def stop(self) -> None:
        """What Ctrl-C does."""
        self.session.tell(do="stop")

    def began(self, time_s: float) -> None:
        """The fault happens now."""
        self.fault_s = time_s

    def spawn(self, action: Callable[[], None]) -> None:
        """Do something that takes time, beside the link."""
        thread = threading.Thread(target=action)
        thread.start()
        self._threads.append(thread)

    def join(self) -> None:
        self.over.set()
        for thread in self._threads:
            thread.join(30.0)
            assert not thread.is_alive()


@dataclass(frozen=True)
class Fault:
    """One row of the matrix."""

    name: str
    inject: Callable[[Cell], None]
    """Called in the link's thread, before the chunk that it has just received goes on."""
    after_stop: Callable[[Cell], None] | None = None
    """In phase stopping: called when the robot server has answered the stop and brakes. None: the
    stop is asked for at the moment that the fault begins."""
    plant: str = "nothing"
    """What is planted in the session."""
    lock_step: bool = False
    proxied: bool = False
    """Whether there is a TCP proxy between session and link."""
    lead_ms: float = 40.0
    """See `DeployOptions`. More than its default, for the same reason as `ATTEMPTS`."""
    clock_jump_s: int = 0
    """By how much the wall clock is to jump, which needs a bench with such a clock."""
    taken: bool = False
    """Whether a controller may take the arm away in motion."""
    egm: bool = False
    """Whether the robot is the EGM bridge with an emulated controller."""


def run_cell(fault: Fault, phase: Phase, bench: Bench) -> Observed:
    """Run with the fault, judge the motion, and run again without it.

    Args:
        fault: Which.
        phase: When.
        bench: Of the fault's pace, disarmed.

    Raises:
        AssertionError: A limit was broken, the arm does not rest, or it cannot be used afterwards.
        NotReachedError: The arm did not move when the fault came, or the fault did not come.
    """
    robot, session = bench.robot, bench.session
    assert robot.lock_step == fault.lock_step
    first_row = len(robot.rows())
    with ExitStack() as stack:
        link = stack.enter_context(FaultLink(robot.locator, lock_step=fault.lock_step))
        proxy = stack.enter_context(TcpProxy(link.locator)) if fault.proxied else None
        cell = Cell(bench, link, proxy)
        _schedule(fault, phase, cell)
        # The link shall not be slower than what it links.
        stack.enter_context(hot_loop(priority=not fault.lock_step))
        report = session.run(
            (proxy or link).locator,
            lock_step=fault.lock_step,
            steps=STEPS,
            spread=SPREAD,
            lead_ms=fault.lead_ms,
            plant=fault.plant,
            stop_with_plant=phase is Phase.STOPPING,
            began=cell.began,
        )
        cell.join()
        description = _wait_for_rest(robot, ready=fault.taken)
        if phase is Phase.STOPPING and fault.after_stop is not None:
            link.hear_robot_out()
        said = f"{_said(report, link, cell)} | {description.reason}"
    rows = robot.rows()[first_row:]
    # A plan that follows an arm in somebody else's hands has moved on since it was described.
    end = rows[-1, 2:9] if fault.taken else np.array(description.commanded_position)
    motion = Motion.of(rows, end, cell.server_died_s)
    if any(motion.taken) and not fault.taken:
        raise NotReachedError("the controller's session broke in motion, without a reason")
    velocity = GUIDED_VELOCITY if fault.egm else VELOCITY
    shares = assert_safe(motion, velocity)
    _resume(bench, velocity)
    if cell.fault_s is None:
        raise NotReachedError(f"the fault did not happen: {said}")
    if motion.speed_at(cell.fault_s) < MOVING / 4:
        raise NotReachedError(f"the arm did not move when the fault came: {said}")
    verdict = _verdict(report, phase, motion, cell.fault_s)
    return Observed(verdict, said, shares, link.times)


def _schedule(fault: Fault, phase: Phase, cell: Cell) -> None:
    def begin() -> None:
        if fault.plant == "nothing":
            cell.began(time.monotonic())
        if phase is not Phase.STOPPING or fault.after_stop is None:
            fault.inject(cell)
        if phase is Phase.STOPPING and fault.plant == "nothing":
            cell.stop()

    def stopped() -> None:
        cell.began(time.monotonic())
        assert fault.after_stop is not None
        fault.after_stop(cell)

    if phase is Phase.STOPPING and fault.after_stop is not None:
        cell.link.on_stopped = stopped
    session_state = "to start" if phase is Phase.START else "running"
    cell.link.when_moving(session_state, fault.lead_ms, begin)


def _said(report: dict[str, Any] | None, link: FaultLink, cell: Cell) -> str:
    said = [*cell.told, link.said_by_robot()]
    if report is not None:
        said += [episode["reason"] for episode in report["per_episode"]]
        said += [f"not believed: {s['topic']} {s['node']}" for s in report["strangers"]]
        if report["missed_cycles"]:
            said.append(f"missed {report['missed_cycles']} cycles")
    return " | ".join(said)


def _wait_for_rest(robot: Robot, *, ready: bool = False) -> RobotDescription:
    """Until the robot server is disarmed; a fault is acknowledged as `skewmi stop` does.

    If asked to, until the robot is ready again, too: an arm that was taken away is back then.
    """
    deadline = time.monotonic() + REST_TIMEOUT_S
    config = TransportConfig.for_client(robot.locator, lock_step=robot.lock_step)
    with Link.open(config, "watcher") as link:
        while True:
            answer = link.call(topics.YUMI_DESCRIBE, 5.0)
            description = RobotDescription.from_json(answer.message)
            if description.state == "disarmed" and (description.ready or not ready):
                return description
            if description.state == "fault":
                link.call(topics.YUMI_STOP, 5.0)
            assert time.monotonic() < deadline, f"not at rest: {description}"
            time.sleep(0.02)


def _verdict(report: dict[str, Any] | None, phase: Phase, motion: Motion, fault_s: float) -> str:
    if report is None:
        return DISARMED
    (episode,) = report["per_episode"]
    if episode["outcome"] != "stopped" or episode["reason"] != "interrupted":
        return str(episode["outcome"])
    if phase is Phase.STOPPING:
        return AS_ASKED
    assert episode["steps"] >= STEPS
    # Between start motion and policy the arm rests anyway.
    rests = motion.standstills(fault_s) - (1 if phase is Phase.START else 0)
    return RESTS_GOES_ON if rests > 0 else GOES_ON


def _resume(bench: Bench, velocity: Array) -> None:
    """Arm again and move, by another short run."""
    robot = bench.robot
    first_row = len(robot.rows())
    for _ in range(ATTEMPTS):
        report = bench.session.run(
            robot.locator,
            lock_step=robot.lock_step,
            steps=RESUMED_STEPS,
            spread=RESUMED_SPREAD,
            lead_ms=RESUMED_LEAD_MS,
        )
        assert report is not None
        (episode,) = report["per_episode"]
        if not any(reason in episode["reason"] for reason in BUSY_AGAIN):
            break
    assert episode["reason"] == "interrupted", f"no way to go on: {episode}"
    assert episode["steps"] == RESUMED_STEPS
    end = np.array(_wait_for_rest(robot).commanded_position)
    motion = Motion.of(robot.rows()[first_row:], end)
    assert motion.path_length() > MOVED, "it did not move"
    assert_safe(motion, velocity)
