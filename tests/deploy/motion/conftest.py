"""A planner at rest at its start."""

from __future__ import annotations

import planner_scenes
import pytest
from planned_runs import START

from skewmi.deploy.motion.planner import Planner
from skewmi.policy_io import Workspace
from skewmi.robot_models import limits


@pytest.fixture(scope="module")
def workspace() -> Workspace:
    box: Workspace = planner_scenes.press_workspace(START)
    return box


@pytest.fixture
def planner(workspace: Workspace) -> Planner:
    made = Planner(workspace, limits.profile("lab"))
    made.reset(START)
    return made
