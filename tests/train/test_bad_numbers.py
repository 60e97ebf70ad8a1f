"""Numbers that mean nothing are refused when a configuration is made, whoever makes it."""

from __future__ import annotations

import dataclasses
import math
import typing
from typing import Any

import pytest

from skewmi.errors import ConfigurationError
from skewmi.train.config import MetricsConfig, RolloutConfig, TrainConfig
from skewmi.train.exploration.return_then_explore import ReturnThenExploreConfig
from skewmi.train.exploration.rnd import RndConfig
from skewmi.train.exploration.skew_explore import SkewExploreConfig
from skewmi.train.exploration.skew_fit import SkewFitConfig
from skewmi.train.ppo.config import PpoConfig
from skewmi.train.presets import default_preset
from skewmi.train.registry import EXPLORATIONS, LEARNERS
from skewmi.train.sac.config import SacConfig

CONFIGS: list[Any] = [
    default_preset("t"),
    RolloutConfig(),
    MetricsConfig(),
    *(entry.config() for entry in (*LEARNERS.values(), *EXPLORATIONS.values())),
]
"""One of every kind."""


def with_number(hint: Any, number: float) -> Any:
    """A value like those of a field, but that all its numbers are this one; None: it has none."""
    kinds = {hint, *typing.get_args(hint)}
    if int in kinds or float in kinds:
        return (number, number) if typing.get_origin(hint) is tuple else number
    if typing.get_origin(hint) is tuple and typing.get_origin(typing.get_args(hint)[0]) is tuple:
        return (("x", number),)
    return None


CASES = [
    (config, field.name, value)
    for config in CONFIGS
    for field in dataclasses.fields(config)
    for number in (math.nan, math.inf, -math.inf)
    if (value := with_number(typing.get_type_hints(type(config))[field.name], number)) is not None
]


def test_numbers_of_every_kind_are_looked_at() -> None:
    looked_at = {(type(config), name) for config, name, _ in CASES}
    assert {
        (TrainConfig, "minutes"), (TrainConfig, "task_options"), (RolloutConfig, "num_envs"),
        (MetricsConfig, "entropy_bandwidth"), (SacConfig, "hidden"), (PpoConfig, "heads"),
        (SkewExploreConfig, "goal_clip"), (SkewFitConfig, "intrinsic"), (RndConfig, "predictor"),
        (ReturnThenExploreConfig, "field_weights"),
    } <= looked_at  # fmt: skip


@pytest.mark.parametrize(
    ("config", "name", "value"), CASES, ids=lambda v: type(v).__name__ if v in CONFIGS else str(v)
)
def test_no_number_is_without_end_or_no_number(config: Any, name: str, value: Any) -> None:
    with pytest.raises(ConfigurationError, match=f"{name} is .*must be finite"):
        dataclasses.replace(config, **{name: value})


GOALS = [
    ("history_points", 0), ("candidates", 0), ("proposals", 0), ("history_bandwidth", 0.0),
    ("scale_floor", -0.1), ("self_count", -1.0), ("refresh_steps", -1),
    ("first_refresh_steps", -1), ("rewarded_goal_per_success", -0.1), ("rewarded_goal_max", 1.1),
    ("switch_probability", 2.0), ("field_weights", (("x", 0.0),)),
    ("field_weights", (("x", 1.0), ("y", -1.0))),
]  # fmt: skip
BAD: dict[type[Any], list[tuple[str, Any]]] = {
    TrainConfig: [
        ("checkpoint_every", 0), ("threads", 0), ("total_steps", 0), ("seed", -1),
        ("minutes", -1.0),
    ],
    RolloutConfig: [
        ("num_envs", 0), ("evaluation_envs", -1), ("evaluation_envs", 25), ("random_steps", -1),
        ("taught_steps", 0), ("history_steps", 0), ("noise_correlation", 2.0),
        ("noise_correlation", -1.1), ("noise_probability", 1.1), ("taught_share", -0.1),
        ("taught_noise_probability", 2.0), ("evaluation_share", 1.0), ("evaluation_from", -1.0),
    ],
    MetricsConfig: [
        ("entropy_points", 0), ("entropy_bandwidth", 0.0), ("coverage_width", 0.0),
        ("every_steps", -1), ("convergence_trajectories", 0), ("convergence_tolerance", 0.0),
        ("convergence_fraction", 0.0), ("convergence_fraction", 1.1),
    ],
    SacConfig: [
        ("learning_rate", -1.0), ("learning_rate", 0.0), ("updates_per_step", -1.0),
        ("burst_updates_per_step", -1.0), ("log_std_min", 3.0), ("log_std_max", -6.0),
        ("polyak", 0.0), ("polyak", 1.1), ("discount", 1.0), ("batch_size", 0), ("n_step", 0),
        ("hidden", ()), ("hidden", (0,)), ("initial_temperature", 0.0), ("actor_average", 1.0),
        ("future_fraction", 0.8), ("rare_fraction", -0.1), ("burst_rewarded_fraction", 0.8),
    ],
    PpoConfig: [
        ("learning_rate", 0.0), ("value_weight", -0.1), ("memory", -1), ("heads", (0,)),
        ("clip", 0.0), ("value_clip", 0.0), ("max_gradient_norm", 0.0), ("trace_decay", 1.1),
        ("epochs", 0), ("minibatches", 0), ("steps_per_update", 0), ("sequence_length", 0),
    ],
    SkewFitConfig: GOALS,
    SkewExploreConfig: [*GOALS, ("sigma", 0.0), ("trajectory_bandwidth", -0.1)],
    ReturnThenExploreConfig: [
        *GOALS, ("arrival_radius", 0.0), ("stall_distance", 0.0), ("go_steps", 0),
        ("stall_steps", -1), ("explore_steps", -1), ("nearest_of", 0),
        ("revisit_probability", 1.1), ("keep_probability", -0.1),
    ],
    RndConfig: [
        ("learning_rate", 0.0), ("state_clip", 0.0), ("epochs", -1), ("batch_size", 0),
        ("features", 0), ("bonus_discount", 1.0), ("predictor", ()),
    ],
}  # fmt: skip


def test_every_kind_has_bad_numbers() -> None:
    assert BAD.keys() == {type(config) for config in CONFIGS}


@pytest.mark.parametrize(
    ("config", "name", "value"),
    [(config, *bad) for config in CONFIGS for bad in BAD[type(config)]],
    ids=lambda v: type(v).__name__ if v in CONFIGS else str(v),
)
def test_numbers_that_mean_nothing_are_named(config: Any, name: str, value: Any) -> None:
    with pytest.raises(ConfigurationError, match=name) as error:
        dataclasses.replace(config, **{name: value})
    given = dict(value) if name == "field_weights" else value
    assert str(given) in str(error.value)


@pytest.mark.parametrize(
    ("config", "changes"),
    [
        (RolloutConfig(), {"noise_correlation": 1.0, "random_steps": 0, "evaluation_envs": 0}),
        (MetricsConfig(), {"every_steps": 0, "convergence_fraction": 1.0}),
        (SacConfig(), {"updates_per_step": 0.0, "polyak": 1.0, "log_std_min": 2.0}),
        (SkewExploreConfig(), {"self_count": 0.0, "scale_floor": 0.0, "refresh_steps": 0}),
        (PpoConfig(), {"entropy_weight": -0.1, "value_weight": 0.0, "memory": 0}),
    ],
)
def test_bounds_are_allowed(config: Any, changes: dict[str, Any]) -> None:
    dataclasses.replace(config, **changes)
