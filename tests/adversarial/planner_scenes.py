"""Scenes and adversaries for the planner: where the hand may go, and who commands it badly."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from slow_limits import slowed

from skewmi.policy_io import Workspace
from skewmi.robot_models import frames, limits, yumi
from skewmi.robot_models.kinematics import ArmKinematics, InverseResult
from skewmi.robot_models.limits import JointLimits

Array = NDArray[np.float64]
Command = tuple[Array, float]

LEVER = 0.3
"""Metres that a radian of hand rotation counts as in singular values of the Jacobian."""

PROFILES = ("lab", "careful", "random")
SCENES = ("press", "random", "tight", "edge", "singular")
"""The press task's box; a box anywhere in reach; one with joint bounds so tight that the hand
runs into them; one around a pose with joints at the profile's own bounds; one around a pose that
is nearly singular."""

ADVERSARIES = (
    "constant",
    "reversal",
    "noise",
    "huge",
    "faces",
    "beyond",
    "corners",
    "sudden",
    "silent",
    "late",
    "every cycle",
    "not numbers",
)


def press_workspace(start_configuration: Array) -> Workspace:
    """The hand's box of OpenPressClose, whose start the configuration must reach."""
    return Workspace(
        low=(-0.019, -0.155, 0.190),
        high=(0.001, 0.135, 0.355),
        start=(-0.009, -0.1345, 0.270),
        base_position=(-0.4, 0.0, 0.0),
        hand_quaternion_wxyz=(0.0, 0.5**0.5, 0.5**0.5, 0.0),
        free_following_error=1.0,
        held_following_error=0.2,
        stop_blockage=0.45,
        start_configuration=tuple(start_configuration.tolist()),
        gripper_opening=0.014,
    )


def smallest_singular_value(jacobian: Array) -> Array:
    """Of Jacobians (..., 6, 7), linear rows first; in metres. Shape (...)."""
    weights = np.array([1.0, 1.0, 1.0, LEVER, LEVER, LEVER])[:, None]
    values: Array = np.linalg.svd(weights * jacobian, compute_uv=False)[..., -1]
    return values


def _draw_configurations(
    rng: np.random.Generator, kinematics: ArmKinematics, kind: str, count: int
) -> Array:
    """Anywhere; for `edge` some joints at their bounds, for `singular` nearly singular."""
    lower, upper = kinematics.position_lower, kinematics.position_upper
    if kind == "singular":
        many = rng.uniform(lower, upper, (30 * count, 7))
        return many[np.argsort(smallest_singular_value(kinematics.jacobian(many)))[:count]]
    q = rng.uniform(lower, upper, (count, 7))
    if kind == "edge":
        at = rng.random((count, 7)) < 0.4
        inward = rng.uniform(0.003, 0.05, (count, 7))
        q[at] = np.where(rng.random((count, 7)) < 0.5, lower + inward, upper - inward)[at]
    return q


def random_workspace(rng: np.random.Generator, kinematics: ArmKinematics, kind: str) -> Workspace:
    """A box of random size around a random pose; the orientation is the pose's.

    Most boxes drawn cannot be reached to their corners, so that many are tried at once.
    """
    count = 24
    base = np.array([-0.4, 0.0, 0.0])
    corners = np.array(list(product((-1.0, 1.0), repeat=3)))
    while True:
        q = _draw_configurations(rng, kinematics, kind, count)
        start, rotation = kinematics.forward(q)
        half = rng.uniform(0.005, 0.08, (count, 3))
        centre = start - rng.uniform(-0.9, 0.9, (count, 3)) * half
        good = np.ones(count, dtype=bool)
        if kind == "singular":
            # The way from the start leads past the singular posture, in the box's middle.
            centre, start = start, 2.0 * start - centre
            found = kinematics.inverse(start, rotation, q, max_iterations=50)
            q, good = found.q, _converged(found)
        points = centre[:, None] + corners * half[:, None]
        found = kinematics.inverse(points, rotation[:, None], q[:, None], max_iterations=50)
        good &= _converged(found).all(axis=1)
        # A planner can be reset 1 mrad inside of the bounds.
        room = np.minimum(q - kinematics.position_lower, kinematics.position_upper - q)
        good &= (room > 2e-3).all(axis=1)
        if good.any():
            k = int(np.argmax(good))
            return Workspace(
                low=tuple((centre - half + base)[k].tolist()),
                high=tuple((centre + half + base)[k].tolist()),
                start=tuple((start + base)[k].tolist()),
                base_position=tuple(base.tolist()),
                hand_quaternion_wxyz=tuple(frames.quaternion_from_rotation(rotation[k]).tolist()),
                free_following_error=1.0,
                held_following_error=0.2,
                stop_blockage=0.45,
                start_configuration=tuple(q[k].tolist()),
                gripper_opening=0.014,
            )


def _converged(result: InverseResult) -> NDArray[np.bool_]:
    return (result.position_error < 1e-4) & (result.rotation_error < 1e-3)


def _draw_profile(rng: np.random.Generator, name: str) -> JointLimits:
    """A named profile, sometimes slowed down, or one whose numbers are random per joint."""
    if name != "random":
        bounds = limits.profile(name)
        return slowed(bounds, float(rng.uniform(0.1, 1.0))) if rng.random() < 0.3 else bounds
    acceleration = 10 ** rng.uniform(-0.3, 1.5) * rng.uniform(0.5, 1.0, 7)
    return replace(
        limits.profile("lab"),
        name="random",
        velocity=10 ** rng.uniform(-1.3, 0.0) * yumi.VELOCITY * rng.uniform(0.5, 1.0, 7),
        acceleration=acceleration,
        jerk=10 ** rng.uniform(0.7, 2.0) * acceleration * rng.uniform(0.7, 1.0, 7),
    )


def draw_scene(
    rng: np.random.Generator, kinematics: ArmKinematics
) -> tuple[str, Workspace, JointLimits]:
    """Its kind, a workspace and limits: profile, speed and perhaps tight bounds are drawn too."""
    bounds = _draw_profile(rng, str(rng.choice(PROFILES)))
    kind = str(rng.choice(SCENES))
    if kind == "press" or (kind == "tight" and rng.random() < 0.5):
        workspace = press_workspace(np.array(yumi.TABLE_CONFIGURATION))
    else:
        workspace = random_workspace(rng, kinematics, kind)
    if kind == "tight":
        q = np.array(workspace.start_configuration)
        below, above = rng.uniform(0.02, 0.25, (2, 7))
        bounds = replace(bounds, position_lower=q - below, position_upper=q + above)
    return kind, workspace, bounds


def commands(kind: str, workspace: Workspace, rng: np.random.Generator) -> Iterator[Command | None]:
    """Per cycle a target and its duration, or None; without end."""
    low, high = np.array(workspace.low), np.array(workspace.high)
    position = rng.uniform(low, high)
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    faces = rng.permutation(6)
    cycle = 0
    while True:
        period = {"every cycle": 1, "not numbers": 1, "beyond": 8}.get(kind, 5)
        if cycle % period or kind == "silent":
            yield None
        elif kind == "constant":
            position = np.clip(position + 0.015 * direction, low, high)
            yield position, 0.1
        elif kind == "reversal":
            direction = -direction
            yield position + 0.015 * direction, 0.1
        elif kind == "noise":
            position = np.clip(position + rng.uniform(-0.015, 0.015, 3), low, high)
            yield position, 0.1
        elif kind == "huge":
            yield rng.normal(size=3) * 10.0 ** rng.uniform(-3, 6), 10.0 ** rng.uniform(-6, 1)
        elif kind == "faces":
            target = rng.uniform(low, high)
            axis = rng.integers(3)
            target[axis] = (low if rng.random() < 0.5 else high)[axis]
            yield target, float(rng.uniform(0.001, 0.3))
        elif kind == "beyond":
            axis, side = divmod(int(faces[cycle // period % 6]), 2)
            target = rng.uniform(low, high)
            target[axis] += 1.0 if side else -1.0
            yield target, float(rng.uniform(0.001, 0.1))
        elif kind == "corners":
            yield np.where(rng.random(3) < 0.5, low, high), float(rng.uniform(0.001, 0.1))
        elif kind == "sudden":
            yield rng.uniform(low, high), 0.001
        elif kind == "not numbers" and cycle % 5:
            yield not_numbers(position, rng)
        else:
            position = rng.uniform(low, high)
            yield position, float(rng.uniform(0.02, 0.5))
        cycle += 1


def not_numbers(position: Array, rng: np.random.Generator) -> Command:
    """A command that must be refused: target or duration is no number, or of no use."""
    bad, duration = position.copy(), 0.1
    if rng.random() < 0.5:
        bad[rng.integers(3)] = rng.choice([np.nan, np.inf, -np.inf])
    else:
        duration = float(rng.choice([np.nan, np.inf, -np.inf, 0.0, -1.0]))
    return bad, duration
