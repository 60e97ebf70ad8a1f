"""The secured link with a real robot server: who gets in, and what each may do there."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from scripted_open_press_close import ScriptedOpenPressClose
from secured_link import DAY, SecuredLink, now, robot_process

from skewmi.cli.main import main
from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.options import DeployOptions
from skewmi.deploy.recording.reader import read_recording
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.run import run_deploy
from skewmi.deploy.wire import ros2_keys, topics
from skewmi.deploy.wire.access import Role
from skewmi.deploy.wire.authority import Authority, certificate_pem, key_pem
from skewmi.deploy.wire.messages import (
    JointStates,
    decode_joint_states,
    decode_status,
    encode_chunk,
    encode_joint_states,
)
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.errors import TransportError
from skewmi.robot_models import limits as joint_limits
from skewmi.robot_models import yumi
from skewmi.sim.tasks.open_press_close.definition import make_layout
from skewmi.trajectory import TrajectoryChunk

LAB = joint_limits.profile("lab")
STEP = 0.08 * np.array([1, -0.5, 0, 0.5, 0, 1, 0])


@pytest.fixture(scope="module")
def secured(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SecuredLink]:
    link = SecuredLink(tmp_path_factory.mktemp("link"))
    with robot_process("--zenoh-config", str(link.file(Role.ROBOT))):
        yield link


@pytest.fixture
def commander(secured: SecuredLink) -> Iterator[Link]:
    """The rightful one; finds and leaves the robot server disarmed, its arm at the start."""
    with Link.open(secured.config(Role.COMMANDER), "commander") as link:
        link.wait_for_robot(10.0)
        stop_and_rest(link)
        yield link
        stop_and_rest(link)


def stop_and_rest(link: Link) -> None:
    link.call(topics.YUMI_STOP, 5.0)
    eventually(lambda: describe(link).state == "disarmed")
    assert link.call(topics.YUMI_SCENE_RESET, 5.0, b"0").success


def describe(link: Link) -> RobotDescription:
    return RobotDescription.from_json(link.call(topics.YUMI_DESCRIBE, 5.0).message)


def motion_chunk(description: RobotDescription) -> bytes:
    """A good chunk from where the arm is commanded, due soon."""
    start = np.array(description.commanded_position)
    motion = StartMotion(start, start + STEP, LAB)
    stamp_ns = description.clock_ns + 400_000_000
    chunk = TrajectoryChunk.of(stamp_ns, description.joint_names, motion.trajectory)
    return encode_chunk(chunk)


def server_counts(link: Link) -> tuple[int, int]:
    """Commands that reached the robot server so far: accepted, refused."""
    with_status = link.subscribe(topics.YUMI_STATUS, depth=None)
    deadline = time.monotonic() + 10.0
    heard = 0
    while time.monotonic() < deadline:  # the second is surely newer than this call
        for sample in with_status.drain():
            status = decode_status(sample.payload)
            heard += status.name == "skewmi_robot"
            if heard == 2:
                return int(status.values["accepted"]), int(status.values["refused"])
        time.sleep(0.01)
    raise AssertionError("the robot server does not tell its status")


def eventually(condition: Callable[[], Any], timeout_s: float = 10.0) -> Any:
    deadline = time.monotonic() + timeout_s
    while not (value := condition()):
        assert time.monotonic() < deadline, "never became true"
        time.sleep(0.02)
    return value


def test_commander_reads_arms_moves_and_stops(secured: SecuredLink, commander: Link) -> None:
    states = commander.subscribe(topics.YUMI_JOINT_STATES)
    publisher = commander.publisher(topics.YUMI_TRAJECTORY)
    gripper = commander.publisher(topics.YUMI_GRIPPER)
    assert commander.call(topics.YUMI_ARM, 5.0, publisher.gid + gripper.gid).success
    before = decode_joint_states(states.wait(5.0).payload).position[:7]
    accepted, refused = server_counts(commander)
    chunk = motion_chunk(describe(commander))
    publisher.put(chunk)
    eventually(lambda: describe(commander).state == "executing")
    eventually(lambda: describe(commander).state == "holding")
    after = decode_joint_states(states.wait(5.0).payload).position[:7]
    np.testing.assert_allclose(after - before, STEP, atol=0.02)
    assert server_counts(commander) == (accepted + 1, refused)
    assert main(["stop", "--zenoh-config", str(secured.file(Role.COMMANDER))]) == 0
    assert describe(commander).state == "disarmed"


class Briefly(ScriptedOpenPressClose):
    """The script for 30 steps."""

    def reset(self) -> None:
        super().reset()
        self.count = 0

    def act(self, observation: np.ndarray) -> np.ndarray:
        self.count += 1
        if self.count > 30:
            raise ValueError("enough")
        return super().act(observation)


def test_deploy_runs_and_records_over_the_secured_link(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    link = SecuredLink(tmp_path)
    with robot_process("--zenoh-config", str(link.file(Role.ROBOT)), "--lock-step"):
        path = tmp_path / "run.mcap"
        options = DeployOptions(
            lock_step=True, record=path, zenoh_config=link.file(Role.COMMANDER), seed=2
        )
        report = run_deploy(Briefly(make_layout()), options)
        (episode,) = report.episodes
        assert episode.steps == 30, episode
        assert "enough" in episode.reason
        recorded = read_recording(path).messages
        for topic in topics.TOPICS:
            assert recorded[topic.name], f"{topic.name} was not recorded"
        # The same from the command line, with a policy file; nothing is started beside it.
        policy = next((Path(main.__code__.co_filename).parents[1] / "policies").glob("*.onnx"))
        arguments = ["--zenoh-config", str(link.file(Role.COMMANDER)), "--lock-step", "--json"]
        assert main(["deploy", str(policy), *arguments]) == 0
        said = json.loads(capsys.readouterr().out)
        assert said["episodes"] == 1
        assert said["robot"] == str(link.file(Role.COMMANDER))
        # Real time against lock-step: it is this robot server that was asked, none of its own.
        assert main(["deploy", str(policy), *arguments[:2]]) == 2
        assert "lock-step" in capsys.readouterr().err


@pytest.mark.parametrize("own_rules", [True, False], ids=["as made", "own rules removed"])
def test_observer_reads_states_and_nothing_else(
    secured: SecuredLink, commander: Link, own_rules: bool
) -> None:
    publisher = commander.publisher(topics.YUMI_TRAJECTORY)
    readable = (topics.YUMI_JOINT_STATES, topics.YUMI_SCENE_STATES, topics.YUMI_STATUS)
    config = secured.config(Role.OBSERVER) if own_rules else secured.without_rules(Role.OBSERVER)
    with Link.open(config, "observer") as link:
        assert link.wait_for_robot(10.0)["task"] == "open_press_close"
        everything = link._session.declare_subscriber("**", zenoh.handlers.RingChannel(10_000))
        readers = {topic: link.subscribe(topic, depth=None) for topic in topics.TOPICS}
        for topic in readable:
            readers[topic].wait(10.0)
        status = readers[topics.YUMI_STATUS]
        publisher.put(b"a command that nobody else shall see")
        # The robot server tells that it has refused it: by then it would have been passed on.
        eventually(lambda: any(is_refusal(sample.payload) for sample in status.drain()))
        seen = set()
        while (sample := everything.handler.try_recv()) is not None:
            seen.add(str(sample.key_expr))
    assert seen == {ros2_keys.data_key(0, topic) for topic in readable}


def is_refusal(status: bytes) -> bool:
    return bool(decode_status(status).values.get("refusal"))


@pytest.mark.parametrize("own_rules", [True, False], ids=["as made", "own rules removed"])
def test_observer_commands_have_no_effect(
    secured: SecuredLink, commander: Link, own_rules: bool
) -> None:
    config = secured.config(Role.OBSERVER) if own_rules else secured.without_rules(Role.OBSERVER)
    rightful = commander.publisher(topics.YUMI_TRAJECTORY)
    rightful_gripper = commander.publisher(topics.YUMI_GRIPPER)
    with Link.open(config, "observer") as link:
        link.wait_for_robot(10.0)
        states = link.subscribe(topics.YUMI_JOINT_STATES)
        before = decode_joint_states(states.wait(10.0).payload).position
        counts = server_counts(commander)

        # Disarmed: it can neither arm nor reset.
        own = link.publisher(topics.YUMI_TRAJECTORY)
        for service in (topics.YUMI_ARM, topics.YUMI_STOP, topics.YUMI_SCENE_RESET):
            with pytest.raises(TransportError, match="no answer"):
                link.call(service, 1.0, own.gid)
        assert describe(commander).state == "disarmed"

        # Armed by the commander: it neither moves nor stops the arm, even in the other's name.
        gids = rightful.gid + rightful_gripper.gid
        assert commander.call(topics.YUMI_ARM, 5.0, gids).success
        description = describe(commander)
        chunk = motion_chunk(description)
        finger = JointStates(
            description.clock_ns,
            yumi.finger_names("right")[:1],
            np.array([0.02]),
            np.zeros(0),
            np.zeros(0),
        )
        attacks = {
            topics.YUMI_TRAJECTORY: (chunk, rightful.gid),
            topics.YUMI_GRIPPER: (encode_joint_states(finger), rightful_gripper.gid),
        }
        for topic, (payload, gid) in attacks.items():
            key = ros2_keys.data_key(0, topic)
            attachment = ros2_keys.encode_attachment(1, time.time_ns(), gid)
            for spelling in (key, f"0{topic.name}/**", "**"):
                link._session.put(spelling, payload, attachment=attachment)
            link._session.delete(key)
        for wild in ("0/yumi/stop/**", "0/yumi/*/**", "**"):
            for _ in link._session.get(wild, timeout=0.3, payload=b"\x00\x01\x00\x00\x00"):
                pass
        assert server_counts(commander) == counts
        assert describe(commander).commanded_position == description.commanded_position
        after = decode_joint_states(states.wait(10.0).payload).position
        np.testing.assert_allclose(after, before, atol=5e-3)  # it would be 80e-3
        # What it sent was good: from the rightful sender the robot server follows it.
        commander.call(topics.YUMI_STOP, 5.0)
        assert commander.call(topics.YUMI_ARM, 5.0, gids).success
        rightful.put(motion_chunk(describe(commander)))
        eventually(lambda: describe(commander).state == "executing")


def test_observer_cannot_play_the_robot_server(secured: SecuredLink, commander: Link) -> None:
    """Neither its states nor its answers reach the commander."""
    states = commander.subscribe(topics.YUMI_JOINT_STATES, depth=None)
    status = commander.subscribe(topics.YUMI_STATUS, depth=None)
    with Link.open(secured.without_rules(Role.OBSERVER), "impostor") as link:
        link.wait_for_robot(10.0)
        answered = []
        for service in topics.SERVICES:
            link.service(service, answered.append)
        false_states, false_status = (
            link.publisher(topics.YUMI_JOINT_STATES),
            link.publisher(topics.YUMI_STATUS),
        )
        states.wait(5.0)
        for _ in range(20):
            false_states.put(b"false")
            false_status.put(b"false")
            describe(commander)
            time.sleep(0.02)
        senders = {sample.gid for sample in (*states.drain(), *status.drain())}
        assert false_states.gid not in senders
        assert false_status.gid not in senders
        assert senders, "the commander hears nobody"
        assert answered == []
        assert not [token for token in commander.graph.tokens() if link.session_id in token]


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


def test_rules_mirror_each_other(secured: SecuredLink) -> None:
    """What a role's own file lets out is what the robot server's file lets in, and the reverse."""

    def rules(role: Role, peer: Role) -> set[tuple[str, str, str]]:
        text = secured.file(role).read_text()
        section = json.loads(text[text.index("{") :])["access_control"]
        assert section["default_permission"] == "deny"
        (named,) = [s["id"] for s in section["subjects"] if s["cert_common_names"] == [
            secured.common_names[peer]
        ]]  # fmt: skip
        (used,) = [p["rules"] for p in section["policies"] if p["subjects"] == [named]]
        return {
            (flow, kind, key)
            for rule in section["rules"]
            if rule["id"] in used
            for flow in rule["flows"]
            for kind in rule["messages"]
            for key in rule["key_exprs"]
        }

    swap = {"ingress": "egress", "egress": "ingress"}
    for role in (Role.COMMANDER, Role.OBSERVER):
        at_server = rules(Role.ROBOT, role)
        assert {(swap[f], m, k) for f, m, k in rules(role, Role.ROBOT)} == at_server
        assert not [k for _, _, k in at_server if k in ("**", "*")]
    commands = ros2_keys.data_key(0, topics.YUMI_TRAJECTORY)
    observer = rules(Role.ROBOT, Role.OBSERVER)
    assert not [entry for entry in observer if entry[2] == commands]
    assert not [entry for entry in observer if entry[0] == "ingress" and entry[1] == "put"]
