"""`skewmi deploy` with real policy files, and the parts of the session that need no robot."""

from __future__ import annotations

import gc
import json
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from skewmi.cli.main import main
from skewmi.deploy.options import DeployOptions
from skewmi.deploy.realtime import hot_loop
from skewmi.deploy.robot.description import RobotDescription, limit_values
from skewmi.deploy.robot.process import free_port, simulated_robot_process
from skewmi.deploy.safety.checks import ChunkChecks
from skewmi.deploy.safety.guard import Guard
from skewmi.deploy.session.agreement import check_agreement
from skewmi.deploy.session.pace import followed_speed, planning_limits
from skewmi.deploy.session.preflight import check_way, draw_start
from skewmi.deploy.session.stream import ChunkStream
from skewmi.deploy.session.timing import CycleTimes, percentiles_ms
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.errors import (
    ConfigurationError,
    LayoutMismatchError,
    LimitViolationError,
    TransportError,
)
from skewmi.export.onnx_export import export_policy
from skewmi.policy_io import Array, PolicyLayout
from skewmi.robot_models import limits as joint_limits
from skewmi.robot_models import yumi
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.sim.tasks.open_press_close.definition import make_layout
from skewmi.trajectory import CYCLE_NS, GRID_NS, JointTrajectory

LAB = joint_limits.profile("lab")
NAMES = yumi.joint_names("right")


class TinyPolicy:
    """An untrained network; satisfies `ExportablePolicy`."""

    def __init__(self, layout: PolicyLayout, robot_model_hash: str) -> None:
        torch.manual_seed(0)
        self.layout = layout
        linear = torch.nn.Linear(layout.observation_dim, layout.action_dim)
        self.module = torch.nn.Sequential(linear, torch.nn.Tanh()).eval()
        self.metadata = {"method": "none", "robot_model_hash": robot_model_hash, "seed": 0}

    def reset(self) -> None:
        pass

    def act(self, observation: Array) -> Array:
        with torch.no_grad():
            return self.module(torch.tensor(observation).float()).double().numpy()


def write_policy(
    path: Path, layout: PolicyLayout | None = None, robot_model_hash: str = yumi.MODEL_HASH
) -> Path:
    layout = make_layout() if layout is None else layout
    low, high = layout.observation_low, layout.observation_high
    size = (10, 4, layout.observation_dim)
    observations = np.random.default_rng(0).uniform(low, high, size)
    export_policy(TinyPolicy(layout, robot_model_hash), path, observations)
    return path


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_policy(tmp_path_factory.mktemp("policy") / "tiny.onnx")


def one_line(capsys: pytest.CaptureFixture[str], arguments: list[str]) -> str:
    """Run a command that must fail as bad input; its message, without progress lines."""
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    lines = [line for line in captured.err.splitlines() if line.startswith("skewmi deploy: ")]
    assert len(lines) == 1, captured.err
    assert "Traceback" not in captured.err
    return lines[0]


def test_deploy_runs_a_policy_file_and_prints_one_json_document(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    policy = write_policy(tmp_path / "tiny.onnx", make_layout(time_input=True))
    recording = tmp_path / "run.mcap"
    arguments = ["deploy", str(policy), "--lock-step", "--episodes", "1", "--json"]
    assert main([*arguments, "--record", str(recording)]) == 0
    report = json.loads(capsys.readouterr().out)
    assert (report["episodes"], report["successes"], report["success_rate"]) == (1, 0, 0.0)
    (episode,) = report["per_episode"]
    assert episode["outcome"] == "time over"
    assert episode["steps"] == 200
    assert report["cycles"] >= 1000
    assert set(report["cycle_ms"]) >= {"p50", "p99", "p99.9"}
    assert report["missed_cycles"] == 0
    assert report["stops"] == []
    for name in ("position", "velocity", "acceleration", "jerk"):
        assert 0.0 < report["limit_fractions"][name] <= 1.0 + 1e-6
    assert report["files"] == [str(recording)]
    assert recording.stat().st_size > 10_000
    line = one_line(capsys, [*arguments, "--record", str(recording)])
    assert "exists" in line


def test_policy_of_another_layout_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    layout = replace(make_layout(), control_dt=0.2)
    policy = write_policy(tmp_path / "other.onnx", layout)
    assert "layout" in one_line(capsys, ["deploy", str(policy), "--lock-step"])


def test_policy_of_another_robot_model_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    policy = write_policy(tmp_path / "other.onnx", robot_model_hash="0" * 64)
    assert "robot model" in one_line(capsys, ["deploy", str(policy), "--lock-step"])


def test_policy_of_another_task_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    layout = replace(make_layout(), task="point_maze", workspace=None)
    policy = write_policy(tmp_path / "maze.onnx", layout)
    assert "point_maze" in one_line(capsys, ["deploy", str(policy)])


def test_files_that_are_no_policy_are_refused(
    tiny: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good = tiny.read_bytes()
    contents = {"empty": b"", "text": b"hello", "cut": good[: len(good) // 2]}
    for name, content in contents.items():
        path = tmp_path / f"{name}.onnx"
        path.write_bytes(content)
        assert str(path) in one_line(capsys, ["deploy", str(path)])
    assert "no.onnx" in one_line(capsys, ["deploy", str(tmp_path / "no.onnx")])


@pytest.mark.parametrize(
    "flags",
    [
        ["--episodes", "0"],
        ["--speed", "0.05"],
        ["--speed", "1.5"],
        ["--lead-ms", "10"],
        ["--limits", "wild"],
        ["--dry-run", "--lock-step"],
        ["--connect", "localhost"],
    ],
    ids=" ".join,
)
def test_bad_flags_are_one_line(
    tiny: Path, capsys: pytest.CaptureFixture[str], flags: list[str]
) -> None:
    one_line(capsys, ["deploy", str(tiny), *flags])


def test_run_that_was_stopped_exits_1_and_tells_why(
    tiny: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with simulated_robot_process("open_press_close", "lab", lock_step=False) as locator:
        stopper = threading.Timer(3.0, lambda: main(["stop", "--json", "--connect", locator]))
        stopper.start()
        arguments = ["deploy", str(tiny), "--connect", locator, "--episodes", "2", "--json"]
        assert main(arguments) == 1
        stopper.join()
    stopped, report = sorted(map(json.loads, capsys.readouterr().out.splitlines()), key=len)
    assert stopped["state"] == "disarmed"
    assert report["episodes"] == 1
    assert report["per_episode"][0]["outcome"] == "stopped"
    assert report["stops"] == [report["per_episode"][0]["reason"]]
    assert "skewmi stop" in report["stops"][0]


def test_robot_server_tells_each_change_of_state_and_what_it_was_granted(tiny: Path) -> None:
    locator = f"tcp/127.0.0.1:{free_port()}"
    command = [sys.executable, "-m", "skewmi.cli.main", "robot", "--listen", locator, "--json"]
    robot = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert robot.stdout is not None
        assert json.loads(robot.stdout.readline())["state"] == "disarmed"
        with Link.open(TransportConfig.for_client(locator), "test") as link:
            link.wait_for_robot(5.0)
            assert link.call(topics.YUMI_ARM, 5.0, bytes(32)).success
            assert link.call(topics.YUMI_STOP, 5.0, b"the test").success
    finally:
        robot.send_signal(signal.SIGINT)
        told = robot.communicate(timeout=20.0)[1]
    assert robot.returncode == 0
    assert "disarmed -> holding (arm: " in told
    assert "holding -> disarmed (stop: stop asked for by the test" in told
    assert "real-time loop: gc frozen" in told


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_interrupted_command_exits_130(tiny: Path, number: signal.Signals) -> None:
    command = [sys.executable, "-m", "skewmi.cli.main", "deploy", str(tiny), "--json"]
    child = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # The tests themselves may run under nohup.
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),
    )
    time.sleep(6.0)
    child.send_signal(number)
    out, err = child.communicate(timeout=20.0)
    assert child.returncode == 130, err
    assert "Traceback" not in err
    if out:  # interrupted in an episode; else before one
        assert json.loads(out)["interrupted"]


def description(**changes: Any) -> RobotDescription:
    base = RobotDescription(
        backend="sim",
        task="open_press_close",
        layout_hashes=(make_layout().hash(),),
        robot_model_hash=yumi.MODEL_HASH,
        limit_profile="lab",
        lock_step=False,
        simulated=True,
        grid_ns=GRID_NS,
        state_period_ns=CYCLE_NS,
        state="disarmed",
        reason="started",
        clock_ns=0,
        joint_names=NAMES,
        commanded_position=(0.1 + 0.2,) * 7,
        stops=3,
        limits=limit_values(LAB),
    )
    return replace(base, **changes)


def test_descriptions_survive_the_wire_at_full_precision() -> None:
    assert RobotDescription.from_json(description().to_json()) == description()


@pytest.mark.parametrize("text", ["", "{}", "[]", "null", '{"backend": "sim"}'])
def test_what_is_no_description_is_refused(text: str) -> None:
    with pytest.raises(TransportError, match="description"):
        RobotDescription.from_json(text)


def test_agreement_passes_only_if_everything_agrees() -> None:
    check_agreement(make_layout(), yumi.MODEL_HASH, LAB, description())
    check_agreement(make_layout(), None, LAB.scaled(0.3), description())


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"task": "door_open"}, LayoutMismatchError),
        ({"layout_hashes": ("0" * 64,)}, LayoutMismatchError),
        ({"robot_model_hash": "0" * 64}, LayoutMismatchError),
        ({"joint_names": NAMES[::-1]}, ConfigurationError),
        ({"grid_ns": 8_000_000}, ConfigurationError),
        ({"state_period_ns": 4_000_000}, ConfigurationError),
        ({"limits": limit_values(joint_limits.profile("careful"))}, ConfigurationError),
        ({"limits": limit_values(LAB.scaled(0.99))}, ConfigurationError),
        ({"limits": {}}, ConfigurationError),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, dict) else "",
)
def test_every_disagreement_is_refused(changes: dict[str, Any], error: type) -> None:
    with pytest.raises(error):
        check_agreement(make_layout(), yumi.MODEL_HASH, LAB, description(**changes))


def test_a_slow_profile_is_not_slowed_down_twice() -> None:
    careful = joint_limits.profile("careful")
    np.testing.assert_array_equal(planning_limits("careful", 0.3).velocity, careful.velocity)
    np.testing.assert_allclose(planning_limits("lab", 0.3).velocity, 0.3 * LAB.velocity)
    np.testing.assert_array_equal(planning_limits("lab", 0.3).jerk, LAB.jerk)


def test_policy_runs_as_fast_as_the_hand_can_follow() -> None:
    layout = make_layout()
    asked = 0.015 / 0.1  # m/s of a full action
    assert followed_speed(layout, 1.0, 2.0 * asked) == 1.0
    assert followed_speed(layout, 1.0, 0.25 * asked) == pytest.approx(0.25)
    assert followed_speed(layout, 0.1, 0.25 * asked) == 0.1


@pytest.mark.parametrize("far", [False, True])
def test_starts_lie_around_the_tasks_start(far: bool) -> None:
    workspace = make_layout().workspace
    assert workspace is not None
    posture = np.array(workspace.start_configuration)
    near = np.array(yumi.HOME["right"]) if far else posture + 0.01
    forward = ArmKinematics("right").forward
    starts = []
    for seed in range(5):
        q = draw_start(workspace, seed, 0.005, near)
        assert (q == draw_start(workspace, seed, 0.005, near)).all()
        hand = forward(q)[0] + np.array(workspace.base_position)
        starts.append(hand)
        assert np.abs(hand - np.array(workspace.start)).max() < 0.005 + 1e-4
        assert np.abs(q - posture).max() < 0.2
    assert np.ptp(starts, axis=0).min() > 1e-3


def test_whole_way_to_the_start_is_checked_before_anything_moves() -> None:
    workspace = make_layout().workspace
    assert workspace is not None
    checks = ChunkChecks(LAB, workspace)
    q_goal = np.array(workspace.start_configuration)
    check_way(q_goal + 0.02, q_goal, LAB, checks)
    # Both ends are clear by more than is asked for; the way leads past the other arm.
    guard = Guard(LAB, clearance=0.02)
    checks = SimpleNamespace(stages=[("guard", lambda way, *_: guard.check(way.q, way.v, way.a))])
    ends = [-2.5, -1.4, -0.4, 1.2, 0.6, -0.5, -2.0], [1.3, -2.4, 1.5, -0.3, 4.3, -1.2, 2.7]
    for end in map(np.array, ends):
        guard.check(np.tile(end, (6, 1)), np.zeros((6, 7)), np.zeros((6, 7)))
    with pytest.raises(LimitViolationError, match="clearance"):
        check_way(*map(np.array, ends), LAB, checks)


def resting(value: float) -> JointTrajectory:
    """Seven resting joints."""
    return JointTrajectory.resting(np.full(7, value), 8)


def make_stream(sent: list[bytes], *, lock_step: bool = True, checks: Any = ()) -> ChunkStream:
    return ChunkStream(
        sent.append, NAMES, checks, CycleTimes(), lock_step=lock_step, lead_ns=24_000_000
    )


def test_stream_sends_one_chunk_per_state_and_two_after_a_lost_one() -> None:
    sent: list[bytes] = []
    stream = make_stream(sent)
    stream.begin(np.zeros(7), 0)
    counts = []
    for stamp in (0, 20, 40, 80, 100):
        splices = []
        for splice in stream.due(stamp * 1_000_000, 0):
            splices.append(splice)
            stream.send(resting(0.0))
        counts.append(splices)
    assert counts == [[5], [5], [5], [5, 5], [5]]
    assert stream.missed_cycles == 0


def test_late_stream_splices_further_along_the_braking_tail() -> None:
    sent: list[bytes] = []
    stream = make_stream(sent, lock_step=False)
    stream.begin(np.zeros(7), 0)
    late_by_ns = 50_000_000
    received = time.monotonic_ns() - late_by_ns
    splice = next(iter(stream.due(0, received)))
    # 24 ms ahead, 50 ms late and 6 ms to spare: two cycles more are needed.
    assert splice == 5 + 2 * 5
    assert stream.missed_cycles == 2


def test_chunk_that_a_check_refuses_is_not_sent() -> None:
    def refuse(*args: object) -> None:
        raise LimitViolationError("test", 2.0, 1.0)

    sent: list[bytes] = []
    stream = make_stream(sent, checks=(("check", refuse),))
    stream.begin(np.zeros(7), 0)
    next(stream.due(0, 0))
    with pytest.raises(LimitViolationError):
        stream.send(resting(0.0))
    assert sent == []


def test_stream_remembers_what_was_commanded_when() -> None:
    stream = make_stream([])
    stream.begin(np.zeros(7), 0)
    for number, stamp in enumerate((0, 20, 40), start=1):
        for _ in stream.due(stamp * 1_000_000, 0):
            stream.send(resting(float(number)))
    values = [stream.commanded(t * 1_000_000)[0] for t in (0, 23, 24, 43, 44, 64, 500)]
    assert values == [0.0, 0.0, 1.0, 1.0, 2.0, 3.0, 3.0]


def test_hot_loop_leaves_collection_and_scheduling_as_they_were() -> None:
    enabled = gc.isenabled()
    with hot_loop(priority=False) as granted:
        assert not gc.isenabled()
        assert granted == ["gc frozen"]
    assert gc.isenabled() == enabled
    assert gc.get_freeze_count() == 0


HOT = """
import gc, os, re, resource, sys
from pathlib import Path
from skewmi.deploy.realtime import hot_loop
if sys.argv[1] == "refused":
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (0, 0))
    os.setgid(65534), os.setuid(65534)
def state():
    locked = int(re.search(r"VmLck:\\s+(\\d+)", Path("/proc/self/status").read_text())[1])
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO, locked > 0
before = state()
with hot_loop(priority=True) as granted:
    frozen = gc.get_freeze_count() > 0 and not gc.isenabled()
    print(granted == ["gc frozen"] * frozen
          + ["SCHED_FIFO"] * state()[0] + ["memory locked"] * state()[1], granted)
print(before[0] == state()[0] == False, gc.isenabled(), gc.get_freeze_count() == 0)
"""


@pytest.mark.parametrize("permission", ["allowed", "refused"])
def test_hot_loop_takes_what_it_is_permitted_and_tells_the_truth(permission: str) -> None:
    if permission == "refused" and os.getuid() != 0:
        pytest.skip("only root can give up the permission")
    command = [sys.executable, "-c", HOT, permission]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    told, after = result.stdout.splitlines()
    assert told.startswith("True")
    assert after == "True True True"
    if permission == "refused":
        assert told == "True ['gc frozen']"


def test_percentiles_are_those_of_numpy_in_milliseconds() -> None:
    durations = [n * 1_000_000 for n in range(1, 1001)]
    result = percentiles_ms(durations)
    assert result["p50"] == pytest.approx(500.5)
    assert result["p99.9"] == pytest.approx(np.percentile(np.arange(1, 1001), 99.9))
    assert result["max"] == 1000.0
    assert percentiles_ms([])["p99"] == 0.0


@pytest.mark.parametrize(
    "changes", [{"episodes": 0}, {"speed": 0.0}, {"speed": float("nan")}, {"start_spread": -1.0}]
)
def test_impossible_options_are_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError):
        DeployOptions(**changes)
