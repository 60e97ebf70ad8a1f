"""What the bridge to a real controller is started with."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import radians

from skewmi.deploy.robot.backends.egm.program import ProgramSettings
from skewmi.errors import ConfigurationError
from skewmi.policy_io import Workspace
from skewmi.robot_models.base_frame import BoxPose

RIGHT_PORT, LEFT_PORT = 6512, 6511
"""Where public programs for a YuMi send the packets of each arm."""

LEFT_ARM_TOLERANCE = radians(2.0)
"""How far a joint of the left arm may be from where the collision check takes it to be, rad: at
the elbow some 10 mm."""

_PLANNED_SHARE = 0.9
"""Of MaxSpeedDeviation, beyond which a controller slows all joints down and is no longer where it
was told to be: a reference that is a cycle late asks for 8 % more, with a gain of 20 /s."""
_BEND = 0.03
"""By how much the flange's way may be longer than its speed says, since joints go round: 10 mm
half a metre from the nearest axis are 0.02 rad."""


@dataclass(frozen=True)
class TaskFacts:
    """What a robot is told of the task before it, by somebody who knows the task."""

    task: str
    """Its name."""
    layout_hashes: tuple[str, ...]
    """Every variant of its layout."""
    workspace: Workspace
    """Where the hand may be."""
    shapes_json: str = ""
    """Nominal shapes, as `SceneGeometry.to_json`."""
    box: BoxPose | None = None
    """Where the task's box is known to stand; `workspace` and shapes are in its frame. None if
    nobody looked for it."""


@dataclass(frozen=True)
class EgmOptions:
    """How to reach a controller, and what its program does.

    Raises:
        ConfigurationError: A value makes no sense.
    """

    listen: str = f"127.0.0.1:{RIGHT_PORT}"
    """HOST:PORT that the controller sends the right arm's packets to."""
    listen_left: str | None = None
    """The same for the left arm; None for the port before the right arm's, if nobody has it, and
    "none" for no left arm."""
    controller: str | None = None
    """IPv4 address that packets must come from; None takes the first sender's."""
    program: ProgramSettings = field(default_factory=ProgramSettings)
    """What RAPID program and configuration say."""
    feed_forward: float = 1.0
    """Fraction of the plan's speed that is sent as speed reference, 0..1."""
    run_on_limit: float = 0.010
    """How far the flange may run on if this process dies, m: bounds the admitted speed."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.feed_forward <= 1.0:
            raise ConfigurationError(
                f"the feed-forward fraction is {self.feed_forward:g}; it must be in 0..1"
            )
        if not 1e-4 <= self.run_on_limit <= 0.1:
            raise ConfigurationError(
                f"the run-on limit is {1e3 * self.run_on_limit:g} mm; it must be in 0.1..100 mm"
            )

    @property
    def admitted_speed(self) -> float:
        """Largest flange speed at which the arm runs on no farther than `run_on_limit`, m/s."""
        return (1.0 - _BEND) * self.run_on_limit / self.program.runs_on_s(self.feed_forward)

    @property
    def joint_speed(self) -> float:
        """Largest joint speed of a plan, rad/s: what the law adds for errors has to fit, too."""
        return _PLANNED_SHARE * radians(self.program.max_speed_deviation_deg_s)
