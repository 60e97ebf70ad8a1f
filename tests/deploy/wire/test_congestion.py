"""What a link does with more than it can carry: callers without end, long messages, full queues."""

from __future__ import annotations

import json
import os
import select
import signal
import threading
import time

import numpy as np
import pytest
import zenoh
from link_peers import eventually, output_of, start_peer

from skewmi.deploy.safety.validation import ValidationRules
from skewmi.deploy.wire import ros2_keys
from skewmi.deploy.wire.messages import (
    TriggerReply,
    encode_chunk,
    encode_trigger_request,
)
from skewmi.deploy.wire.topics import (
    YUMI_DESCRIBE,
    YUMI_SCENE_RESET,
    YUMI_STOP,
    YUMI_TRAJECTORY,
)
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.deploy.wire.transport_config import MAX_MESSAGE_BYTES
from skewmi.errors import TransportError
from skewmi.robot_models import yumi
from skewmi.trajectory import GRID_NS, JointTrajectory, TrajectoryChunk


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
    closed = threading.Event()

    def note(event: zenoh.TransportEvent) -> None:
        if event.kind == zenoh.SampleKind.DELETE:
            closed.set()

    with Link.open(TransportConfig.for_robot(locator), "endpoint") as link:
        reply = TriggerReply(True, 60_000 * "x")
        service = link.service(YUMI_DESCRIBE, lambda _: reply, polled=True)
        link._session.info.declare_transport_events_listener(note)
        peer = start_peer(locator, DEAF)
        try:
            longest_s, end = 0.0, time.monotonic() + 60.0
            # On a busy computer the caller takes longer to ask.
            while not closed.is_set() and time.monotonic() < end:
                started = time.monotonic()
                service.poll()
                longest_s = max(longest_s, time.monotonic() - started)
                time.sleep(0.004)
            assert closed.is_set(), "who reads no replies keeps the session"
            assert peer.poll() is None, "the caller itself left"
            # A busy machine may take the loop's processor for a while.
            assert longest_s < 1.0
            # Another caller is served all the same.
            other = start_peer(locator, "print(len(link.call(topics.YUMI_DESCRIBE, 10).message))")
            eventually(lambda: service.poll() or other.poll() is not None, 20.0)
            assert output_of(other) == "60000"
        finally:
            peer.kill()
            peer.communicate()


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
