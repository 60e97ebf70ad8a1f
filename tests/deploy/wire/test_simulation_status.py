"""What a simulated robot adds to its status survives the wire, and nonsense is refused."""

from __future__ import annotations

import contextlib
import json

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from skewmi.deploy.wire.simulation_status import (
    CONTACT_FORCES,
    SCENE_POSES,
    ContactForces,
    ScenePose,
    decode_forces,
    decode_poses,
    encode_forces,
    encode_poses,
)
from skewmi.errors import TransportError

NUMBERS = st.floats(-1e3, 1e3, allow_nan=False)
SOME = settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.too_slow])
POSES = st.builds(
    ScenePose,
    st.lists(st.text(max_size=8), max_size=3).map(tuple),
    st.tuples(NUMBERS, NUMBERS, NUMBERS),
    st.tuples(NUMBERS, NUMBERS, NUMBERS, NUMBERS),
)


@SOME
@given(st.lists(POSES, max_size=3))
def test_poses_are_what_they_were(poses: list[ScenePose]) -> None:
    assert decode_poses({SCENE_POSES: encode_poses(poses)}) == tuple(poses)


@SOME
@given(st.integers(0, 2**62), st.lists(st.tuples(st.integers(0, 10**5), st.floats(0, 1e4))))
def test_forces_are_what_they_were_but_for_rounding(first_ms: int, rows: list) -> None:
    first_ns = first_ms // 10**6 * 10**6
    after = np.array([0, *(ms for ms, _ in rows)], dtype=np.int64)
    felt = np.array([0.0, *(force for _, force in rows)])
    told = decode_forces(
        {CONTACT_FORCES: encode_forces(ContactForces(first_ns + after * 10**6, felt, 2 * felt))}
    )
    assert told is not None
    np.testing.assert_array_equal(told.stamps_ns, first_ns + after * 10**6)
    np.testing.assert_allclose(told.hand_n, felt, atol=0.0051)
    np.testing.assert_allclose(told.arm_n, 2 * felt, atol=0.0051)


def test_a_status_without_them_tells_nothing() -> None:
    assert decode_poses({"state": "holding"}) is None
    assert decode_forces({"state": "holding"}) is None


JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=4),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["parts", "translation", "first_ns", "hand_n"]), inner)
    ),
    max_leaves=6,
)


@SOME
@given(st.text(max_size=20) | JSON.map(json.dumps))
def test_whatever_else_stands_there_is_refused_in_words_or_read(text: str) -> None:
    for decode, key in ((decode_poses, SCENE_POSES), (decode_forces, CONTACT_FORCES)):
        with contextlib.suppress(TransportError):
            decode({key: text})


@pytest.mark.parametrize(
    "text",
    [
        '[{"parts":[],"translation":[0,0],"quaternion_wxyz":[1,0,0,0]}]',
        '[{"parts":[],"translation":[0,0,NaN],"quaternion_wxyz":[1,0,0,0]}]',
        "{}x",
        "[1]",
    ],
)
def test_poses_that_are_none_are_refused(text: str) -> None:
    with pytest.raises(TransportError):
        decode_poses({SCENE_POSES: text})
