"""The ROS 2 face, seen by independent peers in another process.

`ros2_peer` runs zenoh-ros2-sdk, rosbags and mcap_ros2 without skewmi. It meets a robot process
and a session process as users start them.
"""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
from collections.abc import Iterator

import numpy as np
import pytest
import xxhash
from ros2_peer_process import (
    COMMANDS,
    CONTROLLER,
    DIAGNOSTICS,
    GRID_NS,
    STATE,
    TRAJECTORY,
    TRIGGER,
    Message,
    Peer,
    eventually,
    robot_and_peer,
)

from skewmi import policies
from skewmi.deploy.robot.process import free_port
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.messages import TriggerReply
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.errors import TransportError

ROBOT_SENDS = {
    "/yumi/joint_states": STATE,
    "/yumi/right/controller_state": CONTROLLER,
    "/yumi/scene_states": STATE,
    "/yumi/status": DIAGNOSTICS,
}
SESSION_SENDS = {
    COMMANDS: TRAJECTORY,
    "/yumi/right/gripper": STATE,
    "/yumi/status": DIAGNOSTICS,
    "/skewmi/policy_observation": STATE,
    "/skewmi/policy_action": STATE,
}
SERVICES = ("/yumi/arm", "/yumi/disarm", "/yumi/stop", "/yumi/describe", "/yumi/scene/reset")
# As published with ROS 2 Jazzy; of ros2_control's type as the SDK and rosbags compute it.
HASHES = {
    CONTROLLER: "RIHS01_51d8dd89cc624cbe9daaeeb4d80d6de9b86168ffdc3be41fefc0953e3c26e480",
    TRAJECTORY: "RIHS01_179b33eba59d676f6d967ac71fe35e7ca2f64b2f3928f4a018cec115e213796e",
    STATE: "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    TRIGGER: "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f",
}


@pytest.fixture(scope="module")
def robot() -> Iterator[tuple[str, Peer]]:
    with robot_and_peer() as both:
        yield both


@pytest.fixture(scope="module")
def locator(robot: tuple[str, Peer]) -> str:
    return robot[0]


@pytest.fixture(scope="module")
def peer(robot: tuple[str, Peer]) -> Peer:
    return robot[1]


def test_peer_runs_nothing_of_ours_and_computes_the_published_type_hashes(peer: Peer) -> None:
    about = peer.ask("about")
    assert about["skewmi"] == []
    for number, (type_name, expected) in enumerate(HASHES.items()):
        if type_name != TRIGGER:
            assert peer.subscribe(f"/elsewhere/{number}", type_name) == expected
    names = {topic.name for topic in topics.TOPICS}
    assert names == {*ROBOT_SENDS, *SESSION_SENDS}, "a topic that no peer looks at"
    assert {service.name for service in topics.SERVICES} == set(SERVICES)


def entity(node: str, type_name: str, *, newest_only: bool = False) -> Message:
    return {
        "node": node,
        "type": type_name,
        "reliability": "BEST_EFFORT" if newest_only else "RELIABLE",
        "durability": "VOLATILE",
        "depth": 1 if newest_only else 10,
    }


def without_hash(entities: list[Message]) -> list[Message]:
    assert all(e["hash"] == HASHES.get(e["type"], e["hash"]) for e in entities)
    return [{k: v for k, v in e.items() if k != "hash"} for e in entities]


def test_peer_sees_topics_types_and_qos_of_the_robot(peer: Peer) -> None:
    graph = peer.ask("graph")
    for name, type_name in ROBOT_SENDS.items():
        seen = graph["topics"][name]
        assert seen["types"] == [type_name]
        assert without_hash(seen["publishers"]) == [entity("skewmi_robot", type_name)]
    for name in (COMMANDS, "/yumi/right/gripper"):
        seen = graph["topics"][name]
        assert seen["types"] == [SESSION_SENDS[name]]
        expected = entity("skewmi_robot", SESSION_SENDS[name])
        assert without_hash(seen["subscribers"]) == [expected]
    for name in SERVICES:
        assert graph["services"][name]["types"] == [TRIGGER]
        servers = graph["services"][name]["servers"]
        assert without_hash(servers) == [entity("skewmi_robot", TRIGGER)]


def check_stream(topic: str, node: str, samples: list[Message], tokens: list[str]) -> list[Message]:
    """All decoders agree, the bytes are canonical, and attachments are those of one publisher.

    What finds no room on the way is dropped, never queued behind: a busy computer loses some.
    """
    assert all(s["same_values"] and s["same_bytes"] for s in samples)
    attachments = [s["attachment"] for s in samples]
    assert {a["bytes"] for a in attachments} == {33}
    sequences = np.array([a["sequence"] for a in attachments])
    assert sequences[0] >= 1
    assert np.all(np.diff(sequences) >= 1), "a message twice, or out of order"
    assert sequences[-1] - sequences[0] < 1.1 * len(sequences), "one in ten was lost"
    # By wall clocks, which may be set meanwhile: that they are ns since 1970 is what matters.
    assert all(abs(a["age_s"]) < 600.0 for a in attachments)
    # The gid is the hash of the publisher's token, as rmw_zenoh makes it.
    token = f"/MP/%/%/{node}/{topic.replace('/', '%')}/"
    own = [each.encode() for each in tokens if token in each]
    gids = {xxhash.xxh3_128_intdigest(each).to_bytes(16, "little").hex() for each in own}
    assert {a["gid"] for a in attachments} == gids
    return [s["message"] for s in samples]


def test_peer_decodes_everything_the_robot_sends(peer: Peer) -> None:
    for topic, type_name in ROBOT_SENDS.items():
        peer.subscribe(topic, type_name)
    taken: dict[str, list[Message]] = {topic: [] for topic in ROBOT_SENDS}

    def enough() -> bool:
        for topic, samples in taken.items():
            samples += peer.ask("take", topic=topic)
        return all(len(s) >= (2 if t == "/yumi/status" else 25) for t, s in taken.items())

    eventually(enough)
    tokens = peer.ask("graph")["tokens"]
    received = {t: check_stream(t, "skewmi_robot", s, tokens) for t, s in taken.items()}
    server = peer.describe()
    states = received["/yumi/joint_states"]
    stamps = [m["header"]["stamp"]["sec"] * 10**9 + m["header"]["stamp"]["nanosec"] for m in states]
    sent = [s["attachment"]["sequence"] for s in taken["/yumi/joint_states"]]
    np.testing.assert_array_equal(np.diff(stamps), np.diff(sent) * server["state_period_ns"])
    for message in states:
        assert message["name"] == [*server["joint_names"], "gripper_r_joint"]
        assert len(message["position"]) == len(message["velocity"]) == len(message["effort"]) == 8
    commanded = server["commanded_position"]
    np.testing.assert_allclose(states[-1]["position"][:7], commanded, atol=5e-3)
    for message in received["/yumi/right/controller_state"]:
        assert message["joint_names"] == server["joint_names"]
        assert message["reference"]["positions"] == commanded
        assert message["reference"]["accelerations"] == [0.0] * 7
        assert len(message["feedback"]["effort"]) == 7
        assert message["multi_dof_joint_names"] == []
    assert received["/yumi/scene_states"][-1]["name"] == ["lid_hinge", "button_slide"]
    (status,) = received["/yumi/status"][-1]["status"]
    assert (status["name"], status["hardware_id"]) == ("skewmi_robot", "yumi")
    assert status["message"].startswith(server["state"])


@pytest.mark.parametrize("service", SERVICES)
def test_replies_are_canonical_and_answer_the_client_that_asked(peer: Peer, service: str) -> None:
    by_sdk = peer.call(service)
    (reply,) = peer.ask("call_raw", service=service)
    assert reply["same_values"]
    assert reply["same_bytes"]
    assert by_sdk[0] == reply["message"]["success"]
    # rmw_zenoh finds the waiting call by these two.
    assert reply["attachment"]["bytes"] == 33
    assert reply["attachment"]["sequence"] == 77
    assert reply["attachment"]["gid"] == reply["client"]


def test_peer_serves_our_calls(peer: Peer) -> None:
    """The other way round: a request of ours in the SDK's hands."""
    locator = f"tcp/127.0.0.1:{free_port()}"
    with Link.open(TransportConfig.for_robot(locator), "caller") as link:
        server = Peer(int(locator.rpartition(":")[2]))
        try:
            server.ask("serve", service="/elsewhere/trigger", message="Grüße")
            # A call that is made before the peer's service is known to the link is lost.
            replies: list[TriggerReply] = []

            def answered() -> bool:
                with contextlib.suppress(TransportError):
                    replies.append(link.call(topics.Service("/elsewhere/trigger"), 6.0))
                return bool(replies)

            eventually(answered)
            assert replies == [TriggerReply(True, "Grüße")]
        finally:
            server.close()


def test_peer_sees_and_decodes_everything_the_session_sends(locator: str, peer: Peer) -> None:
    peer.call("/yumi/stop")
    for topic, type_name in SESSION_SENDS.items():
        peer.subscribe(topic, type_name)
    name = sorted(policies.bundled())[0]
    command = [sys.executable, "-m", "skewmi.cli.main", "deploy", name, "--connect", locator]
    command += ["--lead-ms", "100"]  # a busy computer plans slowly
    session = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    taken: dict[str, list[Message]] = {topic: [] for topic in SESSION_SENDS}
    graphs: list[Message] = []

    def enough() -> bool:
        for topic, samples in taken.items():
            samples += peer.ask("take", topic=topic)
        if not graphs and taken[COMMANDS]:
            graph = peer.ask("graph")
            seen = [graph["topics"].get(name, {"publishers": []}) for name in SESSION_SENDS]
            # What a busy computer answers too late is missing from it: asked again.
            if set.intersection(*({e["node"] for e in each["publishers"]} for each in seen)):
                graphs.append(graph)
        return bool(graphs) and len(taken["/skewmi/policy_action"]) >= 5 and all(taken.values())

    try:
        eventually(enough, 120.0)
    finally:
        session.send_signal(signal.SIGINT)
        session.wait(30.0)
    (graph,) = graphs
    (node,) = {e["node"] for e in graph["topics"]["/skewmi/policy_action"]["publishers"]}
    for topic, type_name in SESSION_SENDS.items():
        assert entity(node, type_name) in without_hash(graph["topics"][topic]["publishers"])
    # The robot tells its status on the same topic.
    taken["/yumi/status"] = [
        sample for sample in taken["/yumi/status"] if sample["message"]["status"][0]["name"] == node
    ]
    received = {
        topic: check_stream(topic, node, samples, graph["tokens"])
        for topic, samples in taken.items()
    }
    names = received[COMMANDS][0]["joint_names"]
    assert names == peer.describe()["joint_names"]
    for message in received[COMMANDS]:
        stamp, points = message["header"]["stamp"], message["points"]
        assert stamp["nanosec"] % GRID_NS == 0
        offsets = [p["time_from_start"] for p in points]
        times = [offset["sec"] * 10**9 + offset["nanosec"] for offset in offsets]
        assert times == [k * GRID_NS for k in range(len(points))]
        assert points[-1]["velocities"] == points[-1]["accelerations"] == [0.0] * 7
        assert all(point["effort"] == [] for point in points)
    for topic in ("/skewmi/policy_observation", "/skewmi/policy_action"):
        for message in received[topic]:
            assert len(message["name"]) == len(message["position"]) > 0
