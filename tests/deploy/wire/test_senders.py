"""Who is believed on a topic: laws over random senders, and bounds on what is remembered."""

from __future__ import annotations

import random
from types import SimpleNamespace

import pytest
import zenoh

from skewmi.deploy.session.trust import Trust
from skewmi.deploy.wire import ros2_keys
from skewmi.deploy.wire.channels import LatestReader
from skewmi.deploy.wire.senders import (
    MAX_BELIEVED,
    MAX_STRANGERS,
    Senders,
    TopicSenders,
    gids_of,
    parse_gid,
)
from skewmi.deploy.wire.topics import YUMI_SCENE_STATES, YUMI_STATUS
from skewmi.errors import TransportError

SCENE = YUMI_SCENE_STATES.name


def gid(number: int) -> bytes:
    return number.to_bytes(16, "little")


def nobody(_: bytes) -> str:
    return ""


@pytest.mark.parametrize("seed", range(20))
def test_exactly_what_believed_senders_count_up_is_admitted(seed: int) -> None:
    rng = random.Random(seed)
    senders = TopicSenders(SCENE, nobody)
    believed = rng.sample(range(40), rng.randint(1, 5))
    senders.believe(map(gid, believed))
    senders.ignore(gid(100))
    last = dict.fromkeys(believed, -(1 << 63) - 1)
    left_out: dict[int, int] = {}
    repeated: dict[int, int] = {}
    for _ in range(2000):
        who = rng.choice([*range(40), 100])
        sequence = rng.choice([rng.randint(-5, 300), -(1 << 63), (1 << 63) - 1, 0])
        admitted = senders.admit(gid(who), sequence)
        assert admitted == (who in believed and sequence > last[who])
        if admitted:
            last[who] = sequence
        elif who in believed:
            repeated[who] = repeated.get(who, 0) + 1
        elif who != 100:
            left_out[who] = left_out.get(who, 0) + 1
    told = senders.strangers()
    assert {s.gid: s.messages for s in told if s.copied} == {
        gid(who).hex(): count for who, count in repeated.items()
    }
    named = [s for s in told if s.gid and not s.copied]
    assert {s.gid: s.messages for s in named}.items() <= {
        gid(who).hex(): count for who, count in left_out.items()
    }.items()
    assert len(named) == min(MAX_STRANGERS, len(left_out))
    assert sum(s.messages for s in told if not s.copied) == sum(left_out.values())
    assert senders.copied == bool(repeated)


def test_nobody_is_believed_before_it_is_said_who_is() -> None:
    senders = Senders(nobody)
    topic = senders.on(YUMI_SCENE_STATES)
    assert not topic.admit(gid(1), 1)
    assert senders.strangers() == []
    senders.believe({SCENE: [gid(1)]})
    assert topic.admit(gid(1), 2)
    assert not senders.on(YUMI_STATUS).admit(gid(1), 3)


def test_strangers_are_told_once_and_bounded_by_number() -> None:
    asked: list[bytes] = []

    def node_of(who: bytes) -> str:
        asked.append(who)
        return "camera" if who == gid(1) else ""

    senders = Senders(node_of)
    senders.believe({SCENE: [gid(0)]})
    topic = senders.on(YUMI_SCENE_STATES)
    assert senders.news() == []
    topic.admit(gid(1), 1)
    (stranger,) = senders.news()
    assert str(stranger) == f"{SCENE}: 01000000 (node camera)"
    topic.admit(gid(1), 2)
    assert senders.news() == []
    for number in range(2, 100_000):
        topic.admit(gid(number), 1)
    assert len(senders.news()) == MAX_STRANGERS
    assert senders.news() == []
    told = senders.strangers()
    assert len(told) == MAX_STRANGERS + 1
    assert sum(s.messages for s in told) == 100_000
    assert str(told[-1]) == f"{SCENE}: others"
    assert len(set(asked)) <= MAX_STRANGERS


def test_server_that_was_restarted_is_no_stranger_and_its_last_messages_neither() -> None:
    senders = Senders(nobody)
    topic = senders.on(YUMI_SCENE_STATES)
    senders.believe({SCENE: [gid(1)]})
    assert topic.admit(gid(1), 7)
    assert not topic.admit(gid(2), 1)
    senders.believe({SCENE: [gid(2)]})
    assert topic.admit(gid(2), 2)
    assert not topic.admit(gid(1), 8)
    assert senders.strangers() == []
    # Believed once more, it goes on counting: what it has said before stays said.
    senders.believe({SCENE: [gid(2)]})
    assert not topic.admit(gid(2), 2)
    assert "two senders use the id 02000000" in str(senders.copied())


def test_everybody_is_a_bounded_number() -> None:
    topic = Senders(nobody, everybody=True).on(YUMI_SCENE_STATES)
    admitted = [topic.admit(gid(number), 1) for number in range(100)]
    assert admitted == [True] * MAX_BELIEVED + [False] * (100 - MAX_BELIEVED)
    assert topic.admit(gid(0), 1)  # nothing is judged when nobody is known
    with pytest.raises(TransportError, match="at most 16"):
        topic.believe(map(gid, range(17)))


@pytest.mark.parametrize("text", ["", "12", "x" * 32, "00" * 17, "é" * 16])
def test_what_is_no_id_is_refused(text: str) -> None:
    with pytest.raises(TransportError, match="is not a publisher's id"):
        gids_of({SCENE: [text]})


def test_ids_are_read_as_ros_2_tools_print_them() -> None:
    assert (
        parse_gid("01.0f" + ".00" * 14) == parse_gid("010f" + "00" * 14) == b"\x01\x0f" + bytes(14)
    )


class Untouchable:
    """A message whose payload must not be looked at."""

    def __init__(self, attachment: bytes) -> None:
        self.attachment = zenoh.ZBytes(attachment)

    @property
    def payload(self) -> zenoh.ZBytes:
        raise AssertionError("the payload of a stranger was looked at")


class Handler:
    """An endless channel of one message; counts how often it is asked."""

    def __init__(self, message: Untouchable) -> None:
        self._message, self.asked = message, 0

    def try_recv(self) -> Untouchable:
        self.asked += 1
        return self._message


def test_nothing_of_a_stranger_is_read_and_a_look_ends_whatever_comes() -> None:
    senders = Senders(nobody)
    senders.believe({SCENE: [gid(1)]})
    for attachment in (ros2_keys.encode_attachment(1, 0, gid(2)), b"", bytes(33), bytes(10**6)):
        handler = Handler(Untouchable(attachment))
        reader = LatestReader(handler, YUMI_SCENE_STATES, 1000, senders.on(YUMI_SCENE_STATES))
        assert reader.drain() == []
        assert handler.asked == 1000
    assert senders.strangers()[0].messages == 1000
    assert gid(2).hex()[:8] in reader.others()


def test_a_second_reader_counts_for_itself_and_believes_the_same() -> None:
    trust = Trust(SimpleNamespace(graph=SimpleNamespace(node_of=nobody)), {}, None)
    trust.senders.believe({SCENE: [gid(1)]})
    for sequence in range(3):
        assert trust.senders.on(SCENE).admit(gid(1), sequence)
    apart = trust.apart(YUMI_SCENE_STATES).on(SCENE)
    for sequence in range(3):
        assert apart.admit(gid(1), sequence)
        assert not apart.admit(gid(2), sequence)
    assert not apart.admit(gid(1), 2), "nobody may say the same again to either"
    assert not trust.senders.on(SCENE).admit(gid(1), 2)
