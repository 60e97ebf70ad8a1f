"""The scene before a real robot: what is known of the task; resets, if somebody serves them.

An emulated controller has its scene in its own process. It publishes the scene's states itself;
resets go through the robot server, which knows who commands, and from here to the emulator.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from skewmi.deploy.robot.backend import SceneState
from skewmi.deploy.robot.backends.egm.options import TaskFacts
from skewmi.deploy.wire.messages import decode_status
from skewmi.deploy.wire.senders import parse_gid
from skewmi.deploy.wire.topics import DIAGNOSTIC_ARRAY, TRIGGER, Topic
from skewmi.deploy.wire.topics import Service as ServiceName
from skewmi.deploy.wire.transport import LatestReader, Link
from skewmi.errors import CommandRefusedError, TransportError
from skewmi.trajectory import Array

EMULATOR_RESET = ServiceName("/skewmi/emulator/reset", TRIGGER)
"""Of the emulator, for the robot server alone: put scene and arm back to an episode's start."""

EMULATOR_STATUS = Topic("/skewmi/emulator/status", DIAGNOSTIC_ARRAY)
"""What the emulator tells the robot server of its scene: the contact since the last reset, and who
publishes its states."""

SCENE_PUBLISHER = "scene_publisher"
"""Key in that status: global id of the emulator's publisher of scene states, hexadecimal."""

AGAINST_THE_BOX = ("hand_tilt_deg", "outside_box_mm")
"""Of what an emulator tells of contact: against a box in its place, as it knows of no other. Where
the box is known to stand elsewhere they would be wrong, and are not told."""

_MOST_SEED = 10**18


@dataclass(frozen=True)
class ResetRequest:
    """What is asked of `EMULATOR_RESET`, as JSON behind the Trigger request."""

    seed: int
    """Of what the scene draws at a reset."""
    robot_server: str
    """Zenoh id of the session that asks."""

    def to_json(self) -> bytes:
        """One JSON object."""
        return json.dumps({"seed": self.seed, "robot_server": self.robot_server}).encode()

    @staticmethod
    def from_json(request: bytes) -> ResetRequest:
        """Inverse of `to_json`.

        Raises:
            ValueError: It is not such an object; the message says what is wrong.
        """
        content = json.loads(request or b"{}")
        if not isinstance(content, dict):
            raise ValueError("it is not a JSON object")
        seed, robot_server = content.get("seed"), content.get("robot_server")
        if not isinstance(seed, int) or isinstance(seed, bool) or not 0 <= seed < _MOST_SEED:
            raise ValueError("its seed is not a whole number of at most 18 digits, not negative")
        if not isinstance(robot_server, str) or not robot_server:
            raise ValueError("it does not name the robot server")
        return ResetRequest(seed, robot_server)


RESET_TIMEOUT_S = 1.0
_HEARD_S = 1.5
"""An emulator that has not told its status for so long is not there."""


class EgmScene:
    """Satisfies `Scene`.

    Args:
        facts: Of the task.
        link: An open session, to find an emulator on; None if there is none to be found, as before
            a real controller, where somebody else might say that he is one.
        status: What is told of whom on that link.
    """

    simulated = False

    def __init__(
        self, facts: TaskFacts, link: Link | None = None, status: LatestReader | None = None
    ) -> None:
        self.task = facts.task
        self.layout_hashes = facts.layout_hashes
        self.workspace = facts.workspace
        self.known_box = facts.box
        self.shapes_json = facts.shapes_json
        self._link = link
        self._status = status
        self.on_reset: Callable[[], None] = lambda: None
        """Called once the emulator has ended the arm's session for a reset."""
        self._emulator = b""
        """Global id of the one that is listened to."""
        self._publisher: bytes | None = None
        self._heard_s = -_HEARD_S
        self._contact: dict[str, float] = {}

    @staticmethod
    def open(facts: TaskFacts, link: Link | None) -> EgmScene:
        """Listen for an emulator on a link, if there is one."""
        status = None if link is None else link.subscribe(EMULATOR_STATUS)
        return EgmScene(facts, link, status)

    @property
    def resettable(self) -> bool:
        """Whether an emulator is there."""
        self._hear()
        return time.monotonic() - self._heard_s < _HEARD_S

    def publishers(self) -> tuple[bytes, ...]:
        """Global id of the emulator's publisher, as it says itself; empty without an emulator, when
        the user has to name whoever sees the scene."""
        return (self._publisher,) if self.resettable and self._publisher is not None else ()

    def state(self) -> SceneState | None:
        """Somebody else publishes them."""
        return None

    def contact(self) -> Mapping[str, float]:
        """What an emulator has told last."""
        self._hear()
        return self._contact

    def reset(self, seed: int) -> Array:
        """Ask the emulator. The answer comes within a cycle or two; the arm's session ends by it.

        Raises:
            CommandRefusedError: There is none, or it refuses.
        """
        if self._link is None or not self.resettable:
            raise CommandRefusedError(
                "the scene before this robot is real, or its emulator is not connected: put it "
                "back by hand"
            )
        try:
            request = ResetRequest(seed, self._link.session_id).to_json()
            reply = self._link.call(EMULATOR_RESET, RESET_TIMEOUT_S, request)
            if not reply.success:
                raise CommandRefusedError(reply.message)
            q = np.array([float(value) for value in json.loads(reply.message)])
        except (TransportError, ValueError, TypeError) as error:
            raise CommandRefusedError(f"the scene was not reset: {error}") from error
        if q.shape != (7,) or not np.isfinite(q).all():
            raise CommandRefusedError(
                f"the scene was reset, but the arm is said to be at {reply.message[:80]}"
            )
        self._contact = {}
        self.on_reset()
        return q

    def _hear(self) -> None:
        """Take in what an emulator says; no second one while the first is there."""
        for sample in [] if self._status is None else self._status.drain():
            now_s = time.monotonic()
            if sample.gid != self._emulator and now_s - self._heard_s < _HEARD_S:
                continue
            try:
                values = dict(decode_status(sample.payload).values)
                publisher = parse_gid(values.pop(SCENE_PUBLISHER))
                contact = {key: float(value) for key, value in values.items()}
            except (TransportError, ValueError, KeyError):
                continue
            self._emulator, self._publisher, self._heard_s = sample.gid, publisher, now_s
            if self.known_box is not None:
                contact = {k: v for k, v in contact.items() if k not in AGAINST_THE_BOX}
            self._contact = contact
