"""Configurations: presets, and JSON that takes nothing it does not know."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from types import ModuleType
from typing import Any

import pytest

from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.train.config import TrainConfig
from skewmi.train.config_json import from_document, to_document
from skewmi.train.presets import PRESETS, default_preset, names, preset
from skewmi.train.sac.config import SacConfig


@pytest.mark.parametrize("config", [*PRESETS.values(), default_preset("anything")])
def test_configurations_survive_json(config: TrainConfig) -> None:
    assert from_document(json.loads(json.dumps(to_document(config)))) == config


def changed(document: dict[str, Any], path: str, value: object) -> dict[str, Any]:
    document = json.loads(json.dumps(document))
    place, *inner = document, *path.split(".")
    for name in inner[:-1]:
        place = place[name]
    place[inner[-1]] = value
    return document


@pytest.mark.parametrize(
    ("path", "value", "says"),
    [
        ("sead", 1, r"extra fields found \(sead\)"),
        ("learner.n_steps", 1, r"extra fields found \(n_steps\) @ \$.learner"),
        ("seed", "1", "'1' is not of type int"),
        ("seed", 1.0, "1.0 is not of type int"),
        ("seed", True, "True is not of type int"),
        ("learner.layer_norm", 1, "1 is not of type bool"),
        ("learner.discount", "high", r"'high' is not of type float @ \$.learner.discount"),
        ("learner.hidden", [32, "64"], r"'64' is not of type int @ \$.learner.hidden\[1\]"),
        ("learner.name", "unheard-of", "there are sac"),
        ("learner", None, "there are sac"),
        ("exploration", {}, "there are skew-explore"),
        ("exploration.trajectory_density", "half", "half not in"),
        ("task_options", [["a", [1]]], r"task_options\[0\]"),
        ("rollout", 3, "expected RolloutConfig"),
        ("learner.n_step", 0, "n_step is 0, needs at least 1"),
        ("rollout.evaluation_envs", 99, "must be below num_envs"),
    ],
)
def test_json_is_taken_strictly(path: str, value: object, says: str) -> None:
    document = to_document(default_preset("t"))
    with pytest.raises(ConfigurationError, match=says):
        from_document(changed(document, path, value))


def test_all_mistakes_are_listed() -> None:
    document = changed(to_document(default_preset("t")), "seed", "x")
    with pytest.raises(ConfigurationError) as error:
        from_document(changed(document, "learner.n_step", "y"))
    assert "$.seed" in str(error.value)
    assert "$.learner.n_step" in str(error.value)


def test_whole_numbers_are_numbers() -> None:
    document = changed(to_document(default_preset("t")), "minutes", 3)
    assert isinstance(from_document(document).minutes, float)


@pytest.mark.parametrize("document", [[], None, "x"])
def test_what_is_no_object_is_refused(document: object) -> None:
    with pytest.raises(ConfigurationError, match="is an object"):
        from_document(document)


def test_unknown_preset_lists_those_there_are() -> None:
    with pytest.raises(NotFoundError, match="point_maze/paper, point_maze/improved"):
        preset("point_maze", "best")


def test_a_task_without_presets_starts_from_the_defaults() -> None:
    assert names("new_task") == ("improved",)
    assert preset("new_task") == default_preset("new_task")
    with pytest.raises(NotFoundError, match="new_task/improved"):
        preset("new_task", "paper")


MINE = replace(default_preset("new_task"), preset="mine")
"""A preset that a task brings from its own package."""


def test_a_task_may_bring_presets(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("new_task_presets")
    module.MINE, module.OTHER = MINE, 3  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    elsewhere = {"mine": "new_task_presets:MINE", "bad": "new_task_presets:OTHER"}
    assert preset("new_task", "mine", elsewhere) is MINE
    with pytest.raises(NotFoundError, match="new_task/mine, new_task/bad"):
        preset("new_task", "improved", elsewhere)
    with pytest.raises(ConfigurationError, match="no training configuration of task 'new_task'"):
        preset("new_task", "bad", elsewhere)
    with pytest.raises(ConfigurationError, match="no training configuration of task 'another'"):
        preset("another", "mine", elsewhere)
    with pytest.raises(ConfigurationError, match="nowhere"):
        preset("new_task", "lost", {"lost": "nowhere:MINE"})
    # What this package has is not replaced.
    maze = preset("point_maze")
    assert preset("point_maze", "improved", {"improved": "new_task_presets:MINE"}) is maze


@pytest.mark.parametrize("task", sorted({task for task, name in PRESETS if name == "paper"}))
def test_the_reduced_budget_is_the_paper_with_an_eighth_of_the_gradient_samples(task: str) -> None:
    """All else is equal, in all five configurations."""
    for ending in ("", "-skew-fit", "-ppo", "-ppo-skew-fit", "-ppo-rnd"):
        paper, reduced = preset(task, f"paper{ending}"), preset(task, f"paper-reduced{ending}")
        if isinstance(paper.learner, SacConfig):
            assert isinstance(reduced.learner, SacConfig)
            assert reduced.learner.updates_per_step == paper.learner.updates_per_step
            assert 8 * reduced.learner.batch_size == paper.learner.batch_size
            learner = replace(reduced.learner, batch_size=paper.learner.batch_size)
            rollout = replace(reduced.rollout, num_envs=paper.rollout.num_envs)
            reduced = replace(reduced, learner=learner, rollout=rollout)
        assert replace(reduced, preset=paper.preset) == paper
