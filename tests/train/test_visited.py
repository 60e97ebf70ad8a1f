"""Visited states have the numbers of their trajectories, also where the history holds the last."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from skewmi.errors import CheckpointError
from skewmi.policy_io import PolicyLayout
from skewmi.sweep.places import RESULT
from skewmi.sweep.plan import Plan, make_plan
from skewmi.sweep.results import MOST_STATES, collect
from skewmi.sweep.sweep_file import parse_sweep
from skewmi.train import visited
from skewmi.train.checkpoint import write_checkpoint, write_run_header
from skewmi.train.config import TrainConfig
from skewmi.train.history import visited_states
from skewmi.train.presets import default_preset
from skewmi.train.replay import Episodes, Replay
from skewmi.train.visited import visited_trajectories

CAPACITY = 20
"""Episodes that a run holds."""


def start(task: str, preset: str) -> TrainConfig:
    return replace(default_preset(task), preset=preset)


@pytest.fixture
def plan(layout: PolicyLayout) -> Plan:
    steps = CAPACITY * layout.episode_steps
    text = f"set: {{rollout.history_steps: {steps}}}\ngroups:\n"
    text += "  g: {tasks: [point_maze], configurations: [a], keep_states: true}"
    return make_plan(parse_sweep(text, "f"), start)


def write_run(runs: Path, plan: Plan, layout: PolicyLayout, count: int) -> Path:
    """A run of so many trajectories, each of which stood where its number says."""
    (run,) = plan.runs
    history = Replay(layout, run.config.rollout.history_steps, goal_dim=2)
    steps = layout.episode_steps
    for number in range(1, count + 1):
        observations = np.full((1, steps + 1, layout.observation_dim), float(number))
        actions = np.zeros((1, steps, layout.action_dim))
        episode = Episodes(observations, actions, np.zeros((1, steps, 2)), np.zeros((1, steps)))
        history.add(episode, np.zeros((1, steps)))
    write_run_header(runs / run.name, run.config, layout)
    state = {"evaluation_goal": torch.zeros(2), "episodes": count, "discoveries": {}}
    write_checkpoint(runs / run.name, count * steps, state, history)
    return runs / run.name


COUNTS = pytest.mark.parametrize("count", [1, CAPACITY - 1, CAPACITY, CAPACITY + 1, 50])


@COUNTS
def test_every_state_has_the_number_of_its_trajectory(
    tmp_path: Path, plan: Plan, layout: PolicyLayout, count: int
) -> None:
    states, numbers = visited_trajectories(write_run(tmp_path, plan, layout, count))
    assert states.shape == (min(count, CAPACITY), layout.episode_steps + 1, layout.state_dim)
    assert numbers.tolist() == list(range(max(1, count - CAPACITY + 1), count + 1))
    np.testing.assert_array_equal(states, np.broadcast_to(numbers[:, None, None], states.shape))


@COUNTS
@pytest.mark.parametrize("done", [False, True])
def test_the_table_of_states_has_them_too(
    tmp_path: Path, plan: Plan, layout: PolicyLayout, count: int, done: bool
) -> None:
    run_dir = write_run(tmp_path, plan, layout, count)
    if done:
        (run_dir / RESULT).write_text(f'{{"trajectories": {count}}}')
    first, again = (collect(plan, tmp_path, {}).states for _ in range(2))
    assert first == again
    assert len(first["trajectory"]) <= MOST_STATES
    assert first["trajectory"][0] == max(1, count - CAPACITY + 1)
    assert first["trajectory"][-1] == count
    assert first["x"] == first["trajectory"]


def test_states_that_were_kept_with_other_numbers_are_read_again(
    tmp_path: Path, plan: Plan, layout: PolicyLayout
) -> None:
    """Beside runs that earlier releases collected they are numbered from 1, always."""
    run_dir = write_run(tmp_path, plan, layout, 50)
    (run_dir / RESULT).write_text('{"trajectories": 50}')
    right = collect(plan, tmp_path, {}).states
    with np.load(run_dir / "states.npz") as file:
        kept = dict(file)
    np.savez(run_dir / "states.npz", **{**kept, "trajectory": kept["trajectory"] - 30})
    assert collect(plan, tmp_path, {}).states == right
    # What is right is not read again.
    (run_dir / "config.json").unlink()
    assert collect(plan, tmp_path, {}).states == right


def test_numbers_fit_the_states_while_the_run_goes_on(
    tmp_path: Path, plan: Plan, layout: PolicyLayout, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its next checkpoint may come between two readings."""
    read = visited_states
    counts = iter([40, 60])

    def read_and_go_on(run_dir: Path) -> object:
        found = read(run_dir)
        for count in counts:
            write_run(tmp_path, plan, layout, count)
            break
        return found

    run_dir = write_run(tmp_path, plan, layout, 30)
    monkeypatch.setattr(visited, "visited_states", read_and_go_on)
    states, numbers = visited_trajectories(run_dir)
    assert numbers[-1] == 60
    np.testing.assert_array_equal(states[:, 0, 0], numbers)


def test_a_run_that_is_always_ahead_is_told(
    tmp_path: Path, plan: Plan, layout: PolicyLayout, monkeypatch: pytest.MonkeyPatch
) -> None:
    def ever_more() -> Iterator[int]:
        yield from range(1000)

    counts = ever_more()
    monkeypatch.setattr(visited, "_made", lambda run_dir: next(counts))
    with pytest.raises(CheckpointError, match="goes on faster than"):
        visited_trajectories(write_run(tmp_path, plan, layout, 30))
