"""The link: keys and tokens as rmw_zenoh spells them, and delivery between two processes."""

from __future__ import annotations

import json
import os
import re
import select
import signal
import socket
import struct
import subprocess
import sys
import textwrap
import threading
import time

import numpy as np
import pytest
import xxhash
import zenoh

from skewmi.deploy.safety.validation import ValidationRules
from skewmi.deploy.wire import ros2_keys, ros2_types, topics
from skewmi.deploy.wire.channels import Request
from skewmi.deploy.wire.messages import (
    TriggerReply,
    encode_chunk,
    encode_trigger_request,
)
from skewmi.deploy.wire.ros2_keys import EntityKind
from skewmi.deploy.wire.topics import (
    YUMI_ARM,
    YUMI_DESCRIBE,
    YUMI_JOINT_STATES,
    YUMI_SCENE_RESET,
    YUMI_STOP,
    YUMI_TRAJECTORY,
)
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.deploy.wire.transport_config import MAX_MESSAGE_BYTES
from skewmi.errors import CommandRefusedError, ConfigurationError, TransportError
from skewmi.robot_models import yumi
from skewmi.trajectory import GRID_NS, JointTrajectory, TrajectoryChunk

PEER = """
import sys, time
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.transport import Link, TransportConfig
with Link.open(TransportConfig.for_client(sys.argv[1]), "peer") as link:
    {body}
"""


@pytest.fixture
def locator() -> str:
    """A loopback port that is free now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def start_peer(locator: str, body: str) -> subprocess.Popen[str]:
    """Another process with a link, running `body`."""
    code = PEER.format(body=textwrap.indent(textwrap.dedent(body), "    ").strip())
    return subprocess.Popen(
        [sys.executable, "-c", code, locator],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def output_of(peer: subprocess.Popen[str]) -> str:
    out, error = peer.communicate(timeout=30)
    assert peer.returncode == 0, error
    return out.strip()


def eventually(condition, timeout_s: float = 5.0):
    """First true value of `condition()`."""
    deadline = time.monotonic() + timeout_s
    while not (value := condition()):
        assert time.monotonic() < deadline, "never became true"
        time.sleep(0.01)
    return value


def test_type_hashes_are_those_of_ros2():
    # As ros2 computes them; the service's covers request, response and event.
    assert ros2_types.type_hash(topics.JOINT_TRAJECTORY) == (
        "RIHS01_179b33eba59d676f6d967ac71fe35e7ca2f64b2f3928f4a018cec115e213796e"
    )
    assert ros2_types.type_hash(topics.JOINT_STATE) == (
        "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"
    )
    assert ros2_types.type_hash(topics.TRIGGER) == (
        "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"
    )


@pytest.mark.parametrize("topic", [*topics.TOPICS, *topics.SERVICES], ids=lambda t: t.name)
def test_keys_and_tokens_have_the_form_of_rmw_zenoh(topic):
    chunk = r"[^/%*$?#]+"
    kind = "srv" if topic.type_name == topics.TRIGGER else "msg"
    types = rf"{chunk}::{kind}::dds_::{chunk}_/RIHS01_[0-9a-f]{{64}}"
    assert re.fullmatch(rf"5{topic.name}/{types}", ros2_keys.data_key(5, topic))
    node = ros2_keys.Node(5, "ab12", "skewmi_endpoint")
    assert ros2_keys.node_token(node) == "@ros2_lv/5/ab12/0/0/NN/%/%/skewmi_endpoint"
    token = ros2_keys.endpoint_token(node, 3, EntityKind.PUBLISHER, topic, "::,10:,:,:,,")
    name = topic.name.replace("/", "%")
    pattern = rf"@ros2_lv/5/ab12/0/3/MP/%/%/skewmi_endpoint/{name}/{types}/::,10:,:,:,,"
    assert re.fullmatch(pattern, token)
    zenoh.KeyExpr(token)  # Zenoh accepts it as a key
    assert ros2_keys.session_of_token(token) == "ab12"


def test_attachment_is_what_zenoh_serializes():
    entity_gid = ros2_keys.gid("@ros2_lv/0/a/0/1/MP/%/%/n")
    attachment = ros2_keys.encode_attachment(7, 1_700_000_000_123_456_789, entity_gid)
    expected = zenoh.ext.z_serialize(
        (zenoh.ext.Int64(7), zenoh.ext.Int64(1_700_000_000_123_456_789), entity_gid)
    )
    assert attachment == expected.to_bytes()
    assert len(attachment) == 33
    assert ros2_keys.decode_attachment(attachment) == (7, 1_700_000_000_123_456_789, entity_gid)
    # Low half first.
    digest = xxhash.xxh3_128_intdigest(b"@ros2_lv/0/a/0/1/MP/%/%/n")
    assert struct.unpack("<QQ", entity_gid) == (digest & (2**64 - 1), digest >> 64)


@pytest.mark.parametrize("attachment", [b"", b"x" * 33, b"\x00" * 32, b"\x00" * 34])
def test_other_attachments_are_refused(attachment):
    with pytest.raises(TransportError):
        ros2_keys.decode_attachment(attachment)


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
            client.subscribe(YUMI_JOINT_STATES),
            client.subscribe(YUMI_JOINT_STATES, depth=None),
        )
        assert newest.latest() is None
        publisher = server.publisher(YUMI_JOINT_STATES)
        eventually(lambda: publisher.put(b"probe") or (every.drain() and newest.take()))
        time.sleep(0.1)
        every.drain()
        newest.take()
        for number in range(100):
            publisher.put(b"%d" % number)
        seen = []
        eventually(lambda: seen.extend(every.drain()) or len(seen) == 100)
        assert [sample.payload for sample in seen] == [b"%d" % n for n in range(100)]
        taken = newest.take()
        assert taken is not None
        assert taken.payload == b"99"
        assert newest.take() is None
        assert newest.latest() is taken
        with pytest.raises(TransportError, match="/yumi/joint_states within"):
            newest.wait(0.02)


def test_lock_step_loses_nothing_that_real_time_could_drop(locator):
    """A thousand chunks overflow the queues to a stalled receiver; blocking delivers them."""
    count = 1000
    with Link.open(TransportConfig.for_robot(locator, lock_step=True), "endpoint") as link:
        peer = start_peer(
            locator,
            f"""
            reader = link.subscribe(topics.YUMI_TRAJECTORY, depth=None)
            reader.wait(20.0)
            print("ready", flush=True)
            samples, end = reader.drain(), time.monotonic() + 20.0
            while (not samples or samples[-1].payload != b"last") and time.monotonic() < end:
                samples += reader.drain()
                time.sleep(0.001)
            counts = [sample.sequence for sample in samples]
            print(counts == list(range(counts[0], counts[0] + len(counts))), len(counts) > {count})
            """,
        )
        publisher = link.publisher(YUMI_TRAJECTORY)
        assert peer.stdout is not None
        # Messages flow only some time after the subscription: send until one has arrived.
        while not select.select([peer.stdout], [], [], 0.01)[0]:
            publisher.put(b"probe")
        assert peer.stdout.readline().strip() == "ready"
        # A receiver that stands still for a moment, as on a loaded machine.
        os.kill(peer.pid, signal.SIGSTOP)
        threading.Timer(0.5, os.kill, (peer.pid, signal.SIGCONT)).start()
        for _ in range(count):
            publisher.put(bytes(12_000))
        publisher.put(b"last")
        assert output_of(peer) == "True True"


# Asks and reads nothing: its session reads no further while the first reply is being handled.
DEAF = """
import zenoh
from skewmi.deploy.wire import messages, ros2_keys
request = messages.encode_trigger_request(b"")
asleep = zenoh.handlers.Callback(lambda reply: time.sleep(60), indirect=False)
key = ros2_keys.data_key(0, topics.YUMI_DESCRIBE)
for _ in range(1500):
    link._session.get(key, asleep, timeout=60.0, payload=request)
    time.sleep(0.0005)
print("asked", flush=True)
time.sleep(60)
"""


def test_a_caller_that_reads_no_replies_does_not_hold_up_the_robot_server(locator):
    """Its session is closed within milliseconds; Zenoh by itself would block for 5 s, twice."""
    answered = 0

    def describe(_: Request) -> TriggerReply:
        nonlocal answered
        answered += 1
        return TriggerReply(True, 60_000 * "x")

    with Link.open(TransportConfig.for_robot(locator), "endpoint") as link:
        service = link.service(YUMI_DESCRIBE, describe, polled=True)
        peer = start_peer(locator, DEAF)
        assert peer.stdout is not None
        longest_s, asked, end = 0.0, False, time.monotonic() + 30.0
        try:
            while time.monotonic() < end:
                started = time.monotonic()
                service.poll()
                longest_s = max(longest_s, time.monotonic() - started)
                time.sleep(0.004)
                if not asked and select.select([peer.stdout], [], [], 0)[0]:
                    asked, end = True, time.monotonic() + 1.0
            assert asked
            assert answered > 10, "hardly a reply was asked for"
            # A busy machine may take the loop's processor for a while.
            assert longest_s < 1.0
            # Another caller is served all the same.
            other = start_peer(locator, "print(len(link.call(topics.YUMI_DESCRIBE, 10).message))")
            eventually(lambda: service.poll() or other.poll() is not None, 20.0)
            assert output_of(other) == "60000"
        finally:
            peer.kill()
            peer.communicate()


def test_only_a_real_time_robot_server_puts_out_who_blocks_and_a_file_may_say_otherwise(tmp_path):
    key = "transport/link/tx/queue/congestion_control/block/wait_before_close"
    zenohs_us = 5_000_000

    def wait_us(config: TransportConfig) -> int:
        return json.loads(config.zenoh().get_json(key))

    assert wait_us(TransportConfig.for_robot()) == 10_000
    assert wait_us(TransportConfig.for_robot(lock_step=True)) == zenohs_us
    assert wait_us(TransportConfig.for_client()) == zenohs_us
    file = tmp_path / "zenoh.json5"
    file.write_text(
        "{transport: {link: {rx: {max_message_size: 1000}, tx: {queue: {congestion_control: "
        "{block: {wait_before_close: 70000}}}}}}}"
    )
    config = TransportConfig.for_robot(zenoh_config=file)
    assert wait_us(config) == 70_000
    assert config.zenoh().get_json("transport/link/rx/max_message_size") == "1000"


@pytest.mark.parametrize("lock_step", [False, True])
def test_longest_messages_pass_and_longer_ones_do_not(locator, lock_step):
    """The server puts no message of more than 256 KiB together; what it sends has no bound."""
    count = ValidationRules(joint_names=yumi.joint_names("right"), grid_ns=GRID_NS).max_points
    numbers = np.random.default_rng(0).normal(size=(count, 7))
    samples = JointTrajectory(numbers, numbers, numbers)
    longest = encode_chunk(TrajectoryChunk.of(0, yumi.joint_names("right"), samples))
    assert 0.3 * MAX_MESSAGE_BYTES < len(longest) < 0.5 * MAX_MESSAGE_BYTES
    scene = 500_000 * "x"
    # A stranger with Zenoh's own settings, who would use shared memory, too.
    strange = zenoh.Config()
    strange.insert_json5("mode", '"client"')
    strange.insert_json5("connect/endpoints", json.dumps([locator]))
    key = ros2_keys.data_key(0, YUMI_TRAJECTORY)
    with (
        Link.open(TransportConfig.for_robot(locator, lock_step=lock_step), "endpoint") as link,
        Link.open(TransportConfig.for_client(locator), "client") as client,
        zenoh.open(strange) as session,
    ):
        link.service(YUMI_DESCRIBE, lambda request: TriggerReply(True, f"{len(request.extra)}"))
        link.service(YUMI_SCENE_RESET, lambda _: TriggerReply(True, scene))
        commands = link.subscribe(YUMI_TRAJECTORY, depth=None)

        def put(payload: bytes) -> None:
            attachment = ros2_keys.encode_attachment(1, 0, bytes(16))
            block = zenoh.CongestionControl.BLOCK  # so that each piece is sure to be sent
            session.put(key, payload, attachment=attachment, congestion_control=block)

        eventually(lambda: put(b"probe") or commands.drain())
        fits, too_long = bytes(MAX_MESSAGE_BYTES - 1000), bytes(MAX_MESSAGE_BYTES + 1)
        # More than once: Zenoh gets its shared memory ready when first there is a use for it.
        for _ in range(3):
            for payload in (longest, fits, too_long, bytes(9_600_000)):
                put(payload)
            time.sleep(0.2)
        put(b"last")
        got: list[bytes] = []
        eventually(lambda: got.extend(s.payload for s in commands.drain()) or b"last" in got, 20.0)
        lengths = [len(payload) for payload in got if payload != b"probe"]
        assert lengths == [*3 * [len(longest), len(fits)], len(b"last")]
        assert longest in got
        assert client.call(YUMI_SCENE_RESET, 10.0).message == scene
        assert client.call(YUMI_DESCRIBE, 10.0, fits).message == str(len(fits))
        with pytest.raises(TransportError, match="no answer from /yumi/describe"):
            client.call(YUMI_DESCRIBE, 0.5, too_long)
        assert client.call(YUMI_DESCRIBE, 10.0).message == "0"


def test_polled_service_answers_in_the_polling_thread(locator):
    with Link.open(TransportConfig.for_robot(locator), "endpoint") as link:
        service = link.service(YUMI_STOP, lambda _: TriggerReply(True, "stopped"), polled=True)
        peer = start_peer(locator, "print(link.call(topics.YUMI_STOP, 5.0).message)")
        eventually(service.poll, 20.0)
        assert output_of(peer) == "stopped"


def test_one_poll_answers_a_bounded_number_of_requests(locator):
    """Else whoever asks faster than is answered would keep the loop that polls."""
    with (
        Link.open(TransportConfig.for_robot(locator), "endpoint") as server,
        zenoh.open(TransportConfig.for_client(locator).zenoh()) as session,
    ):
        service = server.service(YUMI_STOP, lambda _: TriggerReply(True, ""), polled=True)
        key = ros2_keys.data_key(0, YUMI_STOP)
        request = encode_trigger_request(b"")
        eventually(lambda: session.get(key, payload=request) and service.poll())
        replies = [session.get(key, payload=request) for _ in range(30)]
        time.sleep(0.3)
        counts = [service.poll() for _ in range(30)]
        assert max(counts) == 8
        assert sum(counts) >= 30, "what is not answered at once is answered later"
        assert all(next(iter(channel)).ok is not None for channel in replies)


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
        eventually(lambda: server.graph.session_of(publisher.gid) is None, 2.0)
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


def test_default_is_loopback_without_scouting():
    config = TransportConfig.for_robot().zenoh()
    servers = config.get_json("listen/endpoints")
    assert "127.0.0.1:7447" in servers
    assert "0.0.0.0" not in servers
    assert json.loads(config.get_json("connect/endpoints")) == []
    for kind in ("multicast", "gossip"):
        assert config.get_json(f"scouting/{kind}/enabled") == "false"
    assert json.loads(TransportConfig.for_client().zenoh().get_json("listen/endpoints")) == []


def test_zenoh_configuration_file_is_used_and_locators_override_it(tmp_path, locator):
    file = tmp_path / "zenoh.json5"
    file.write_text(
        '{mode: "router", listen: {endpoints: ["tcp/127.0.0.1:1"]}, '
        "scouting: {multicast: {enabled: false}}}"
    )
    config = TransportConfig(listen=(locator,), zenoh_config=file)
    with (
        Link.open(config, "endpoint") as server,
        Link.open(TransportConfig.for_client(locator), "client") as client,
    ):
        server.service(YUMI_DESCRIBE, lambda _: TriggerReply(True, "{}"))
        assert client.wait_for_robot(5.0) == {}


def test_bad_configurations_are_refused(tmp_path):
    with pytest.raises(ConfigurationError, match="no Zenoh configuration file"):
        TransportConfig(zenoh_config=tmp_path / "absent.json5").zenoh()
    broken = tmp_path / "broken.json5"
    broken.write_text("{mode: 3")
    with pytest.raises(ConfigurationError, match=r"broken\.json5"):
        TransportConfig(zenoh_config=broken).zenoh()
    with pytest.raises(ConfigurationError, match=r"127\.0\.0\.1:7447"):
        TransportConfig.for_client("127.0.0.1:7447")
    with pytest.raises(ConfigurationError, match="domain"):
        TransportConfig(domain=300)


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
