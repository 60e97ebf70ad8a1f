"""What cells run on: a robot server and a session, each a process."""

from __future__ import annotations

from pathlib import Path
from typing import Self

from fault_clock import WallClock
from fault_egm_robot import EgmRobot
from fault_robot import Robot
from fault_session import SessionProcess


class Bench:
    """A robot server and a session to run cells on; a context manager that ends both.

    Args:
        folder: For the robot server's log.
        lock_step: Their pace.
        clock: That both shall have, or None for the machine's.
        egm: Whether the robot is behind EGM.
    """

    def __init__(
        self,
        folder: Path,
        *,
        lock_step: bool,
        clock: WallClock | None = None,
        egm: bool = False,
    ) -> None:
        environment = {} if clock is None else clock.environment
        self.clock = clock
        log = folder / "targets"
        self.robot: Robot = (
            EgmRobot(log, environment)
            if egm
            else Robot(log, lock_step=lock_step, environment=environment)
        )
        self.session = SessionProcess(environment)

    def __enter__(self) -> Self:
        self.robot.__enter__()
        self.session.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.session.close()
        self.robot.__exit__()
