"""The policies that come with the package fit the package, and do what they are for."""

from __future__ import annotations

from pathlib import Path

import pytest

from skewmi import policies
from skewmi.deploy.policy import OnnxPolicy
from skewmi.errors import PolicyFileError
from skewmi.evaluation.rollout import run_episodes, summarise
from skewmi.robot_models import yumi
from skewmi.sim import tasks

NAMES = sorted(policies.bundled())


def test_the_task_of_the_readme_has_a_policy() -> None:
    assert "open_press_close" in NAMES


@pytest.mark.parametrize("name", NAMES)
def test_bundled_policy_was_made_for_this_robot_and_layout(name: str) -> None:
    policy = OnnxPolicy.load(name)
    assert policy.metadata["robot_model_hash"] == yumi.MODEL_HASH
    assert policy.layout.hash() == tasks.layout(policy.layout.task, time_input=True).hash()


@pytest.mark.parametrize("name", NAMES)
def test_bundled_policy_solves_its_task_from_random_starts(name: str) -> None:
    policy = OnnxPolicy.load(name)
    env = tasks.make_batch(policy.layout.task, 30, seed=5, time_input=True)
    figures = summarise(run_episodes(policy, env, 30, 5))
    # The seed is fixed, so the figure is the same in every run; see results/ for large samples.
    assert figures["successes"] >= 27


def test_a_file_goes_before_a_bundled_policy_of_the_same_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("open_press_close").write_bytes(b"not a policy")
    with pytest.raises(PolicyFileError):
        OnnxPolicy.load("open_press_close")
