"""Every cycle's reference is told as it was written; cycles without time for it are counted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from lone_motions import OURS, motion_from
from lone_robot import LoneRobot
from robot_servers import LAB, robot_in_a_thread

from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.recording.joint_series import executed_reference, measured_states
from skewmi.deploy.recording.reader import read_recording
from skewmi.deploy.recording.recorder import Recorder
from skewmi.deploy.robot.publisher import StatePublisher
from skewmi.deploy.safety.flange_space import CALIBRATION, TASK
from skewmi.deploy.session.open_space import open_space
from skewmi.deploy.session.robot_client import RobotClient
from skewmi.deploy.session.trust import Trust
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.controller_state import decode_controller_state
from skewmi.deploy.wire.messages import encode_chunk
from skewmi.deploy.wire.topics import Topic
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.trajectory import CYCLE_NS, CYCLE_TICKS, GRID_NS, TrajectoryChunk

CHUNKS = 10
MS = 1_000_000


class Wire:
    """A link that keeps what is published; also each publisher."""

    def __init__(self) -> None:
        self.sent: dict[str, list[bytes]] = {}

    def publisher(self, topic: Topic) -> Wire:
        one = Wire()
        one.put = self.sent.setdefault(topic.name, []).append  # type: ignore[method-assign]
        return one

    gid = bytes(16)

    def put(self, payload: bytes) -> None:
        raise NotImplementedError


def test_what_was_written_is_told_in_every_cycle_that_has_time(
    robot: LoneRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    wire = Wire()
    publisher = StatePublisher(robot.backend, robot.controller, wire)  # type: ignore[arg-type]
    sent = wire.sent[topics.YUMI_CONTROLLER_STATE.name]
    motion = motion_from(robot)
    robot.requests.arm(OURS, 0)
    assert robot.controller.receive(robot.payload(motion, robot.due + 3), OURS, 1, 0)
    rng = np.random.default_rng(3)
    late = rng.random(len(motion.q) + 20) < 0.3
    expected = []
    for is_late in late:
        robot.run(1)
        state = robot.controller.arm_motion.state
        assert state is not None
        monkeypatch.setattr(robot.backend, "due", lambda is_late=is_late: is_late)
        publisher.executed(state)
        publisher.executed(state)  # time stood still
        if not is_late:
            expected.append((robot.controller.arm_motion.executed_ns, state))
    told = [decode_controller_state(payload) for payload in sent]
    assert [t.stamp_ns for t in told] == [stamp for stamp, _ in expected]
    written = [target for target, skipped in zip(robot.targets, late, strict=True) if not skipped]
    for one, (_, state), target in zip(told, expected, written, strict=True):
        for part, sent_part in zip(one.reference, target, strict=True):
            assert np.array_equal(part, sent_part)
        assert np.array_equal(one.position, state.position[:7])
        assert np.array_equal(one.effort, state.effort[:7])
    assert max(float(np.abs(t.reference.v).max()) for t in told) > 0.01
    assert publisher._cycles_untold == late.sum()


@pytest.mark.parametrize("is_late", [False, True])
def test_a_status_waits_for_the_cycle_but_not_for_long(
    robot: LoneRobot, monkeypatch: pytest.MonkeyPatch, is_late: bool
) -> None:
    wire, now = Wire(), [10**12]
    publisher = StatePublisher(robot.backend, robot.controller, wire)  # type: ignore[arg-type]
    sent = wire.sent[topics.YUMI_STATUS.name]
    monkeypatch.setattr("skewmi.deploy.robot.publisher.time.monotonic_ns", lambda: now[0])
    robot.run(1)
    publisher.status()
    monkeypatch.setattr(robot.backend, "due", lambda: is_late)
    told_ms = []
    for ms in range(1, 1601):
        now[0] += MS
        before = len(sent)
        publisher.status()
        told_ms += [ms] * (len(sent) - before)
    assert told_ms == ([520, 1040, 1560] if is_late else [500, 1000, 1500])


def test_a_recording_has_every_cycle_of_a_robot_that_waits(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with robot_in_a_thread(lock_step=True) as locator:
        config = TransportConfig.for_client(locator, lock_step=True)
        with Link.open(config, "skewmi_test") as link:
            commands = link.publisher(topics.YUMI_TRAJECTORY)
            gripper = link.publisher(topics.YUMI_GRIPPER)
            own = {topics.YUMI_TRAJECTORY.name: (commands.gid,)}
            trust = Trust(link, own, None)
            client = RobotClient.open(link, trust, commands, gripper, dry_run=False)
            described = trust.meet(with_scene=True)
            checks = open_space(described, CALIBRATION, LAB)
            with Recorder.start(path, config, believed=trust.believed):
                client.arm(CALIBRATION)
                start = np.array(described.commanded_position)
                motion = StartMotion(start, start + 0.02, LAB)
                armed = client.describe()
                clock_ns = armed.clock_ns
                begin_ns = clock_ns - clock_ns % CYCLE_NS + 2 * CYCLE_NS
                chunks = [motion.chunk(cycle) for cycle in range(CHUNKS)]
                for cycle, samples in enumerate(chunks):
                    checks.guard.check(samples.q, samples.v, samples.a)
                    stamp_ns = begin_ns + cycle * CYCLE_NS
                    chunk = TrajectoryChunk.of(stamp_ns, described.joint_names, samples)
                    client.put_chunk(encode_chunk(chunk))
                while client.describe().clock_ns <= stamp_ns:
                    client.check(late_is_final=True)
                at_rest = client.disarm()
    assert at_rest is not None
    assert (armed.workspace, at_rest.workspace) == (CALIBRATION, TASK)
    read = read_recording(path)
    told = executed_reference(read)
    first, samples = told.on_grid()
    assert told.longest_gap_ns == GRID_NS
    begin = (begin_ns - first) // GRID_NS
    for part in ("q", "v", "a"):
        pieces = [getattr(chunk, part)[:CYCLE_TICKS] for chunk in chunks[:-1]]
        sent = np.concatenate([*pieces, getattr(chunks[-1], part)])
        executed = getattr(samples, part)[begin : begin + len(sent)]
        # Time stands still once the arm rests: the last samples need not be reached.
        assert np.array_equal(executed, sent[: len(executed)])
        assert np.array_equal(executed[-1], sent[-1])
    measured = measured_states(read)
    seen = np.isin(told.stamps_ns, measured.stamps_ns)
    rows = np.isin(measured.stamps_ns, told.stamps_ns)
    assert seen.sum() > 5
    assert np.array_equal(measured.position[rows][:, :7], told.position[seen])
