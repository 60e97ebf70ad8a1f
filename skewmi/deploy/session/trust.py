"""Whom a session believes: the robot server that answered, and who publishes the scene.

Before each episode everybody who serves `/yumi/describe` is asked. There must be one; its answer
names the publishers of joint states, scene states and status. From then on only that server's
answers count, and only messages of those publishers; each later description of its own may name
others, such as an emulated controller that has come. A robot server that was restarted has other
ids, and is met anew before the next episode.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from skewmi.deploy.robot.description import SCENE_REQUEST, RobotDescription
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.senders import SHORT, Senders, Stranger, gids_of, parse_gid
from skewmi.deploy.wire.transport import Link
from skewmi.errors import ConfigurationError, TransportError

ANSWER_TIMEOUT_S = 5.0
_OF_SERVER = (topics.YUMI_JOINT_STATES, topics.YUMI_SCENE_STATES, topics.YUMI_STATUS)
_RECORDED = (topics.YUMI_CONTROLLER_STATE,)
"""What a session does not need itself."""


class Trust:
    """Keeps whom to believe; `meet` fills it.

    Args:
        link: An open one.
        own: Global ids of the session's own publishers, by topic.
        scene_from: Who publishes the scene's states, if not whom the robot server names: a node's
            name or a publisher's id.
    """

    def __init__(
        self, link: Link, own: Mapping[str, Iterable[bytes]], scene_from: str | None
    ) -> None:
        self._link = link
        self._own = {topic: tuple(gids) for topic, gids in own.items()}
        self._scene_from = scene_from
        self._scene_gid: bytes | None = None
        self.senders = Senders(link.graph.node_of)
        for topic, gids in self._own.items():
            for gid in gids:
                self.senders.on(topic).ignore(gid)
        self.server = ""
        """Zenoh id of the robot server's session: its answers count."""
        self._believed: dict[str, tuple[bytes, ...]] = {}
        self.on_believed: list[Callable[[dict[str, list[str]]], None]] = []
        """Told `believed` whenever it has changed: those who record and show the run."""
        self.on_stranger: Callable[[list[Stranger]], None] = lambda strangers: None
        """Told of strangers when they are first heard."""

    def meet(self, *, with_scene: bool = False) -> RobotDescription:
        """Find the robot server, and believe its publishers from now on.

        Args:
            with_scene: Whether to ask for the scene, too.

        Raises:
            TransportError: None answers, or more than one, or it does not say who publishes.
            ConfigurationError: Whoever shall publish the scene is not there.
        """
        extra = SCENE_REQUEST if with_scene else b""
        answers = self._link.call_all(topics.YUMI_DESCRIBE, ANSWER_TIMEOUT_S, extra)
        if len(answers) > 1:
            ids = ", ".join(answer.replier for answer in answers)
            raise TransportError(
                f"{len(answers)} robot servers answer on this link (Zenoh sessions {ids}): which "
                "of them is to be believed cannot be told; end all but one, or give them ROS 2 "
                "domains of their own (--domain)"
            )
        description = RobotDescription.from_json(answers[0].message)
        if self._scene_from is not None:
            self._scene_gid = self._scene_source(self._scene_from)
        self.hear(description)
        self.server = answers[0].replier
        return description

    def hear(self, description: RobotDescription) -> None:
        """Believe whom a description of the robot server names.

        Raises:
            TransportError: It does not say who publishes.
        """
        publishers = gids_of(description.publishers)
        if self._scene_gid is not None:
            publishers[topics.YUMI_SCENE_STATES.name] = (self._scene_gid,)
        missing = [topic.name for topic in _OF_SERVER if topic.name not in publishers]
        if missing:
            raise TransportError(
                f"the robot server does not say who publishes {', '.join(missing)}; is it of "
                "another version of skewmi?"
            )
        told = (topic.name for topic in (*_OF_SERVER, *_RECORDED) if topic.name in publishers)
        self._believe({name: publishers[name] for name in told})

    def apart(self, topic: topics.Topic) -> Senders:
        """Those who are believed on a topic now, for a second reader of it.

        Each message counts once: of two readers with the same senders, the one that looks later
        would take every message for a copy.
        """
        senders = Senders(self._link.graph.node_of)
        senders.believe({topic.name: self.senders.on(topic).believed})
        return senders

    @property
    def believed(self) -> dict[str, list[str]]:
        """Global ids by topic, hexadecimal: the robot server's, the scene's and our own."""
        every = {**self._own}
        for topic, gids in self._believed.items():
            every[topic] = (*gids, *every.get(topic, ()))
        return {topic: [gid.hex() for gid in gids] for topic, gids in every.items()}

    def look(self) -> None:
        """Tell of strangers heard for the first time; cheap if there are none.

        Raises:
            TransportError: Somebody sends with the id of a publisher that is believed.
        """
        news = self.senders.news()
        if news:
            self.on_stranger(news)
        copied = self.senders.copied()
        if copied is not None:
            raise TransportError(copied)

    def _believe(self, publishers: dict[str, tuple[bytes, ...]]) -> None:
        if publishers != self._believed:
            self.senders.believe(publishers)
            self._believed = publishers
            for told in self.on_believed:
                told(self.believed)

    def _scene_source(self, name: str) -> bytes:
        """The publisher of scene states that a user has named."""
        announced = self._link.graph.publishers(topics.YUMI_SCENE_STATES)
        asked = name.strip("/")
        digits = asked.replace(".", "").lower()
        found = [gid for gid, node in announced.items() if node == asked]
        if not found and len(digits) >= SHORT:
            found = [gid for gid in announced if gid.hex().startswith(digits)]
        if len(found) == 1:
            return found[0]
        if not found and len(digits) == 32:
            return parse_gid(digits)  # of somebody who announces nothing
        there = ", ".join(f"node {node} ({gid.hex()})" for gid, node in announced.items())
        count = "nobody" if not found else f"more than one publisher ({len(found)})"
        raise ConfigurationError(
            f"--scene-from {name}: {count} of that name or id publishes "
            f"{topics.YUMI_SCENE_STATES.name}; there are: {there or 'none'}"
        )
