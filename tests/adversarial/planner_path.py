"""How well the planned hand follows a commanded path: by Pinocchio, from the published samples.

A path is a poly-line, commanded as a policy does: every 100 ms the next point at a constant speed,
at last a sudden stop. Judged is the distance of the hand from the poly-line.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from planner_judge import GRID_DT, UrdfArm
from planner_scenes import press_workspace

from skewmi.deploy.motion.planner import Planner
from skewmi.policy_io import Workspace
from skewmi.robot_models import frames, limits, yumi
from skewmi.robot_models.frames import rotation_vector

Array = NDArray[np.float64]

CONTROL_DT = 0.1
STEPS = 5
"""Grid steps per planner cycle, and planner cycles per control step."""

LATERAL_BAR_MM = 1.0
TILT_BAR_DEG = 0.2


def wide_workspace() -> Workspace:
    """The press task's box, wider across (x): room for corners in every plane."""
    box = press_workspace(np.array(yumi.TABLE_CONFIGURATION))
    return replace(box, low=(-0.079, *box.low[1:]), high=(0.061, *box.high[1:]))


def distance_to_line(points: Array, vertices: Array) -> Array:
    """Distance of points from a poly-line whose last leg goes on beyond its end.

    (How far a stop is overshot is another figure.) Shapes (n, 3), (m, 3) -> (n,).
    """
    nearest = np.full(len(points), np.inf)
    for k, (begin, end) in enumerate(pairwise(vertices)):
        length = float(np.linalg.norm(end - begin))
        way = (end - begin) / length
        last = k == len(vertices) - 2
        along = np.clip((points - begin) @ way, 0.0, np.inf if last else length)
        distance = np.linalg.norm(points - begin - along[:, None] * way, axis=1)
        nearest = np.minimum(nearest, distance)
    return nearest


def follow(planner: Planner, vertices: Array, speed: float) -> tuple[Array, Array]:
    """Command the poly-line and wait 1.5 s.

    Returns:
        Executed joint samples (n, 7) and commanded positions (n, 3) on the 4 ms grid.
    """
    targets: list[Array] = []
    durations: list[float] = []
    for begin, end in pairwise(vertices):
        length = float(np.linalg.norm(end - begin))
        count = max(1, round(length / (speed * CONTROL_DT)))
        targets += [begin + (end - begin) * (k + 1) / count for k in range(count)]
        durations += [length / speed / count] * count
    q, command = [], []
    share = np.arange(STEPS)[:, None] / STEPS
    for cycle in range(STEPS * len(targets) + 75):
        if cycle % STEPS == 0 and cycle < STEPS * len(targets):
            planner.set_target(targets[cycle // STEPS], durations[cycle // STEPS])
        begin = planner.command_position
        chunk = planner.step()
        q.append(chunk.q[:STEPS])
        command.append(begin + share * (planner.command_position - begin))
    return np.vstack(q), np.vstack(command)


def path_quality(
    arm: UrdfArm, workspace: Workspace, vertices: Array, profile: str, speed: float
) -> dict[str, Any]:
    """Deviation, lag on each leg, overshoot of the stop, tilt; and whether the bars are met."""
    planner = Planner(workspace, limits.profile(profile))
    start = np.array(workspace.start)
    planner.reset(np.array(workspace.start_configuration))
    if np.linalg.norm(vertices[0] - start) > 0.0:
        planner.set_target(vertices[0], 2.0)
        for _ in range(300):
            planner.step()
    q, command = follow(planner, vertices, speed)
    position = arm.positions(q) + np.array(workspace.base_position)
    rotation = arm.rotations(q)
    tilt = rotation_vector(np.swapaxes(rotation, -1, -2) @ frames.HAND_DOWN)
    tilt_deg = float(np.degrees(np.linalg.norm(tilt, axis=1).max()))
    lags = []
    for begin, end in pairwise(vertices):
        way = (end - begin) / np.linalg.norm(end - begin)
        half = 0.5 * float(np.linalg.norm(end - begin))
        passed = [int(np.argmax((points - begin) @ way > half)) for points in (position, command)]
        lags.append(round(1e3 * GRID_DT * (passed[0] - passed[1]), 1))
    way = (vertices[-1] - vertices[-2]) / np.linalg.norm(vertices[-1] - vertices[-2])
    lateral = 1e3 * float(distance_to_line(position, vertices).max())
    fastest = float(np.linalg.norm(np.diff(position, axis=0), axis=1).max()) / GRID_DT
    return {
        "profile": profile,
        "speed_mm_s": 1e3 * speed,
        "vertices_mm": (1e3 * (vertices - vertices[0])).round(1).tolist(),
        "lateral_mm": round(lateral, 3),
        "lag_ms": lags,
        "overshoot_mm": round(1e3 * float(((position - vertices[-1]) @ way).max()), 3),
        "final_error_mm": round(1e3 * float(np.linalg.norm(position[-1] - vertices[-1])), 4),
        "tilt_deg": round(tilt_deg, 4),
        "fastest_mm_s": round(1e3 * fastest, 1),
        "within": {
            "lateral": lateral <= LATERAL_BAR_MM,
            "orientation": tilt_deg <= TILT_BAR_DEG,
        },
    }


def steps(arm: UrdfArm) -> list[dict[str, Any]]:
    """Straight ways from the start, as far as the box allows and at most 150 mm."""
    workspace = press_workspace(np.array(yumi.TABLE_CONFIGURATION))
    start = np.array(workspace.start)
    cases = [
        ((0.0, 1.0, 0.0), "lab", 0.15),
        ((0.0, 1.0, 0.4), "lab", 0.15),
        ((0.0, 0.0, 1.0), "lab", 0.15),
        ((0.0, 0.6, -0.4), "lab", 0.15),
        ((1.0, 0.0, 0.0), "lab", 0.15),
        ((0.0, 1.0, 0.0), "careful", 0.04),
        ((0.0, 0.6, -0.4), "careful", 0.04),
    ]
    found = []
    for direction, profile, speed in cases:
        way = np.array(direction) / np.linalg.norm(direction)
        room = np.where(way > 0, workspace.high - start, start - np.array(workspace.low))
        reach = min(0.15, float((room[way != 0] / np.abs(way[way != 0])).min()))
        count = int(reach / (CONTROL_DT * speed))
        length = CONTROL_DT * speed * count if count else reach
        vertices = np.stack([start, start + length * way])
        found.append(path_quality(arm, workspace, vertices, profile, speed))
    return found


def corners(arm: UrdfArm) -> list[dict[str, Any]]:
    """Right angles in the planes xy, yz, zx and an oblique one, both ways round."""
    workspace = wide_workspace()
    middle = (np.array(workspace.low) + np.array(workspace.high)) / 2.0
    x, y, z = np.eye(3)
    oblique = (y + z) / np.sqrt(2.0), (x + y - z) / np.sqrt(3.0)
    pairs = [(x, y), (y, x), (y, z), (z, y), (-z, -x), (x, -z), oblique]
    found = []
    for profile, speed in (("lab", 0.15), ("lab", 0.1), ("careful", 0.04)):
        leg = 0.06
        for first, second in pairs:
            corner = middle + leg / 2 * (first - second)
            vertices = np.stack([corner - leg * first, corner, corner + leg * second])
            found.append(path_quality(arm, workspace, vertices, profile, speed))
    return found


def zigzags(arm: UrdfArm) -> list[dict[str, Any]]:
    """A right angle every other control step."""
    workspace = wide_workspace()
    middle = (np.array(workspace.low) + np.array(workspace.high)) / 2.0
    _, y, z = np.eye(3)
    found = []
    for profile, speed in (("lab", 0.15), ("lab", 0.1), ("careful", 0.04)):
        length = 2 * CONTROL_DT * speed
        legs = [length * (y if k % 2 else z) for k in range(6)]
        vertices = np.cumsum([middle - 1.5 * length * (y + z), *legs], axis=0)
        found.append(path_quality(arm, workspace, vertices, profile, speed))
    return found


def verdict(cases: list[dict[str, Any]]) -> dict[str, Any]:
    """The worst of all cases and whether every one meets its bar."""
    return {
        "cases": len(cases),
        "worst_lateral_mm": max(case["lateral_mm"] for case in cases),
        "worst_tilt_deg": max(case["tilt_deg"] for case in cases),
        "worst_overshoot_mm": max(case["overshoot_mm"] for case in cases),
        "worst_lag_ms": max(max(case["lag_ms"]) for case in cases),
        "within": {
            bar: all(case["within"][bar] for case in cases) for bar in ("lateral", "orientation")
        },
    }
