"""A robot server's words about the default task's scene, and poses of an arm before it."""

from __future__ import annotations

import functools

import numpy as np
from robot_servers import LAB, description

from skewmi.cli.egm_flags import task_facts
from skewmi.cli.home import start_of
from skewmi.cli.scene_touches import TouchPlanner
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.safety.flange_space import TASK, flange_spaces
from skewmi.deploy.safety.guard import Guard
from skewmi.deploy.safety.obstacles import scene_obstacles
from skewmi.deploy.session.touch_plan import PlannedTouch
from skewmi.deploy.session.way_plan import WayPlanner
from skewmi.deploy.session.way_spaces import way_spaces
from skewmi.deploy.wire.scene_geometry import SceneGeometry
from skewmi.robot_models.obstacle import Obstacle
from skewmi.robot_models.servo import CONTACT_SERVO
from skewmi.trajectory import Array

FACTS = task_facts("open_press_close")


def obstacles() -> tuple[Obstacle, ...]:
    return scene_obstacles(SceneGeometry.from_json(FACTS.shapes_json).parts)


def described(q: Array) -> RobotDescription:
    """By a server whose arm is held there."""
    workspace = FACTS.workspace
    base = np.array(workspace.base_position)
    spaces = {n: s.numbers() for n, s in flange_spaces(workspace, obstacles()).items()}
    spaces[TASK] = {n: tuple(np.array(getattr(workspace, n)) - base) for n in ("low", "high")}
    return description(scene=FACTS.shapes_json, workspaces=spaces, commanded_position=tuple(q))


def planner(q: Array, *, slow: bool = False) -> WayPlanner:
    return WayPlanner(way_spaces(described(q), LAB, q, slow=slow), q)


@functools.cache
def task_start() -> Array:
    return start_of(described(np.zeros(7)))


@functools.cache
def touches() -> tuple[PlannedTouch, ...]:
    """As calibration makes them."""
    start = task_start()
    return tuple(TouchPlanner(described(start), LAB, CONTACT_SERVO, lambda text: None).touches())


def in_contact(touch: PlannedTouch, pressed: float = 0.001) -> Array:
    """Commanded joints of a hand that has met a face: its finger so deep in it, m."""
    clearance = Guard(LAB, obstacles=obstacles()).clearance
    low, high = 0.0, touch.creep.length
    for _ in range(14):
        middle = (low + high) / 2.0
        named = clearance.distances(touch.creep.at(middle))
        nearest = min(d for first, second, d in named if "scene" in first + second)
        low, high = (middle, high) if nearest > -pressed else (low, middle)
    return touch.creep.at(low)
