"""A link that a variation makes bad: what is lost, what is late, and that it begins anew."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skewmi.deploy.robot.backend import LinkErrors, RobotState
from skewmi.deploy.robot.backends.hold import HoldBackend
from skewmi.deploy.robot.backends.mujoco.backend import MujocoBackend
from skewmi.deploy.robot.backends.mujoco.simulation import ArmSimulation
from skewmi.deploy.robot.bad_link import BadLink
from skewmi.deploy.robot.publisher import StatePublisher
from skewmi.deploy.wire.messages import decode_joint_states
from skewmi.robot_models import yumi
from skewmi.trajectory import CYCLE_NS

MS = 1_000_000


def sent(errors: LinkErrors, *, n: int = 2000, cycle_ms: int = 4) -> list[tuple[int, int]]:
    """(number, cycles late) of what arrives of messages that are put once a cycle."""
    link, arrived, present = BadLink(errors), [], [0]

    def send(message: bytes) -> None:
        arrived.append((int(message), present[0]))

    for cycle in range(n + 300):
        present[0], now_ns = cycle, cycle * cycle_ms * MS
        link.carry(now_ns)
        if cycle < n:
            link.take(send, b"%d" % cycle, now_ns)
    return [(number, cycle - number) for number, cycle in arrived]


@pytest.mark.parametrize("loss", [0.0, 0.1, 0.5])
def test_as_many_are_lost_as_asked_for(loss: float) -> None:
    arrived = sent(LinkErrors(loss, 0.0, 0.0, (1, 0)))
    assert 1.0 - len(arrived) / 2000 == pytest.approx(loss, abs=4 * np.sqrt(0.25 / 2000) * loss)
    assert all(late == 0 for _, late in arrived)


def test_the_rest_is_late_by_the_delay_and_by_up_to_the_jitter() -> None:
    late = np.array([late for _, late in sent(LinkErrors(0.0, 0.040, 0.0, (1, 0)))])
    assert len(late) == 2000
    assert np.all(late == 10)
    # Messages further apart than the jitter do not wait for each other.
    arrived = sent(LinkErrors(0.0, 0.1, 0.1, (1, 0)), cycle_ms=100, n=500)
    assert {cycles for _, cycles in arrived} <= {1, 2}
    assert len(arrived) == 500


@given(st.floats(0.0, 0.9), st.floats(0.0, 0.5), st.floats(0.0, 0.5), st.integers(0, 2**32 - 1))
def test_nothing_overtakes_comes_early_twice_or_too_late(
    loss: float, delay_s: float, jitter_s: float, seed: int
) -> None:
    errors = LinkErrors(loss, delay_s, jitter_s, (seed, 0))
    arrived = sent(errors, n=60)
    numbers = [number for number, _ in arrived]
    assert numbers == sorted(set(numbers))
    for _, late in arrived:
        assert 0.004 * late >= delay_s - 1e-9
        assert 0.004 * (late - 1) <= delay_s + jitter_s
    assert sent(errors, n=60) == arrived


class Recorder:
    """The publishers of a link that keep what they are given."""

    def __init__(self) -> None:
        self.told: list[Any] = []

    def publisher(self, topic: Any) -> Any:
        return SimpleNamespace(put=lambda payload: self.told.append((topic.name, payload)))


def published(errors: LinkErrors | None, states: int = 400) -> list[int]:
    """Stamps of the joint states that a publisher of a robot with such a link tells."""
    recorder = Recorder()
    motion = SimpleNamespace(executed_ns=0)
    backend: Any = SimpleNamespace(scene=None, state_names=("a",), link_errors=lambda: errors)
    controller: Any = SimpleNamespace(arm_motion=motion)
    link: Any = recorder
    publisher = StatePublisher(backend, controller, link)
    one = np.zeros(1)
    for index in range(states):
        motion.executed_ns = index * CYCLE_NS
        publisher.states(RobotState(index * CYCLE_NS, one, one, one))
        publisher.carry()
    deadline = time.monotonic() + (0.0 if errors is None else 2 * errors.delay_s)
    while time.monotonic() < deadline:
        publisher.carry()
    return [decode_joint_states(payload).stamp_ns for _, payload in recorder.told]


def test_a_publisher_loses_and_delays_joint_states_of_a_robot_that_asks_for_it() -> None:
    every = published(None)
    assert len(every) == 400
    some = published(LinkErrors(0.25, 0.05, 0.0, (3, 0)))
    assert len(some) == pytest.approx(300, abs=35)
    assert set(some) < set(every)
    assert published(LinkErrors(0.25, 0.05, 0.0, (3, 0))) == some
    assert published(LinkErrors(0.25, 0.05, 0.0, (4, 0))) != some


def test_a_robot_has_the_link_that_its_variation_draws_for_the_episode() -> None:
    simulation = ArmSimulation(
        variation="{seed: 5, link: {loss: 0.1, delay_ms: [10, 20], jitter_ms: 3}}"
    )
    robot = MujocoBackend(simulation)
    drawn = []
    for seed in (1, 2, 1):
        simulation.reset(seed)
        errors = robot.link_errors()
        assert errors is not None
        assert robot.link_errors() is errors
        assert (errors.loss, errors.jitter_s, errors.seed) == (0.1, 0.003, (seed, 5))
        assert 0.010 <= errors.delay_s <= 0.020
        drawn.append(errors)
    assert drawn[0] == drawn[2] != drawn[1]
    assert drawn[0] is not drawn[2]


def test_there_is_no_bad_link_in_lock_step_and_the_user_is_told(
    caplog: pytest.LogCaptureFixture,
) -> None:
    varied = MujocoBackend(ArmSimulation(variation="{link: {loss: 0.5}}"), lock_step=True)
    assert varied.link_errors() is None
    varied.open(lambda: False)
    assert "no effect in lock-step" in caplog.text
    assert not hasattr(HoldBackend(np.array(yumi.HOME["right"])), "link_errors")
