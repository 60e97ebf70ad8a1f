"""A scripted motion solves OpenPressClose through actions and observations alone."""

from __future__ import annotations

import numpy as np
import pytest
from scripted_episodes import NUM_ENVS, ScriptedEpisodes
from scripted_open_press_close import ScriptedOpenPressClose

from skewmi.sim.tasks.open_press_close.definition import ARM


def run(seed: int, **options) -> ScriptedEpisodes:
    return ScriptedEpisodes(ARM, ScriptedOpenPressClose, seed, **options)


@pytest.fixture(scope="module", params=[0, 1])
def nominal(request: pytest.FixtureRequest) -> ScriptedEpisodes:
    return run(request.param)


def test_every_start_succeeds_with_time_to_spare(nominal: ScriptedEpisodes) -> None:
    assert len(np.unique(nominal.starts, axis=0)) == NUM_ENVS
    assert np.all(nominal.success_step > 0), nominal.success_step
    assert nominal.success_step.max() <= 140


def test_the_lid_is_opened_before_the_button_is_pressed_and_shut_afterwards(
    nominal: ScriptedEpisodes,
) -> None:
    lid, button = nominal.states[..., 4], nominal.states[..., 5]
    for i in range(NUM_ENVS):
        first_pressed = int(np.argmax(button[:, i] > 0.010))
        assert lid[:first_pressed, i].max() > 1.5
        assert lid[first_pressed, i] > 1.5
        assert lid[-1, i] < 0.035
        assert button[-1, i] > 0.010


def test_forces_are_those_of_a_collaborative_robot(nominal: ScriptedEpisodes) -> None:
    assert nominal.figure("hand_force_peak").max() <= 100.0
    assert nominal.figure("hand_force_mean").max() <= 40.0
    assert nominal.figure("arm_force_peak").max() == 0.0
    # The script has to touch things, so a sensor that is dead would show.
    assert nominal.figure("hand_force_peak").max() > 2.0


def test_the_hand_stays_upright_in_its_box_and_near_its_command(nominal: ScriptedEpisodes) -> None:
    assert np.degrees(nominal.figure("hand_tilt").max()) <= 2.0
    scale = nominal.layout.action_scale[:3]
    assert nominal.figure("hand_to_command").max() <= np.linalg.norm(scale) + 1e-3
    hand = nominal.states[..., :3]
    assert np.all(hand >= np.array(nominal.layout.workspace.low) - 0.003)
    assert np.all(hand <= np.array(nominal.layout.workspace.high) + 0.003)


def test_nothing_jumps_so_nothing_was_edited(nominal: ScriptedEpisodes) -> None:
    steps = np.abs(np.diff(nominal.states, axis=0)).max(axis=(0, 1))
    assert np.all(steps[:3] < 0.025)
    assert steps[4] < 0.35
    assert steps[5] < 0.015


def test_the_button_never_comes_back_up(nominal: ScriptedEpisodes) -> None:
    assert np.diff(nominal.states[..., 5], axis=0).min() > -1e-4


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
