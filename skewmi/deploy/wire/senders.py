"""Who is believed on each topic, by publisher's global id; everybody else is counted and named.

A message is judged by its attachment alone, before anything of it is copied or decoded, so that a
flood of somebody's costs microseconds each. What is remembered of strangers is bounded.

A global id is a name and no secret: everybody who reads a topic sees it, and whoever may publish
there may copy it. Each publisher counts its messages, though, and a link keeps their order: a
number that repeats or goes back tells that two use one id. Then nobody knows which of them is
right, and whoever acts on the messages has to stop (`Senders.copied`). docs/security.md says what
is left open.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from skewmi.deploy.wire.topics import TOPICS, Topic
from skewmi.errors import TransportError

GID_BYTES = 16
MAX_BELIEVED = 16
"""Publishers that are believed on one topic."""
MAX_STRANGERS = 16
"""Strangers that are told apart on one topic; the messages of more are counted as one."""

SHORT = 8
"""Hexadecimal digits of an id that people are shown."""

_BEFORE_ALL = -(1 << 63) - 1
_NOBODY = ""


@dataclass(frozen=True)
class Stranger:
    """Somebody whose messages were left out."""

    topic: str
    gid: str
    """Hexadecimal; empty for all those beyond `MAX_STRANGERS`."""
    node: str
    """Name of the ROS 2 node, if a liveliness token tells it; else empty."""
    messages: int
    """How many were left out."""
    copied: bool = False
    """Whether they bore a believed publisher's id, with numbers that repeat or go back."""

    def __str__(self) -> str:
        who = f"{self.gid[:SHORT]} (node {self.node or 'unknown'})" if self.gid else "others"
        if self.copied:
            who = f"a second sender with the id of {who}"
        return f"{self.topic}: {who}"


class TopicSenders:
    """Who is believed on one topic. Belongs to one thread.

    Args:
        topic: Its name.
        node_of: Name of the node that an id belongs to, empty if unknown.
        everybody: Believe whoever comes, the first `MAX_BELIEVED`.
    """

    def __init__(
        self, topic: str, node_of: Callable[[bytes], str], *, everybody: bool = False
    ) -> None:
        self.topic = topic
        self._node_of = node_of
        self._everybody = everybody
        self._last: dict[bytes, int] | None = {} if everybody else None
        self._own: frozenset[bytes] = frozenset()
        self._strangers: dict[bytes, int] = {}
        self._others = 0
        self._copied: dict[bytes, int] = {}
        self.changed = False
        """Set when a stranger is heard for the first time; whoever has looked resets it."""

    def believe(self, gids: Iterable[bytes]) -> None:
        """Believe these publishers from now on, and nobody else.

        Raises:
            TransportError: They are too many.
        """
        before, believed = self._last or {}, tuple(gids)
        if len(believed) > MAX_BELIEVED:
            raise TransportError(
                f"{len(believed)} publishers are to be believed on {self.topic}; "
                f"at most {MAX_BELIEVED} can be"
            )
        # Messages of those who were believed before may still be on their way.
        self._own |= before.keys() - set(believed) if len(self._own) < MAX_BELIEVED else set()
        self._last = {gid: before.get(gid, _BEFORE_ALL) for gid in believed}
        for gid in believed:
            self._strangers.pop(gid, None)

    def ignore(self, gid: bytes) -> None:
        """Leave out a publisher's messages without a word: it is one's own."""
        self._own |= {gid}

    def admit(self, gid: bytes, sequence: int) -> bool:
        """Whether to take a message in; counts it if not.

        Args:
            gid: Of its publisher. 16 bytes.
            sequence: The publisher's count.
        """
        if self._last is None:
            return False  # nobody has said yet who is to be believed
        last = self._last.get(gid)
        if last is None:
            if not (self._everybody and len(self._last) < MAX_BELIEVED):
                self._leave_out(gid)
                return False
            last = _BEFORE_ALL
        if sequence <= last and not self._everybody:
            self.changed |= gid not in self._copied
            self._copied[gid] = self._copied.get(gid, 0) + 1
            return False
        self._last[gid] = sequence
        return True

    @property
    def believed(self) -> tuple[bytes, ...]:
        return tuple(self._last or ())

    @property
    def copied(self) -> bool:
        """Whether somebody has sent with a believed publisher's id."""
        return any(gid in (self._last or ()) for gid in self._copied)

    def words(self) -> str:
        """Who else publishes here, to end a complaint with; empty if nobody does."""
        names = [str(stranger).removeprefix(f"{self.topic}: ") for stranger in self.strangers()]
        return f"; not believed on {self.topic}: {', '.join(names[:3])}" if names else ""

    def strangers(self) -> list[Stranger]:
        """Everybody whose messages were left out, in the order of their first."""
        found = [
            Stranger(self.topic, gid.hex(), self._node_of(gid), count, copied)
            for counts, copied in ((self._copied, True), (self._strangers, False))
            for gid, count in counts.items()
        ]
        if self._others:
            found.append(Stranger(self.topic, _NOBODY, _NOBODY, self._others))
        return found

    def _leave_out(self, gid: bytes) -> None:
        if gid in self._own:
            return
        count = self._strangers.get(gid)
        if count is None and len(self._strangers) >= MAX_STRANGERS:
            self.changed |= self._others == 0
            self._others += 1
            return
        self.changed |= count is None
        self._strangers[gid] = (count or 0) + 1


class Senders:
    """Who is believed on every topic of a link. Belongs to one thread.

    Args:
        node_of: Name of the node that a publisher's id belongs to, empty if unknown.
        everybody: Believe whoever comes, the first `MAX_BELIEVED` on each topic.
    """

    def __init__(self, node_of: Callable[[bytes], str], *, everybody: bool = False) -> None:
        self._node_of = node_of
        self._nodes: dict[bytes, str] = {}
        self._topics = {
            topic.name: TopicSenders(topic.name, self._node, everybody=everybody)
            for topic in TOPICS
        }
        self._named: set[tuple[str, str, bool]] = set()

    def on(self, topic: Topic | str) -> TopicSenders:
        """Those of one topic."""
        return self._topics[topic if isinstance(topic, str) else topic.name]

    def believe(self, publishers: Mapping[str, Iterable[bytes]]) -> None:
        """Believe these publishers, by topic, and nobody else there; other topics stay.

        Raises:
            TransportError: They are too many.
        """
        for topic, gids in publishers.items():
            if topic in self._topics:
                self._topics[topic].believe(gids)

    def copied(self) -> str | None:
        """Who is heard twice, in words; None if nobody is."""
        topic = next((senders for senders in self._topics.values() if senders.copied), None)
        if topic is None:
            return None
        twice = topic.strangers()[0]
        return (
            f"two senders use the id {twice.gid[:SHORT]} on {twice.topic}: what the robot server "
            "sends cannot be told from what somebody else does"
        )

    def strangers(self) -> list[Stranger]:
        """Everybody whose messages were left out."""
        return [stranger for senders in self._topics.values() for stranger in senders.strangers()]

    def news(self) -> list[Stranger]:
        """Those who have not been told before; cheap if there is nobody."""
        if not any(senders.changed for senders in self._topics.values()):
            return []
        for senders in self._topics.values():
            senders.changed = False
        fresh = []
        for stranger in self.strangers():
            key = stranger.topic, stranger.gid, stranger.copied
            if key not in self._named:
                self._named.add(key)
                fresh.append(stranger)
        return fresh

    def _node(self, gid: bytes) -> str:
        # A stranger that has left takes its token with it: its name is remembered. What can be
        # asked for is bounded, as strangers are.
        name = self._nodes.get(gid) or self._node_of(gid)
        if name:
            self._nodes[gid] = name
        return name


def gids_of(publishers: Mapping[str, Iterable[str]]) -> dict[str, tuple[bytes, ...]]:
    """Ids by topic from their hexadecimal form.

    Raises:
        TransportError: One is no id.
    """
    return {topic: tuple(map(parse_gid, gids)) for topic, gids in publishers.items()}


def parse_gid(text: str) -> bytes:
    """A global id from its 32 hexadecimal digits; ROS 2 tools put dots between bytes.

    Raises:
        TransportError: It is none.
    """
    try:
        gid = bytes.fromhex(text.replace(".", ""))
    except (ValueError, AttributeError) as error:
        raise TransportError(f"{text!r} is not a publisher's id: {error}") from error
    if len(gid) != GID_BYTES:
        raise TransportError(f"{text!r} is not a publisher's id: it has not 32 hexadecimal digits")
    return gid
