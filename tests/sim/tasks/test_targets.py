"""The named targets of tasks: what they promise, and that they are those that were drawn."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.sim import tasks
from skewmi.sim.arm.arm_task import ArmTask
from skewmi.sim.tasks.door_open import targets as angles
from skewmi.sim.tasks.door_open.definition import ARM
from skewmi.sim.tasks.point_maze import maze
from skewmi.sim.tasks.point_maze import targets as points
from skewmi.sim.tasks.point_maze.batch import PointMazeBatch
from skewmi.sim.tasks.point_maze.scene import MazeCamera

SCRIPT = Path(__file__).resolve().parents[3] / "docs" / "make_targets_picture.py"
WITH_TARGETS = [name for name in tasks.names() if tasks.find(name).targets]


@pytest.fixture(scope="module")
def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location(SCRIPT.stem, SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_two_tasks_of_the_table_have_five_each() -> None:
    assert {name: len(tasks.find(name).targets) for name in WITH_TARGETS} == {
        "door_open": 5,
        "point_maze": 5,
    }


def test_they_are_those_that_were_drawn_by_lot(script: ModuleType) -> None:
    assert script.drawn_points() == points.TARGETS
    assert script.drawn_angles() == angles.TARGETS


def test_the_published_ones_are_among_them_and_the_default() -> None:
    assert points.TARGETS[points.DEFAULT] == (-4.0, 0.0) == maze.TARGET
    assert angles.TARGETS[angles.DEFAULT] == 1.216
    assert ARM.success == ARM.targets[angles.DEFAULT]


def test_no_region_touches_a_wall_and_none_another(script: ModuleType) -> None:
    centre = np.array(list(points.TARGETS.values()))
    assert script.roomy(centre).all()
    apart = np.linalg.norm(centre[:, None] - centre[None], axis=-1)
    assert apart[~np.eye(5, dtype=bool)].min() > 2 * points.RADIUS
    assert np.diff(script.way_lengths(centre)).min() > 0.0


def test_ways_lead_around_walls(script: ModuleType) -> None:
    # By hand: past the corners (-1, 3), (-3, 3) and (-7, 3) of the two inner walls.
    diagonal = float(np.hypot(1.0, 3.0))
    point = np.array([(0.5, 1.0), (-4.0, 0.0), (-8.0, 0.0), (-2.0, 4.0)])
    ways = (np.hypot(0.5, 1.0), 2 * diagonal + 2.0, 2 * diagonal + 6.0, diagonal + np.sqrt(2.0))
    np.testing.assert_allclose(script.way_lengths(point), ways, rtol=1e-12)


@pytest.mark.parametrize("name", points.TARGETS)
def test_every_target_of_the_maze_can_be_walked_to_and_kept(name: str) -> None:
    env = PointMazeBatch(1, target=name)
    position = env.reset()[0]
    target = np.array(points.TARGETS[name])
    row = 4.0 if target[1] > 0.0 else -4.0
    around = [np.array([0.0, row]), np.array([target[0], row])] if target[0] < -1.0 else []
    route = [*around, target]
    rewards = []
    for _ in range(env.layout.episode_steps):
        if len(route) > 1 and np.abs(position - route[0]).max() < 0.05:
            route.pop(0)
        result = env.step(np.clip((route[0] - position) / maze.STEP_SIZE, -1.0, 1.0)[None])
        position = result.observation[0]
        rewards.append(float(result.reward[0]))
    first = rewards.index(1.0)
    assert first < 150
    assert all(rewards[first:])


def test_pictures_of_the_maze_show_the_target_that_was_chosen() -> None:
    def is_green(target: str | None) -> dict[str, bool]:
        camera = MazeCamera(PointMazeBatch(1, target=target), 365, 365)
        try:
            image = camera.render(0).astype(int)
        except ConfigurationError as error:
            pytest.skip(str(error))
        finally:
            camera.close()
        # 25 pixels a metre, the middle of the maze in the middle.
        places = {
            n: (round(182 - 25 * y), round(182 + 25 * (x + 4.0)))
            for n, (x, y) in points.TARGETS.items()
        }
        return {n: bool(image[p][1] > image[p][[0, 2]].max() + 40) for n, p in places.items()}

    for target in (None, "t2", "t5"):
        shown = is_green(target)
        assert [n for n, green in shown.items() if green] == [target or points.DEFAULT]


@pytest.mark.parametrize("task", WITH_TARGETS)
def test_a_target_changes_the_reward_and_nothing_else(task: str) -> None:
    default = tasks.layout(task)
    assert tasks.layout(task, target=tasks.find(task).targets[0]) == default
    for name in tasks.find(task).targets[1:]:
        layout = tasks.layout(task, target=name)
        assert layout.hash() != default.hash()
        assert (layout.observation, layout.action) == (default.observation, default.action)
        assert layout.workspace == default.workspace
        env = tasks.make_batch(task, 1, num_threads=1, target=name)
        assert env.layout == layout
        state = 0.5 * (layout.observation_low + layout.observation_high)
        for ball in layout.reward_region:
            state[[layout.observation_names.index(field) for field in ball.fields]] = ball.centre
        assert env.compute_reward(state) == 1.0
        assert tasks.make_batch(task, 1, num_threads=1).compute_reward(state) == 0.0


@pytest.mark.parametrize("target", ["t9", "", 3, ["t1"]])
def test_an_unknown_target_is_refused_with_those_that_exist(target: object) -> None:
    for task in WITH_TARGETS:
        with pytest.raises(NotFoundError, match="targets are t1, t2, t3, t4, t5"):
            tasks.make_batch(task, 1, target=target)


def test_a_task_with_one_region_has_no_targets() -> None:
    with pytest.raises(NotFoundError, match="leave it out"):
        tasks.layout("open_press_close", target="t1")


def test_a_task_whose_region_is_none_of_its_targets_is_refused() -> None:
    fields = {name: getattr(ARM, name) for name in ARM.__dataclass_fields__}
    fields["targets"] = {name: ARM.targets[name] for name in ("t1", "t2")}
    with pytest.raises(ConfigurationError, match="none of its targets"):
        ArmTask(**fields)
