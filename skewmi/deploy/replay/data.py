"""What a run shows, as arrays on one time axis: seconds of the robot server's clock.

A recording is one stretch of a run, a live view many short ones; both are drawn from `Run`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from skewmi.deploy.recording.reader import BOX_POSE, LAYOUT, LIMITS, LOCK_STEP, SCENE, VARIATION
from skewmi.deploy.wire.messages import Status
from skewmi.deploy.wire.scene_geometry import SceneGeometry
from skewmi.deploy.wire.simulation_status import ScenePose
from skewmi.errors import ConfigurationError
from skewmi.policy_io import PolicyLayout
from skewmi.robot_models.base_frame import NOMINAL_BASE, BaseFrame, BoxPose, base_of
from skewmi.robot_models.kinematics import ArmKinematics

Array = NDArray[np.float64]

REGULAR_S = 0.010
"""Commanded samples closer than this belong to one uninterrupted motion, s."""


@dataclass(frozen=True)
class Motion:
    """Joint motion over time."""

    time_s: Array
    """Shape (n,)."""
    q: Array
    """rad. Shape (n, 7)."""
    v: Array
    """rad/s. Shape (n, 7); (n, 0) if unknown."""
    a: Array
    """rad/s^2. Shape (n, 7); (n, 0) if unknown."""
    jerk: Array
    """rad/s^3, over the interval that ends at each sample. Shape (n, 7) or (n, 0)."""
    base: BaseFrame = NOMINAL_BASE
    """The robot base in the task's frame, "world" here."""

    @cached_property
    def hand_w(self) -> Array:
        """Flange in world, m. Shape (n, 3)."""
        return self.base.to_task(self._flange[0])

    def tilt_deg(self, hold_wxyz: tuple[float, ...]) -> Array:
        """Angle between the flange and how it is to be held.

        Args:
            hold_wxyz: Of `Workspace.hand_quaternion_wxyz`.

        Returns:
            Degrees. Shape (n,).
        """
        rotation = self.base.rotations_to_task(self._flange[1])
        trace = np.einsum("nij,ij->n", rotation, rotation_of(hold_wxyz))
        tilt: Array = np.degrees(np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0)))
        return tilt

    @cached_property
    def _flange(self) -> tuple[Array, Array]:
        return ArmKinematics("right").forward(self.q)


def no_motion() -> Motion:
    """Nothing at all."""
    nothing = np.zeros((0, 7))
    return Motion(np.zeros(0), nothing, nothing, nothing, nothing)


@dataclass(frozen=True)
class Series:
    """Named numbers over time."""

    time_s: Array
    names: tuple[str, ...]
    values: Array
    """Shape (n, len(names))."""


def no_series() -> Series:
    """Of nothing."""
    return Series(np.zeros(0), (), np.zeros((0, 0)))


@dataclass(frozen=True)
class Placement:
    """Where the scene stands from a time on."""

    time_s: float
    poses: tuple[ScenePose, ...]
    """Of what stands elsewhere than described."""


@dataclass(frozen=True)
class Subject:
    """What is known of a run before it begins."""

    layout: PolicyLayout | None
    limits: dict[str, Array]
    """Per joint, by name: position_lower, position_upper, velocity, acceleration, jerk."""
    geometry: SceneGeometry | None
    lock_step: bool = False
    """Whether robot and session wait for each other."""
    base: BaseFrame = NOMINAL_BASE
    """The robot base in the task's frame: elsewhere than usual if the box was known to be."""
    variation: str = ""
    """What a simulated robot was told to vary; empty if nothing."""

    @staticmethod
    def from_metadata(metadata: Mapping[str, str], source: str) -> Subject:
        """Read what `reader.run_metadata` wrote; keys may be missing.

        Args:
            metadata: Of a recording, or as handed to a live view.
            source: Where it comes from, for messages.

        Raises:
            ConfigurationError: A value cannot be read.
        """
        layout, scene = metadata.get(LAYOUT), metadata.get(SCENE)
        return Subject(
            layout=None if layout is None else PolicyLayout.from_json(layout),
            limits=_limits(metadata.get(LIMITS), source),
            geometry=None if scene is None else SceneGeometry.from_json(scene),
            base=base_frame(metadata, source),
            lock_step=metadata.get(LOCK_STEP) == str(True),
            variation=metadata.get(VARIATION, ""),
        )


@dataclass(frozen=True)
class Run:
    """A stretch of a run: all of a recording, or what has happened since the last look."""

    subject: Subject
    commanded: Motion
    measured: Motion
    fingers: Series
    left: Series
    """Joints of the left arm, rad; without names if nobody measures it."""
    scene: Series
    observation: Series
    action: Series
    error: Series
    """Commanded minus measured hand, see `tracking_error`; x, y, z in world, m."""
    events: tuple[tuple[float, Status], ...]
    """Transitions and refusals: (time s, status); repeats are left out."""
    success_s: tuple[float, ...]
    """When the reward region had been held long enough, once per episode at most."""
    malformed: int
    """Messages so far that could not be decoded, left out."""
    duration_s: float
    """Time of the last motion so far."""
    torque: Series = field(default_factory=no_series)
    """Measured effort of the arm's joints, N m; without names if nobody measures it."""
    forces: Series = field(default_factory=no_series)
    """Largest contact forces of each cycle, N, as a simulated robot tells them."""
    placements: tuple[Placement, ...] = ()
    """Where a simulated scene stands, as its robot tells; only changes."""
    intervals: Mapping[str, Series] = field(default_factory=dict)
    """Time between two messages as sent, ms; see `timing.REGULAR`."""
    spare: Series = field(default_factory=no_series)
    """How long before its time each command was sent, ms."""
    counts: Series = field(default_factory=no_series)
    """What went wrong, as the robot server counts it since it started."""


def rotation_of(quaternion_wxyz: tuple[float, ...]) -> Array:
    """Rotation matrix of a unit quaternion. Shape (3, 3)."""
    w, x, y, z = quaternion_wxyz
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def tracking_error(commanded: Motion, measured: Motion) -> Series:
    """Commanded minus measured hand, while a command is in force.

    Between runs of chunks nothing is commanded, and a simulated arm may be put elsewhere: in
    lock-step, while time stands still. So of several measurements of one time none counts.

    Returns:
        x, y, z in world, m, at the times of those measurements.
    """
    names = ("x", "y", "z")
    if not (len(commanded.time_s) and len(measured.time_s)):
        return Series(np.zeros(0), names, np.zeros((0, 3)))
    after = np.searchsorted(commanded.time_s, measured.time_s)
    last = len(commanded.time_s) - 1
    gap = commanded.time_s[np.minimum(after, last)] - commanded.time_s[np.maximum(after - 1, 0)]
    again = np.diff(measured.time_s, prepend=-np.inf, append=np.inf) == 0.0
    during = (after > 0) & (after <= last) & (gap < REGULAR_S) & ~(again[1:] | again[:-1])
    time_s, hand = measured.time_s[during], commanded.hand_w
    at_measured = [np.interp(time_s, commanded.time_s, hand[:, axis]) for axis in range(3)]
    nothing = measured.q[during, :0]
    compared = Motion(time_s, measured.q[during], nothing, nothing, nothing, measured.base)
    return Series(time_s, names, np.column_stack(at_measured) - compared.hand_w)


def base_frame(metadata: Mapping[str, str], source: str) -> BaseFrame:
    """The robot base in the task's frame, from where a run knew the task's box to stand.

    Args:
        metadata: Of a recording, or as handed to a live view.
        source: Where it comes from, for messages.

    Raises:
        ConfigurationError: It cannot be read.
    """
    try:
        return base_of(BoxPose.of_mapping(json.loads(metadata.get(BOX_POSE, "{}"))))
    except (ValueError, TypeError, AttributeError, ConfigurationError) as error:
        raise ConfigurationError(f"the box's pose in {source} is unreadable: {error}") from error


def _limits(text: str | None, source: str) -> dict[str, Array]:
    if text is None:
        return {}
    try:
        limits = {
            name: np.array(value, dtype=np.float64) for name, value in json.loads(text).items()
        }
    except (ValueError, TypeError, AttributeError) as error:
        raise ConfigurationError(f"limits in {source} are unreadable: {error}") from error
    return {name: value for name, value in limits.items() if value.shape == (7,)}
