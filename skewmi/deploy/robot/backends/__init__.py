"""The robots that there are, by name; each is loaded only when it is asked for.

A new one is one file or folder here and one line in `_OURS`, or a package of its own that registers
it by an entry point of the group `skewmi.robots`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from types import MappingProxyType

from skewmi.deploy.robot.backend import RobotBackend
from skewmi.deploy.robot.backends.egm.options import EgmOptions, TaskFacts
from skewmi.deploy.robot.gripper.base import Gripper
from skewmi.deploy.wire.transport import Link
from skewmi.errors import ConfigurationError, NotFoundError, did_you_mean
from skewmi.robot_models.feed_forward import FeedForward

GROUP = "skewmi.robots"
"""Entry points by which other packages register robots: `name = "package.module:make"`."""

_OURS = {
    "sim": "skewmi.deploy.robot.backends.mujoco.backend:make",
    "hold": "skewmi.deploy.robot.backends.hold:make",
    "egm": "skewmi.deploy.robot.backends.egm.backend:make",
}


def with_those_of(points: Iterable[EntryPoint]) -> dict[str, tuple[str, ...]]:
    """Where the robots are, by name: one place each, unless two packages clash.

    Ours come first and keep their names: no other package can stand in the place of one.

    Args:
        points: Entry points of `GROUP`.
    """
    found: dict[str, tuple[str, ...]] = {name: (where,) for name, where in _OURS.items()}
    for point in sorted(points, key=lambda point: point.name):
        # One package may be found twice, as where it was edited and where it is installed.
        places = found.get(point.name, ())
        if point.name not in _OURS and point.value not in places:
            found[point.name] = (*places, point.value)
    return found


BACKENDS: Mapping[str, tuple[str, ...]] = MappingProxyType(with_those_of(entry_points(group=GROUP)))
"""Name -> modules and functions that make it of `BackendOptions`; more than one is a clash."""


@dataclass(frozen=True)
class BackendOptions:
    """What a robot may be told when it is made; each takes what concerns it, and refuses what it
    cannot do."""

    task: str | None = None
    """Whose scene stands in front of the robot, for robots that have one; None for the default."""
    variation: str | None = None
    """How a simulated robot and its scene differ from the nominal ones."""
    lock_step: bool = False
    """Let time pass only when commands have arrived."""
    delay_s: float | None = None
    """From a command to the state that shows it, s, for robots that let one choose."""
    start_configuration: tuple[float, ...] | None = None
    """Where a simulated arm is at first, chain order, rad."""
    feed_forward: FeedForward | None = None
    """Of servos that are known: what is sent in place of the plan, which is checked before."""
    low_pass_s: float = 0.0
    """Of a controller guided by EGM that is known: time constant of its law's low-pass, s."""
    egm: EgmOptions | None = None
    """How to reach a controller."""
    gripper: Gripper | None = None
    """Of a robot whose arm knows nothing of one; closed with the robot."""
    facts: TaskFacts | None = None
    """What a robot is told of the task that it does not know itself."""
    box: tuple[float, float, float] | None = None
    """Where a calibration has the task's box, `box_frame.box_displacement`: of a robot that knows
    its scene, whose `workspace` and shapes are in that box's frame then."""
    link: Link | None = None
    """The robot server's, for a robot whose scene is served by somebody else."""


def make_backend(name: str, options: BackendOptions) -> RobotBackend:
    """A robot of a kind, not opened yet.

    Args:
        name: One of `BACKENDS`.
        options: For it.

    Raises:
        NotFoundError: There is no such robot, task or variation.
        ConfigurationError: The options are not for it, its package cannot be imported, or two
            packages have a robot of that name.
    """
    places = BACKENDS.get(name, ())
    if not places:
        raise NotFoundError(
            f"no robot {name!r}; there are {', '.join(BACKENDS)}{did_you_mean(name, BACKENDS)}"
        )
    if len(places) > 1:
        raise ConfigurationError(
            f"{len(places)} robots are called {name!r}: {', '.join(places)}; uninstall the "
            "packages of all but one, or rename their robots"
        )
    module, _, function = places[0].partition(":")
    try:
        make: Callable[[BackendOptions], RobotBackend] = getattr(import_module(module), function)
    except (ImportError, AttributeError) as error:
        if name in _OURS:
            raise  # the command line says which extra brings what is missing
        raise ConfigurationError(
            f"robot {name!r} cannot be loaded from {places[0]}: {error}"
        ) from error
    return make(options)
