"""The whole chain in two processes over Zenoh: policy, planner, guard, link, simulated robot."""

from __future__ import annotations

import signal
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from robot_servers import describe
from scipy import signal as signals
from scripted_runs import Scripted, give_up
from sent_motion import assert_limits_kept, chunks_of

from skewmi.cli.interrupt import ENDING_SIGNALS
from skewmi.cli.main import main
from skewmi.deploy.options import DeployOptions
from skewmi.deploy.recording.reader import read_recording
from skewmi.deploy.robot.process import free_port
from skewmi.deploy.run import run_deploy
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.messages import (
    decode_joint_states,
    decode_status,
)
from skewmi.errors import ConfigurationError, LayoutMismatchError, TransportError
from skewmi.policy_io import Array
from skewmi.sim.tasks.open_press_close.definition import make_layout
from skewmi.trajectory import GRID_NS


def test_scripted_motion_solves_the_task_within_all_limits(
    lock_step_robot: str, tmp_path: Path
) -> None:
    path = tmp_path / "run.mcap"
    report = run_deploy(
        Scripted(),
        DeployOptions(seed=3, connect=lock_step_robot, lock_step=True, record=path),
    )
    assert report.success_rate == 1.0, report.as_dict()
    assert report.missed_cycles == 0
    assert report.stops == []
    worst = assert_limits_kept(path)
    # What the session reports is what the messages say (it counts unused braking tails, too).
    assert worst["velocity"] <= report.usage.velocity + 1e-6
    assert worst["velocity"] > 0.2, "the arm hardly moved: the check above shows nothing"
    assert report.usage.jerk <= 1.0 + 1e-6

    recording = read_recording(path)
    scene = [decode_joint_states(m.payload) for m in recording.messages["/yumi/scene_states"]]
    lid = np.array([s.position[s.names.index("lid_hinge")] for s in scene])
    button = np.array([s.position[s.names.index("button_slide")] for s in scene])
    assert lid.max() > 1.5, "the lid was never open"
    assert abs(lid[-1]) < 0.035
    assert button[-1] > 0.010
    statuses = [decode_status(m.payload) for m in recording.messages["/yumi/status"]]
    session = [s.values["state"] for s in statuses if s.name == "skewmi_deploy"]
    assert session[:4] == ["to start", "running", "success", "holding"]


def test_smoothness_is_that_of_what_was_sent(lock_step_robot: str, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    options = DeployOptions(seed=3, connect=lock_step_robot, lock_step=True, record=path)
    (episode,) = run_deploy(Scripted(), options).episodes
    acted = read_recording(path).messages[topics.POLICY_ACTION.name]
    began_ns = min(decode_joint_states(message.payload).stamp_ns for message in acted)
    chunks = [chunk for chunk in chunks_of(path) if chunk.stamp_ns >= began_ns]
    parts = [
        before.trajectory.a[: (after.stamp_ns - before.stamp_ns) // GRID_NS]
        for before, after in pairwise(chunks)
    ]
    # The first still is of the way to the start, which has ended.
    assert not parts.pop(0).any()
    frequency, power = signals.periodogram(
        np.concatenate(parts), 1e9 / GRID_NS, detrend=False, axis=0
    )
    for name, least in (("power_above_10_hz", 10.0), ("power_above_20_hz", 20.0)):
        above = power[frequency > least].sum(0) / power.sum(0)
        assert episode.smoothness[name] == pytest.approx(above.max(), rel=1e-6), name
        assert above.max() > 1e-4, "the arm hardly moved: nothing is shown"


def test_lock_step_runs_are_repeatable(lock_step_robot: str, tmp_path: Path) -> None:
    def stop_early(action: Array) -> Array:
        raise ValueError("enough")

    recorded = []
    for name in ("first", "second"):
        path = tmp_path / f"{name}.mcap"
        options = DeployOptions(seed=7, connect=lock_step_robot, lock_step=True, record=path)
        report = run_deploy(Scripted(30, stop_early), options)
        assert report.faulted
        recorded.append(np.concatenate([chunk.trajectory.q for chunk in chunks_of(path)]))
    np.testing.assert_array_equal(*recorded)


class Fumbling:
    """Opens and shuts the fingers, with the hand about where it starts, until it has enough."""

    layout = make_layout(gripper_action=True)

    def reset(self) -> None:
        self.rng, self.count = np.random.default_rng(5), 0

    def act(self, observation: Array) -> Array:
        self.count += 1
        if self.count > 60:
            give_up()
        return np.array([0.0, 0.2, 0.2, 1.0]) * self.rng.uniform(-1.0, 1.0, 4)


def test_lock_step_waits_for_commands_of_the_fingers_too(
    lock_step_robot: str, tmp_path: Path
) -> None:
    measured: list[dict[int, Array]] = []
    for name in ("first", "second"):
        path = tmp_path / f"{name}.mcap"
        options = DeployOptions(seed=7, connect=lock_step_robot, lock_step=True, record=path)
        assert run_deploy(Fumbling(), options).episodes[0].reason == "enough"
        messages = read_recording(path).messages
        states, actions = (
            [decode_joint_states(message.payload) for message in messages[topic.name]]
            for topic in (topics.YUMI_JOINT_STATES, topics.POLICY_ACTION)
        )
        # What was before is the way to the start, from wherever the arm was.
        began_ns = actions[0].stamp_ns
        measured.append({state.stamp_ns - began_ns: state.position for state in states})
    # A busy computer may lose some of what is recorded, and an action, but hardly the first.
    both = sorted(at for at in measured[0].keys() & measured[1].keys() if at >= 0)
    first, second = (np.array([each[at] for at in both]) for each in measured)
    assert np.ptp(first[:, -1]) > 0.005, "the fingers hardly moved: nothing is shown"
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize(
    ("what", "outcome", "reason"),
    [
        (lambda action: action * np.nan, "stopped", "finite"),
        (lambda action: 1 / 0, "fault", "ZeroDivisionError"),
        (lambda action: action[:2], "fault", "Error"),
    ],
    ids=["nan", "exception", "shape"],
)
def test_broken_policy_ends_at_rest_with_the_reason(
    lock_step_robot: str, tmp_path: Path, what, outcome: str, reason: str
) -> None:
    path = tmp_path / "run.mcap"
    options = DeployOptions(connect=lock_step_robot, lock_step=True, record=path)
    report = run_deploy(Scripted(12, what), options)
    (episode,) = report.episodes
    assert episode.outcome == outcome
    assert reason in episode.reason
    assert report.stops == [episode.reason]
    assert describe(lock_step_robot).state == "disarmed"
    assert_limits_kept(path)


def test_pace_and_layout_must_agree(lock_step_robot: str) -> None:
    with pytest.raises(ConfigurationError, match="lock-step"):
        run_deploy(Scripted(), DeployOptions(connect=lock_step_robot))
    other = Scripted()
    other.layout = replace(other.layout, success_hold_steps=11)
    options = DeployOptions(connect=lock_step_robot, lock_step=True)
    with pytest.raises(LayoutMismatchError, match="layout"):
        run_deploy(other, options)
    with pytest.raises(LayoutMismatchError, match="robot model"):
        run_deploy(Scripted(), replace(options, robot_model_hash="0" * 64))


def test_nobody_there_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    nobody = f"tcp/127.0.0.1:{free_port()}"
    with pytest.raises(TransportError, match="no robot server answers"):
        run_deploy(Scripted(), DeployOptions(connect=nobody))
    assert main(["stop", "--connect", nobody]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "no robot server answers" in line


def test_port_in_use_is_one_line(robot: str, capsys: pytest.CaptureFixture[str]) -> None:
    handlers = {n: signal.getsignal(n) for n in ENDING_SIGNALS}
    try:
        assert main(["robot", "--listen", robot]) == 2
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    (line,) = capsys.readouterr().err.splitlines()
    assert "in use" in line


def test_dry_run_sends_nothing(robot: str, tmp_path: Path) -> None:
    def enough(action: Array) -> Array:
        raise ValueError("enough")

    before = describe(robot).commanded_position
    path = tmp_path / "run.mcap"
    policy = Scripted(8, enough)
    run_deploy(policy, DeployOptions(connect=robot, dry_run=True, record=path))
    assert policy.count == 8
    recording = read_recording(path)
    assert not recording.messages.get("/yumi/right/joint_trajectory")
    assert len(recording.messages["/skewmi/policy_action"]) >= 6
    assert describe(robot).commanded_position == before


@pytest.mark.slow
def test_scripted_motion_solves_the_task_in_real_time(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    report = run_deploy(Scripted(), DeployOptions(episodes=2, record=path))
    assert report.successes == 2, report.as_dict()
    assert_limits_kept(path)
