"""`skewmi deploy --live`: shows what a replay will show, and never disturbs the deployment."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drawn import drawn, rows
from scripted_open_press_close import ScriptedOpenPressClose

from skewmi.cli.main import main
from skewmi.deploy import run as deploy_run
from skewmi.deploy.options import DeployOptions
from skewmi.deploy.recording.reader import read_recording
from skewmi.deploy.replay import viewer
from skewmi.deploy.replay.assembler import RunAssembler, understand
from skewmi.deploy.replay.data import Run, Subject
from skewmi.deploy.replay.live import LiveView
from skewmi.deploy.replay.live_options import LiveOptions
from skewmi.deploy.replay.replay import write_replay
from skewmi.deploy.report import DeployReport
from skewmi.deploy.robot.process import free_port
from skewmi.errors import ConfigurationError
from skewmi.policy_io import Array
from skewmi.sim.tasks.open_press_close.definition import make_layout


class Scripted(ScriptedOpenPressClose):
    """The script for some steps; something happens at one of them."""

    def __init__(self, steps: int = 1000, at_step: int = -1, what: Any = None) -> None:
        super().__init__(make_layout())
        self._steps, self._at_step, self._what = steps, at_step, what

    def reset(self) -> None:
        super().reset()
        self.count = 0

    def act(self, observation: Array) -> Array:
        self.count += 1
        if self.count == self._at_step:
            self._what()
        if self.count > self._steps:
            raise ValueError("enough")
        return super().act(observation)


@pytest.fixture(scope="module")
def deployed(tmp_path_factory: pytest.TempPathFactory) -> tuple[DeployReport, Path, Path]:
    """Two episodes in lock-step: report, recording, what the live view showed."""
    folder = tmp_path_factory.mktemp("live")
    recording, shown = folder / "run.mcap", folder / "live.rrd"
    options = DeployOptions(
        episodes=2, lock_step=True, record=recording, live=LiveOptions(out=shown)
    )
    return deploy_run.run_deploy(Scripted(), options), recording, shown


def test_live_view_holds_every_sample_of_the_replay(
    deployed: tuple[DeployReport, Path, Path], tmp_path: Path
) -> None:
    report, recording, shown = deployed
    assert report.successes == 2, report.as_dict()
    assert report.notes == []
    assert report.files == [str(recording), str(shown)]
    replay = write_replay(recording, tmp_path / "replay.rrd")
    assert len(replay.success_s) == 2
    expected, live = rows(tmp_path / "replay.rrd"), rows(shown)
    once = {entity for entity in expected if not entity.endswith(("/limit", "/box", "/range"))}
    assert {"/events", "/policy/observation", "/policy/observation_in_range/success"} <= once
    # The view began shortly before the recorder: it may show some states of the resting arm more,
    # and of the ghost's fingers some less, before the first command.
    for entity in sorted(once):
        fewer = 50 if entity.startswith("/robot_commanded/joints/gripper") else 0
        assert expected[entity] - fewer <= live[entity] <= expected[entity] + 500, entity
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
        finals = [list(episode.final_observation.values()) for episode in report.episodes]
        ends = np.cumsum([episode.steps + 1 for episode in report.episodes]) - 1
        np.testing.assert_allclose(observations[ends], finals, atol=1e-9)
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


@contextlib.contextmanager
def gathering_viewer(path: Path) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Rerun as a viewer without a screen: takes what comes over gRPC into a file."""
    port = free_port()
    child = subprocess.Popen(
        [viewer._executable(), "--save", path, "--port", str(port), "--bind", "127.0.0.1"],
        stderr=subprocess.DEVNULL,
    )
    try:
        deadline = time.monotonic() + 20.0
        while True:
            with contextlib.suppress(OSError):
                socket.create_connection(("127.0.0.1", port), 0.2).close()
                break
            assert time.monotonic() < deadline, "the viewer does not start"
            time.sleep(0.05)
        yield f"rerun+http://127.0.0.1:{port}/proxy", child
    finally:
        child.send_signal(signal.SIGCONT)
        child.kill()
        child.wait()


def watched(monkeypatch: pytest.MonkeyPatch) -> list[LiveView]:
    """Live views that deployments open from now on."""
    views: list[LiveView] = []

    class Watched(LiveView):
        def __init__(self, *args: Any) -> None:
            super().__init__(*args)
            views.append(self)

    monkeypatch.setattr(deploy_run, "LiveView", Watched)
    return views


def test_real_time_run_over_grpc_arrives_at_the_viewer(tmp_path: Path) -> None:
    recording, shown = tmp_path / "run.mcap", tmp_path / "viewer.rrd"
    with gathering_viewer(shown) as (url, child):
        report = deploy_run.run_deploy(
            Scripted(25), DeployOptions(record=recording, live=LiveOptions(connect=url))
        )
        child.send_signal(signal.SIGINT)
        child.wait(20.0)
    assert report.notes == []
    assert report.episodes[0].steps == 25
    run, live = understand(read_recording(recording)), rows(shown)
    assert live["/joints/velocity/of_limit"] == len(run.commanded.time_s) > 500
    assert live["/policy/action/fields"] == 25


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "hung"])
@pytest.mark.parametrize("lock_step", [True, False], ids=["lock-step", "real time"])
def test_view_that_dies_or_hangs_leaves_the_run_alone(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, number: signal.Signals, lock_step: bool
) -> None:
    views = watched(monkeypatch)
    policy = Scripted(150, 20, lambda: os.kill(views[0].pid, number))
    live = LiveOptions(out=tmp_path / "live.rrd")
    report = deploy_run.run_deploy(policy, DeployOptions(lock_step=lock_step, live=live))
    (episode,) = report.episodes
    assert episode.steps >= 100, episode.reason
    assert episode.outcome == "success" or "enough" in episode.reason
    (note,) = report.notes
    assert ("hung" if number == signal.SIGSTOP else "ended early") in note
    if not lock_step:  # there, all is over before much is drawn
        assert rows(tmp_path / "live.rrd")["/policy/action/fields"] >= 5


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "hung"])
def test_viewer_that_dies_or_hangs_leaves_the_run_alone(
    tmp_path: Path, number: signal.Signals
) -> None:
    kept = tmp_path / "live.rrd"
    with gathering_viewer(tmp_path / "viewer.rrd") as (url, child):
        policy = Scripted(60, 20, lambda: child.send_signal(number))
        live = LiveOptions(connect=url, out=kept)
        ended = threading.Event()
        started = time.monotonic()
        report = deploy_run.run_deploy(policy, DeployOptions(live=live), stop=ended)
        took_s = time.monotonic() - started
    assert report.episodes[0].steps == 60, report.as_dict()
    assert took_s < 45.0
    assert all("live view" in note for note in report.notes)
    # The file beside the viewer is whole all the same, up to the last drawing of 0.1 s: that one
    # may be under way when the view of a hung viewer is given up.
    assert rows(kept)["/policy/action/fields"] in (59, 60), report.notes


def one_line(capsys: pytest.CaptureFixture[str], arguments: list[str]) -> str:
    assert main(["deploy", "open_press_close", "--lock-step", *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    lines = [line for line in captured.err.splitlines() if line.startswith("skewmi deploy: ")]
    assert len(lines) == 1, captured.err
    assert "Traceback" not in captured.err
    return lines[0]


def test_bad_places_are_one_line(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
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
        assert complaint in one_line(capsys, arguments)
    assert there.read_bytes() == b"precious"
    unused = f"rerun+http://127.0.0.1:{free_port()}/proxy"
    with pytest.raises(ConfigurationError, match=r"no screen.*do this instead"):
        viewer.spawn_viewer("do this instead", unused)
    with pytest.raises(ConfigurationError, match="folder"):
        LiveOptions(out=tmp_path / "absent" / "x.rrd")
