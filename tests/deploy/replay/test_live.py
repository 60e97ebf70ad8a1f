"""`skewmi deploy --live`: shows what a replay will show, and never disturbs the deployment."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from drawn import drawn, drawn_times, rows
from live_views import PATIENT_MS, Scripted, about_the_view, gathering_viewer

from skewmi.cli.main import main
from skewmi.deploy import run as deploy_run
from skewmi.deploy.options import DeployOptions
from skewmi.deploy.recording.reader import read_recording
from skewmi.deploy.replay import viewer
from skewmi.deploy.replay.assembler import RunAssembler, understand
from skewmi.deploy.replay.data import Run, Subject
from skewmi.deploy.replay.live_options import LiveOptions
from skewmi.deploy.replay.replay import write_replay
from skewmi.deploy.report import DeployReport
from skewmi.deploy.robot.process import free_port
from skewmi.errors import ConfigurationError
from skewmi.policy_io import Array


class StoppedAgain(Scripted):
    """The script for one episode; some steps after the next start somebody asks for the end."""

    def __init__(self, stop: threading.Event) -> None:
        super().__init__(at_step=15, what=lambda: stop.set() if self.done else None)
        self.done = False

    def act(self, observation: Array) -> Array:
        action = super().act(observation)
        self.done |= self.phase == self.PHASES[-1]
        return action


@pytest.fixture(scope="module")
def deployed(
    tmp_path_factory: pytest.TempPathFactory, lock_step_robot: str
) -> tuple[DeployReport, Path, Path]:
    """A success and the begin of an episode: report, recording, what the live view showed."""
    folder, stop = tmp_path_factory.mktemp("live"), threading.Event()
    recording, shown = folder / "run.mcap", folder / "live.rrd"
    options = DeployOptions(
        episodes=2,
        connect=lock_step_robot,
        lock_step=True,
        record=recording,
        live=LiveOptions(out=shown),
    )
    return deploy_run.run_deploy(StoppedAgain(stop), options, stop=stop), recording, shown


def test_live_view_holds_every_sample_of_the_replay(
    deployed: tuple[DeployReport, Path, Path], tmp_path: Path
) -> None:
    report, recording, shown = deployed
    assert [episode.outcome for episode in report.episodes] == ["success", "stopped"]
    assert report.notes == []
    assert report.files == [str(recording), str(shown)]
    replay = write_replay(recording, tmp_path / "replay.rrd")
    assert len(replay.success_s) == 1
    told = {name: metrics["max"] for name, metrics in report.smoothness().items()}
    assert told
    assert replay.smoothness == pytest.approx(told, rel=1e-12)
    expected, live = rows(tmp_path / "replay.rrd"), rows(shown)
    # Lines of limits are drawn again with each stretch; only recordings have the robot's cycles.
    lines = ("/limit", "/workspace", "/range", "/success", "/meant", "/late")
    once = {entity for entity in expected if not entity.endswith(lines)}
    once -= {"/timing/intervals/robots_cycles/ms"}
    once |= {"/policy/observation_in_range/success"}
    assert {"/events/robot", "/events/session", "/events/task", "/policy/observation"} <= once
    # The view began before the recorder: it may show some states of the resting arm more. The
    # ghost's fingers are drawn with what was told until then: how often before the first command
    # depends on when either began to draw, and on how busy the machine was.
    fingers = {entity for entity in once if entity.startswith("/robot_commanded/joints/gripper")}
    assert fingers
    for entity in sorted(once - fingers):
        assert expected[entity] <= live[entity] <= expected[entity] + 500, entity
    first = drawn_times(shown, "/policy/action/fields").min()
    for entity in sorted(fingers):
        told = np.unique(drawn_times(tmp_path / "replay.rrd", entity))
        seen = np.unique(drawn_times(shown, entity))
        told = told[told > first]
        assert len(told) > 100
        assert np.isin(told, seen).all(), entity
    for entity in ("/joints/jerk/of_limit", "/world/hand/commanded", "/policy/action/fields"):
        assert live[entity] == expected[entity] > 100
    assert live["/world/path/measured"] > 5


def test_what_is_drawn_is_the_run_of_the_report(
    deployed: tuple[DeployReport, Path, Path], tmp_path: Path
) -> None:
    report, recording, shown = deployed
    replayed = tmp_path / "replay.rrd"
    write_replay(recording, replayed)
    for path in (replayed, shown):
        for quantity in ("position", "velocity", "acceleration", "jerk"):
            used = getattr(report.usage, quantity)
            largest = np.abs(drawn(path, f"/joints/{quantity}/of_limit")).max()
            # The report counts braking tails, too, which nothing has executed.
            assert 0.5 * used < largest <= used + 1e-6, quantity
        observations = drawn(path, "/policy/observation")
        first, second = report.episodes
        final = list(first.final_observation.values())
        np.testing.assert_allclose(observations[first.steps], final, atol=1e-9)
        # Whoever asks for the end does not wait for another observation.
        assert len(observations) == first.steps + 1 + second.steps
        actions = drawn(path, "/policy/action/fields")
        assert len(actions) == sum(episode.steps for episode in report.episodes)
        pulses = drawn(path, "/policy/observation_in_range/success")
        assert len(pulses) == 4 * report.successes


def in_pieces(recording: Path, size: int) -> list[Run]:
    """What a live view understands: messages in the order of sending, with looks in between."""
    recorded = read_recording(recording)
    ordered = sorted(
        (
            (m.publish_time_ns, topic, m.payload)
            for topic, ms in recorded.messages.items()
            for m in ms
        ),
        key=lambda item: item[0],
    )
    assembler = RunAssembler(Subject.from_metadata(recorded.metadata, "test"))
    pieces = []
    for number, (_, topic, payload) in enumerate(ordered):
        assembler.feed(topic, payload)
        if number % size == size - 1:
            pieces.append(assembler.take())
    pieces.append(assembler.take(final=True))
    return [piece for piece in pieces if piece is not None]


@pytest.mark.parametrize("size", [1, 7, 200])
def test_pieces_add_up_to_the_whole(deployed: tuple[DeployReport, Path, Path], size: int) -> None:
    _, recording, _ = deployed
    whole = understand(read_recording(recording))
    pieces = in_pieces(recording, size)
    assert len(pieces) > 10

    def joined(get: Callable[[Run], Array]) -> Array:
        return np.concatenate([get(piece) for piece in pieces if len(get(piece))])

    # The origin is the first stamp that was seen, which may be a later topic's in pieces.
    shift = pieces[0].measured.time_s[0] - whole.measured.time_s[0]
    for motion in ("commanded", "measured"):
        for name in ("q", "v"):
            np.testing.assert_array_equal(
                joined(lambda run, m=motion, n=name: getattr(getattr(run, m), n)),
                getattr(getattr(whole, motion), name),
            )
        times = joined(lambda run, m=motion: getattr(run, m).time_s)
        np.testing.assert_allclose(times - shift, getattr(whole, motion).time_s, atol=1e-9)
    np.testing.assert_allclose(joined(lambda run: run.commanded.jerk), whole.commanded.jerk)
    np.testing.assert_allclose(joined(lambda run: run.error.values), whole.error.values)
    np.testing.assert_array_equal(joined(lambda run: run.action.values), whole.action.values)
    success = [time_s for piece in pieces for time_s in piece.success_s]
    np.testing.assert_allclose(np.array(success) - shift, whole.success_s, atol=1e-9)
    texts = [status.message for piece in pieces for _, status in piece.events]
    assert sorted(texts) == sorted(status.message for _, status in whole.events)


def test_real_time_run_over_grpc_arrives_at_the_viewer(robot: str, tmp_path: Path) -> None:
    recording, shown = tmp_path / "run.mcap", tmp_path / "viewer.rrd"
    with gathering_viewer(shown) as (url, child):
        live = LiveOptions(connect=url)
        report = deploy_run.run_deploy(
            Scripted(25),
            DeployOptions(connect=robot, record=recording, live=live, lead_ms=PATIENT_MS),
        )
        child.send_signal(signal.SIGINT)
        child.wait(120.0)
    assert about_the_view(report) == []
    assert report.episodes[0].steps == 25, report.as_dict()
    run, live_rows = understand(read_recording(recording)), rows(shown)
    assert live_rows["/joints/velocity/of_limit"] == len(run.commanded.time_s) > 500
    assert live_rows["/policy/action/fields"] == 25


def one_line(capsys: pytest.CaptureFixture[str], robot: str, arguments: list[str]) -> str:
    lock_step = ["--lock-step", "--connect", robot]
    assert main(["deploy", "open_press_close", *lock_step, *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    lines = [line for line in captured.err.splitlines() if line.startswith("skewmi deploy: ")]
    assert len(lines) == 1, captured.err
    assert "Traceback" not in captured.err
    return lines[0]


def test_bad_places_are_one_line(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    lock_step_robot: str,
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    nobody = f"rerun+http://127.0.0.1:{free_port()}/proxy"
    there = tmp_path / "there.rrd"
    there.write_bytes(b"precious")
    for arguments, complaint in (
        (["--live-connect", nobody], "no Rerun viewer listens"),
        (["--live-connect", "localhost:9876"], "not the address"),
        (["--live-connect", nobody, "--live"], "not both"),
        (["--live-out", str(there / "x.rrd")], "is a file"),
        (["--live-out", str(there)], "exists"),
    ):
        assert complaint in one_line(capsys, lock_step_robot, arguments)
    assert there.read_bytes() == b"precious"
    unused = f"rerun+http://127.0.0.1:{free_port()}/proxy"
    with pytest.raises(ConfigurationError, match=r"no screen.*do this instead"):
        viewer.spawn_viewer("do this instead", unused)
    with pytest.raises(ConfigurationError, match="folder"):
        LiveOptions(out=tmp_path / "absent" / "x.rrd")
