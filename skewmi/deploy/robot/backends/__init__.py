"""The robots that there are, by name; each is loaded only when it is asked for.

A new one is one file or folder here and one line in `BACKENDS`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from types import MappingProxyType

from skewmi.deploy.robot.backend import RobotBackend
from skewmi.deploy.robot.backends.egm.options import EgmOptions, TaskFacts
from skewmi.deploy.robot.gripper.base import Gripper
from skewmi.deploy.wire.transport import Link
from skewmi.errors import NotFoundError
from skewmi.robot_models.feed_forward import FeedForward

BACKENDS: Mapping[str, str] = MappingProxyType(
    {
        "sim": "skewmi.deploy.robot.backends.mujoco.backend:make",
        "hold": "skewmi.deploy.robot.backends.hold:make",
        "egm": "skewmi.deploy.robot.backends.egm.backend:make",
    }
)
"""Name -> module and function that makes it of `BackendOptions`."""


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
    egm: EgmOptions | None = None
    """How to reach a controller."""
    gripper: Gripper | None = None
    """Of a robot whose arm knows nothing of one; closed with the robot."""
    facts: TaskFacts | None = None
    """What a robot is told of the task that it does not know itself."""
    link: Link | None = None
    """The robot server's, for a robot whose scene is served by somebody else."""


def make_backend(name: str, options: BackendOptions) -> RobotBackend:
    """A robot of a kind, not opened yet.

    Args:
        name: One of `BACKENDS`.
        options: For it.

    Raises:
        NotFoundError: There is no such robot, task or variation.
        ConfigurationError: The options are not for it.
    """
    if name not in BACKENDS:
        raise NotFoundError(f"no robot {name!r}; there are {', '.join(BACKENDS)}")
    module, function = BACKENDS[name].split(":")
    make: Callable[[BackendOptions], RobotBackend] = getattr(import_module(module), function)
    return make(options)
