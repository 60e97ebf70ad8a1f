"""The link: messages and services between processes, and what becomes of whoever is not there."""

from __future__ import annotations

import re
import struct
import subprocess
import sys
import time

import pytest
import zenoh
from link_peers import eventually, output_of, start_peer

from skewmi.deploy.wire import ros2_keys
from skewmi.deploy.wire.channels import Request
from skewmi.deploy.wire.messages import (
    TriggerReply,
)
from skewmi.deploy.wire.topics import (
    YUMI_ARM,
    YUMI_DESCRIBE,
    YUMI_JOINT_STATES,
    YUMI_SCENE_RESET,
    YUMI_STOP,
    YUMI_TRAJECTORY,
)
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.errors import CommandRefusedError, TransportError


def test_messages_and_services_between_two_processes(locator):
    with Link.open(TransportConfig.for_robot(locator), "endpoint") as link:
        publisher = link.publisher(YUMI_JOINT_STATES)
        commands = link.subscribe(YUMI_TRAJECTORY, depth=None)

        def arm(request: Request) -> TriggerReply:
            if request.extra == b"refuse":
                raise CommandRefusedError("somebody else commands")
            return TriggerReply(True, link.graph.session_of(request.gid) or "unknown")

        link.service(YUMI_ARM, arm)
        link.service(YUMI_DESCRIBE, lambda request: TriggerReply(True, '{"backend": "test"}'))
        peer = start_peer(
            locator,
            """
            print(link.wait_for_robot(5.0)["backend"])
            print(link.call(topics.YUMI_ARM, 2.0).message == link.session_id)
            print(link.call(topics.YUMI_ARM, 2.0, b"refuse"))
            states = link.subscribe(topics.YUMI_JOINT_STATES)
            commands = link.publisher(topics.YUMI_TRAJECTORY)
            for _ in range(20):
                sample = states.wait(5.0)
                commands.put(sample.payload)
            print(link.session_id)
            """,
        )
        received, sessions = [], set()
        deadline = time.monotonic() + 20.0
        while len(received) < 20 and time.monotonic() < deadline and peer.poll() is None:
            publisher.put(bytes(12_000) + struct.pack("<I", publisher.sequence))
            time.sleep(0.005)
            new = commands.drain()
            sessions |= {link.graph.session_of(sample.gid) for sample in new}
            received += new
        lines = output_of(peer).splitlines()
    assert lines[:3] == [
        "test",
        "True",
        "TriggerReply(success=False, message='somebody else commands')",
    ]
    assert [sample.sequence for sample in received] == list(range(1, 21))
    # None: the peer had gone when its last commands were looked at.
    assert lines[3] in sessions
    assert sessions <= {lines[3], None}
    counts = [struct.unpack("<I", sample.payload[-4:])[0] for sample in received]
    assert counts == sorted(set(counts))
    assert all(abs(time.time_ns() - sample.source_time_ns) < 60e9 for sample in received)


def test_depth_one_keeps_the_newest_and_latest_remembers_it(locator):
    with (
        Link.open(TransportConfig.for_robot(locator), "endpoint") as server,
        Link.open(TransportConfig.for_client(locator), "client") as client,
    ):
        newest, every = (
            server.subscribe(YUMI_JOINT_STATES),
            server.subscribe(YUMI_JOINT_STATES, depth=None),
        )
        assert newest.latest() is None
        # Not the robot server: it waits for nobody, and drops what is sent in a rush.
        publisher = client.publisher(YUMI_JOINT_STATES)
        eventually(lambda: publisher.put(b"probe") or (every.drain() and newest.take()))
        time.sleep(0.1)
        every.drain()
        newest.take()
        for number in range(100):
            publisher.put(b"%d" % number)
        seen = []

        def all_seen() -> bool:
            # A probe may have been on its way until now.
            seen.extend(sample for sample in every.drain() if sample.payload != b"probe")
            return len(seen) == 100

        eventually(all_seen)
        assert [sample.payload for sample in seen] == [b"%d" % n for n in range(100)]
        taken = newest.take()
        assert taken is not None
        assert taken.payload == b"99"
        assert newest.take() is None
        assert newest.latest() is taken
        with pytest.raises(TransportError, match="/yumi/joint_states within"):
            newest.wait(0.02)


def test_polled_service_answers_in_the_polling_thread(locator):
    with Link.open(TransportConfig.for_robot(locator), "endpoint") as link:
        service = link.service(YUMI_STOP, lambda _: TriggerReply(True, "stopped"), polled=True)
        peer = start_peer(locator, "print(link.call(topics.YUMI_STOP, 5.0).message)")
        eventually(service.poll, 20.0)
        assert output_of(peer) == "stopped"


def test_a_bug_in_a_handler_is_told_to_the_caller(locator):
    def handler(request: Request) -> TriggerReply:
        raise RuntimeError("a bug")

    with (
        Link.open(TransportConfig.for_robot(locator), "endpoint") as server,
        Link.open(TransportConfig.for_client(locator), "client") as client,
    ):
        server.service(YUMI_STOP, handler)
        reply = eventually(lambda: _call_if_there(client))
        assert not reply.success
        assert "a bug" in reply.message


def _call_if_there(client: Link) -> TriggerReply | None:
    try:
        return client.call(YUMI_STOP, 1.0)
    except TransportError:
        return None


def test_tokens_of_a_closed_link_disappear_at_once(locator):
    with Link.open(TransportConfig.for_robot(locator), "endpoint") as server:
        with Link.open(TransportConfig.for_client(locator), "client") as client:
            publisher = client.publisher(YUMI_TRAJECTORY)
            session = client.session_id
            assert eventually(lambda: server.graph.session_of(publisher.gid)) == session
        eventually(lambda: server.graph.session_of(publisher.gid) is None)
        assert not [token for token in server.graph.tokens() if session in token]


def test_samples_without_attachment_are_ignored(locator):
    with Link.open(TransportConfig.for_robot(locator), "endpoint") as server:
        reader = server.subscribe(YUMI_TRAJECTORY, depth=None)
        with zenoh.open(TransportConfig.for_client(locator).zenoh()) as session:
            key = ros2_keys.data_key(0, YUMI_TRAJECTORY)
            entity_gid = bytes(range(16))
            session.put(key, b"bare")
            session.put(key, b"short", attachment=b"123")
            session.put(key, b"good", attachment=ros2_keys.encode_attachment(1, 2, entity_gid))
            samples = eventually(reader.drain)
    assert [sample.payload for sample in samples] == [b"good"]
    assert samples[0].gid == entity_gid


def test_nobody_there_is_said_in_time(locator):
    started = time.monotonic()
    with pytest.raises(TransportError, match=re.escape(locator)):
        Link.open(TransportConfig.for_client(locator, connect_timeout_s=0.3), "client")
    assert time.monotonic() - started < 3.0


def test_robot_server_without_services_is_no_robot_server(locator):
    with (
        Link.open(TransportConfig.for_robot(locator), "endpoint"),
        Link.open(TransportConfig.for_client(locator), "client") as client,
    ):
        with pytest.raises(TransportError, match="no robot server answers"):
            client.wait_for_robot(0.3)
        with pytest.raises(TransportError, match="/yumi/scene/reset"):
            client.call(YUMI_SCENE_RESET, 0.3)


def test_silent_service_times_out(locator):
    with (
        Link.open(TransportConfig.for_robot(locator), "endpoint") as server,
        Link.open(TransportConfig.for_client(locator), "client") as client,
    ):
        server.service(YUMI_STOP, lambda _: TriggerReply(True, ""), polled=True)
        started = time.monotonic()
        with pytest.raises(TransportError, match="no answer from /yumi/stop"):
            client.call(YUMI_STOP, 0.3)
        assert time.monotonic() - started < 2.0


def test_port_in_use_names_port_and_way_out(locator):
    port = locator.rpartition(":")[2]
    with (
        Link.open(TransportConfig.for_robot(locator), "endpoint"),
        pytest.raises(TransportError, match=rf"port {port} on 127.0.0.1 is in use.*--listen"),
    ):
        Link.open(TransportConfig.for_robot(locator), "second")


def test_publishing_on_a_closed_link_is_a_transport_error(locator):
    link = Link.open(TransportConfig.for_robot(locator), "endpoint")
    publisher = link.publisher(YUMI_JOINT_STATES)
    link.close()
    link.close()
    with pytest.raises(TransportError, match="cannot publish"):
        publisher.put(b"late")


def test_process_that_forgets_to_close_still_ends(locator):
    code = f"""
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.messages import (
    TriggerReply,
    encode_chunk,
    encode_trigger_request,
)
from skewmi.deploy.wire.transport import Link, TransportConfig
link = Link.open(TransportConfig.for_robot("{locator}"), "endpoint")
link.service(topics.YUMI_STOP, lambda request: TriggerReply(True, ""))
1 / 0
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, timeout=20, check=False
    )
    assert b"ZeroDivisionError" in done.stderr
