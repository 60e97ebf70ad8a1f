"""The door through the whole chain: policy, planner, guard, link, simulated robot, scene."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from robot_servers import describe
from scripted_door_open import ScriptedDoorOpen
from sent_motion import assert_limits_kept

from skewmi.deploy.options import DeployOptions
from skewmi.deploy.recording.reader import read_recording
from skewmi.deploy.robot.process import spawn_robot
from skewmi.deploy.run import run_deploy
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.messages import decode_joint_states
from skewmi.errors import LayoutMismatchError
from skewmi.sim import tasks
from skewmi.sim.tasks.door_open import targets
from skewmi.sim.tasks.door_open.definition import ARM

TASK = "door_open"


@pytest.fixture(scope="module")
def door_robot() -> Iterator[str]:
    """Locator of a simulated robot before a door, in lock-step."""
    with spawn_robot("sim", TASK, "lab", lock_step=True) as locator:
        yield locator


@pytest.mark.parametrize("target", [pytest.param("t1", marks=pytest.mark.slow), "t5"])
def test_scripted_motion_opens_the_door_within_all_limits(
    door_robot: str, tmp_path: Path, target: str
) -> None:
    path = tmp_path / "run.mcap"
    policy = ScriptedDoorOpen(ARM.layout(target=target))
    options = DeployOptions(seed=3, connect=door_robot, lock_step=True, record=path)
    report = run_deploy(policy, options)
    assert report.success_rate == 1.0, report.as_dict()
    assert report.missed_cycles == 0
    assert report.stops == []
    assert report.as_dict()["speed"] == 1.0, "the arm's posture does not let the hand keep up"
    worst = assert_limits_kept(path)
    assert worst["velocity"] > 0.1, "the arm hardly moved: the check above shows nothing"

    messages = read_recording(path).messages
    scene = [decode_joint_states(m.payload) for m in messages[topics.YUMI_SCENE_STATES.name]]
    assert {s.names for s in scene} == {("door_hinge",)}
    door = np.array([s.position[0] for s in scene])
    assert np.abs(door).min() < 1e-3, "the episode did not begin with the door shut"
    assert abs(door[-1] - targets.TARGETS[target]) <= targets.RADIUS


def test_the_robot_serves_every_target_and_no_other_task(door_robot: str) -> None:
    server = describe(door_robot)
    assert server.task == TASK
    expected = {layout.hash() for _, layout in tasks.find(TASK).layouts()}
    assert set(server.layout_hashes) == expected
    policy = ScriptedDoorOpen(ARM.layout())
    policy.layout = tasks.layout("open_press_close")
    with pytest.raises(LayoutMismatchError, match="the robot server has 'door_open'"):
        run_deploy(policy, DeployOptions(connect=door_robot, lock_step=True))
