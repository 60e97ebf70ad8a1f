"""A robot that lacks something."""

from __future__ import annotations

from skewmi.deploy.robot.backend import RobotState
from skewmi.deploy.robot.backends.hold import HoldBackend


class Unready(HoldBackend):
    """Lacks something, as long as it is told to."""

    missing: str | None = None
    states = True

    def readiness(self) -> str | None:
        return self.missing

    def read(self) -> RobotState | None:
        state = super().read()
        return state if self.states else None
