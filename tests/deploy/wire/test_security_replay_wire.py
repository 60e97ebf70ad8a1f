"""Old commands put again over the wire, byte for byte: refused, with the reason."""

from __future__ import annotations

import time

import numpy as np
import pytest
import zenoh
from secured_link import robot_process

from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.robot.process import free_port
from skewmi.deploy.wire import ros2_keys, topics
from skewmi.deploy.wire.messages import (
    JointStates,
    decode_joint_states,
    decode_status,
    encode_chunk,
    encode_joint_states,
)
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.robot_models import limits as joint_limits
from skewmi.robot_models import yumi
from skewmi.trajectory import TrajectoryChunk

LAB = joint_limits.profile("lab")
SIZE = 0.08 * np.array([1, -0.5, 0, 0.5, 0, 1, 0])


def describe(link: Link) -> RobotDescription:
    return RobotDescription.from_json(link.call(topics.YUMI_DESCRIBE, 5.0).message)


def counts(link: Link, status) -> tuple[int, int, str]:
    """Accepted and refused so far, and the reasons told since the last call."""
    link.call(topics.YUMI_DESCRIBE, 5.0)
    deadline = time.monotonic() + 5.0
    reasons, values = [], {}
    seen_since = time.monotonic_ns()
    while not values or time.monotonic_ns() - seen_since < 0.7e9:  # it reports twice a second
        assert time.monotonic() < deadline
        for sample in status.drain():
            decoded = decode_status(sample.payload)
            if decoded.name == "skewmi_robot":
                values = decoded.values
                reasons.append(values["refusal"])
        time.sleep(0.01)
    return int(values["accepted"]), int(values["refused"]), "; ".join(filter(None, reasons))


CHUNK_KEY = ros2_keys.data_key(0, topics.YUMI_TRAJECTORY)
GRIPPER_KEY = ros2_keys.data_key(0, topics.YUMI_GRIPPER)
Record = list[tuple[str, bytes, bytes]]
"""Key, payload and attachment of each message."""


def finger_command(stamp_ns: int, opening: float) -> bytes:
    names, nothing = yumi.finger_names("right")[:1], np.zeros(0)
    return encode_joint_states(JointStates(stamp_ns, names, np.array([opening]), nothing, nothing))


def read(tap) -> Record:
    """What a Zenoh subscriber has heard."""
    heard: Record = []
    while (sample := tap.handler.try_recv()) is not None:
        heard.append(
            (str(sample.key_expr), sample.payload.to_bytes(), sample.attachment.to_bytes())
        )
    return heard


def put_again(session, recorded: Record) -> None:
    for key, payload, attachment in recorded:
        session.put(key, payload, attachment=attachment)


def wait_until_it_holds(link: Link) -> RobotDescription:
    deadline = time.monotonic() + 10.0
    while describe(link).state != "holding":
        assert time.monotonic() < deadline
        time.sleep(0.05)
    return describe(link)


def test_bytes_put_again_over_the_wire_are_refused_with_the_reason() -> None:
    locator = f"tcp/127.0.0.1:{free_port()}"
    config = TransportConfig.for_client(locator)
    with (
        robot_process("--listen", locator),
        Link.open(config, "first") as link,
        zenoh.open(config.zenoh()) as other,
    ):
        status = link.subscribe(topics.YUMI_STATUS, depth=None)
        publisher = link.publisher(topics.YUMI_TRAJECTORY)
        gripper = link.publisher(topics.YUMI_GRIPPER)
        tap = other.declare_subscriber("0/yumi/right/*/**", zenoh.handlers.RingChannel(1000))
        link.wait_for_robot(10.0)
        time.sleep(0.3)  # until the tap is known to everybody
        assert link.call(topics.YUMI_ARM, 5.0, publisher.gid + gripper.gid).success
        before = describe(link)
        start = np.array(before.commanded_position)
        motion = StartMotion(start, start + SIZE, LAB)
        stamp_ns = before.clock_ns + 400_000_000  # a busy machine may be late
        first = encode_chunk(TrajectoryChunk.of(stamp_ns, before.joint_names, motion.trajectory))
        publisher.put(first)
        gripper.put(finger_command(before.clock_ns, 0.02))
        accepted, refused, reasons = counts(link, status)
        assert (accepted, refused) == (1, 0), reasons
        recorded = read(tap)
        # The third on these keys is what the robot server tells by itself.
        recorded = [told for told in recorded if "/controller_state/" not in told[0]]
        assert {key for key, _, _ in recorded} == {CHUNK_KEY, GRIPPER_KEY}
        rest = wait_until_it_holds(link).commanded_position
        assert np.abs(np.array(rest) - start).max() > 0.05, "it did not move"

        # The same bytes, from the same session and from another.
        for number, session in enumerate((link._session, other), start=1):
            put_again(session, recorded)
            accepted, refused, reasons = counts(link, status)
            assert (accepted, refused) == (1, 2 * number)
            # A machine so slow that the lease has run out refuses them all the more.
            told = [reasons.count(w) for w in ("repeated or overtaken", "arm it first")]
            assert sum(told) == 2, reasons
        # With new numbers, as the commander's own next messages after it has armed again.
        link.call(topics.YUMI_STOP, 5.0)
        assert link.call(topics.YUMI_ARM, 5.0, publisher.gid + gripper.gid).success
        publisher.put(first)
        gripper.put(finger_command(before.clock_ns - 10_000_000_000, 0.0))
        accepted, refused, reasons = counts(link, status)
        assert (accepted, refused) == (1, 6)
        assert "in the past of the robot server's clock" in reasons
        assert "s old by the robot server's clock" in reasons
        assert describe(link).commanded_position == rest
    assert_not_followed_after_a_restart(locator, recorded)


def assert_not_followed_after_a_restart(locator: str, recorded: Record) -> None:
    """By a robot server that is started again, and armed for the recorded senders."""
    config = TransportConfig.for_client(locator)
    with (
        robot_process("--listen", locator),
        zenoh.open(config.zenoh()) as other,
        Link.open(config, "second") as link,
    ):
        status = link.subscribe(topics.YUMI_STATUS, depth=None)
        states = link.subscribe(topics.YUMI_JOINT_STATES)
        link.wait_for_robot(10.0)
        gids = {key: attachment[17:] for key, _, attachment in recorded}
        assert link.call(topics.YUMI_ARM, 5.0, gids[CHUNK_KEY] + gids[GRIPPER_KEY]).success
        before = describe(link)
        fingers = decode_joint_states(states.wait(5.0).payload).position[7]
        time.sleep(0.3)
        put_again(other, recorded)
        accepted, refused, reasons = counts(link, status)
        assert (accepted, refused) == (0, 2)
        assert reasons.count("the robot server's clock") == 2
        assert describe(link).commanded_position == before.commanded_position
        now = decode_joint_states(states.wait(5.0).payload).position[7]
        assert now == pytest.approx(fingers, abs=1e-4)
