"""Robot servers for tests: what they say, and how to ask them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

from skewmi.deploy.robot.backends import BackendOptions
from skewmi.deploy.robot.description import RobotDescription, limit_values
from skewmi.deploy.robot.process import free_port
from skewmi.deploy.robot.run import serve_robot
from skewmi.deploy.session.states import STATUS_NAME, SessionState
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.messages import decode_status
from skewmi.deploy.wire.transport import Link, Sample, TransportConfig
from skewmi.robot_models import limits as joint_limits
from skewmi.robot_models import yumi
from skewmi.sim.tasks.open_press_close.definition import make_layout
from skewmi.trajectory import CYCLE_NS, GRID_NS

LAB = joint_limits.profile("lab")
NAMES = yumi.joint_names("right")


def description(**changes: Any) -> RobotDescription:
    """What a simulated robot server says that agrees with this version, but for the changes."""
    base = RobotDescription(
        backend="sim",
        task="open_press_close",
        layout_hashes=(make_layout().hash(),),
        robot_model_hash=yumi.MODEL_HASH,
        limit_profile="lab",
        lock_step=False,
        simulated=True,
        grid_ns=GRID_NS,
        state_period_ns=CYCLE_NS,
        state="disarmed",
        reason="started",
        clock_ns=0,
        joint_names=NAMES,
        commanded_position=(0.1 + 0.2,) * 7,
        stops=3,
        limits=limit_values(LAB),
    )
    return replace(base, **changes)


@contextmanager
def robot_in_a_thread(
    *, lock_step: bool = False, start_configuration: tuple[float, ...] | None = None
) -> Iterator[str]:
    """A robot server in this process, so that a test can get at its parts."""
    locator = f"tcp/127.0.0.1:{free_port()}"
    config = TransportConfig.for_robot(locator, lock_step=lock_step)
    stop, ready = threading.Event(), threading.Event()
    options = BackendOptions(lock_step=lock_step, start_configuration=start_configuration)
    thread = threading.Thread(
        target=serve_robot, args=("sim", options, config, LAB, stop, lambda _: ready.set())
    )
    thread.start()
    assert ready.wait(20.0)
    try:
        yield locator
    finally:
        stop.set()
        thread.join(20.0)
        assert not thread.is_alive()


def call(locator: str, service: topics.Service, extra: bytes = b"") -> tuple[bool, str]:
    with Link.open(TransportConfig.for_client(locator), f"test_{time.monotonic_ns()}") as link:
        link.wait_for_robot(5.0)
        reply = link.call(service, 5.0, extra)
        return reply.success, reply.message


def describe(locator: str) -> RobotDescription:
    return RobotDescription.from_json(call(locator, topics.YUMI_DESCRIBE)[1])


def once_running(locator: str, what: Callable[[], object]) -> threading.Thread:
    """Do something when a policy commands the arm; a thread that already listens."""
    listens = threading.Event()

    def watch() -> None:
        with Link.open(TransportConfig.for_client(locator), "watcher") as link:
            statuses = link.subscribe(topics.YUMI_STATUS, depth=None)
            link.wait_for_robot(60.0)
            listens.set()
            deadline = time.monotonic() + 120.0
            while not any(map(_says_running, statuses.drain())) and time.monotonic() < deadline:
                time.sleep(0.05)
        what()

    thread = threading.Thread(target=watch)
    thread.start()
    assert listens.wait(60.0)
    return thread


def _says_running(sample: Sample) -> bool:
    status = decode_status(sample.payload)
    return status.name == STATUS_NAME and status.values["state"] == SessionState.RUNNING.value
