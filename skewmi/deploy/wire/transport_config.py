"""How to reach the others: locators, a Zenoh configuration file, and our settings of the link."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skewmi.deploy.wire import zenoh_file
from skewmi.deploy.wire.domain import MAX_DOMAIN
from skewmi.errors import ConfigurationError

DEFAULT_LOCATOR = "tcp/127.0.0.1:7447"
"""Where the robot server listens; 7447 is also where ROS 2 nodes look for their router."""

MAX_MESSAGE_BYTES = 256 * 1024
"""Longest message that a robot server takes in; the longest chunk has some 110 kB."""

_REPLY_WAIT_US = 2_000
"""How long a reply in real time waits for room in the caller's queue before its session is
closed, us; half a tick of the robot server's loop."""


@dataclass(frozen=True)
class TransportConfig:
    """How to reach the others."""

    connect: tuple[str, ...] = ()
    """Zenoh locators to connect to, such as tcp/127.0.0.1:7447."""
    listen: tuple[str, ...] = ()
    """Zenoh locators to listen on."""
    zenoh_config: Path | None = None
    """Zenoh configuration file (JSON5 or YAML); `connect` and `listen`, if given, override it.
    What it leaves open is as without it, see `zenoh_file`."""
    server: bool = False
    """Whether this session is a robot server's, which listens if nothing says where."""
    lock_step: bool = False
    """Block rather than drop when the link is congested."""
    domain: int = 0
    """ROS 2 domain."""
    connect_timeout_s: float = 3.0
    """How long opening waits for somebody to connect to, s."""

    def __post_init__(self) -> None:
        for locator in (*self.connect, *self.listen):
            if not zenoh_file.is_locator(locator):
                raise ConfigurationError(
                    f"{locator!r} is not a Zenoh locator; write one like {DEFAULT_LOCATOR}"
                )
        if not 0 <= self.domain <= MAX_DOMAIN:
            raise ConfigurationError(f"ROS 2 domain {self.domain} is not in 0..{MAX_DOMAIN}")

    @staticmethod
    def for_robot(listen: str | None = None, **options: Any) -> TransportConfig:
        """Configuration of a robot server; by default what the file says, else loopback."""
        return TransportConfig(listen=() if listen is None else (listen,), server=True, **options)

    @staticmethod
    def for_client(connect: str | None = None, **options: Any) -> TransportConfig:
        """Configuration of a session, a stop command or a watcher; by default as for_robot."""
        return TransportConfig(connect=() if connect is None else (connect,), **options)

    def zenoh(self) -> Any:
        """The Zenoh configuration.

        Raises:
            ConfigurationError: The file or a file it names is missing, or Zenoh refuses it.
        """
        listens = self.listens
        defaults = {
            "mode": "router" if listens else "client",
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            "listen/timeout_ms": 0,
            "listen/exit_on_failure": True,
            "connect/timeout_ms": round(1e3 * self.connect_timeout_s),
            "connect/exit_on_failure": True,
            # Zenoh's two 64 KiB batches fill while a receiver is not scheduled for a moment;
            # sixteen, the most it allows, ride out about a second of a running arm.
            "transport/link/tx/queue/size/real_time": 16,
            "transport/link/tx/queue/size/interactive_high": 16,
            # Between programs of one machine it is no faster, and goes round the bound below.
            "transport/shared_memory/enabled": False,
            "listen/endpoints": [DEFAULT_LOCATOR] if listens else [],
            "connect/endpoints": [] if listens else [DEFAULT_LOCATOR],
        }
        if listens:
            # Zenoh allows a gigabyte, which one message could make the robot server put together.
            defaults["transport/link/rx/max_message_size"] = MAX_MESSAGE_BYTES
        if listens and not self.lock_step:
            congestion = "transport/link/tx/queue/congestion_control"
            defaults[f"{congestion}/block/wait_before_close"] = _REPLY_WAIT_US
            # Zenoh waits 1 ms for each peer that has fallen asleep, in the loop that publishes.
            defaults[f"{congestion}/drop/wait_before_drop"] = 0
        config = zenoh_file.load(self.zenoh_config, defaults)
        if self.connect or (self.listen and self.zenoh_config is None):
            config.insert_json5("connect/endpoints", json.dumps(self.connect))
        if self.listen:
            config.insert_json5("listen/endpoints", json.dumps(self.listen))
        zenoh_file.check_protocols(config, self.zenoh_config)
        return config

    @property
    def where(self) -> str:
        """The locators, for messages."""
        return ", ".join(zenoh_file.locators(self.zenoh(), "listen" if self.listens else "connect"))

    @property
    def listens(self) -> bool:
        """Whether others connect to this session."""
        return self.server or bool(self.listen)

    @property
    def unprotected(self) -> tuple[str, ...]:
        """Locators on which other machines reach this session without a certificate."""
        config = self.zenoh()
        locators = zenoh_file.locators(config, "listen")
        return tuple(where for where in locators if zenoh_file.is_unprotected(where, config))
