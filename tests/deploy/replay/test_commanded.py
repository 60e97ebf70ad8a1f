"""What is drawn of the command: the ghost that stands where it was commanded, and the spectrum."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recorded_motion import CYCLE_NS, EPOCH_NS, GRID_NS, Q_MIDDLE
from rerun.chunk import RrdReader

from skewmi.deploy.recording.writer import RecordingWriter
from skewmi.deploy.replay.replay import write_replay
from skewmi.deploy.wire import messages, topics
from skewmi.deploy.wire.messages import JointStates
from skewmi.robot_models import yumi
from skewmi.trajectory import JointTrajectory, TrajectoryChunk

NAMES = yumi.joint_names("right")
CYCLES, FIRST = 122, 25
"""Of the robot's states; the one with which the first chunk comes."""
SLOW_HZ, FAST_HZ = 3.5, 12.5
"""Whole periods fit into the two seconds that are commanded; in the middle of bars of 1 Hz."""


def motion(time_s: np.ndarray) -> JointTrajectory:
    """Two sines, the acceleration of the slow one twice as large, on all joints."""
    rates = 2 * np.pi * np.array([SLOW_HZ, FAST_HZ])
    phase = rates * time_s[:, None]
    a = np.array([2.0, 1.0])
    curves = [-a / rates**2 * np.sin(phase), -a / rates * np.cos(phase), a * np.sin(phase)]
    q, v, acceleration = (np.repeat(c.sum(1)[:, None], 7, axis=1) for c in curves)
    return JointTrajectory(Q_MIDDLE + q, v, acceleration)


@pytest.fixture(scope="module")
def replayed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A replay of an arm that sags before it is commanded for the first time."""
    folder = tmp_path_factory.mktemp("commanded")
    with RecordingWriter(folder / "run.mcap") as writer:
        for cycle in range(CYCLES):
            stamp_ns, after_s = EPOCH_NS + cycle * CYCLE_NS, (cycle - FIRST) * CYCLE_NS / 1e9
            if cycle >= FIRST:
                samples = motion(after_s + np.arange(20) * GRID_NS / 1e9)
                chunk = TrajectoryChunk.of(stamp_ns, NAMES, samples)
                writer.write(topics.YUMI_TRAJECTORY, messages.encode_chunk(chunk))
            nothing = np.zeros(7)
            measured = JointStates(stamp_ns, NAMES, Q_MIDDLE + 1e-3 * cycle, nothing, nothing)
            writer.write(topics.YUMI_JOINT_STATES, messages.encode_joint_states(measured))
    write_replay(folder / "run.mcap", folder / "run.rrd")
    return folder / "run.rrd"


def turns(path: Path, entity: str) -> dict[float, np.ndarray]:
    """Quaternions of an entity by the time in s."""
    found = {}
    for chunk in RrdReader(path).stream().to_chunks():
        if str(chunk.entity_path) == entity and not chunk.is_static:
            batch = chunk.to_record_batch()
            (name,) = [name for name in batch.schema.names if name.endswith("quaternion")]
            times = [time.total_seconds() for time in batch.column("robot_time").to_pylist()]
            rows = [row[0] for row in batch.column(name).to_pylist()]
            found.update({round(t, 6): np.array(row) for t, row in zip(times, rows, strict=True)})
    return found


@pytest.mark.parametrize("joint", NAMES)
def test_before_the_first_command_the_ghost_is_where_the_arm_is(replayed: Path, joint: str) -> None:
    ghost = turns(replayed, f"/robot_commanded/joints/{joint}")
    arm = turns(replayed, f"/robot_measured/joints/{joint}")
    commanded_s = FIRST * CYCLE_NS / 1e9
    before = [time for time in arm if time < commanded_s]
    assert len(before) == FIRST
    assert min(ghost) == min(arm)
    for time in before:
        np.testing.assert_array_equal(ghost[time], arm[time])
    # From then on it moves as commanded, and the arm as measured.
    assert np.abs(ghost[round(commanded_s, 6)] - arm[round(commanded_s, 6)]).max() > 1e-3


def test_bars_of_the_spectrum_are_those_of_the_commanded_sines(replayed: Path) -> None:
    bars, middles = [], []
    for chunk in RrdReader(replayed).stream().to_chunks():
        if str(chunk.entity_path) == "/joints/spectrum" and not chunk.is_static:
            content = chunk.to_record_batch().to_pydict()
            for name, values in content.items():
                if name.endswith("values"):
                    bars = values[-1][0]["buffer"]
                elif name.endswith("abscissa"):
                    middles = values[-1][0]["buffer"]
    power = dict(zip(middles, bars, strict=True))
    # Power goes with the square.
    assert power[SLOW_HZ] == pytest.approx(80.0, abs=0.1)
    assert power[FAST_HZ] == pytest.approx(20.0, abs=0.1)
    assert sum(power.values()) == pytest.approx(100.0, abs=1e-3)
