"""A scripted motion opens the door to every target through actions and observations alone."""

from __future__ import annotations

import numpy as np
import pytest
from scripted_door_open import ScriptedDoorOpen
from scripted_episodes import NUM_ENVS, ScriptedEpisodes

from skewmi.sim.arm.batch import ArmBatch
from skewmi.sim.tasks.door_open import parts, targets
from skewmi.sim.tasks.door_open.definition import ARM

PAYLOAD = 25.0
"""Standing force that the motion must not need, N: it lifts some 3 N."""


def run(seed: int, **options) -> ScriptedEpisodes:
    return ScriptedEpisodes(ARM, ScriptedDoorOpen, seed, **options)


@pytest.fixture(scope="module", params=targets.TARGETS)
def opened(request: pytest.FixtureRequest) -> tuple[float, ScriptedEpisodes]:
    """The angle that was asked for, and what happened."""
    return targets.TARGETS[request.param], run(0, target=request.param)


def test_every_start_reaches_the_target_with_time_to_spare(opened) -> None:
    _, episodes = opened
    assert len(np.unique(episodes.starts, axis=0)) == NUM_ENVS
    assert np.all(episodes.success_step > 0), episodes.success_step
    assert episodes.success_step.max() <= 100


def test_the_door_stays_at_the_target_to_the_end_of_the_episode(opened) -> None:
    angle, episodes = opened
    assert episodes.inside[-50:].all()
    assert np.abs(episodes.states[-50:, :, 4] - angle).max() < targets.RADIUS


def test_forces_are_those_of_a_collaborative_robot(opened) -> None:
    _, episodes = opened
    assert episodes.figure("hand_force_peak").max() <= 100.0
    assert episodes.figure("hand_force_mean").max() <= PAYLOAD
    assert episodes.figure("arm_force_peak").max() == 0.0
    # The script has to touch the handle, so a sensor that is dead would show.
    assert episodes.figure("hand_force_peak").max() > 1.0


def test_the_hand_stays_upright_in_its_box(opened) -> None:
    _, episodes = opened
    assert np.degrees(episodes.figure("hand_tilt").max()) <= 2.0
    hand = episodes.states[..., :3]
    assert np.all(hand >= np.array(ARM.low) - 0.003)
    assert np.all(hand <= np.array(ARM.high) + 0.003)


def test_nothing_jumps_so_nothing_was_edited(opened) -> None:
    _, episodes = opened
    steps = np.abs(np.diff(episodes.states, axis=0)).max(axis=(0, 1))
    assert np.all(steps[:3] < 0.025)
    assert steps[4] < 0.35


@pytest.mark.parametrize(
    "options",
    [
        {"delay_steps": 1},
        {"noise": 5e-4},
        {"gripper_action": True, "time_input": True},
    ],
    ids=["late by 100 ms", "hand measured with 0.5 mm noise", "other layout"],
)
def test_the_script_survives_what_a_real_chain_adds(options: dict) -> None:
    late = run(7, **options)
    assert np.all(late.success_step > 0), late.success_step
    assert late.figure("hand_force_peak").max() <= 100.0


def test_pulling_on_at_the_open_stop_settles_at_a_bounded_force() -> None:
    env = ArmBatch(ARM, 1, num_threads=1)
    script = ScriptedDoorOpen(env.layout)
    observation = env.reset(0)
    for _ in range(45):
        observation = env.step(script.act(observation[0])[None]).observation
    forces = []
    for _ in range(40):
        # Along the arc, which at the stop leads nearly straight to -y, and then up.
        up = float(observation[0, 4] > 1.5)
        observation = env.step(np.array([[0.0, -1.0, up]])).observation
        forces.append(env.diagnostics().hand_force_mean[0])
    assert observation[0, 4] == pytest.approx(parts.DOOR_MAX, abs=0.01)
    assert forces[-1] > 5.0, "nothing pulls"
    # What the held following error of a blocked hand comes to in the arm's stiffest direction, in
    # the mean of a second: it goes up and down by 6 N from step to step.
    assert np.mean(forces[-10:]) < 42.0
    assert max(forces[-10:]) < 55.0
