"""A run that a policy file begins: what it did is learned from, and counts for nobody's success."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tiny_methods import Reinforce, ReinforceConfig
from train_runs import assert_same_checkpoint, assert_same_table

from skewmi.errors import ConfigurationError, LayoutMismatchError, PolicyFileError
from skewmi.policy_io import Array, PolicyLayout
from skewmi.train.checkpoint import read_checkpoint
from skewmi.train.config import TrainConfig
from skewmi.train.log import read_metrics
from skewmi.train.registry import LEARNERS, Entry
from skewmi.train.replay import Episodes
from skewmi.train.run import run_train
from skewmi.train.runner import Runner

BY = "scripted, sha256 0"
ENVS, STEPS = 5, 40


class Scripted:
    """Knows the corridor: up, to the right above the wall, down to where the reward is."""

    def __init__(self, layout: PolicyLayout) -> None:
        self.layout = layout
        self.begun = 0

    def reset(self) -> None:
        self.begun += 1

    def act(self, observation: Array) -> Array:
        x, y = observation[..., 0], observation[..., 1]
        across = np.where(y > 3.1, 1.0, np.where(x > 2.5, np.clip(4.0 * (3.5 - x), -1, 1), 0.0))
        up = np.where(x > 3.0, np.clip(4.0 * (0.5 - y), -1, 1), np.where(y < 3.5, 1.0, 0.0))
        return np.stack((across, up), axis=-1)


def kept(runner: Runner, monkeypatch: pytest.MonkeyPatch) -> list[Episodes]:
    """What the run keeps from now on, as it comes."""
    all_episodes: list[Episodes] = []
    add = runner.history.add

    def spy(episodes: Episodes, term: Array) -> None:
        all_episodes.append(episodes)
        add(episodes, term)

    monkeypatch.setattr(runner.history, "add", spy)
    return all_episodes


@pytest.fixture
def taught(corridor_config: TrainConfig) -> TrainConfig:
    """Two iterations of the teacher, two of the learner."""
    rollout = replace(
        corridor_config.rollout,
        taught_steps=2 * ENVS * STEPS,
        taught_share=0.0,
        noise_probability=0.0,
        evaluation_envs=2,
    )
    return replace(corridor_config, taught_by=BY, rollout=rollout, total_steps=4 * ENVS * STEPS)


def test_teacher_acts_until_its_steps_are_over_and_some_episodes_end_at_random(
    make_corridor, taught, monkeypatch: pytest.MonkeyPatch
) -> None:
    env = make_corridor(ENVS)
    teacher = Scripted(env.layout)
    runner = Runner(taught, env, teacher)
    iterations = kept(runner, monkeypatch)
    for iteration in range(4):
        runner.iterate()
        assert teacher.begun == min(iteration + 1, 2)
        assert (runner.learner.updates > 0) == (iteration >= 1)
    follows = [
        np.abs(actions - teacher.act(observations[:-1])).max(1) < 1e-6
        for one in iterations
        for actions, observations in zip(one.actions, one.observations, strict=True)
    ]
    for k in range(2 * ENVS):
        end = STEPS if follows[k].all() else int(np.argmin(follows[k]))
        assert k % ENVS >= 2 or end == STEPS, "evaluated episodes are the teacher's own"
        assert not follows[k][end:].any(), "what ends at random does not go back to the teacher"
    assert not all(row.all() for row in follows[: 2 * ENVS])
    assert not any(row.all() for row in follows[2 * ENVS :])
    assert sum(one.rewards.any(1).sum() for one in iterations[:2]) >= 4


def test_what_the_teacher_can_do_is_no_convergence(make_corridor, taught) -> None:
    env = make_corridor(ENVS)
    runner = Runner(taught, env, Scripted(env.layout))
    for _ in range(2):
        runner.iterate()
    assert runner.rewarded_episodes >= 4
    assert not runner.convergence.shares
    assert runner.best_score == (0.0, 0.0), "no checkpoint is the best for what its teacher did"
    runner.iterate()
    assert len(runner.convergence.shares) == 2


def test_a_taught_run_resumes_as_if_it_had_not_ended(tmp_path: Path, make_corridor, taught) -> None:
    def run(name: str, steps: int, *, resume: bool = False, with_teacher: bool = True) -> Path:
        env, folder = make_corridor(ENVS), tmp_path / name
        config = replace(taught, total_steps=steps)
        teacher = Scripted(env.layout) if with_teacher else None
        run_train(config, env, folder, resume=resume, teacher=teacher, progress=False)
        return folder

    whole = run("whole", 4 * ENVS * STEPS)
    parts = run("parts", ENVS * STEPS)
    with pytest.raises(ConfigurationError, match=r"taught by scripted.*give the same --teacher"):
        run("parts", 4 * ENVS * STEPS, resume=True, with_teacher=False)
    run("parts", 3 * ENVS * STEPS, resume=True)
    run("parts", 4 * ENVS * STEPS, resume=True, with_teacher=False)
    assert_same_table(whole, parts)
    assert_same_checkpoint(whole, parts)
    assert read_metrics(whole)["rewarded_fraction"][0] >= 0.4
    assert read_checkpoint(whole).state["converged_at"] is None


def test_teacher_hands_episodes_over_until_the_run_has_converged(
    make_corridor, taught, monkeypatch: pytest.MonkeyPatch
) -> None:
    rollout = replace(taught.rollout, taught_steps=ENVS * STEPS, taught_share=1.0)
    env = make_corridor(ENVS)
    teacher = Scripted(env.layout)
    runner = Runner(replace(taught, rollout=rollout), env, teacher)
    iterations = kept(runner, monkeypatch)
    for _ in range(4):
        runner.iterate()
    assert runner.needs_teacher
    until = []
    for one in iterations[1:]:
        for k in range(ENVS):
            theirs = np.abs(one.actions[k] - teacher.act(one.observations[k, :-1])).max(1) < 1e-6
            end = STEPS if theirs.all() else int(np.argmin(theirs))
            assert not theirs[end:].any(), "what was handed over stays so"
            assert k >= 2 or end == 0, "evaluated episodes are the learner's own"
            until += [end] if k >= 2 else []
    assert len(set(until)) >= 4
    assert min(until) < STEPS / 2 < max(until)
    runner.convergence.at = runner.episodes
    assert not runner.needs_teacher
    begun = teacher.begun
    runner.iterate()
    assert teacher.begun == begun


def test_a_teacher_needs_episodes_that_are_evaluated(taught) -> None:
    with pytest.raises(ConfigurationError, match=r"rollout\.evaluation-envs 1"):
        replace(taught, rollout=replace(taught.rollout, evaluation_envs=0))


def test_random_beginning_is_uniform(
    make_corridor, corridor_config, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Uniform from the run's own stream, without the noise that later episodes may end in."""
    rollout = replace(corridor_config.rollout, random_steps=ENVS * STEPS, noise_probability=0.5)
    runner = Runner(replace(corridor_config, rollout=rollout), make_corridor(ENVS))
    iterations = kept(runner, monkeypatch)
    runner.iterate()
    actions = iterations[0].actions
    assert np.abs(actions).max() <= 1.0
    assert np.allclose(np.quantile(actions, (0.25, 0.5, 0.75)), (-0.5, 0.0, 0.5), atol=0.12)


def test_a_run_that_is_taught_needs_its_teacher(tmp_path: Path, make_corridor, taught) -> None:
    with pytest.raises(ConfigurationError, match="give the same --teacher again"):
        run_train(taught, make_corridor(ENVS), tmp_path / "run", progress=False)
    assert not (tmp_path / "run" / "config.json").exists()


def test_teacher_of_another_task_is_refused(tmp_path: Path, make_corridor, taught) -> None:
    other = Scripted(make_corridor(ENVS, field_high=5.0).layout)
    with pytest.raises(LayoutMismatchError, match="teacher"):
        run_train(taught, make_corridor(ENVS), tmp_path / "run", teacher=other, progress=False)
    assert not (tmp_path / "run" / "config.json").exists()


def test_actions_that_are_no_numbers_end_the_run(make_corridor, taught) -> None:
    env = make_corridor(ENVS)
    teacher = Scripted(env.layout)
    teacher.act = lambda observation: np.full((ENVS, 2), np.nan)  # type: ignore[method-assign]
    with pytest.raises(PolicyFileError, match="not finite"):
        Runner(taught, env, teacher).iterate()


def test_learner_that_needs_its_own_actions_has_no_teacher(
    make_corridor, taught, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(LEARNERS, "reinforce", Entry(ReinforceConfig, Reinforce))
    own = replace(taught.rollout, random_steps=0, noise_probability=0.0)
    config = replace(taught, learner=ReinforceConfig(), rollout=own)
    env = make_corridor(ENVS)
    with pytest.raises(ConfigurationError, match="leave out --teacher"):
        Runner(config, env, Scripted(env.layout))
