"""Variation files: what is read, what is refused, what is drawn."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.sim import tasks
from skewmi.sim.arm.arm_task import ARM_VARIATIONS
from skewmi.sim.tasks.open_press_close.definition import ARM
from skewmi.sim.variation import NOMINAL, ModelVariation

VARIATIONS = ARM.variations
KEYS = {key.name: key for key in VARIATIONS.keys}


def _values(key: str) -> st.SearchStrategy:
    spec = KEYS[key]
    number = st.floats(spec.low, spec.high)
    one = number | st.tuples(number, number).map(sorted)
    return one | st.lists(one, min_size=7, max_size=7) if spec.size == 7 else one


@st.composite
def _variations(draw: st.DrawFn) -> ModelVariation:
    content: dict = {"seed": draw(st.integers(0, 9))}
    drawn = draw(st.sets(st.sampled_from(list(KEYS))))
    for key in drawn - {KEYS[name].excludes for name in drawn}:
        section, _, name = key.partition(".")
        content.setdefault(section, {})[name] = draw(_values(key))
    return VARIATIONS.parse(str(content))


@given(_variations())
def test_json_reads_back_as_the_same_variation(variation: ModelVariation) -> None:
    assert VARIATIONS.parse(variation.to_json()) == variation
    assert VARIATIONS.resolve(variation.to_json()) == variation


@given(_variations(), st.integers(0, 2**32 - 1))
def test_samples_lie_in_their_ranges_and_depend_on_the_seed_alone(
    variation: ModelVariation, seed: int
) -> None:
    sample = variation.sample(np.random.default_rng(seed), 5)
    again = variation.sample(np.random.default_rng(seed), 5)
    assert list(sample.values) == [key.name for key, _ in variation.ranges]
    for key, pairs in variation.ranges:
        low, high = np.array(pairs).T
        drawn = sample.values[key.name]
        assert drawn.shape == ((5,) if key.size == 1 else (5, 7))
        assert np.all(drawn >= low)
        assert np.all(drawn <= high)
        np.testing.assert_array_equal(drawn, again.values[key.name])


def test_a_range_fills_its_width_and_differs_between_simulations_and_joints() -> None:
    variation = VARIATIONS.parse("{servo: {kp_scale: [0.5, 1.5]}, lid: {mass: 0.2}}")
    sample = variation.sample(np.random.default_rng(0), 400)
    scale = sample.values["servo.kp_scale"]
    assert len(np.unique(scale)) == 2800
    assert scale.mean() == pytest.approx(1.0, abs=0.02)
    assert scale.std() == pytest.approx(1.0 / np.sqrt(12), abs=0.02)
    assert np.all(sample.values["lid.mass"] == 0.2)


def test_seven_values_belong_to_the_joints_in_order() -> None:
    variation = VARIATIONS.parse("servo: {kd_scale: [1, 1.1, 1.2, [0.5, 0.6], 1.4, 1.5, 1.6]}")
    drawn = variation.sample(np.random.default_rng(0), 3).values["servo.kd_scale"]
    np.testing.assert_array_equal(drawn[:, [0, 1, 2, 4, 5, 6]], [[1, 1.1, 1.2, 1.4, 1.5, 1.6]] * 3)
    assert np.all((drawn[:, 3] >= 0.5) & (drawn[:, 3] <= 0.6))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("lids: {}", "no section 'lids'; allowed: seed, servo, lid, button"),
        ("lid: {weight: 1}", "lid has no key 'weight'; allowed: frictionloss, damping, mass"),
        ("lid: 3", "lid is 3; it must map keys to values: frictionloss, damping, mass"),
        ("lid: {mass: heavy}", "lid.mass is 'heavy'; it must be a number or [low, high], within"),
        ("lid: {mass: true}", "lid.mass is True"),
        ("lid: {mass: [0.3, 0.2]}", "lid.mass is [0.3, 0.2]"),
        ("lid: {mass: [0.1, 0.2, 0.3]}", "lid.mass is [0.1, 0.2, 0.3]"),
        ("lid: {mass: .nan}", "lid.mass is nan"),
        ("lid: {mass: 50}", "within 0.01..1 kg"),
        ("servo: {kp_scale: [1, 1, 1]}", "or a list of 7 of these"),
        ("servo: {frictionloss: 4}", "servo.frictionloss is 4; it must be a number or [low, high]"),
        ("servo: {frictionloss: -0.1}", "within 0..3 N m"),
        (
            "servo: {frictionloss: 1, frictionloss_scale: 2}",
            "servo.frictionloss and servo.frictionloss_scale are both given and say the same; "
            "leave one out",
        ),
        ("servo: {stiction_scale: 0.5}", "within 1..5,"),
        ("servo: {backlash: 0.1}", "within 0..0.05 rad"),
        ("sensors: {joint_offset: 1}", "within -0.05..0.05 rad"),
        ("sensors: {velocity_noise: 2}", "within 0..0.5 rad/s"),
        ("sensors: {effort_noise: -1}", "within 0..5 N m"),
        ("arm: {mass_scale: 3}", "within 0.5..2"),
        ("link: {loss: 1}", "within 0..0.9"),
        ("link: {jitter_ms: 501}", "within 0..500 ms"),
        ("link: {lost: 0.1}", "link has no key 'lost'; allowed: loss, delay_ms, jitter_ms"),
        ("seed: -1", "seed is -1"),
        ("seed: 1.5", "seed is 1.5"),
        ("- 1", "must map sections to keys"),
        ("lid: {mass: [", "is not YAML"),
        ("lid: {mass: 0.1, mass: 0.2}", "is not YAML"),
        ("lid: {mass: &m 0.1, damping: *m}", "robot.yaml, line 1: anchors (&name) and aliases"),
        (f"lid: {{mass: {'9' * 400}}}", "a number of more than 40 characters"),
        (f"lid: {{mass: {'x' * 9000}}}", "x...x"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(text)
    with pytest.raises(ConfigurationError) as error:
        VARIATIONS.load(path)
    assert said in str(error.value)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_a_missing_file_lists_what_is_bundled() -> None:
    with pytest.raises(NotFoundError, match=r"no variation file nowhere\.yaml.*randomised"):
        VARIATIONS.load("nowhere.yaml")
    with pytest.raises(ConfigurationError, match="randomised"):
        VARIATIONS.resolve(3)  # type: ignore[arg-type]


def test_an_empty_file_is_the_nominal_model() -> None:
    for text in ("", "{}", "lid:", "seed: 0"):
        assert VARIATIONS.parse(text) == NOMINAL
    assert NOMINAL.is_nominal


def test_every_bundled_file_is_valid_and_lets_the_lid_stay_where_it_is_left() -> None:
    assert "randomised" in VARIATIONS.bundled()
    for name in VARIATIONS.bundled():
        variation = VARIATIONS.load(name)
        assert not variation.is_nominal
        friction = {key.name: r for key, r in variation.ranges}.get("lid.frictionloss")
        assert friction is None or friction[0][0] >= 0.10


@pytest.mark.parametrize("task", ["door_open", "open_press_close", None])
def test_deployed_is_the_documented_randomisation_and_late_commands(task: str | None) -> None:
    variations = ARM_VARIATIONS if task is None else tasks.find(task).variations
    deployed = json.loads(variations.load("deployed").to_json())
    assert deployed.pop("command") == {"delay_ms": [60.0, 140.0]}
    assert deployed == json.loads(variations.load("randomised").to_json())
