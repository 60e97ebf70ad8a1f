"""What a robot is to its server: a cycle of its own, a state, a command; and the scene before it.

The robot is the master of its time. `read` waits for its next cycle, whether that is a simulation
that sleeps until a step is due or a controller whose packet arrives; `write` answers it. The server
does the rest in between: read, decide, write, and only then publish and serve.

A backend is one folder (or file) of `backends` and one line of its registry.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from skewmi.errors import SkewmiError
from skewmi.policy_io import Array, Workspace
from skewmi.robot_models.base_frame import BoxPose
from skewmi.trajectory import JointPoint

_CLOCK_STARTS_S = (1 << 28, 1 << 30)
"""Range of the clock's start, s: it fits a ROS time stamp for decades to come."""


class BackendFaultError(SkewmiError):
    """The robot itself cannot go on; the robot server goes to fault with this reason."""


@dataclass(frozen=True, slots=True)
class RobotState:
    """What a robot measures in one cycle. The arrays are not written to afterwards.

    Attributes:
        time_ns: Of the cycle, by the robot's own clock since `open`; never goes back. Cycles that
            were lost are left out: the plan goes on in the robot's time.
        position: The arm's joints, then what else `state_names` names now; rad, m for fingers.
            Shape (n,).
        velocity: rad/s and m/s. Shape (n,).
        effort: N m and N. Shape (n,).
        guided: Whether the arm follows what is written. While it does not (motors off, moved by
            hand), it is commanded to stay where it is measured.
    """

    time_ns: int
    position: Array
    velocity: Array
    effort: Array
    guided: bool = True


@dataclass(frozen=True, slots=True)
class SceneState:
    """What is measured of a scene at one time.

    Attributes:
        names: Of its joints.
        position: rad or m. Shape (len(names),).
        velocity: rad/s or m/s. Shape (len(names),).
    """

    names: tuple[str, ...]
    position: Array
    velocity: Array


@dataclass(frozen=True)
class LinkErrors:
    """What becomes of the states on their way from a simulated robot to its session.

    Attributes:
        loss: Fraction that never arrives, in 0..1.
        delay_s: By which every other one is late, s.
        jitter_s: By up to as much again, drawn uniformly for each, s.
        seed: Numbers that decide which are lost and how late each is.
    """

    loss: float
    delay_s: float
    jitter_s: float
    seed: tuple[int, ...]


class Scene(Protocol):
    """What stands before a robot. A robot may lack one; then it serves no task."""

    task: str
    """The task that it belongs to."""
    layout_hashes: tuple[str, ...]
    """Every variant of the task's layout that this scene serves (with and without time, ...)."""

    @property
    def workspace(self) -> Workspace | None:
        """Box of the hand in the task, which motion that is inside must not leave; placed as the
        known box asks for (`box_frame.placed`)."""

    shapes_json: str
    """Shapes around the robot for replays, as `SceneGeometry.to_json`, in the frame of the known
    box; empty if unknown."""
    simulated: bool
    """Whether robot and scene are simulated in this process."""

    @property
    def resettable(self) -> bool:
        """Whether `reset` does anything now: simulated scenes, and those that somebody serves."""

    def state(self) -> SceneState | None:
        """Joints of the scene in the newest cycle; None if somebody else publishes them."""

    def publishers(self) -> Iterable[bytes]:
        """Global ids, 16 bytes each, of those who publish this scene's states in the robot server's
        place, such as the process of an emulated controller; empty if it publishes them itself.

        Asked for each description. Sessions and recorders believe nobody else, so that only who is
        known to be what he says belongs here. A camera that the robot server knows nothing of is
        named by the user instead (`skewmi deploy --scene-from`).
        """

    def contact(self) -> Mapping[str, float]:
        """Largest of `skewmi.contact.QUANTITIES` since the last reset; empty if unknown."""

    def reset(self, seed: int) -> Array:
        """Start the episode `seed` says; returns where the arm rests now, shape (7,), rad.

        Raises:
            CommandRefusedError: The scene is real.
        """


@runtime_checkable
class StandsKnown(Protocol):
    """A scene that works in the frame of a box that a calibration has found, besides `Scene`."""

    known_box: BoxPose | None
    """Where it is known to stand; None if nobody looked for it."""


class RobotBackend(Protocol):
    """One arm, in cycles. Used by the robot server's loop alone: one thread, nothing waits."""

    name: str
    """What `describe` tells, and what the registry calls it: `sim`, ..."""
    joint_names: tuple[str, ...]
    """The seven arm joints in chain order."""
    state_names: tuple[str, ...]
    """Of the joints in the newest `RobotState`: the arm's, then the finger if there is one, then
    those of another arm that is seen."""
    period_ns: int
    """Nominal time between two cycles, ns."""
    lock_step: bool
    """Whether time stands still until commands have arrived."""

    @property
    def admitted_speed(self) -> float:
        """Largest speed of the flange that the robot can be left alone with, m/s; inf if any."""

    @property
    def joint_speed(self) -> float:
        """Largest speed of any joint that the robot follows, rad/s; inf if any."""

    @property
    def slips(self) -> int:
        """How often cycles were left out because the server came too late."""

    @property
    def scene(self) -> Scene | None:
        """What stands before it, if the robot knows."""

    def open(self, may_advance: Callable[[], bool]) -> None:
        """Begin; the first cycle is at time 0.

        Args:
            may_advance: Whether there is something to do in the next cycles; asked by a robot in
                lock-step, whose time stands still otherwise.

        Raises:
            TransportError: The robot cannot be reached.
        """

    def readiness(self) -> str | None:
        """What is missing before the arm can be commanded, in words; None if nothing is."""

    def read(self) -> RobotState | None:
        """Wait for the next cycle, a few milliseconds at most.

        Returns:
            The state; None if there was no cycle in this time. In lock-step a state may come again
            with the time of the last one, measured anew.

        Raises:
            BackendFaultError: The robot cannot go on, and there is no state. What is wrong in a
                cycle that has one is raised by the `write` that answers it.
        """

    def due(self) -> bool:
        """Whether the next cycle has come, or is about to: what can wait should."""

    def write(self, command: JointPoint) -> None:
        """Command what is to hold from this cycle on. Called once after each `read` that gave a
        state, also while deactivated: then with the point at which the arm rests.

        Raises:
            BackendFaultError: Something is wrong with the robot; it follows if it can.
        """

    def activate(self) -> None:
        """Somebody has armed: commands will move the arm.

        Raises:
            CommandRefusedError: Not now.
        """

    def deactivate(self) -> None:
        """The arm rests, and nobody commands it any more."""

    def open_gripper(self, opening: float) -> None:
        """Move each finger to `opening` m from closed, from the next cycle on.

        Raises:
            CommandRefusedError: Not an opening of the fingers, or there are none.
        """

    def told(self) -> Mapping[str, str]:
        """What the status says of this kind of robot, beyond that of every robot."""

    def close(self) -> None:
        """End, also if it could not be opened; nothing else is called afterwards."""


@runtime_checkable
class SendsAhead(Protocol):
    """A robot that sends on something else than it is commanded, and remembers it, besides
    `RobotBackend`."""

    def rest_at(self, q: Array) -> None:
        """The next command is to rest at `q`, shape (7,), rad, wherever the last one was: what is
        sent rests there at once, too. The arm is there already, or held off its command."""


@runtime_checkable
class LinkVaries(Protocol):
    """A robot whose states shall not reach the session as they would by themselves.

    For simulated robots, besides `RobotBackend`.
    """

    def link_errors(self) -> LinkErrors | None:
        """What becomes of the states now; None if nothing. Asked in every cycle that has states:
        another object begins anew with its seed."""


@runtime_checkable
class GuidedByEgm(Protocol):
    """A robot whose controller follows commands by a law of its own, besides `RobotBackend`."""

    def egm(self) -> Mapping[str, float]:
        """Constants of the law, as `RobotDescription.egm`."""


@runtime_checkable
class TellsContact(Protocol):
    """A robot that knows what it touches. For simulated robots, besides `RobotBackend`."""

    def contact_forces(self) -> tuple[float, float]:
        """Largest contact force on the hand, and on the rest of the arm, since this was asked
        last, N."""


def fresh_start_ns() -> int:
    """A time for a robot server's clock to start from, on a full second, ns.

    Drawn at random, so that what was recorded from one run of a robot server (a bag that somebody
    plays, a captured message) is never due in another: its stamps are years away. The time of
    day would not do, because robots without a clock battery start again at the same time.
    """
    low_s, high_s = _CLOCK_STARTS_S
    return (low_s + secrets.randbelow(high_s - low_s)) * 1_000_000_000
