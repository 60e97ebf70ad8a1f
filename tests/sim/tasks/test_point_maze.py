"""The maze: its arithmetic against MuJoCo's contacts, its geometry against the paper's figures."""

from __future__ import annotations

import hypothesis.extra.numpy as numpy_strategies
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.errors import ConfigurationError
from skewmi.policy_io import Array
from skewmi.sim.tasks.point_maze import maze
from skewmi.sim.tasks.point_maze.batch import PointMazeBatch
from skewmi.sim.tasks.point_maze.scene import POINT_RADIUS, MazePicture, build_scene

points = numpy_strategies.arrays(np.float64, (2,), elements=st.floats(-14.0, 14.0, allow_nan=False))
actions = numpy_strategies.arrays(np.float64, (2,), elements=st.floats(-1.5, 1.5, allow_nan=False))


def free_points(count: int, seed: int) -> Array:
    generator = np.random.default_rng(seed)
    candidates = generator.uniform((-9.0, -5.0), (1.0, 5.0), (4 * count, 2))
    return candidates[maze.is_free(candidates)][:count]


@pytest.fixture(scope="module")
def scene() -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = build_scene().compile()
    return model, mujoco.MjData(model)


def test_walls_agree_with_contacts_of_mujoco(
    scene: tuple[mujoco.MjModel, mujoco.MjData],
) -> None:
    model, data = scene
    generator = np.random.default_rng(0)
    uniform = generator.uniform((-11.0, -7.0), (3.0, 7.0), (3000, 2))
    # Half of the points close to a grid line, on either side, where mistakes would be.
    near = np.round(generator.uniform((-10.0, -6.0), (2.0, 6.0), (3000, 2)))
    near += generator.choice([-1.0, 1.0], (3000, 2)) * generator.uniform(
        2 * POINT_RADIUS, 1e-3, (3000, 2)
    )
    positions = np.concatenate([uniform, near])
    touching = np.empty(len(positions), dtype=bool)
    for index, position in enumerate(positions):
        data.qpos[:] = position
        mujoco.mj_fwdPosition(model, data)
        touching[index] = data.ncon > 0
    np.testing.assert_array_equal(~maze.is_free(positions), touching)
    assert 0.2 < touching.mean() < 0.8


@given(position=points)
def test_free_area_is_mirrored_in_y(position: Array) -> None:
    assert maze.is_free(position) == maze.is_free(position * [1.0, -1.0])


@given(x=st.floats(-14.0, 14.0), y=st.floats(-14.0, 14.0))
def test_free_points_lie_in_a_free_cell(x: float, y: float) -> None:
    if maze.is_free(np.array([x, y])):
        # Free points on a line between cells may round into either: both are free.
        row, column = round(y / maze.CELL_SIZE) + 3, round(x / maze.CELL_SIZE) + 5
        assert maze.FREE_CELLS[row, column]


@given(action=actions, seed=st.integers(0, 2**16))
def test_a_step_is_taken_or_undone_and_never_ends_in_a_wall(action: Array, seed: int) -> None:
    before = free_points(20, seed)
    after = maze.move(before, np.broadcast_to(action, before.shape))
    assert maze.is_free(after).all()
    proposed = before + maze.STEP_SIZE * np.clip(action, -1.0, 1.0)
    free = maze.is_free(proposed)
    np.testing.assert_array_equal(after[free], proposed[free])
    np.testing.assert_array_equal(after[~free], before[~free])


def test_touching_a_wall_undoes_both_axes_of_the_step() -> None:
    start = np.array([0.95, 0.0])
    np.testing.assert_array_equal(maze.move(start, np.array([1.0, 1.0])), start)
    np.testing.assert_allclose(maze.move(start, np.array([0.0, 1.0])), [0.95, 0.12])


@pytest.mark.parametrize(
    ("position", "free"),
    [
        ((0.0, 0.0), True),
        ((1.0, 0.0), False),
        ((np.nextafter(1.0, 0.0), 0.0), True),
        ((-2.0, 0.0), False),
        ((-4.0, 0.0), True),
        ((-3.0, 0.0), False),  # on the wall's face
        ((-2.0, 3.0), False),
        ((-2.0, np.nextafter(3.0, 4.0)), True),
        ((-4.0, 3.0), True),  # on a line between free cells
        ((-3.0, 3.0), False),  # on the corner of a wall
        ((-8.0, -4.0), True),
        ((40.0, 0.0), False),
        ((np.nan, 0.0), False),
        ((0.0, np.inf), False),
    ],
)
def test_free_and_wall_by_hand(position: tuple[float, float], free: bool) -> None:
    assert maze.is_free(np.array(position)) == free


def test_wall_rectangles_are_the_walls_once() -> None:
    rectangles = maze.wall_rectangles()
    sizes = rectangles[:, 2:] - rectangles[:, :2]
    assert np.prod(sizes, axis=1).sum() == pytest.approx((49 - 19) * maze.CELL_SIZE**2)
    generator = np.random.default_rng(1)
    positions = generator.uniform((-11.0, -7.0), (3.0, 7.0), (5000, 2))
    inside = (positions[:, None] >= rectangles[:, :2]) & (positions[:, None] <= rectangles[:, 2:])
    count = inside.all(axis=-1).sum(axis=1)
    np.testing.assert_array_equal(count, ~maze.is_free(positions))


def test_geometry_gives_the_ceilings_of_the_published_metrics() -> None:
    # Entropy and coverage of a policy that has been everywhere, on the authors' 50x50 grid.
    low, high = maze.layout().observation_low, maze.layout().observation_high
    grid_x, grid_y = (np.linspace(low[axis], high[axis], 50) for axis in range(2))
    spacing = 0.04
    x, y = np.meshgrid(
        np.arange(-9.0, 1.0, spacing) + spacing / 2, np.arange(-5.0, 5.0, spacing) + spacing / 2
    )
    visited = np.stack([x.ravel(), y.ravel()], axis=-1)
    visited = visited[maze.is_free(visited)]
    log_norm = np.log(2.0 * np.pi * 0.1**2)
    density, nearest = np.empty((50, 50)), np.empty((50, 50))
    for row in range(50):
        for column in range(50):
            squares = (visited[:, 0] - grid_x[column]) ** 2 + (visited[:, 1] - grid_y[row]) ** 2
            density[row, column] = np.exp(-squares / 0.02 - log_norm).mean()
            nearest[row, column] = squares.min()
    positive = density[density > 0.0]
    assert -(positive * np.log(positive)).sum() == pytest.approx(55.1, abs=0.05)
    # Nearest distances on a finite lattice are up to half a diagonal long: remove that.
    distance = np.maximum(np.sqrt(nearest) - spacing / 2, 0.0)
    assert np.exp(-(distance**2) / 0.02).mean() == pytest.approx(0.427, abs=0.006)


def test_every_free_point_is_reached_by_walking() -> None:
    # Flood the cells with steps of the environment itself, starting at the origin.
    reached = {maze.START_CELL}
    frontier = [np.zeros(2)]
    while frontier:
        centre = frontier.pop()
        for direction in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)):
            position = centre
            for _ in range(round(maze.CELL_SIZE / maze.STEP_SIZE) + 1):
                position = maze.move(position, np.array(direction))
            column, row = np.round(position / maze.CELL_SIZE).astype(int) + np.array([5, 3])
            if (row, column) not in reached:
                reached.add((row, column))
                frontier.append(np.array([column - 5, row - 3]) * maze.CELL_SIZE)
    assert reached == {tuple(cell) for cell in np.argwhere(maze.FREE_CELLS)}


def test_reward_is_paid_within_the_radius_of_the_target() -> None:
    env = PointMazeBatch(1)
    angle = np.linspace(0.0, 2.0 * np.pi, 40)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    target = np.array([-4.0, 0.0])
    assert env.compute_reward(target + 0.1499 * ring).tolist() == [1.0] * 40
    assert env.compute_reward(target + 0.1501 * ring).tolist() == [0.0] * 40


def test_a_walk_to_the_target_is_paid_in_time() -> None:
    env = PointMazeBatch(2, time_input=True)
    observation = env.reset()
    route = [(0.0, 4.0), (-4.0, 4.0), (-4.0, 0.0)]
    rewards = np.zeros((env.layout.episode_steps, 2))
    for step in range(env.layout.episode_steps):
        if len(route) > 1 and np.abs(observation[0, :2] - route[0]).max() < 0.05:
            route.pop(0)
        action = np.clip((np.array(route[0]) - observation[:, :2]) / maze.STEP_SIZE, -1.0, 1.0)
        action[1] = 0.0  # the second point stays
        result = env.step(action)
        observation, rewards[step] = result.observation, result.reward
        assert observation[0, 2] == (step + 1) / env.layout.episode_steps
    first = int(np.argmax(rewards[:, 0]))
    assert 90 <= first <= 110  # 12 m at 0.12 m a step
    assert rewards[first:, 0].all()
    assert not rewards[:, 1].any()
    assert result.truncated


@pytest.mark.parametrize("noise", [-0.1, 1.0, float("nan")])
def test_start_noise_outside_the_start_cell_is_refused(noise: float) -> None:
    with pytest.raises(ConfigurationError, match="start_noise"):
        PointMazeBatch(1, start_noise=noise)


@settings(max_examples=20)
@given(noise=st.floats(0.0, 0.99), seed=st.integers(0, 2**32))
def test_noisy_starts_are_free_and_within_the_noise(noise: float, seed: int) -> None:
    start = PointMazeBatch(50, start_noise=noise).reset(seed)
    assert (np.abs(start) <= noise).all()
    assert maze.is_free(start).all()


def test_picture_shows_walls_point_and_trail() -> None:
    picture = MazePicture(73, 73)  # 5 pixels a metre: cells are 10 pixels wide
    try:
        without = picture.render(np.array([0.0, 0.0])).astype(int)
        image = picture.render(np.array([-8.0, 4.0]), np.array([[-4.0, 4.0], [-4.0, 3.9]]))
    finally:
        picture.close()
    image = image.astype(int)

    def pixel(x: float, y: float) -> tuple[int, int]:
        return round(36 - 5 * y), round(36 + 5 * (x + 4.0))

    assert image.shape == (73, 73, 3)
    assert image[pixel(-2.0, 0.0)].max() < 190 < image[pixel(0.0, -4.0)].min()  # wall, floor
    red, green, _ = image[pixel(-8.0, 4.0)]
    assert red > green + 60
    assert without[pixel(-8.0, 4.0)].min() > 190
    changed = np.abs(image - without).sum(axis=-1) > 30
    assert changed[pixel(-4.0, 4.0)] or changed[pixel(-4.0, 3.9)]
    assert not changed[pixel(-6.0, 0.0)]
