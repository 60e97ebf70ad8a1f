"""Who follows a run's directory sees every row and every episode once, however often he looks."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from skewmi.sim import tasks
from skewmi.train import run
from skewmi.train.config import TrainConfig
from skewmi.train.follow import MOST_EPISODES, News, RunFollower
from skewmi.train.history import pursued_goals, visited_states
from skewmi.train.log import read_metrics
from skewmi.train.presets import preset

ENVS = 3


def config(steps: int) -> TrainConfig:
    """Of a few episodes of the maze, with goals from the first on."""
    base = preset("point_maze")
    exploration = replace(base.exploration, first_refresh_steps=600, refresh_steps=600)
    rollout = replace(base.rollout, num_envs=ENVS, evaluation_envs=1, random_steps=10**6)
    return replace(base, total_steps=steps, exploration=exploration, rollout=rollout)


def train(run_dir: Path, steps: int, *, resume: bool = False) -> None:
    chosen = config(steps)
    env = tasks.make_batch("point_maze", ENVS, seed=0, **dict(chosen.task_options))
    run.run_train(chosen, env, run_dir, resume=resume, progress=False)


@pytest.fixture(scope="module")
def looked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[News]]:
    """A run that was looked at before it began, after each part of it, and once more."""
    run_dir = tmp_path_factory.mktemp("runs") / "maze"
    follower = RunFollower(run_dir)
    assert follower.look() is None
    assert follower.facts() is None
    news = []
    for steps in (600, 1800, 2400):
        train(run_dir, steps, resume=steps > 600)
        news += [follower.look(), follower.look()]
    found = [one for one in news if one is not None]
    assert len(found) == 6
    return run_dir, found


def test_looks_add_up_to_the_run(looked: tuple[Path, list[News]]) -> None:
    run_dir, news = looked
    assert all(one.nothing for one in news[1::2])
    states, rewards = visited_states(run_dir)
    np.testing.assert_array_equal(np.concatenate([n.states for n in news]), states)
    np.testing.assert_array_equal(np.concatenate([n.rewards for n in news]), rewards)
    beside, goals = pursued_goals(run_dir)
    np.testing.assert_array_equal(beside, states)
    assert goals.shape == (*rewards.shape, 2)
    episodes = np.concatenate([n.episodes for n in news])
    np.testing.assert_array_equal(episodes, np.arange(len(states)))
    table = read_metrics(run_dir)
    for name in ("step", "trajectories", "covered_cells", "entropy"):
        rows = np.concatenate([n.rows[name] for n in news if n.rows])
        np.testing.assert_array_equal(rows, table[name])


def test_goals_are_those_of_the_checkpoint(looked: tuple[Path, list[News]]) -> None:
    run_dir, news = looked
    from skewmi.train.checkpoint import read_checkpoint

    proposals = [one.proposals for one in news if one.proposals is not None]
    kept = read_checkpoint(run_dir).state["exploration"]["proposals"]
    np.testing.assert_allclose(proposals[-1], kept.numpy())
    assert len(proposals) >= 2


def test_facts_are_the_configurations(looked: tuple[Path, list[News]]) -> None:
    facts = RunFollower(looked[0]).facts()
    assert facts is not None
    assert facts.layout.task == "point_maze"
    assert facts.convergence_fraction == config(600).metrics.convergence_fraction


def test_a_later_look_sees_the_whole_past_at_once(looked: tuple[Path, list[News]]) -> None:
    news = RunFollower(looked[0]).look()
    assert news is not None
    assert len(news.episodes) == min(MOST_EPISODES, 12)


def test_what_is_being_replaced_or_damaged_is_left_for_the_next_look(
    looked: tuple[Path, list[News]], tmp_path: Path
) -> None:
    run_dir = tmp_path / "run"
    shutil.copytree(looked[0], run_dir)
    latest = sorted(p for p in (run_dir / "checkpoints").iterdir() if p.name.isdigit())[-1]
    follower = RunFollower(run_dir)
    for file in sorted(latest.rglob("*.*")):
        content = file.read_bytes()
        for damaged in (b"", content[:-20]):
            file.write_bytes(damaged)
            news = follower.look()
            assert news is not None
            assert not len(news.episodes), file
        file.write_bytes(content)
    news = follower.look()
    assert news is not None
    assert len(news.episodes) == 12
    (run_dir / "config.json").write_text(json.dumps({"config": {}}))
    assert RunFollower(run_dir).look() is None


def test_following_loads_no_tensor_library() -> None:
    code = "import sys, skewmi.train.follow, skewmi.evaluation.training_view\nprint(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert not {"torch", "mujoco", "zenoh"} & set(loaded.stdout.split())
