"""Contact figures of `skewmi evaluate`: reduced as they say, and true of the real simulation."""

from __future__ import annotations

import json
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from skewmi.contact import QUANTITIES
from skewmi.errors import ConfigurationError
from skewmi.evaluation.contact import (
    ContactRecorder,
    contact_text,
    recorder_for,
    summarise_contact,
)
from skewmi.evaluation.rollout import run_episodes
from skewmi.policy_io import Array, PolicyLayout
from skewmi.sim import tasks

NAMES = list(QUANTITIES)
LIMITS = np.array([q.limit if q.limit is not None else np.inf for q in QUANTITIES.values()])

VALUES = hnp.arrays(
    np.float64,
    st.tuples(st.integers(1, 6), st.just(len(QUANTITIES)), st.integers(1, 5)),
    elements=st.floats(0.0, 150.0),
)


@given(VALUES)
def test_one_bad_step_spoils_its_episode_and_no_other(values: Array) -> None:
    figures = summarise_contact(values)
    good = [
        all((step <= LIMITS).all() for step in values[:, :, episode])
        for episode in range(values.shape[2])
    ]
    assert figures["share_of_episodes_gentle"] == pytest.approx(np.mean(good))
    for name in NAMES:
        column = figures[name]
        assert 0.0 <= column["p50"] <= column["p99"] <= column["max"]
        if "limit" in column:
            assert column["share_of_episodes_within"] >= figures["share_of_episodes_gentle"]
            assert (column["share_of_episodes_within"] == 1.0) == (column["max"] <= column["limit"])
    json.dumps(figures, allow_nan=False)


def test_limits_are_inclusive_and_each_of_them_counts() -> None:
    at_limit = np.where(np.isinf(LIMITS), 1e6, LIMITS)[None, :, None]
    assert summarise_contact(at_limit)["share_of_episodes_gentle"] == 1.0
    for column in np.flatnonzero(np.isfinite(LIMITS)):
        beyond = at_limit.copy()
        beyond[0, column] = np.nextafter(beyond[0, column], np.inf)
        figures = summarise_contact(beyond)
        assert figures["share_of_episodes_gentle"] == 0.0
        assert figures[NAMES[column]]["share_of_episodes_within"] == 0.0


def test_nothing_recorded_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="no finished episode"):
        summarise_contact(np.zeros((200, len(QUANTITIES), 0)))


class Leaning:
    """Drives the hand into the box from where it starts, with all it may command."""

    def __init__(self, layout: PolicyLayout) -> None:
        self.layout = layout

    def reset(self) -> None:
        pass

    def act(self, observation: Array) -> Array:
        return np.tile([0.0, 0.0, -1.0], (len(observation), 1))


def test_recorder_tells_what_the_environment_said_and_where_the_hand_was() -> None:
    env = tasks.make_batch("open_press_close", 2, num_threads=1)
    layout = env.layout
    assert layout.workspace is not None
    low, high = np.array(layout.workspace.low), np.array(layout.workspace.high)
    recorder = recorder_for(env)
    assert recorder is not None
    episodes = run_episodes(Leaning(layout), env, 3, 0, observer=recorder)
    values = recorder.values
    assert values.shape == (layout.episode_steps, len(QUANTITIES), 3)
    peak, mean, standing, _, tilt, outside, lead = values.swapaxes(0, 1)
    hand = np.concatenate(
        [episodes.observation[1:, :, :3], episodes.final_observation[None, :, :3]]
    )
    nearest = np.clip(hand, low, high)
    np.testing.assert_allclose(outside, 1e3 * np.linalg.norm(hand - nearest, axis=-1), atol=1e-9)
    assert (peak >= mean - 1e-9).all()
    np.testing.assert_allclose(standing[7], mean[3:8].mean(axis=0))
    np.testing.assert_allclose(standing[1], mean[:2].sum(axis=0) / 5.0)
    # The second round was the last: its first environment is episode 2.
    last = env.diagnostics()
    np.testing.assert_array_equal(peak[-1, 2], last.hand_force_peak[0])
    np.testing.assert_allclose(np.deg2rad(tilt[-1, 2]), last.hand_tilt[0])
    np.testing.assert_allclose(1e-3 * lead[-1, 2], last.hand_to_command[0])
    # A fingertip on the lid with the command below it pushes with the servos' strength.
    assert mean[-1].min() > 1.0
    text = "\n".join(contact_text(summarise_contact(values)))
    assert all(quantity.label in text for quantity in QUANTITIES.values())


def test_tasks_without_a_hand_have_no_contact_figures(
    recorder: Callable[[PolicyLayout], ContactRecorder],
) -> None:
    assert recorder_for(tasks.make_batch("point_maze", 1)) is None
    with pytest.raises(ConfigurationError, match="no hand in a workspace"):
        recorder(tasks.layout("point_maze"))


@pytest.fixture
def recorder() -> Callable[[PolicyLayout], ContactRecorder]:
    env = tasks.make_batch("open_press_close", 1, num_threads=1)
    return lambda layout: ContactRecorder(layout, env.diagnostics)
