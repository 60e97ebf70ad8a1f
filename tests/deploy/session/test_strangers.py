"""Strangers on the topics of a running session: left out, named, and never a success."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from drawn import rows
from robot_servers import call, describe, robot_in_a_thread
from scripted_runs import EnoughError, Scripted
from strangers import FALSE, SESSION_SUCCESS, solved_scene, stranger, strangers_everywhere

from skewmi.deploy.options import DeployOptions
from skewmi.deploy.recording.reader import BELIEVED, STRANGERS, read_recording
from skewmi.deploy.replay.live_options import LiveOptions
from skewmi.deploy.replay.replay import write_replay
from skewmi.deploy.report import DeployReport
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.run import run_deploy
from skewmi.deploy.session.news import SessionNews
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.channels import LatestReader
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.errors import ConfigurationError, TransportError
from skewmi.policy_io import Array, Policy
from skewmi.sim.tasks.open_press_close.definition import make_layout

SEEN_BY_SESSION = (topics.YUMI_JOINT_STATES, topics.YUMI_SCENE_STATES, topics.YUMI_STATUS)
ATTEMPTS = 5
BUSY = ("no new joint state for", "came too late", "in the past", "the scene state is")
"""What is said of a run on a machine that has no time for it."""


class Idle:
    """A policy that does not touch anything, for so many steps."""

    def __init__(self, steps: int = 30, at_the_end: Callable[[], None] = lambda: None) -> None:
        self.layout = make_layout()
        self._steps, self._at_the_end = steps, at_the_end

    def reset(self) -> None:
        self.observations: list[Array] = []

    def act(self, observation: Array) -> Array:
        self.observations.append(observation)
        if len(self.observations) > self._steps:
            self._at_the_end()
            raise EnoughError("enough")
        return np.array([0.0, 0.0, 1.0])


class IdleUntilNamed(Idle):
    """An idle policy that somebody comes to, until the session says on the link that it has heard.

    Args:
        statuses: Of a subscriber to `/yumi/status`.
        come: Begins to send there.
    """

    LONGEST_S = 60.0

    def __init__(self, statuses: LatestReader, come: Callable[[], None]) -> None:
        super().__init__(5, come)
        self._statuses = statuses
        self._deadline: float | None = None

    def act(self, observation: Array) -> Array:
        if self._deadline is None:
            try:
                return super().act(observation)
            except EnoughError:
                self._deadline = time.monotonic() + self.LONGEST_S
        for sample in self._statuses.drain():
            news = SessionNews.decode(sample.payload)
            if news is not None and "stranger" in news.strangers:
                raise EnoughError("enough")
        assert time.monotonic() < self._deadline, "the session does not name the stranger"
        # In lock-step the arm waits for it.
        time.sleep(0.01)
        return np.array([0.0, 0.0, 1.0])


def in_real_time(policy: Policy, locator: str) -> DeployReport:
    """A run in real time; again if the machine was too busy for it."""
    for _ in range(ATTEMPTS):
        report = run_deploy(policy, DeployOptions(connect=locator, lead_ms=100.0))
        if not any(busy in report.episodes[0].reason for busy in BUSY):
            break
    return report


def named(report: DeployReport) -> set[tuple[str, str]]:
    return {(s.topic, s.node) for s in report.strangers if not s.copied}


@pytest.mark.slow
def test_strangers_change_nothing_and_each_is_named_once(lock_step_robot: str) -> None:
    words: list[str] = []
    with ExitStack() as stack:
        ids = {
            topic.name: stack.enter_context(
                stranger(lock_step_robot, topic, node="driver", rate=50)
            )
            for topic in SEEN_BY_SESSION
        }
        options = DeployOptions(connect=lock_step_robot, lock_step=True)
        report = run_deploy(Scripted(), options, on_event=words.append)
    assert report.successes == 1, report.as_dict()
    assert {s.topic: s.gid for s in report.strangers} == ids
    assert all(s.messages > 10 and s.node == "driver" for s in report.strangers)
    warnings = [word for word in words if word.startswith("warning: ")]
    assert len(warnings) == len(ids)
    for topic, gid in ids.items():
        assert any(f"{topic}: {gid[:8]} (node driver)" in word for word in warnings)
    told = json.loads(json.dumps(report.as_dict()))["strangers"]
    assert {(s["topic"], s["gid"]) for s in told} == set(ids.items())


def assert_no_success(report: DeployReport, policy: Idle) -> None:
    """Though a stranger shows the button pressed."""
    assert report.successes == 0
    assert report.episodes[0].reason == "enough", report.as_dict()
    button = make_layout().observation_names.index("button_depth")
    assert max(float(o[button]) for o in policy.observations) < 1e-3
    assert named(report) == {("/yumi/scene_states", "stranger")}


def test_false_success_is_none(lock_step_robot: str) -> None:
    policy = Idle()
    # Stamped so that it would be taken: up to the arm's time.
    with stranger(lock_step_robot, topics.YUMI_SCENE_STATES, solved_scene(0)):
        report = run_deploy(policy, DeployOptions(connect=lock_step_robot, lock_step=True))
    assert_no_success(report, policy)


@pytest.mark.parametrize(
    ("topic", "how"),
    [
        (topics.YUMI_SCENE_STATES, "ahead"),
        pytest.param(topics.YUMI_SCENE_STATES, "before", marks=pytest.mark.slow),
        pytest.param(topics.YUMI_JOINT_STATES, "ahead", marks=pytest.mark.slow),
        pytest.param(topics.YUMI_JOINT_STATES, "before", marks=pytest.mark.slow),
    ],
)
def test_stranger_with_a_copied_id_ends_the_run(
    lock_step_robot: str, topic: topics.Topic, how: str
) -> None:
    with stranger(lock_step_robot, topic, copy=how, rate=2000.0):
        options = DeployOptions(connect=lock_step_robot, lock_step=True)
        report = run_deploy(Idle(300), options)
    assert report.successes == 0
    assert report.faulted, report.as_dict()
    assert f"on {topic.name}: what the robot server sends cannot be told" in report.stops[0]
    assert any(s.copied and s.topic == topic.name for s in report.strangers)
    # It is gone now: the next run is as good as any.
    assert run_deploy(Idle(3), options).episodes[0].reason == "enough"


@pytest.mark.slow
def test_strangers_are_in_the_sessions_status_and_not_in_the_recording(
    lock_step_robot: str, tmp_path: Path
) -> None:
    path, shown = tmp_path / "run.mcap", tmp_path / "live.rrd"
    options = DeployOptions(
        connect=lock_step_robot,
        lock_step=True,
        record=path,
        live=LiveOptions(out=shown),
    )
    with strangers_everywhere(lock_step_robot) as ids:
        report = run_deploy(Idle(10), options)
    assert {s.topic: s.gid for s in report.strangers} == ids
    recording = read_recording(path)
    believed = json.loads(recording.metadata[BELIEVED])
    for topic, recorded in recording.messages.items():
        assert {m.sender for m in recorded} <= set(believed[topic])
        assert not {m.sender for m in recorded} & set(ids.values())
        assert FALSE[topic] not in {m.payload for m in recorded}
    told = {s["gid"] for s in json.loads(recording.metadata[STRANGERS])}
    assert told == set(ids.values())
    news = [SessionNews.decode(m.payload) for m in recording.messages["/yumi/status"]]
    last = [item for item in news if item is not None][-1]
    for topic in SEEN_BY_SESSION:
        assert topic.name in last.strangers
    assert rows(shown)["/policy/action/fields"] == 10
    assert "/policy/observation_in_range/success" not in rows(shown)
    replay = write_replay(path, tmp_path / "replay.rrd")
    assert replay.success_s == ()
    assert len([note for note in replay.notes if "not recorded" in note]) == len(FALSE)
    assert replay.tracking_error_mm is not None
    assert replay.tracking_error_mm < 20.0


def test_status_of_a_stranger_neither_stops_nor_succeeds(lock_step_robot: str) -> None:
    with stranger(lock_step_robot, topics.YUMI_STATUS, SESSION_SUCCESS):
        report = run_deploy(Idle(), DeployOptions(connect=lock_step_robot, lock_step=True))
    assert report.episodes[0].reason == "enough"


@pytest.mark.slow
def test_camera_is_believed_when_it_is_named_and_only_then(lock_step_robot: str) -> None:
    """Here a camera that sees the task solved: success is what the trusted source says."""
    seen = solved_scene(0)
    with stranger(lock_step_robot, topics.YUMI_SCENE_STATES, seen, node="camera") as gid:
        for name in ("camera", "/camera", gid, gid[:10]):
            options = DeployOptions(connect=lock_step_robot, lock_step=True, scene_from=name)
            report = run_deploy(Idle(), options)
            assert report.successes == 1, report.as_dict()
            # The robot server's own scene is not looked at, and that is told.
            assert named(report) == {("/yumi/scene_states", "skewmi_robot")}
        wrong = DeployOptions(connect=lock_step_robot, lock_step=True, scene_from="lamp")
        with pytest.raises(ConfigurationError, match=r"--scene-from lamp: nobody.*node camera"):
            run_deploy(Idle(), wrong)
        with stranger(lock_step_robot, topics.YUMI_SCENE_STATES, node="camera"):
            two = DeployOptions(connect=lock_step_robot, lock_step=True, scene_from="camera")
            with pytest.raises(ConfigurationError, match="more than one publisher"):
                run_deploy(Idle(), two)


def test_two_robot_servers_are_refused(lock_step_robot: str) -> None:
    other = describe(lock_step_robot).to_json()
    options = DeployOptions(connect=lock_step_robot, lock_step=True)
    with (
        stranger(lock_step_robot, topics.YUMI_STATUS, serve=other),
        pytest.raises(TransportError, match="2 robot servers answer on this link"),
    ):
        run_deploy(Idle(), options)


def test_second_server_during_a_run_is_not_listened_to(lock_step_robot: str) -> None:
    """It says that the arm is in fault, at the end, too; the run ends as it would have."""
    description = json.loads(describe(lock_step_robot).to_json())
    false = json.dumps({**description, "state": "fault", "reason": "says a stranger"})
    client = TransportConfig.for_client(lock_step_robot)
    with ExitStack() as stack:

        def come() -> None:
            stack.enter_context(stranger(lock_step_robot, topics.YUMI_STATUS, serve=false))

        link = stack.enter_context(Link.open(client, "watcher"))
        statuses = link.subscribe(topics.YUMI_STATUS, depth=None)
        link.wait_for_robot(60.0)
        options = DeployOptions(connect=lock_step_robot, lock_step=True)
        report = run_deploy(IdleUntilNamed(statuses, come), options)
    assert report.episodes[0].reason == "enough", report.as_dict()
    assert named(report) == {("/yumi/status", "stranger")}


def test_server_that_names_nobody_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with robot_in_a_thread(lock_step=True) as locator:
        to_json = RobotDescription.to_json
        monkeypatch.setattr(
            RobotDescription,
            "to_json",
            lambda self: json.dumps({**json.loads(to_json(self)), "publishers": {}}),
        )
        with pytest.raises(TransportError, match="does not say who publishes"):
            run_deploy(Idle(), DeployOptions(connect=locator, lock_step=True))


def test_server_that_was_restarted_is_met_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its publishers have other ids: those of the description that answers the next run."""
    with robot_in_a_thread(lock_step=True) as locator:
        first = describe(locator).publishers
        report = run_deploy(Idle(3), DeployOptions(connect=locator, lock_step=True))
        assert report.strangers == []
    with robot_in_a_thread(lock_step=True) as locator:
        assert describe(locator).publishers != first
        report = run_deploy(Idle(3), DeployOptions(connect=locator, lock_step=True, episodes=2))
        assert [e.reason for e in report.episodes] == ["enough", "enough"]
        assert report.strangers == []
        assert call(locator, topics.YUMI_STOP)[0]


# Those in real time last: their robot keeps a processor busy for as long as it is there.


def test_false_success_is_none_in_real_time(robot: str) -> None:
    policy = Idle()
    # Stamped so that it would be taken: not too old.
    with stranger(robot, topics.YUMI_SCENE_STATES, solved_scene()):
        report = in_real_time(policy, robot)
    assert_no_success(report, policy)


def test_flood_costs_no_cycle(robot: str) -> None:
    """Ten megabytes a second, of which nothing is decoded.

    With fifty, a slow computer's link may be full: the robot server waits for nobody, and the run
    ends for want of an answer.
    """
    with stranger(robot, topics.YUMI_SCENE_STATES, b"", more_bytes=100_000, rate=100.0):
        report = in_real_time(Idle(20), robot)
    assert report.episodes[0].reason == "enough", report.as_dict()
    (found,) = report.strangers
    assert found.messages > 100
