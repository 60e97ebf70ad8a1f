"""Laws of the policy layout: JSON, hash, observation."""

from __future__ import annotations

import dataclasses
import json
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from skewmi.errors import ConfigurationError, LayoutMismatchError
from skewmi.policy_io import (
    WORKSPACE_KEYS,
    ActionField,
    Array,
    Ball,
    Field,
    PolicyLayout,
    Workspace,
    assemble_observation,
    require_same_layout,
)

WORKSPACE = Workspace(
    low=(-0.019, -0.155, 0.19),
    high=(0.001, 0.135, 0.355),
    start=(-0.009, -0.1345, 0.27),
    base_position=(-0.4, 0.0, 0.0),
    hand_quaternion_wxyz=(0.0, math.sqrt(0.5), math.sqrt(0.5), 0.0),
    free_following_error=1.5,
    held_following_error=0.4,
    stop_blockage=0.45,
    start_configuration=(1.0, -2.0, -1.1, 0.1 + 0.2, 1e-17, 2.0 / 3.0, 5e-324),
    gripper_opening=0.014,
)
LAYOUT = PolicyLayout(
    task="box",
    observation=(
        Field("hand_x", "m", "world", -0.019, 0.001),
        Field("lid_angle", "rad", "hinge", 0.0, 2.0 / 3.0),
        Field("button_depth", "m", "slide", 0.0, 0.017),
        Field("time", "", "episode", 0.0, 1.0),
    ),
    action=(
        ActionField("velocity_x", "m", "world", 0.005),
        ActionField("velocity_y", "m", "world", 0.015),
        ActionField("velocity_z", "m", "world", 0.1 + 0.2),
        ActionField("gripper", "m", "hand", 0.0025),
    ),
    reward_region=(
        Ball(("lid_angle",), (0.0,), 0.05),
        Ball(("hand_x", "button_depth"), (0.0, 0.0135), 0.0035),
    ),
    control_dt=0.1,
    episode_steps=200,
    success_hold_steps=10,
    workspace=WORKSPACE,
)

finite = st.floats(allow_nan=False, allow_infinity=False)
names = st.text(min_size=1, max_size=8).filter(lambda name: name != "time")


@st.composite
def fields(draw: st.DrawFn, name: str) -> Field:
    low, high = sorted(draw(st.lists(finite, min_size=2, max_size=2, unique=True)))
    return Field(name, draw(st.text(max_size=4)), draw(st.text(max_size=4)), low, high)


@st.composite
def workspaces(draw: st.DrawFn) -> Workspace:
    def numbers(n: int) -> Any:
        return tuple(draw(st.lists(finite, min_size=n, max_size=n)))

    return Workspace(
        *(numbers(3) for _ in range(4)), numbers(4), *numbers(3), numbers(7), draw(finite)
    )


@st.composite
def layouts(draw: st.DrawFn) -> PolicyLayout:
    field_names = draw(st.lists(names, min_size=1, max_size=4, unique=True))
    if draw(st.booleans()):
        field_names.append("time")
    in_ball = draw(st.lists(st.sampled_from(field_names), min_size=1, unique=True))
    balls = st.builds(
        Ball,
        st.just(tuple(in_ball)),
        st.tuples(*(finite for _ in in_ball)),
        st.floats(0.0, 10.0),
    )
    positive = st.floats(min_value=0.0, exclude_min=True, allow_infinity=False)
    actions = st.builds(ActionField, names, st.text(max_size=4), st.text(max_size=4), positive)
    return PolicyLayout(
        task=draw(names),
        observation=tuple(draw(fields(name)) for name in field_names),
        action=tuple(draw(st.lists(actions, min_size=1, max_size=4))),
        reward_region=tuple(draw(st.lists(balls, max_size=3))),
        control_dt=draw(positive),
        episode_steps=draw(st.integers(1, 10**6)),
        success_hold_steps=draw(st.integers(1, 10**6)),
        workspace=draw(st.none() | workspaces()),
    )


@given(layouts())
def test_json_round_trip_is_exact(layout: PolicyLayout) -> None:
    again = PolicyLayout.from_json(layout.to_json())
    assert again == layout
    assert again.to_json() == layout.to_json()
    assert again.hash() == layout.hash()


@given(layouts())
def test_hash_survives_another_json_writer(layout: PolicyLayout) -> None:
    rewritten = json.dumps(json.loads(layout.to_json()), indent=3)
    assert PolicyLayout.from_json(rewritten).hash() == layout.hash()


def leaves(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths to every number and text of a nested document."""
    if isinstance(value, dict):
        return [leaf for key in value for leaf in leaves(value[key], (*path, key))]
    if isinstance(value, list):
        return [leaf for i, item in enumerate(value) for leaf in leaves(item, (*path, i))]
    return [path]


DOCUMENT = json.loads(LAYOUT.to_json())


def changed(path: tuple[Any, ...]) -> str:
    """The document with one leaf changed as little as its type allows."""
    document = json.loads(LAYOUT.to_json())
    holder = document
    for key in path[:-1]:
        holder = holder[key]
    old = holder[path[-1]]
    if isinstance(old, str):
        holder[path[-1]] = old + "'"
    elif isinstance(old, int):
        holder[path[-1]] = old + 1
    else:
        holder[path[-1]] = float(np.nextafter(old, np.inf))
    return json.dumps(document)


@pytest.mark.parametrize("path", leaves(DOCUMENT), ids=lambda path: ".".join(map(str, path)))
def test_hash_sees_the_smallest_change_of_every_field(path: tuple[Any, ...]) -> None:
    try:
        other = PolicyLayout.from_json(changed(path))
    except (ConfigurationError, LayoutMismatchError):
        # Refused outright: another version, or a region of unknown fields.
        assert path[0] == "layout_version" or {"name", "fields"} & set(path)
        return
    assert other.hash() != LAYOUT.hash()
    with pytest.raises(LayoutMismatchError, match="the file was made for another layout"):
        require_same_layout(LAYOUT, other, "the file")


def test_document_has_every_field_of_the_dataclasses() -> None:
    """So that the test above covers all of them, also those added later."""
    for part, kind in (
        (DOCUMENT, PolicyLayout),
        (DOCUMENT["observation"][0], Field),
        (DOCUMENT["action"][0], ActionField),
        (DOCUMENT["reward_region"][0], Ball),
        (DOCUMENT["workspace"], Workspace),
    ):
        # A base that is not turned is left out, so that older versions' hashes stay.
        names = {f.name for f in dataclasses.fields(kind)} - {"base_yaw"}
        keys = {WORKSPACE_KEYS.get(name, name) for name in names}
        assert keys == set(part) - {"layout_version"}


@pytest.mark.parametrize(("name", "key"), WORKSPACE_KEYS.items())
def test_a_workspace_is_written_and_read_by_its_keys_only(name: str, key: str) -> None:
    """They are part of the hash of every policy file; Python may call the fields otherwise."""
    document = json.loads(LAYOUT.to_json())
    assert document["workspace"][key] == getattr(WORKSPACE, name)
    document["workspace"][name] = document["workspace"].pop(key)
    with pytest.raises(LayoutMismatchError, match=key):
        PolicyLayout.from_json(json.dumps(document))


@pytest.mark.parametrize("part", ["observation", "action", "reward_region"])
def test_hash_depends_on_order(part: str) -> None:
    parts = list(getattr(LAYOUT, part))
    parts[0], parts[1] = parts[1], parts[0]
    assert dataclasses.replace(LAYOUT, **{part: tuple(parts)}).hash() != LAYOUT.hash()


def test_mismatch_names_what_differs() -> None:
    other = dataclasses.replace(LAYOUT, control_dt=0.05)
    with pytest.raises(LayoutMismatchError, match=r"control_dt: expected 0\.1, got 0\.05"):
        require_same_layout(LAYOUT, other, "policy.onnx")
    require_same_layout(LAYOUT, PolicyLayout.from_json(LAYOUT.to_json()), "policy.onnx")


@pytest.mark.parametrize(
    "text",
    ["", "[]", "null", "3", '"x"', "{}", '{"layout_version": 1}', "{" * 10]
    + [json.dumps({**DOCUMENT, "layout_version": 2})]
    + [json.dumps({**DOCUMENT, "extra": 1})]
    + [json.dumps({key: DOCUMENT[key] for key in DOCUMENT if key != removed})
       for removed in DOCUMENT],
)  # fmt: skip
def test_what_is_no_layout_is_refused(text: str) -> None:
    with pytest.raises(LayoutMismatchError):
        PolicyLayout.from_json(text)


@pytest.mark.parametrize(
    "change",
    [
        {"control_dt": 0.0},
        {"control_dt": math.nan},
        {"episode_steps": 0},
        {"success_hold_steps": 0},
        {"observation": LAYOUT.observation + LAYOUT.observation},
        {"observation": LAYOUT.observation[::-1]},
        {"reward_region": (Ball(("nobody",), (0.0,), 1.0),)},
    ],
)
def test_impossible_layouts_are_refused(change: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError):
        dataclasses.replace(LAYOUT, **change)


@pytest.mark.parametrize("bounds", [(1.0, 1.0), (1.0, 0.0), (math.nan, 1.0), (0.0, math.nan)])
def test_empty_ranges_are_refused(bounds: tuple[float, float]) -> None:
    with pytest.raises(ConfigurationError):
        Field("x", "m", "world", *bounds)


@pytest.mark.parametrize("scale", [0.0, -1.0, math.nan])
def test_scales_that_are_not_positive_are_refused(scale: float) -> None:
    with pytest.raises(ConfigurationError):
        ActionField("x", "m", "world", scale)


def test_state_is_the_observation_without_time() -> None:
    assert LAYOUT.observation_dim == 4
    assert LAYOUT.state_dim == 3
    assert [field.name for field in LAYOUT.state_fields] == ["hand_x", "lid_angle", "button_depth"]


@given(hnp.arrays(np.float64, (5, 4), elements=finite), st.permutations(LAYOUT.observation_names))
def test_observation_follows_the_layout_whatever_the_order_given(
    rows: Array, order: list[str]
) -> None:
    column = {name: i for i, name in enumerate(LAYOUT.observation_names)}
    batched = assemble_observation(LAYOUT, {name: rows[:, column[name]] for name in order})
    np.testing.assert_array_equal(batched, rows)
    for row in rows:
        single = assemble_observation(LAYOUT, {name: row[column[name]] for name in order})
        np.testing.assert_array_equal(single, row)


def test_observation_broadcasts_scalars_ignores_others_and_names_what_is_missing() -> None:
    values = {"hand_x": np.arange(3.0), "lid_angle": 1.0, "button_depth": 2.0, "time": 0.5}
    observation = assemble_observation(LAYOUT, values | {"unused": 9.0})
    np.testing.assert_array_equal(observation, [[i, 1.0, 2.0, 0.5] for i in range(3)])
    del values["lid_angle"]
    with pytest.raises(LayoutMismatchError, match="lid_angle"):
        assemble_observation(LAYOUT, values)
