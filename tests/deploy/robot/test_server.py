"""A robot server and its commander: who disarms it, and how it ends."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from robot_servers import call, describe
from scripted_runs import FewSteps

from skewmi.deploy.options import DeployOptions
from skewmi.deploy.robot.backend import BackendFaultError
from skewmi.deploy.robot.backends import BackendOptions
from skewmi.deploy.robot.backends.mujoco import backend as mujoco_backend
from skewmi.deploy.robot.backends.mujoco.simulation import ArmSimulation
from skewmi.deploy.robot.process import free_port
from skewmi.deploy.robot.run import serve_robot
from skewmi.deploy.run import run_deploy
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.transport import TransportConfig
from skewmi.errors import TransportError
from skewmi.robot_models import limits as joint_limits


def test_only_the_commander_disarms(lock_step_robot: str) -> None:
    ours, other = bytes(range(16)), bytes(range(16, 32))
    assert call(lock_step_robot, topics.YUMI_ARM, ours + bytes(16))[0]
    for gid in (other, b"", other + ours):
        refused, why = call(lock_step_robot, topics.YUMI_DISARM, gid)
        assert not refused
        assert "not the commander" in why
        assert describe(lock_step_robot).state == "holding"
    assert call(lock_step_robot, topics.YUMI_DISARM, ours + bytes(16)) == (True, "disarmed")
    assert "disarmed by its commander" in describe(lock_step_robot).reason
    # Armed by nobody in particular: anybody may stop it, nobody is its commander.
    assert call(lock_step_robot, topics.YUMI_ARM)[0]
    assert not call(lock_step_robot, topics.YUMI_DISARM, bytes(16))[0]
    assert call(lock_step_robot, topics.YUMI_STOP)[0]


def test_a_robot_that_cannot_be_opened_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Or its gripper's thread goes on talking, and its sockets stay bound."""
    closed = []

    class Unreachable(mujoco_backend.MujocoBackend):
        def open(self, may_advance: object) -> None:
            raise TransportError("no robot at this address")

        def close(self) -> None:
            closed.append(self)
            super().close()

    monkeypatch.setattr(mujoco_backend, "MujocoBackend", Unreachable)
    config = TransportConfig.for_robot(f"tcp/127.0.0.1:{free_port()}", lock_step=True)
    options, lab = BackendOptions(lock_step=True), joint_limits.profile("lab")
    with pytest.raises(TransportError, match="no robot at this address"):
        serve_robot("sim", options, config, lab, threading.Event())
    assert len(closed) == 1


@pytest.mark.parametrize("lock_step", [True, False])
def test_a_robot_server_that_is_ended_in_a_fault_follows_the_plan_to_rest_first(
    lock_step: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    ended, crashes, targets = threading.Event(), [], []
    ready, fail = threading.Event(), threading.Event()

    class Failing(ArmSimulation):
        def step(self) -> None:
            super().step()
            targets.append(self.command.q.copy())
            if fail.is_set() and np.abs(self.command.v).max() > 0.05:
                fail.clear()
                targets.clear()
                ended.set()
                raise BackendFaultError("drive 3 over temperature")

    monkeypatch.setattr(mujoco_backend, "ArmSimulation", Failing)
    locator = f"tcp/127.0.0.1:{free_port()}"
    config = TransportConfig.for_robot(locator, lock_step=lock_step)
    options = BackendOptions(lock_step=lock_step)
    lab = joint_limits.profile("lab")

    def serve() -> None:
        try:
            serve_robot("sim", options, config, lab, ended, lambda _: ready.set())
        except Exception as error:
            crashes.append(error)

    thread = threading.Thread(target=serve)
    thread.start()
    assert ready.wait(20.0)
    run_deploy(
        FewSteps(3, fail.set), DeployOptions(connect=locator, lock_step=lock_step, lead_ms=60.0)
    )
    thread.join(20.0)
    assert not thread.is_alive()
    assert crashes == []
    assert len(targets) > 5, "the arm was moving when the robot server was ended"
    # Its last sample, at rest, is due when the loop ends.
    np.testing.assert_allclose(targets[-1], targets[-2], atol=1e-4)
