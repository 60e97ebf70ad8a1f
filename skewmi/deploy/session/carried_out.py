"""How a run that is no policy's ends, whatever ends it: told, disarmed, at rest."""

from __future__ import annotations

from collections.abc import Callable

from skewmi.deploy.realtime import hot_loop
from skewmi.deploy.session.robot_client import RobotClient
from skewmi.deploy.session.states import SessionEvent
from skewmi.deploy.session.status import SessionStatus
from skewmi.errors import SkewmiError, TransportError


def carried_out(
    action: Callable[[], None],
    robot: RobotClient,
    status: SessionStatus,
    *,
    over: str,
    after: str,
    lock_step: bool,
) -> list[str]:
    """Carry something out with a robot, and give the arm back.

    Args:
        action: From arming to rest; raises SkewmiError for whatever ends it early.
        robot: To disarm.
        status: Told what happens.
        over, after: Words for the end, and for what it is the end of.
        lock_step: Whether the robot waits: then nothing is urgent.

    Returns:
        Why it was stopped, if it was. Whatever ends it, nothing has been sent since.
    """
    stops: list[str] = []
    try:
        with hot_loop(priority=not lock_step):
            action()
    except TransportError as error:
        stops.append(str(error))
        status.fire(SessionEvent.FAULT, str(error))
    except SkewmiError as error:
        stops.append(str(error))
        status.fire(SessionEvent.STOP, str(error))
    else:
        status.fire(SessionEvent.TIME_OVER, over)
    try:
        robot.disarm()
    except SkewmiError as error:
        stops.append(str(error))
        status.fire(SessionEvent.FAULT, str(error))
    status.fire(SessionEvent.AT_REST, after)
    status.fire(SessionEvent.FINISH, "the run is over")
    return stops
