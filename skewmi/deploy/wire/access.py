"""Who may say what on a secured link: access rules and the Zenoh configuration of each role.

Zenoh checks each message where it enters and where it leaves a session, against the common name
in the certificate of the peer. The robot server's rules are what protects the robot. Commander and
observer carry the same rules mirrored: they listen to nobody but the server, and an observer's
own session keeps its commands back. Whatever no rule allows is dropped without a word.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from enum import StrEnum
from typing import Any

from skewmi.deploy.wire import ros2_keys, topics
from skewmi.deploy.wire.topics import Service, Topic

AUTHORITY_FILE = "authority.pem"
CERTIFICATE_FILE = "certificate.pem"
KEY_FILE = "key.pem"
CONFIG_FILE = "zenoh.json5"


class Role(StrEnum):
    """What a certificate entitles to."""

    ROBOT = "robot"
    """The robot: publishes states, serves arm and stop, follows commands."""
    COMMANDER = "commander"
    """`skewmi deploy` and `skewmi stop`: moves the robot."""
    OBSERVER = "observer"
    """Reads states, changes nothing."""


_READ_BY_ALL = (
    topics.YUMI_JOINT_STATES,
    topics.YUMI_CONTROLLER_STATE,
    topics.YUMI_SCENE_STATES,
    topics.YUMI_STATUS,
)
_WRITTEN_BY_COMMANDER = (
    topics.YUMI_TRAJECTORY,
    topics.YUMI_GRIPPER,
    topics.YUMI_STATUS,  # of the session
    topics.POLICY_OBSERVATION,
    topics.POLICY_ACTION,
)

Rule = tuple[str, str, tuple[str, ...], tuple[str, ...]]
"""Direction ("in" to the robot server or "out" of it), what for, Zenoh's message kinds, keys."""


def access_rules(role: Role, domain: int) -> tuple[Rule, ...]:
    """Everything that a role may exchange with the robot server.

    Args:
        role: Commander or observer.
        domain: ROS 2 domain.
    """

    def keys(*names: Topic | Service) -> tuple[str, ...]:
        return tuple(ros2_keys.data_key(domain, name) for name in names)

    tokens = (f"{ros2_keys.ADMIN_SPACE}/{domain}/**",)
    if role is Role.OBSERVER:
        readable, callable_ = keys(*_READ_BY_ALL), keys(topics.YUMI_DESCRIBE)
    else:
        # A recorder runs with the commander's certificate: it reads commands, too.
        readable, callable_ = keys(*topics.TOPICS), keys(*topics.SERVICES)
    rules: list[Rule] = [
        ("in", "subscribe", ("declare_subscriber",), readable),
        ("out", "receive", ("put",), readable),
        ("in", "call", ("query",), callable_),
        # Zenoh sends a query only where something is declared that answers it.
        ("out", "answer", ("declare_queryable", "reply"), callable_),
        ("in", "watch", ("liveliness_query", "declare_liveliness_subscriber"), tokens),
        ("out", "tokens", ("liveliness_token",), tokens),
    ]
    if role is Role.COMMANDER:
        written = keys(*_WRITTEN_BY_COMMANDER)
        rules += [
            ("in", "publish", ("put",), written),
            # Nor does it send a sample unless it was told that somebody subscribes.
            ("out", "subscribed", ("declare_subscriber",), written),
            ("in", "announce", ("liveliness_token",), tokens),
        ]
    return tuple(rules)


def access_control(role: Role, common_names: Mapping[Role, str], domain: int) -> dict[str, Any]:
    """Zenoh's `access_control` section for the session of a role.

    Args:
        role: Whose session.
        common_names: Of each role's certificate.
        domain: ROS 2 domain.
    """
    if role is Role.ROBOT:
        peers = {peer: access_rules(peer, domain) for peer in (Role.COMMANDER, Role.OBSERVER)}
        flow = {"in": "ingress", "out": "egress"}
    else:
        peers = {Role.ROBOT: access_rules(role, domain)}
        flow = {"in": "egress", "out": "ingress"}
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [
            {
                "id": f"{peer} {purpose}",
                "permission": "allow",
                "flows": [flow[direction]],
                "messages": list(kinds),
                "key_exprs": list(keys),
            }
            for peer, rules in peers.items()
            for direction, purpose, kinds, keys in rules
        ],
        "subjects": [
            {"id": peer.value, "cert_common_names": [common_names[peer]], "link_protocols": ["tls"]}
            for peer in peers
        ],
        "policies": [
            {
                "id": peer.value,
                "subjects": [peer.value],
                "rules": [f"{peer} {purpose}" for _, purpose, _, _ in rules],
            }
            for peer, rules in peers.items()
        ],
    }


def zenoh_configuration(
    role: Role, locator: str, common_names: Mapping[Role, str], domain: int = 0
) -> str:
    """The whole configuration file of a role, JSON5.

    The files it names lie beside it. What it leaves open (queues, time-outs) is filled in by
    `TransportConfig` as for an unsecured link.

    Args:
        role: Whose session.
        locator: tls/HOST:PORT to listen on (robot server) or to connect to.
        common_names: Of each role's certificate.
        domain: ROS 2 domain.
    """
    listens = role is Role.ROBOT
    side = "listen" if listens else "connect"
    tls = {
        "root_ca_certificate": AUTHORITY_FILE,
        f"{side}_certificate": CERTIFICATE_FILE,
        f"{side}_private_key": KEY_FILE,
        "enable_mtls": True,
        "verify_name_on_connect": True,
        "close_link_on_expiration": True,
    }
    config = {
        "mode": "router" if listens else "client",
        "listen": {"endpoints": [locator] if listens else []},
        "connect": {"endpoints": [] if listens else [locator]},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "adminspace": {"enabled": False},
        # No other kind of link is opened or accepted, whatever --listen or --connect say.
        "transport": {"link": {"protocols": ["tls"], "tls": tls}},
        "access_control": access_control(role, common_names, domain),
    }
    head = (
        f"// Zenoh configuration of the {role.value}'s session: mutual TLS, no scouting, access\n"
        "// by certificate. Pass it as --zenoh-config; files it names lie beside it.\n"
    )
    return head + json.dumps(config, indent=2) + "\n"
