"""Smoothness of a recording: of the policy's motion in each episode, and nothing else."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from skewmi.deploy.recording.reader import read_recording
from skewmi.deploy.recording.writer import RecordingWriter
from skewmi.deploy.replay.policy_part import policy_smoothness
from skewmi.deploy.session.news import SessionNews
from skewmi.deploy.session.states import SessionEvent, SessionState
from skewmi.deploy.wire import messages, topics
from skewmi.robot_models import yumi
from skewmi.smoothness import smoothness
from skewmi.trajectory import CYCLE_NS, GRID_S, JointTrajectory, TrajectoryChunk

_S, _E = SessionState, SessionEvent
LEAD_NS = 24_000_000
TICKS = 20


@dataclass
class Session:
    """Writes what a session sends."""

    writer: RecordingWriter
    clock_ns: int = 3_000_000_000
    wall_ns: int = 1_000

    def _write(self, topic: topics.Topic, payload: bytes) -> None:
        self.wall_ns += 1_000
        self.writer.write(topic, payload, log_time_ns=self.wall_ns)

    def tell(self, state: SessionState, source: SessionState, event: SessionEvent) -> None:
        news = SessionNews(self.clock_ns, state, "why", source, event)
        self._write(topics.YUMI_STATUS, news.encode())

    def move(self, frequency_hz: float, cycles: int) -> np.ndarray:
        """Chunks that accelerate at a frequency; all of them but for the last one's rest."""
        for cycle in range(cycles):
            a = accelerations(frequency_hz, 5 * cycle + np.arange(TICKS))
            chunk = TrajectoryChunk.of(
                self.clock_ns + LEAD_NS, yumi.joint_names("right"), JointTrajectory(0 * a, 0 * a, a)
            )
            self._write(topics.YUMI_TRAJECTORY, messages.encode_chunk(chunk))
            self.clock_ns += CYCLE_NS
        return accelerations(frequency_hz, np.arange(5 * (cycles - 1)))

    def episode(self, frequency_hz: float) -> np.ndarray:
        """A way to the start that shakes, and a policy's motion, which is returned."""
        self.tell(_S.TO_START, _S.PREFLIGHT, _E.READY)
        self.move(40.0, 10)
        self.tell(_S.RUNNING, _S.TO_START, _E.AT_START)
        moved = self.move(frequency_hz, 60)
        # That somebody is not believed is told with the state, once more.
        self.tell(_S.RUNNING, _S.TO_START, _E.AT_START)
        self.clock_ns += 500_000_000
        moved = np.concatenate([moved, self.move(frequency_hz, 60)])
        self.tell(_S.SUCCESS, _S.RUNNING, _E.SUCCESS)
        self.tell(_S.HOLDING, _S.SUCCESS, _E.AT_REST)
        self.clock_ns += 100_000_000
        return moved


def accelerations(frequency_hz: float, ticks: np.ndarray) -> np.ndarray:
    time_s = GRID_S * ticks[:, None]
    slow = np.sin(2 * np.pi * 2.0 * time_s + np.arange(7))
    return slow + 0.2 * np.sin(2 * np.pi * frequency_hz * time_s)


def test_it_is_of_the_least_smooth_episode_by_itself(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with RecordingWriter(path) as writer:
        session = Session(writer)
        moved = [session.episode(frequency_hz) for frequency_hz in (15.0, 25.0, 5.0)]
        session.move(40.0, 10)
    expected = [smoothness(a, GRID_S) for a in moved]
    found = policy_smoothness(read_recording(path))
    assert set(found) == set(expected[0])
    for name, value in found.items():
        assert value == pytest.approx(max(e[name] for e in expected), rel=1e-12), name


def test_an_episode_that_the_recording_does_not_end_counts(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with RecordingWriter(path) as writer:
        session = Session(writer)
        session.move(40.0, 10)
        session.tell(_S.RUNNING, _S.TO_START, _E.AT_START)
        moved = session.move(15.0, 60)
    assert policy_smoothness(read_recording(path)) == smoothness(moved, GRID_S)


def test_without_a_policy_there_is_none(tmp_path: Path, recorded: Path) -> None:
    path = tmp_path / "run.mcap"
    with RecordingWriter(path) as writer:
        session = Session(writer)
        session.tell(_S.TO_START, _S.PREFLIGHT, _E.READY)
        session.move(40.0, 10)
        writer.write(topics.YUMI_STATUS, b"garbage")
        writer.write(topics.YUMI_TRAJECTORY, b"garbage")
    assert policy_smoothness(read_recording(path)) == {}
    assert policy_smoothness(read_recording(recorded)) == {}
