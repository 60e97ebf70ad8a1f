"""The secured link with a real robot server: who gets in, on either side, and for how long."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from secured_commands import describe, eventually, motion_chunk, server_counts
from secured_link import DAY, SecuredLink, now

from skewmi.deploy.wire import topics
from skewmi.deploy.wire.access import Role
from skewmi.deploy.wire.authority import Authority, certificate_pem, key_pem
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.errors import TransportError

REFUSED = {
    "another authority": "unknown ca",
    "expired": "expired",
    "not yet valid": "certificate",
    "no certificate": "certificate required",
    "the robot server's certificate": "unsupported certificate",
    "key of another": "mismatch",
    "no TLS": "no robot server answers",
}


@pytest.mark.parametrize("what", REFUSED)
def test_others_do_not_get_in(secured: SecuredLink, commander: Link, what: str) -> None:
    """Each with the commander's name on its certificate, and no rules of its own."""
    name = secured.common_names[Role.COMMANDER]

    def no_certificate(content: dict[str, Any]) -> None:
        del content["access_control"]
        tls = content["transport"]["link"]["tls"]
        del tls["connect_certificate"], tls["connect_private_key"]
        tls["enable_mtls"] = False

    def robots_certificate(content: dict[str, Any]) -> None:
        del content["access_control"]
        tls = content["transport"]["link"]["tls"]
        tls["connect_certificate"] = "../robot/certificate.pem"
        tls["connect_private_key"] = "../robot/key.pem"

    def other_key(content: dict[str, Any]) -> None:
        content["transport"]["link"]["tls"]["connect_private_key"] = "../observer/key.pem"

    def no_tls(content: dict[str, Any]) -> None:
        del content["access_control"]
        content["connect"]["endpoints"] = [f"tcp/localhost:{secured.plan.port}"]
        content["transport"]["link"]["protocols"] = ["tcp"]

    if what == "another authority":
        stranger = Authority.make(now() - DAY, now() + DAY)
        config = secured.with_certificate(stranger, name, now() - DAY, now() + DAY)
    elif what == "expired":
        config = secured.with_certificate(secured.authority, name, now() - DAY, now() - DAY / 24)
    elif what == "not yet valid":
        config = secured.with_certificate(secured.authority, name, now() + DAY / 24, now() + DAY)
    else:
        change = {
            "no certificate": no_certificate,
            "the robot server's certificate": robots_certificate,
            "key of another": other_key,
            "no TLS": no_tls,
        }[what]
        config = secured.intruder(Role.COMMANDER, change)
    with pytest.raises(TransportError, match=REFUSED[what]) as refusal:
        Link.open(replace(config, connect_timeout_s=1.0), "intruder")
    assert "\n" not in str(refusal.value)
    assert describe(commander).state == "disarmed"


def test_a_certificate_without_a_role_gets_in_but_has_no_rights(
    secured: SecuredLink, commander: Link
) -> None:
    """As one of an earlier issue would be, had the same authority signed it."""
    config = secured.with_certificate(
        secured.authority, "skewmi-commander-0000", now() - DAY, now() + DAY
    )
    counts = server_counts(commander)
    with Link.open(config, "former") as link:
        states = link.subscribe(topics.YUMI_JOINT_STATES)
        publisher = link.publisher(topics.YUMI_TRAJECTORY)
        with pytest.raises(TransportError):
            link.call(topics.YUMI_ARM, 1.0, publisher.gid)
        publisher.put(motion_chunk(describe(commander)))
        with pytest.raises(TransportError):
            states.wait(0.5)
    assert server_counts(commander) == counts


@pytest.mark.parametrize("what", ["observer's certificate", "former robot server's certificate"])
def test_commander_obeys_no_false_robot_server(tmp_path: Path, what: str) -> None:
    """Somebody else listens where the robot server should be."""
    link = SecuredLink(tmp_path)
    if what == "observer's certificate":
        folder = tmp_path / Role.OBSERVER.value
    else:
        folder = tmp_path / "former"
        folder.mkdir()
        certificate, key = link.authority.sign(
            "skewmi-robot server-0000", now() - DAY, now() + DAY, ("localhost", "127.0.0.1")
        )
        (folder / "certificate.pem").write_bytes(certificate_pem(certificate))
        (folder / "key.pem").write_bytes(key_pem(key))

    def impostor(content: dict[str, Any]) -> None:
        del content["access_control"]
        tls = content["transport"]["link"]["tls"]
        tls["listen_certificate"] = str(folder / "certificate.pem")
        tls["listen_private_key"] = str(folder / "key.pem")

    file = link.intruder(Role.ROBOT, impostor).zenoh_config
    with Link.open(TransportConfig.for_robot(zenoh_config=file), "impostor") as server:
        called: list[object] = []
        server.service(topics.YUMI_DESCRIBE, called.append)
        server.service(topics.YUMI_ARM, called.append)
        with (
            pytest.raises(TransportError, match=r"certificate|no robot server answers"),
            Link.open(link.config(Role.COMMANDER), "commander") as commander,
        ):
            commander.wait_for_robot(2.0)
        assert called == []


def test_link_ends_when_the_certificate_does(secured: SecuredLink, commander: Link) -> None:
    """A commander that stays connected is cut off; its arm comes to rest, the others go on."""
    name = secured.common_names[Role.COMMANDER]
    ends = now() + DAY / 86400 * 6
    config = secured.with_certificate(secured.authority, name, now() - DAY, ends)
    with Link.open(config, "short") as link:
        states = link.subscribe(topics.YUMI_JOINT_STATES)
        publisher = link.publisher(topics.YUMI_TRAJECTORY)
        states.wait(5.0)
        assert link.call(topics.YUMI_ARM, 5.0, publisher.gid).success
        eventually(lambda: now() > ends, 30.0)

        def cut_off() -> bool:
            states.take()
            time.sleep(0.5)
            return states.take() is None

        eventually(cut_off, 30.0)
        # Without its commander the robot server disarms.
        eventually(lambda: describe(commander).state == "disarmed", 30.0)
