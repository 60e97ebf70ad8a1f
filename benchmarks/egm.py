"""How soon the EGM bridge answers a controller while its link is loaded.

A bridge (`skewmi robot --backend egm`) in a process of its own, and a controller, here, that sends
a packet every 4.032 ms and notes when the answer comes. Meanwhile another process loads Zenoh
(chunks that are refused, describe requests, a subscriber that does not read), and a planner runs on
the other core. Beside it, in the same run and in the same way, a bare echo process: what remains
late there is the machine's doing, not the bridge's.

    python benchmarks/egm.py --json --out results/egm.json
"""

from __future__ import annotations

import json
import os
import select
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from common import argument_parser, print_result, progress, write_result
from egm_wire import MCI_STOPPED, Feedback, fields

from skewmi.deploy.realtime import hot_loop
from skewmi.deploy.robot.process import free_port
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.messages import encode_chunk
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.robot_models import yumi
from skewmi.trajectory import JointTrajectory, TrajectoryChunk

PERIOD_NS = 4_032_000
LATE_NS = 2_000_000
"""An answer that takes longer than half a cycle."""
CHUNKS_PER_S = 200
DESCRIBES_PER_S = 10
STEP_DEG = 1e-4
"""By which the last axis differs from packet to packet: 60 s are 1.5 deg."""
CHUNK_POINTS = 60
"""Of a chunk that is refused; some 12 kB."""


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="how long, s")
    parser.add_argument("--role", default=None, help="used by this program for its own children")
    parser.add_argument("--where", default="", help="likewise")
    arguments = parser.parse_args()
    roles = {"echo": _echo, "load": _load, "plan": _plan}
    if arguments.role is not None:
        roles[arguments.role](arguments.where)
        return
    config = {
        "seconds": arguments.seconds,
        "period_ms": PERIOD_NS / 1e6,
        "chunks_per_s": CHUNKS_PER_S,
        "describes_per_s": DESCRIBES_PER_S,
    }
    result = measure(arguments.seconds)
    document = write_result("egm", result, arguments.out, config=config)
    print_result(document, as_json=arguments.json)


def measure(seconds: float) -> dict[str, Any]:
    """Both kinds of answers over the given time."""
    locator = f"tcp/127.0.0.1:{free_port()}"
    bridge_port, echo_port = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_DGRAM)
    bridge = [sys.executable, "-m", "skewmi.cli.main", "robot", "--backend", "egm", "--json"]
    bridge += ["--listen", locator, "--egm-listen", f"127.0.0.1:{bridge_port}"]
    bridge += ["--egm-listen-left", "none", "--end-with-input"]
    with ExitStack() as stack:
        stack.enter_context(_child(bridge))
        stack.enter_context(_child(_own("echo", str(echo_port))))
        stack.enter_context(_child(_own("load", locator)))
        stack.enter_context(_child(_own("plan", "")))
        progress(f"measuring for {seconds:g} s")
        with hot_loop(priority=True) as granted:
            of_bridge, of_echo = _answers(seconds, bridge_port, echo_port)
    return {
        "reply_ms": _percentiles(of_bridge),
        "late_share": _late(of_bridge),
        "echo_ms": _percentiles(of_echo),
        "late_share_echo": _late(of_echo),
        "packets": len(of_bridge),
        "unanswered": int(np.isnan(of_bridge).sum()),
        "granted": granted,
    }


def _answers(seconds: float, *ports: int) -> list[np.ndarray]:
    """Time from sending each packet to its answer, ns, for each port; NaN if none came.

    Answers are time-stamped by the kernel, so that this process' own delays do not count. The
    controller does not guide the arm, so that each answer repeats the angles of the packet that it
    answers: the last axis tells them apart.
    """
    sockets = []
    for port in ports:
        opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        opened.setsockopt(socket.SOL_SOCKET, 35, 1)  # SO_TIMESTAMPNS
        opened.connect(("127.0.0.1", port))
        opened.setblocking(False)
        sockets.append(opened)
    poll = select.poll()
    for opened in sockets:
        poll.register(opened, select.POLLIN)
    count = round(seconds * 1e9 / PERIOD_NS)
    taken = [np.full(count, np.nan) for _ in ports]
    sent = [np.zeros(count, dtype=np.int64) for _ in ports]
    home = np.degrees(yumi.HOME["right"])
    packet = Feedback(axis_7=(home[2],), mci=MCI_STOPPED)
    due_ns = time.monotonic_ns()
    for number in range(count):
        clock_us = 1_700_000_000_000_000 + number * PERIOD_NS // 1000
        packet.sequence, packet.clock = number, divmod(clock_us, 1_000_000)
        packet.axes = (*home[[0, 1, 3, 4, 5]], number * STEP_DEG)
        data = packet.encode()
        for index, opened in enumerate(sockets):
            sent[index][number] = time.time_ns()
            opened.send(data)
        due_ns += PERIOD_NS
        while (left_ns := due_ns - time.monotonic_ns()) > 0:
            ready = {descriptor for descriptor, _ in poll.poll(left_ns / 1e6)}
            for index, opened in enumerate(sockets):
                if opened.fileno() in ready:
                    answered, arrived_ns = _receive(opened)
                    taken[index][answered] = arrived_ns - sent[index][answered]
    for opened in sockets:
        opened.close()
    return taken


def _receive(opened: socket.socket) -> tuple[int, int]:
    """Number of the packet that an answer is for, and when it arrived, ns since 1970."""
    data, ancillary, _, _ = opened.recvmsg(2048, 64)
    stamp = ancillary[0][2]
    arrived_ns = int.from_bytes(stamp[:8], "little") * 1_000_000_000
    arrived_ns += int.from_bytes(stamp[8:16], "little")
    # Both kinds of messages have a part 2 with axes 1 to 6 as its part 1.
    joints = dict(fields(dict(fields(dict(fields(data))[2]))[1]))[1]
    return round(joints / STEP_DEG), arrived_ns


def _percentiles(taken_ns: np.ndarray) -> dict[str, float]:
    answered = taken_ns[~np.isnan(taken_ns)] / 1e6
    names = {"p50": 50.0, "p99": 99.0, "p99.9": 99.9}
    return {name: round(float(np.percentile(answered, q)), 4) for name, q in names.items()}


def _late(taken_ns: np.ndarray) -> float:
    """Share of packets whose answer was late, or did not come within the cycle."""
    return round(float((np.isnan(taken_ns) | (taken_ns > LATE_NS)).mean()), 6)


@contextmanager
def _child(command: list[str]) -> Iterator[None]:
    """A process of this benchmark, once it has said that it is ready."""
    child = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    assert child.stdin is not None
    assert child.stdout is not None
    try:
        if not child.stdout.readline():
            raise RuntimeError(f"{' '.join(command[-4:])} did not start")
        yield
    finally:
        child.stdin.close()
        try:
            child.wait(10)
        except subprocess.TimeoutExpired:
            child.kill()


def _own(role: str, where: str) -> list[str]:
    return [sys.executable, str(Path(__file__).resolve()), "--role", role, "--where", where]


def _until_input_ends() -> threading.Event:
    """Set when the benchmark closes our standard input; tells it that we are ready."""
    ended = threading.Event()

    def wait() -> None:
        while os.read(sys.stdin.fileno(), 4096):
            pass
        ended.set()

    threading.Thread(target=wait, daemon=True).start()
    print(json.dumps({"ready": True}), flush=True)
    return ended


def _echo(port: str) -> None:
    """Send back what comes, with the priority that the bridge asks for."""
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    opened.bind(("127.0.0.1", int(port)))
    opened.settimeout(0.1)
    ended = _until_input_ends()
    with hot_loop(priority=True):
        while not ended.is_set():
            try:
                data, sender = opened.recvfrom(2048)
            except TimeoutError:
                continue
            opened.sendto(data, sender)


def _load(locator: str) -> None:
    """Chunks that nobody may send, questions, and a subscriber that does not read."""
    names = yumi.joint_names("right")
    rest = JointTrajectory.resting(np.array(yumi.HOME["right"]), CHUNK_POINTS)
    chunk = encode_chunk(TrajectoryChunk.of(0, names, rest))
    with Link.open(TransportConfig.for_client(locator), "egm_benchmark") as link:
        publisher = link.publisher(topics.YUMI_TRAJECTORY)
        link.subscribe(topics.YUMI_JOINT_STATES, depth=None)
        ended = _until_input_ends()
        count = 0
        due_s = time.monotonic()
        while not ended.is_set():
            publisher.put(chunk)
            count += 1
            if count % (CHUNKS_PER_S // DESCRIBES_PER_S) == 0:
                link.call(topics.YUMI_DESCRIBE, 5.0)
            due_s = max(due_s + 1.0 / CHUNKS_PER_S, time.monotonic() - 0.1)
            time.sleep(max(0.0, due_s - time.monotonic()))


def _plan(_: str) -> None:
    """What a session does every 20 ms: plan, check, encode."""
    from planner_robot_server import plan_chunks

    from skewmi.sim.arm.scene import workspace_of
    from skewmi.sim.tasks.open_press_close.definition import make_layout

    workspace = workspace_of(make_layout())
    ended = _until_input_ends()
    seed = 0
    while not ended.is_set():
        plan_chunks(workspace, "lab", 50, seed)
        seed += 1


if __name__ == "__main__":
    main()
