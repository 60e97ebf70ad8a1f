"""EGM packets on the wire, against a writer of the tests' own and against ABB's field table."""

from __future__ import annotations

import math

import egm_wire
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.deploy.robot.backends.egm import messages
from skewmi.deploy.robot.backends.egm.codec import (
    MAX_DATAGRAM,
    MalformedPacketError,
    decode_feedback,
    decode_reference,
    encode_feedback,
    encode_reference,
)
from skewmi.deploy.robot.backends.egm.packets import (
    FeedbackPacket,
    Mci,
    Motors,
    Pose,
    Rapid,
    ReferencePacket,
)
from skewmi.errors import ConfigurationError

# What ABB's manual and public headers say: name -> (number, repeated). The tests' own copy.
ABB_FIELDS = {
    "EgmHeader": "seqno 1, tm 2, mtype 3",
    "EgmCartesian": "x 1, y 2, z 3",
    "EgmQuaternion": "u0 1, u1 2, u2 3, u3 4",
    "EgmEuler": "x 1, y 2, z 3",
    "EgmClock": "sec 1, usec 2",
    "EgmTimestamp": "sec 1, nsec 2",
    "EgmPose": "pos 1, orient 2, euler 3",
    "EgmCartesianSpeed": "value 1",
    "EgmJoints": "joints 1",
    "EgmPlanned": "joints 1, cartesian 2, externalJoints 3, time 4, timeStamp 5",
    "EgmSpeedRef": "joints 1, cartesians 2, externalJoints 3",
    "EgmFeedBack": "joints 1, cartesian 2, externalJoints 3, time 4, timeStamp 5",
    "EgmMotorState": "state 1",
    "EgmMCIState": "state 1",
    "EgmRapidCtrlExecState": "state 1",
    "EgmTestSignals": "signals 1",
    "EgmMeasuredForce": "fcActive 1, force 2",
    "EgmCollisionInfo": "collsionTriggered 1, collDetQuota 2",
    "EgmRAPIDdata": "digVal 1, dnum 2",
    "EgmRobot": (
        "header 1, feedBack 2, planned 3, motorState 4, mciState 5, mciConvergenceMet 6, "
        "testSignals 7, rapidExecState 8, measuredForce 9, utilizationRate 10, moveIndex 11, "
        "CollisionInfo 12, RAPIDfromRobot 13, torqueRef 14"
    ),
    "EgmSensor": "header 1, planned 2, speedRef 3, RAPIDtoRobot 4",
}

angles = st.floats(-6.0, 6.0, allow_nan=False)
seven = st.lists(angles, min_size=7, max_size=7).map(np.array)


@pytest.mark.parametrize("name", ABB_FIELDS)
def test_messages_have_abbs_fields(name: str) -> None:
    descriptor = messages.CLASSES[name].DESCRIPTOR
    written = ", ".join(f"{field.name} {field.number}" for field in descriptor.fields)
    assert written == ABB_FIELDS[name]


def test_there_are_no_other_messages() -> None:
    assert set(messages.CLASSES) == set(ABB_FIELDS)


@pytest.mark.parametrize(
    "text",
    [
        "message A { optional int32 x = 1; }",
        "message A { optional double x = 1 [default = 2]; }",
        "message A { oneof x { double y = 1; } }",
        "message A { optional B x = 1; }",
        "message A { optional double x = 1;",
        "import 'x.proto';",
        "message A { § }",
    ],
)
def test_proto_text_that_is_not_understood_is_refused(text: str) -> None:
    with pytest.raises(ConfigurationError):
        messages.parse_proto(text, "test.proto")


def test_axes_are_in_abbs_order_and_degrees() -> None:
    # Axis 7 sits between the axes 2 and 3 of the chain.
    wire = egm_wire.Feedback(axes=(10, 20, 30, 40, 50, 60), axis_7=(70,))
    np.testing.assert_allclose(
        np.degrees(decode_feedback(wire.encode()).q), [10, 20, 70, 30, 40, 50, 60], atol=1e-12
    )


@pytest.mark.parametrize("joint", range(7))
def test_a_reference_moves_the_axis_that_is_meant(joint: int) -> None:
    q, v = np.zeros(7), np.zeros(7)
    q[joint], v[joint] = np.radians(30.0), np.radians(-5.0)
    wire = egm_wire.Reference.decode(encode_reference(ReferencePacket(3, 5, q, v)))
    axis = (1, 2, 7, 3, 4, 5, 6)[joint]
    positions = dict(enumerate(wire.axes, 1)) | {7: wire.axis_7[0]}
    speeds = dict(enumerate(wire.speeds, 1)) | {7: wire.speed_7[0]}
    assert wire.sequence == 3
    assert wire.mtype == egm_wire.CORRECTION
    for number in range(1, 8):
        assert positions[number] == pytest.approx(30.0 if number == axis else 0.0)
        assert speeds[number] == pytest.approx(-5.0 if number == axis else 0.0)


def test_position_alone_has_no_speed_reference() -> None:
    data = encode_reference(ReferencePacket(1, 2, np.zeros(7)))
    assert [number for number, _ in egm_wire.fields(data)] == [1, 2]


@settings(deadline=None)
@given(seven, st.none() | seven, st.integers(0, 2**32 - 1))
def test_reference_survives_the_wire(q: np.ndarray, v: np.ndarray | None, sequence: int) -> None:
    back = decode_reference(encode_reference(ReferencePacket(sequence, 7, q, v)))
    assert (back.sequence, back.time_ms) == (sequence, 7)
    np.testing.assert_allclose(back.q, q, atol=1e-14)
    assert (back.v is None) == (v is None)
    if v is not None:
        np.testing.assert_allclose(back.v, v, atol=1e-14)


@settings(deadline=None)
@given(
    seven,
    st.sampled_from(Motors),
    st.sampled_from(Mci),
    st.sampled_from(Rapid),
    st.none() | st.floats(0, 1e4),
    st.sampled_from([6, 7]),
    st.integers(0, 2**33) | st.none(),
)
def test_feedback_survives_the_wire(
    q: np.ndarray,
    motors: Motors,
    mci: Mci,
    rapid: Rapid,
    utilization: float | None,
    robotware: int,
    clock_us: int | None,
) -> None:
    pose = Pose(np.array([0.1, -0.2, 0.3]), np.array([0.5, 0.5, -0.5, 0.5]))
    packet = FeedbackPacket(
        9, q, motors, mci, rapid, clock_us, 11, q + 0.1, True, utilization, pose, pose, robotware
    )
    back = decode_feedback(encode_feedback(packet))
    np.testing.assert_allclose(back.q, packet.q, atol=1e-14)
    assert back.planned_q is not None
    np.testing.assert_allclose(back.planned_q, q + 0.1, atol=1e-14)
    for told in (back.flange, back.planned_flange):
        assert told is not None
        np.testing.assert_allclose(told.position, pose.position, atol=1e-15)
        np.testing.assert_array_equal(told.quaternion_wxyz, pose.quaternion_wxyz)
    assert (back.motors, back.mci, back.rapid) == (motors, mci, rapid)
    assert back.clock_us == clock_us
    assert (back.sequence, back.time_ms, back.converged) == (9, 11, True)
    assert back.utilization == utilization
    assert back.robotware == robotware


@pytest.mark.parametrize(
    ("packet", "words"),
    [
        (egm_wire.Feedback(mtype=egm_wire.CORRECTION), "message type 3"),
        (egm_wire.Feedback(mtype=None), "message type 0"),
        (egm_wire.Feedback(axes=(0,) * 5), "5 joints"),
        (egm_wire.Feedback(axes=(0,) * 7), "7 joints"),
        (egm_wire.Feedback(axis_7=()), "0 external"),
        (egm_wire.Feedback(axes=(0, 0, math.nan, 0, 0, 0)), "not a finite number"),
        (egm_wire.Feedback(axis_7=(math.inf,)), "not a finite number"),
        (egm_wire.Feedback(motors=None), "lacks motorState"),
        (egm_wire.Feedback(mci=None), "lacks mciState"),
        (egm_wire.Feedback(mci=17), "lacks mciState.state"),
        (egm_wire.Feedback(utilization=math.nan), "utilisation"),
        (egm_wire.Feedback(planned_axes=(0,) * 3), "planned has 3 joints"),
    ],
)
def test_packets_of_no_yumi_are_refused(packet: egm_wire.Feedback, words: str) -> None:
    with pytest.raises(MalformedPacketError, match=words):
        decode_feedback(packet.encode())


@pytest.mark.parametrize("size", [0, MAX_DATAGRAM + 1, 65_507])
def test_size_is_looked_at_first(size: int) -> None:
    with pytest.raises(MalformedPacketError, match=f"{size} bytes"):
        decode_feedback(b"\x0a" * size)


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=400) | st.integers(0, 300), st.randoms(use_true_random=False))
def test_no_bytes_raise_anything_else(data: bytes | int, random: object) -> None:
    if isinstance(data, int):
        # A good packet with a byte or two changed reaches further into the decoder.
        good = bytearray(egm_wire.Feedback(sequence=5, utilization=20.0).encode())
        for _ in range(2):
            good[random.randrange(len(good))] = random.randrange(256)  # type: ignore[attr-defined]
        data = bytes(good[: len(good) - data % 40])
    for decode in (decode_feedback, decode_reference):
        try:
            packet = decode(data)
        except MalformedPacketError:
            continue
        if isinstance(packet, FeedbackPacket):
            assert np.isfinite(packet.q).all()


def test_a_reference_that_is_no_number_is_read_as_it_is() -> None:
    q = np.zeros(7)
    q[2] = math.nan
    assert np.isnan(decode_reference(encode_reference(ReferencePacket(0, 0, q))).q[2])


def test_unknown_fields_are_skipped() -> None:
    extra = egm_wire.block(99, b"news") + egm_wire.integer(98, 4)
    packet = decode_feedback(egm_wire.Feedback(sequence=5, extra=extra).encode())
    assert packet.sequence == 5


def test_forces_of_robotware_6_do_not_harm() -> None:
    # There field 1 of the measured force is a list of doubles, here a flag.
    extra = egm_wire.block(9, egm_wire.doubles(1, (1.0,) * 6))
    assert decode_feedback(egm_wire.Feedback(extra=extra).encode()).robotware == 6
