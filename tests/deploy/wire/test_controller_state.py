"""The controller state on the wire: what ROS 2 reads there, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from skewmi.deploy.wire import ros2_types, topics
from skewmi.deploy.wire.controller_state import (
    ControllerState,
    decode_controller_state,
    encode_controller_state,
)
from skewmi.errors import TransportError
from skewmi.trajectory import JointPoint

NAMES = st.lists(
    st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=12),
    min_size=1,
    max_size=9,
).map(tuple)
STAMPS = st.integers(0, 2**31 * 10**9 - 1)


@st.composite
def states(draw: st.DrawFn) -> ControllerState:
    names = draw(NAMES)
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    scale = draw(st.sampled_from([0.0, 1.0, 1e300, np.inf]))
    with np.errstate(invalid="ignore"):
        q, v, a, position, velocity, effort = rng.normal(size=(6, len(names))) * scale
    return ControllerState(draw(STAMPS), names, JointPoint(q, v, a), position, velocity, effort)


def same(first: ControllerState, second: ControllerState) -> bool:
    arrays = [
        (*state.reference, state.position, state.velocity, state.effort)
        for state in (first, second)
    ]
    return (first.stamp_ns, first.names) == (second.stamp_ns, second.names) and all(
        np.array_equal(a, b, equal_nan=True) for a, b in zip(*arrays, strict=True)
    )


@pytest.mark.filterwarnings("ignore:invalid value")
@settings(deadline=None)
@given(states())
def test_what_is_encoded_is_decoded_and_read_by_rosbags(state: ControllerState) -> None:
    payload = encode_controller_state(state)
    assert same(decode_controller_state(payload), state)
    message = ros2_types.decode(payload, topics.CONTROLLER_STATE)
    stamp = message.header.stamp
    assert stamp.sec * 10**9 + stamp.nanosec == state.stamp_ns
    assert tuple(message.joint_names) == state.names
    reference, feedback, error = message.reference, message.feedback, message.error
    read = JointPoint(reference.positions, reference.velocities, reference.accelerations)
    told = ControllerState(
        state.stamp_ns,
        state.names,
        read,
        feedback.positions,
        feedback.velocities,
        feedback.effort,
    )
    assert same(told, state)
    assert np.array_equal(error.positions, read.q - feedback.positions, equal_nan=True)
    assert np.array_equal(error.velocities, read.v - feedback.velocities, equal_nan=True)
    empty = (reference.effort, feedback.accelerations, error.accelerations, error.effort)
    assert not any(len(array) for array in (*empty, message.output.positions))
    assert message.speed_scaling_factor == 1.0
    assert ros2_types.encode(message, topics.CONTROLLER_STATE) == payload


def test_messages_do_not_share_their_bytes() -> None:
    zero, one = np.zeros(2), np.ones(2)
    point = JointPoint(one, one, one)
    first = encode_controller_state(ControllerState(1, ("a", "b"), point, one, one, one))
    before = bytes(first)
    encode_controller_state(
        ControllerState(2, ("a", "b"), JointPoint(zero, zero, zero), zero, zero, zero)
    )
    assert first == before


@settings(deadline=None, max_examples=200)
@given(st.data())
def test_broken_bytes_are_refused_or_read(data: st.DataObject) -> None:
    values = np.arange(1.0, 8.0)
    state = ControllerState(5, tuple("abcdefg"), JointPoint(values, values, values), *[values] * 3)
    payload = bytearray(encode_controller_state(state))
    kind = data.draw(st.sampled_from(["cut", "flip", "any"]))
    if kind == "cut":
        payload = payload[: data.draw(st.integers(0, len(payload) - 1))]
    elif kind == "flip":
        payload[data.draw(st.integers(0, len(payload) - 1))] ^= data.draw(st.integers(1, 255))
    else:
        payload = bytearray(data.draw(st.binary(max_size=200)))
    try:
        decoded = decode_controller_state(bytes(payload))
    except TransportError:
        return
    assert kind == "flip"
    assert len(decoded.names) == len(decoded.reference.q) == len(decoded.effort)


@pytest.mark.parametrize("wrong", range(6))
def test_arrays_have_a_number_for_each_joint(wrong: int) -> None:
    arrays = [np.zeros(7 - (part == wrong)) for part in range(6)]
    state = ControllerState(5, tuple("abcdefg"), JointPoint(*arrays[:3]), *arrays[3:])
    with pytest.raises(TransportError, match="of 7 joints has arrays of shapes"):
        encode_controller_state(state)


def test_the_type_is_that_of_ros2_control() -> None:
    """As control_msgs 5.3 and later define it: one field less or in other order hashes to
    something else, and no ROS 2 node would see the topic."""
    assert ros2_types.type_hash(topics.CONTROLLER_STATE) == (
        "RIHS01_51d8dd89cc624cbe9daaeeb4d80d6de9b86168ffdc3be41fefc0953e3c26e480"
    )
    store = get_typestore(Stores.ROS2_JAZZY)
    schema = ros2_types.schema(topics.CONTROLLER_STATE)
    own = schema.split("=" * 80)[0]
    store.register(get_types_from_msg(own, topics.CONTROLLER_STATE))
    assert store.hash_rihs01(topics.CONTROLLER_STATE) == ros2_types.type_hash(
        topics.CONTROLLER_STATE
    )
