"""Late commands: as late as asked, no further than what was commanded, at rest where it ended."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.policy_io import Array
from skewmi.sim import tasks
from skewmi.sim.arm.command_delay import CommandLine, DelayedCommands
from skewmi.sim.arm.definition import CONTROL_DT, SIM_DT, SUBSTEPS
from skewmi.sim.variation import ModelVariation

TASK = "open_press_close"


def delayed(delay_ms: list[float]) -> DelayedCommands:
    n = len(delay_ms)
    return DelayedCommands(1e-3 * np.array(delay_ms), np.zeros((n, 7)), np.zeros((n, 3)))


def lines(ends: Array) -> list[CommandLine]:
    """From 0 through points of shape (steps, n, 7), a control step each; the hand as joints 1-3."""
    ends = np.concatenate([np.zeros_like(ends[:1]), ends])
    return [
        CommandLine(begin, end, (end - begin) / CONTROL_DT, begin[:, :3], end[:, :3])
        for begin, end in pairwise(ends)
    ]


def followed(commands: DelayedCommands, ends: Array) -> Array:
    """What is commanded at every substep. Shape (n, steps * SUBSTEPS, 7)."""
    parts = []
    for line in lines(ends):
        commands.lay(line)
        parts.append(commands.q.copy())
    return np.concatenate(parts, axis=1)


@pytest.mark.parametrize("delay_ms", [0.0, 2.0, 50.0, 100.0, 200.0])
def test_a_straight_line_comes_so_much_later(delay_ms: float) -> None:
    times = CONTROL_DT * np.arange(1, 9)
    ends = np.ones((1, 7)) * times[:, None, None]
    q = followed(delayed([delay_ms]), ends)[0, :, 0]
    now = SIM_DT * np.arange(1, len(q) + 1)
    begun = now > 2e-3 * delay_ms
    np.testing.assert_allclose(q[begun], now[begun] - 1e-3 * delay_ms, atol=1e-9)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32), st.lists(st.floats(0.0, 200.0), min_size=1, max_size=4))
def test_no_command_leaves_what_was_commanded_lately(seed: int, delay_ms: list[float]) -> None:
    rng = np.random.default_rng(seed)
    ends = rng.normal(size=(6, len(delay_ms), 7))
    late, plain = followed(delayed(delay_ms), ends), followed(delayed([0.0] * len(delay_ms)), ends)
    for arm, delay in enumerate(delay_ms):
        reach = round(2.0 * delay / (1e3 * SIM_DT))
        for at in range(late.shape[1]):
            lately = plain[arm, max(at - reach, 0) : at + 1]
            if at < reach:
                lately = np.concatenate([np.zeros((1, 7)), lately])
            assert (late[arm, at] <= lately.max(axis=0) + 1e-12).all()
            assert (late[arm, at] >= lately.min(axis=0) - 1e-12).all()


def test_velocities_are_those_of_the_commanded_joints() -> None:
    commands = delayed([80.0])
    q = followed(commands, np.random.default_rng(1).normal(size=(5, 1, 7)))[0]
    differences = np.diff(q, axis=0)[-SUBSTEPS + 1 :] / SIM_DT
    middles = 0.5 * (commands.velocity[0, 1:] + commands.velocity[0, :-1])
    np.testing.assert_allclose(differences, middles, atol=0.35 * np.abs(middles).max())
    assert np.corrcoef(differences.ravel(), middles.ravel())[0, 1] > 0.99


def test_held_arms_rest_where_they_are_commanded_to_be_and_the_others_go_on() -> None:
    ends = np.random.default_rng(2).normal(size=(3, 2, 7))
    commands, other = delayed([100.0, 100.0]), delayed([100.0, 100.0])
    followed(commands, ends)
    followed(other, ends)
    held, at = np.array([1]), 10
    there = commands.look(at, np.zeros((2, 3)))[0][held]
    q = commands.hold(held, at, there)
    np.testing.assert_array_equal(q[0], other.q[1, at - 1])
    np.testing.assert_array_equal(commands.q[1, at:], np.repeat(q, SUBSTEPS - at, axis=0))
    np.testing.assert_array_equal(commands.q[0], other.q[0])
    end = np.concatenate([ends[-1, :1], q])
    stay = CommandLine(end, end, np.zeros((2, 7)), end[:, :3], end[:, :3])
    commands.lay(stay)
    np.testing.assert_allclose(commands.q[1], np.repeat(q, SUBSTEPS, axis=0), atol=1e-12)


def hands(text: str, actions: Array, n: int = 2) -> Array:
    """Measured hands after every action, m. Shape (steps, n, 3)."""
    variation: ModelVariation = tasks.find(TASK).variations.parse(text, "a test")
    env = tasks.make_batch(TASK, n, variation=variation, seed=5)
    columns = [env.layout.observation_names.index(f"hand_{axis}") for axis in "xyz"]
    env.reset(5)
    steps = [env.step(np.tile(action, (n, 1))).observation[:, columns] for action in actions]
    return np.array(steps)


def free_motion() -> Array:
    """Up, to and fro along y above the box."""
    steps = np.zeros((24, 3))
    steps[:8, 2] = 0.5
    steps[8:, 1] = np.sin(np.arange(16) * 0.8)
    return steps


def test_the_hand_moves_later_by_the_delay() -> None:
    actions = free_motion()
    plain, late = hands("{}", actions), hands("command: {delay_ms: 100}", actions)
    # 100 ms are a control step; corners of the way are rounded.
    assert np.abs(late[1:] - plain[:-1]).max() < 0.005
    assert np.abs(late - plain).max() > 0.010


def test_no_delay_is_the_nominal_simulation() -> None:
    actions = free_motion()
    np.testing.assert_array_equal(hands("command: {delay_ms: 0}", actions), hands("{}", actions))
