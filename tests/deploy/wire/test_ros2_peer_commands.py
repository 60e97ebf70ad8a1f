"""Commands of an independent ROS 2 peer: followed if they keep the rules, else refused and why.

The peer is zenoh-ros2-sdk in a process without skewmi: its own tokens, attachments and gids.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from ros2_peer_process import (
    COMMANDS,
    DIAGNOSTICS,
    STATE,
    TRAJECTORY,
    Message,
    Peer,
    duration,
    eventually,
    header,
    robot_and_peer,
    trajectory,
)

STEP = 0.08 * np.array([1, -0.5, 0, 0.5, 0, 1, 0])


ATTEMPTS = 5
"""For commands that a busy machine makes late: they may be 500 ms ahead at most."""
LATE = "in the past of the robot server's clock"


@pytest.fixture(scope="module")
def peer() -> Iterator[Peer]:
    with robot_and_peer() as (_, peer):
        peer.subscribe("/yumi/joint_states", STATE)
        peer.subscribe("/yumi/status", DIAGNOSTICS)
        yield peer


@pytest.fixture(scope="module")
def commander(peer: Peer) -> str:
    """The peer's publisher of commands: its gid, hexadecimal."""
    declared = peer.ask("publisher", topic=COMMANDS, type_name=TRAJECTORY)
    assert declared["matching"], "the robot server's subscription is not seen"
    return str(declared["gid"])


def armed(peer: Peer) -> Message:
    """Arm anew, the arm at the start of an episode; what the server then says about itself."""
    peer.call("/yumi/stop")
    eventually(lambda: peer.describe()["state"] == "disarmed")
    assert peer.call("/yumi/scene/reset")[0]
    peer.statuses()
    success, said = peer.call("/yumi/arm")
    assert success, said
    return peer.describe()


def executed(peer: Peer, duration_s: float = 1.0) -> tuple[Message, np.ndarray, dict[str, str]]:
    """Publish a good trajectory; again if this computer is too busy for it to be in time.

    Returns:
        What the server said about itself before, where the arm was, and the status that tells that
        it moves.
    """
    for _ in range(ATTEMPTS):
        server, before = armed(peer), peer.position()
        peer.ask("publish", topic=COMMANDS, message=trajectory(server, STEP, duration_s))
        told = eventually(
            lambda: [s for s in peer.statuses() if s["state"] == "executing" or s["refusal"]]
        )[0]
        if not told["refusal"]:
            return server, before, told
        assert LATE in told["refusal"]
    raise AssertionError("too busy for a stamp 400 ms ahead")


def test_trajectory_that_keeps_the_rules_is_executed(peer: Peer, commander: str) -> None:
    server, before, moving = executed(peer)
    assert moving["commander"] == commander
    eventually(lambda: peer.describe()["state"] == "holding")
    np.testing.assert_allclose(peer.position()[:7] - before[:7], STEP, atol=5e-3)
    np.testing.assert_allclose(
        peer.describe()["commanded_position"], server["commanded_position"] + STEP, atol=1e-12
    )


def test_stop_by_a_peer_brakes_the_arm_on_its_way(peer: Peer, commander: str) -> None:
    for _ in range(ATTEMPTS):
        server, _, _ = executed(peer, 1.996)
        start = np.array(server["commanded_position"])
        eventually(lambda start=start: np.abs(peer.position()[:7] - start).max() > 0.01)
        answer = peer.call("/yumi/stop")
        if answer != (True, "disarmed"):  # as if it had already arrived
            break
    assert answer == (True, "stopping")
    eventually(lambda: peer.describe()["state"] == "disarmed")


def test_gripper_obeys_a_peer(peer: Peer, commander: str) -> None:
    server = armed(peer)
    peer.ask("publisher", topic="/yumi/right/gripper", type_name=STATE)
    opening = {"name": ["gripper_r_joint"], "position": [0.02], "velocity": [], "effort": []}
    message = {"header": header(server["clock_ns"]), **opening}
    # The SDK counts from 0, where rmw_zenoh counts from 1.
    assert peer.ask("publish", topic="/yumi/right/gripper", message=message) == {"sequence": 0}
    eventually(lambda: abs(peer.position()[7] - 0.02) < 1e-3)
    assert all(not status["refusal"] for status in peer.statuses())


def changed(**new: Any) -> Callable[[Message], Message]:
    """A good trajectory with other contents at its top."""
    return lambda server: trajectory(server, STEP) | new


def at_point(index: int, **new: Any) -> Callable[[Message], Message]:
    """A good trajectory with one point changed."""

    def make(server: Message) -> Message:
        message = trajectory(server, STEP)
        message["points"][index] |= new
        return message

    return make


def reordered(server: Message) -> Message:
    """Joints in the order of their numbers, as on a data sheet: every value still with its name."""
    message = trajectory(server, STEP)
    order = sorted(range(7), key=lambda joint: message["joint_names"][joint])
    message["joint_names"] = [message["joint_names"][joint] for joint in order]
    for point in message["points"]:
        for name in ("positions", "velocities", "accelerations"):
            point[name] = [point[name][joint] for joint in order]
    return message


def moved(joint: int, change: float, duration_s: float) -> Callable[[Message], Message]:
    """One joint alone, smoothly, towards the side with more room."""

    def make(server: Message) -> Message:
        limits, q = server["limits"], server["commanded_position"][joint]
        up = limits["position_upper"][joint] - q > q - limits["position_lower"][joint]
        return trajectory(server, (change if up else -change) * np.eye(7)[joint], duration_s)

    return make


def begun_elsewhere(server: Message) -> Message:
    here = np.array(server["commanded_position"])
    return trajectory(server | {"commanded_position": here + 0.01}, STEP)


def cut_short(server: Message) -> Message:
    message = trajectory(server, STEP)
    return message | {"points": message["points"][: len(message["points"]) // 2]}


BROKEN_RULES: dict[str, tuple[Callable[[Message], Message], str]] = {
    "wrong names": (
        changed(joint_names=[f"joint_{k}" for k in range(7)]),
        "joints must be yumi_joint_1_r.* got joint_0",
    ),
    "wrong order": (reordered, "in this order; got yumi_joint_1_r, yumi_joint_2_r, yumi_joint_3_r"),
    "no accelerations": (at_point(9, accelerations=[]), r"point 9 has \(7, 7, 0\)"),
    "no points": (changed(points=[]), "2 to 500 points; this has 0"),
    "point off the grid": (at_point(9, time_from_start=duration(35_000_000)), "times 4 ms"),
    "stamp off the grid": (
        lambda server: trajectory(server, STEP, ahead_ns=401_000_000),
        "not a multiple of the grid",
    ),
    "too late": (
        lambda server: trajectory(server, STEP, ahead_ns=-400_000_000),
        LATE,
    ),
    "too early": (
        lambda server: trajectory(server, STEP, ahead_ns=20_000_000_000),
        "ahead of the robot server's clock; at most 500 ms",
    ),
    "too long": (lambda server: trajectory(server, STEP, 2.4), "2 to 500 points; this has 601"),
    "far too long": (lambda server: trajectory(server, STEP, 3.0), "bytes; at most 131072"),
    "does not end at rest": (cut_short, "must end at rest"),
    "jump at the start": (begun_elsewhere, "splice: position of yumi_joint_1_r steps by 0.01 rad"),
    "jump on the way": (
        lambda server: at_point(125, positions=server["commanded_position"])(server),
        "joint velocity: .* is outside the bound",
    ),
    "not a number": (at_point(9, positions=[float("nan")] * 7), "positions hold .* not finite"),
    "infinite": (at_point(9, velocities=[float("inf")] * 7), "velocities hold .* not finite"),
    "position limit": (moved(1, 3.4, 1.996), "joint position"),
    "velocity limit": (moved(0, 1.0, 1.0), "joint velocity"),
    "acceleration limit": (moved(4, 0.6, 0.4), "joint acceleration"),
    "jerk limit": (moved(4, 0.02, 0.1), "joint jerk"),
    "hand too fast": (moved(0, 0.7, 1.0), "tool speed"),
    "out of the workspace": (moved(0, 0.6, 1.996), "outside the workspace"),
}


@pytest.mark.parametrize("rule", BROKEN_RULES)
def test_trajectory_that_breaks_a_rule_is_refused_with_the_reason(
    peer: Peer, commander: str, rule: str
) -> None:
    make, reason = BROKEN_RULES[rule]
    for _ in range(ATTEMPTS):
        armed(peer)
        earlier = eventually(lambda: [s for s in peer.statuses() if s.get("event") == "arm"])[0]
        server = peer.describe()
        peer.ask("publish", topic=COMMANDS, message=make(server))
        told = eventually(lambda: [s for s in peer.statuses() if s["refusal"]])[0]
        if LATE not in told["refusal"] or reason == LATE:
            break
    assert re.search(reason, told["refusal"]), told["refusal"]
    assert told["level"] == 1
    assert told["accepted"] == earlier["accepted"]
    assert int(told["refused"]) == int(earlier["refused"]) + 1
    after = peer.describe()
    assert after["state"] == "holding"
    assert after["commanded_position"] == server["commanded_position"]


def test_arm_stays_where_it_is_through_all_of_them(peer: Peer, commander: str) -> None:
    armed(peer)
    refused = int(eventually(peer.statuses)[-1]["refused"])
    before = peer.position()[:7]
    peer.ask("take", topic="/yumi/joint_states")
    for make, _ in BROKEN_RULES.values():
        assert peer.call("/yumi/arm")[0]  # anew, lest the lease runs out meanwhile
        peer.ask("publish", topic=COMMANDS, message=make(peer.describe()))
    time.sleep(0.6)  # by then each of them, executed, would be on its way
    taken = peer.ask("take", topic="/yumi/joint_states")
    q = np.array([sample["message"]["position"][:7] for sample in taken])
    assert len(q) > 25
    np.testing.assert_allclose(q, np.broadcast_to(before, q.shape), atol=1e-3)
    told = eventually(peer.statuses)[-1]
    assert told["state"] == "holding"
    assert int(told["refused"]) == refused + len(BROKEN_RULES)


def test_second_peer_does_not_get_the_arm(peer: Peer, commander: str) -> None:
    other = peer.ask("publisher", topic=COMMANDS, type_name=TRAJECTORY, name="other")["gid"]
    server, _, moving = executed(peer)
    assert moving["commander"] == commander
    success, reason = peer.call("/yumi/arm")
    assert not success
    assert f"commander {commander[:8]} holds the arm" in reason
    peer.ask("publish", topic=COMMANDS, message=trajectory(server, STEP), name="other")
    told = eventually(lambda: [s for s in peer.statuses() if s["refusal"]])
    assert f"{other[:8]} is not the commander {commander[:8]}" in told[0]["refusal"]
