"""The secured link with a real robot server: what each role may do there."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pytest
import zenoh
from scripted_open_press_close import ScriptedOpenPressClose
from secured_commands import STEP, describe, eventually, motion_chunk, server_counts
from secured_link import SecuredLink, robot_process

from skewmi.cli.main import main
from skewmi.deploy.options import DeployOptions
from skewmi.deploy.recording.reader import read_recording
from skewmi.deploy.run import run_deploy
from skewmi.deploy.wire import ros2_keys, topics
from skewmi.deploy.wire.access import Role
from skewmi.deploy.wire.messages import (
    JointStates,
    decode_joint_states,
    decode_status,
    encode_joint_states,
)
from skewmi.deploy.wire.transport import Link
from skewmi.errors import TransportError
from skewmi.robot_models import yumi
from skewmi.sim.tasks.open_press_close.definition import make_layout


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
        assert report.robot == str(link.file(Role.COMMANDER))
        # From the command line real time against lock-step: it is this robot server that is
        # asked, and none of its own is started beside it.
        arguments = ["--zenoh-config", str(link.file(Role.COMMANDER))]
        assert main(["deploy", "open_press_close", *arguments]) == 2
        assert "lock-step" in capsys.readouterr().err


@pytest.mark.parametrize("own_rules", [True, False], ids=["as made", "own rules removed"])
def test_observer_reads_states_and_nothing_else(
    secured: SecuredLink, commander: Link, own_rules: bool
) -> None:
    publisher = commander.publisher(topics.YUMI_TRAJECTORY)
    readable = (
        topics.YUMI_JOINT_STATES,
        topics.YUMI_CONTROLLER_STATE,
        topics.YUMI_SCENE_STATES,
        topics.YUMI_STATUS,
    )
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
