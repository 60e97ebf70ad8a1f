"""How each fault is brought about."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from fault_cell import Cell
from fault_chunks import rows_of
from fault_link import Delivery, Message
from flood_senders import many_points
from strangers import FALSE

from skewmi.cli.stop import StopCommand, run_stop
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.messages import decode_joint_states, decode_status, encode_joint_states
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.trajectory import CYCLE_NS, CYCLE_TICKS, TrajectoryChunk

Inject = Callable[[Cell], None]
Change = Callable[[TrajectoryChunk], TrajectoryChunk]

DOWN_S = 1.0
FLOOD_BYTES, FLOOD_MESSAGES = 130_000, 60


def silent(topic: topics.Topic) -> Inject:
    """No further state of a kind reaches the session."""

    def inject(cell: Cell) -> None:
        cell.link.on_state = lambda t, message: None if t is topic else message

    return inject


def frozen(topic: topics.Topic) -> Inject:
    """The last state comes again and again, as from a publisher that hangs."""

    def inject(cell: Cell) -> None:
        last: list[Message] = []

        def on_state(t: topics.Topic, message: Message) -> Message:
            if t is not topic:
                return message
            last.append(message)
            return replace(message, payload=last[0].payload)

        cell.link.on_state = on_state

    return inject


def wrong_state(cell: Cell) -> None:
    """Joint states with a NaN."""

    def on_state(topic: topics.Topic, message: Message) -> Message:
        if topic is not topics.YUMI_JOINT_STATES:
            return message
        states = decode_joint_states(message.payload)
        position = states.position.copy()
        position[2] = np.nan
        return replace(message, payload=encode_joint_states(replace(states, position=position)))

    cell.link.on_state = on_state


def first(count: int, fate: Callable[[Message], list[Delivery]]) -> Inject:
    """Do something to so many chunks, and let the others pass."""

    def inject(cell: Cell) -> None:
        seen = 0

        def on_chunk(message: Message) -> list[Delivery]:
            nonlocal seen
            seen += 1
            return fate(message) if seen <= count else [(0.0, message)]

        cell.link.on_chunk = on_chunk

    return inject


def onwards(fate: Callable[[Message], list[Delivery]]) -> Inject:
    """Do something to all chunks from now on."""

    def inject(cell: Cell) -> None:
        cell.link.on_chunk = fate

    return inject


def lost(count: int) -> Inject:
    return first(count, lambda message: [])


doubled = onwards(lambda message: [(0.0, message), (0.0, message)])


def delayed(delay_s: float) -> Inject:
    return onwards(lambda message: [(delay_s, message)])


def reordered(cell: Cell) -> None:
    """The first chunk comes right after the second."""
    held: list[Message] = []

    def fate(message: Message) -> list[Delivery]:
        held.append(message)
        return [] if len(held) == 1 else [(0.0, message), (0.0, held[0])]

    first(2, fate)(cell)


def changed(change: Change) -> Inject:
    """One chunk is replaced."""
    return first(1, lambda message: [(0.0, message.with_chunk(change(message.chunk)))])


def cut_short(cell: Cell) -> None:
    """One message ends in the middle of a point."""
    first(1, lambda m: [(0.0, replace(m, payload=m.payload[: len(m.payload) // 2 - 3]))])(cell)


def next_chunk(cell: Cell) -> Message:
    """What the session would have sent next: the rest of its last chunk, one cycle later."""
    last = cell.link.last_chunk
    assert last is not None
    rest = rows_of(last.chunk, slice(CYCLE_TICKS, None))
    rest = replace(rest, stamp_ns=rest.stamp_ns + CYCLE_NS)
    return last.with_chunk(rest).with_sequence(last.sequence + 1)


def sent_late(change: Change) -> Inject:
    """After the stop another chunk comes from the commander, and it is wrong, too."""

    def inject(cell: Cell) -> None:
        message = next_chunk(cell)
        cell.link.send(message.with_chunk(change(message.chunk)))

    return inject


def cut_short_late(cell: Cell) -> None:
    message = next_chunk(cell)
    cell.link.send(replace(message, payload=message.payload[: len(message.payload) // 2 - 3]))


def planted(cell: Cell) -> None:
    """What `Fault.plant` names happens in the session."""
    cell.session.tell(do="fault")


def killed(cell: Cell) -> None:
    cell.session.kill()


def restarted(number: signal.Signals, wait_s: float = 0.0) -> Inject:
    """The robot server's process ends by a signal, after a while, and a new one is started."""

    def inject(cell: Cell) -> None:
        def restart() -> None:
            time.sleep(wait_s)
            cell.began(time.monotonic())
            if number is signal.SIGKILL:
                cell.server_died_s = time.monotonic()
            cell.robot.end(number)
            cell.robot.start()
            cell.link.connect_robot()

        cell.spawn(restart)

    return inject


def link_silent(cell: Cell) -> None:
    assert cell.proxy is not None
    cell.proxy.silence(DOWN_S)


def link_cut(cell: Cell) -> None:
    assert cell.proxy is not None
    cell.proxy.cut(DOWN_S)


def intruder(cell: Cell) -> None:
    """Another session tries to arm, and sends a chunk that only its sender makes wrong."""
    message = next_chunk(cell)

    def intrude() -> None:
        with Link.open(TransportConfig.for_client(cell.robot.locator), "intruder") as link:
            publisher = link.publisher(topics.YUMI_TRAJECTORY)
            reply = link.call(topics.YUMI_ARM, 5.0, publisher.gid)
            cell.told.append(reply.message)
            publisher.put(message.payload)
            link.call(topics.YUMI_DESCRIBE, 5.0)  # so that it has arrived

    cell.spawn(intrude)


def stranger(topic: topics.Topic) -> Inject:
    """Somebody else publishes false messages on a topic, well-formed, until the run is over."""

    def inject(cell: Cell) -> None:
        def publish() -> None:
            with Link.open(TransportConfig.for_client(cell.link.locator), "stranger") as link:
                publisher = link.publisher(topic)
                while not cell.over.is_set():
                    publisher.put(FALSE[topic.name])
                    time.sleep(0.002)

        cell.spawn(publish)

    return inject


def copied(topic: topics.Topic) -> Inject:
    """Somebody sends what the robot server sends once more, under its id."""

    def inject(cell: Cell) -> None:
        def on_state(t: topics.Topic, message: Message) -> Message:
            if t is topic:
                cell.link.to_session(t, message)
            return message

        cell.link.on_state = on_state

    return inject


def gripper_flood(cell: Cell) -> None:
    """A stranger sends the longest gripper messages at 100 Hz."""

    def flood() -> None:
        with Link.open(TransportConfig.for_client(cell.robot.locator), "stranger") as link:
            publisher = link.publisher(topics.YUMI_GRIPPER)
            link.call(topics.YUMI_DESCRIBE, 5.0)  # so that it is known who listens
            for _ in range(FLOOD_MESSAGES):
                publisher.put(bytes(FLOOD_BYTES))
                time.sleep(0.01)

    cell.spawn(flood)


def hard_to_read(cell: Cell) -> None:
    """One chunk of the commander's is replaced by thousands of points without content."""
    payload = many_points()
    first(1, lambda message: [(0.0, replace(message, payload=payload))])(cell)


def hard_to_read_late(cell: Cell) -> None:
    cell.link.send(replace(next_chunk(cell), payload=many_points()))


def refused_unheard(change: Change) -> Inject:
    """One chunk is replaced, and the status that tells why it was refused is lost."""

    def inject(cell: Cell) -> None:
        changed(change)(cell)

        def on_state(topic: topics.Topic, message: Message) -> Message | None:
            if topic is not topics.YUMI_STATUS or not decode_status(message.payload).values.get(
                "refusal"
            ):
                return message
            cell.link.on_state = None
            return None

        cell.link.on_state = on_state

    return inject


def disarmed(cell: Cell) -> None:
    """Somebody else runs `skewmi stop`."""
    command = StopCommand(connect=cell.robot.locator, json=True)
    cell.spawn(lambda: cell.told.append(f"exit {run_stop(command)}"))


def clock_jump(offset_s: int) -> Inject:
    """The wall clock jumps, for session and robot server alike."""

    def inject(cell: Cell) -> None:
        assert cell.clock is not None
        cell.clock.jump(offset_s)

    return inject
