"""What EGM packets say, in our terms: rad, m, chain order. `codec` puts them on the wire."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from skewmi.trajectory import Array


class Motors(Enum):
    """Whether the drives have power. The values are those on the wire, here and below."""

    UNDEFINED = 0
    ON = 1
    OFF = 2


class Mci(Enum):
    """State of the motion correction: only `RUNNING` follows references."""

    UNDEFINED = 0
    ERROR = 1
    STOPPED = 2
    RUNNING = 3


class Rapid(Enum):
    """Whether the RAPID program runs. A restarted IRC5 says `UNDEFINED` although it does."""

    UNDEFINED = 0
    STOPPED = 1
    RUNNING = 2


@dataclass(frozen=True)
class Pose:
    """The flange in the robot's base frame.

    Attributes:
        position: m. Shape (3,).
        quaternion_wxyz: Of unit length. Shape (4,).
    """

    position: Array
    quaternion_wxyz: Array


@dataclass(frozen=True)
class FeedbackPacket:
    """One packet of the controller: what it measures and what it is doing.

    Attributes:
        sequence: Counts packets; starts again with each EGM session.
        q: Measured joints, rad, chain order. Shape (7,).
        motors: State of the drives.
        mci: State of the motion correction.
        rapid: State of the program.
        clock_us: The controller's clock at the measurement, microseconds since 1970; None before
            RobotWare 6.07.01, whose angles are not to be trusted.
        time_ms: When it was sent, by the controller's own count.
        planned_q: Where the controller wants the joints to be, rad, chain order. Shape (7,).
        converged: Whether the joints have been within the program's convergence limits for as
            long as it asks for.
        utilization: How much of what was asked for the last motion used of the joints' abilities,
            per cent; beyond 100 it was done in part. None before RobotWare 6.10.
        flange: Measured pose, if told.
        planned_flange: Pose of `planned_q`, if told.
        robotware: 7 if the packet has fields that RobotWare 6 does not send, else 6.
        move_index: Of RobotWare 7, if told.
    """

    sequence: int
    q: Array
    motors: Motors
    mci: Mci
    rapid: Rapid
    clock_us: int | None
    time_ms: int = 0
    planned_q: Array | None = None
    converged: bool = False
    utilization: float | None = None
    flange: Pose | None = None
    planned_flange: Pose | None = None
    robotware: int = 6
    move_index: int | None = None

    @property
    def guided(self) -> bool:
        """Whether the controller follows references: drives, program and correction all run."""
        return (
            self.motors is Motors.ON and self.rapid is not Rapid.STOPPED and self.mci is Mci.RUNNING
        )


@dataclass(frozen=True)
class ReferencePacket:
    """One answer to the controller.

    Attributes:
        sequence: Counts answers.
        time_ms: When it was sent, by the sender's count.
        q: Where the joints shall be, rad, chain order. Shape (7,).
        v: How fast they shall move there, rad/s, chain order; None leaves it to the controller's
            own position loop. Shape (7,).
    """

    sequence: int
    time_ms: int
    q: Array
    v: Array | None = None
