"""Replay and hindsight against brute force, on episodes made up at random."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from skewmi.errors import CheckpointError
from skewmi.train.blocks import LARGEST, read_blocks, split, write_blocks
from skewmi.train.config import SkewConfig, TrainConfig
from skewmi.train.density import Scale, unit_scale
from skewmi.train.exploration.skew_explore import RewardTerms, propose
from skewmi.train.inputs import InputNormalizer
from skewmi.train.replay import Episodes, Replay
from skewmi.train.sac.hindsight import make_batch, n_step_return, relabel


def make_episodes(layout, n: int, rng: np.random.Generator, paid: float = 0.1) -> Episodes:
    steps = layout.episode_steps
    observations = rng.uniform(0, 4, size=(n, steps + 1, 3))
    observations[..., 2] = np.arange(steps + 1) / steps
    return Episodes(
        observations=observations,
        actions=rng.uniform(-1, 1, size=(n, steps, 2)),
        goals=rng.uniform(0, 4, size=(n, steps, 2)),
        rewards=(rng.random((n, steps)) < paid).astype(float),
    )


@pytest.fixture
def layout(make_corridor):
    return make_corridor().layout


@pytest.fixture
def filled(layout):
    rng = np.random.default_rng(0)
    replay = Replay(layout, 12 * layout.episode_steps)
    episodes = make_episodes(layout, 8, rng)
    log_tau = rng.normal(size=(8, layout.episode_steps))
    replay.add(episodes, log_tau)
    return replay, episodes, log_tau


def test_n_step_return_by_hand() -> None:
    rewards = np.array([[1.0, 2.0, 4.0], [1.0, 2.0, 4.0], [1.0, 2.0, 4.0]])
    got = n_step_return(rewards, np.array([3, 2, 1]), 0.5)
    np.testing.assert_allclose(got, [1 + 1 + 1, 1 + 1, 1])


@pytest.mark.parametrize("n_step", [1, 3, 7])
def test_drawn_transitions_are_those_of_the_episodes(filled, layout, n_step: int) -> None:
    replay, episodes, log_tau = filled
    drawn = replay.draw(500, n_step, 0.25, np.random.default_rng(1))
    steps = layout.episode_steps
    for i in range(500):
        e, t = drawn.episode[i], drawn.step[i]
        length = min(n_step, steps - t)
        assert drawn.length[i] == length
        assert drawn.at_end[i] == (t + length == steps)
        np.testing.assert_allclose(drawn.observation[i], episodes.observations[e, t], rtol=1e-6)
        np.testing.assert_allclose(drawn.action[i], episodes.actions[e, t], rtol=1e-6)
        np.testing.assert_allclose(drawn.goal[i], episodes.goals[e, t], rtol=1e-6)
        last = episodes.observations[e, t + length]
        np.testing.assert_allclose(drawn.next_observation[i], last, rtol=1e-6)
        for k in range(length):
            state = episodes.observations[e, t + k + 1, :2]
            np.testing.assert_allclose(drawn.states[i, k], state, rtol=1e-6)
            np.testing.assert_allclose(drawn.log_tau[i, k], log_tau[e, t + k], rtol=1e-6)
            assert drawn.rewards[i, k] == episodes.rewards[e, t + k]


@pytest.mark.parametrize("bootstrap", [True, False])
def test_relabelled_batch_is_brute_force(filled, layout, bootstrap: bool) -> None:
    replay, episodes, log_tau = filled
    config = TrainConfig()
    config = replace(config, sac=replace(config.sac, bootstrap_at_timeout=bootstrap))
    scale = Scale(np.array([1.0, 2.0]), np.array([0.5, 0.8]), np.ones(2))
    terms = RewardTerms(replace(config.skew, goal_clip=-9.0), scale)
    rng = np.random.default_rng(2)
    drawn = replay.draw(200, 3, 0.0, rng)
    goals = rng.uniform(0, 4, size=(200, 2))
    batch = make_batch(
        drawn, goals, terms, InputNormalizer(layout, True), config, torch.device("cpu")
    )
    c, gamma = config.skew, config.sac.discount
    normal = multivariate_normal(np.zeros(2), c.sigma**2 * np.eye(2))
    steps = layout.episode_steps
    for i in range(200):
        e, t = drawn.episode[i], drawn.step[i]
        expected, k = 0.0, 0
        while k < 3 and t + k < steps:
            state = episodes.observations[e, t + k + 1, :2]
            log_p_z = max(normal.logpdf((state - goals[i]) / scale.unit), -9.0)
            intrinsic = c.intrinsic * (log_p_z - log_tau[e, t + k])
            expected += gamma**k * (intrinsic + c.extrinsic * episodes.rewards[e, t + k])
            k += 1
        assert float(batch.returns[i]) == pytest.approx(expected, abs=1e-5)
        ends = t + k == steps and not bootstrap
        assert float(batch.discounts[i]) == pytest.approx(0.0 if ends else gamma**k)


def test_hindsight_mix(filled, layout) -> None:
    replay, episodes, _ = filled
    rng = np.random.default_rng(3)
    drawn = replay.draw(4000, 3, 0.0, rng)
    proposals = np.array([[100.0, 100.0], [200.0, 200.0]])
    goals = relabel(drawn, replay, proposals, 0.5, 0.3, rng)
    proposed = goals[:, 0] >= 100.0
    own = (goals == drawn.goal).all(1)
    assert proposed.mean() == pytest.approx(0.3, abs=0.03)
    assert own.mean() == pytest.approx(0.2, abs=0.03)
    for i in np.flatnonzero(~proposed & ~own)[:300]:
        later = episodes.observations[drawn.episode[i], drawn.step[i] + 1 :, :2]
        assert np.isclose(later, goals[i], rtol=1e-6).all(1).any()


def test_rewarded_episodes_are_drawn_more_often(layout) -> None:
    rng = np.random.default_rng(4)
    replay = Replay(layout, 100 * layout.episode_steps)
    none = make_episodes(layout, 99, rng, paid=0.0)
    replay.add(none, np.zeros_like(none.rewards))
    assert len(replay.rewarded_states(10, rng)) == 0
    one = make_episodes(layout, 1, rng, paid=1.0)
    replay.add(one, np.zeros_like(one.rewards))
    drawn = replay.draw(4000, 1, 0.25, rng)
    expected = 0.25 + 0.75 / 100
    assert (drawn.episode == 99).mean() == pytest.approx(expected, abs=0.03)
    states = replay.rewarded_states(10, rng)
    assert len(states) == 10
    assert all(np.isclose(one.observations[0, 1:, :2], s, rtol=1e-6).all(1).any() for s in states)


def test_ring_keeps_the_latest(layout) -> None:
    rng = np.random.default_rng(5)
    replay = Replay(layout, 10 * layout.episode_steps)
    for k in range(7):
        episodes = make_episodes(layout, 3, rng, paid=0.0)
        replay.add(replace(episodes, actions=np.full_like(episodes.actions, k)), episodes.rewards)
    assert len(replay) == 10
    drawn = replay.draw(2000, 1, 0.0, rng)
    assert set(np.unique(drawn.action)) == {3.0, 4.0, 5.0, 6.0}


@given(count=st.integers(0, 20_000), kept=st.integers(1, 20_000))
def test_blocks_cover_the_live_episodes_once(count: int, kept: int) -> None:
    first = max(0, count - kept)
    blocks = split(first, count)
    ends = [start + length for start, length in blocks]
    assert all(end == start for end, (start, _) in zip(ends[:-1], blocks[1:], strict=True))
    assert all(length & (length - 1) == 0 and start % length == 0 for start, length in blocks)
    if count:
        assert blocks[0][0] <= first < ends[0]
        assert ends[-1] == count
        assert len(blocks) <= kept / LARGEST + 2 * np.log2(LARGEST) + 2


@settings(max_examples=20, deadline=None)
@given(batches=st.lists(st.integers(1, 9), min_size=1, max_size=8), capacity=st.integers(9, 30))
def test_blocks_bring_everything_back(tmp_path_factory, batches: list[int], capacity: int) -> None:
    from skewmi.policy_io import ActionField, Field, PolicyLayout

    layout = PolicyLayout(
        task="t",
        observation=(Field("x", "m", "w", 0, 1), Field("y", "m", "w", 0, 1)),
        action=(ActionField("u", "m", "w", 1.0), ActionField("v", "m", "w", 1.0)),
        reward_region=(),
        control_dt=0.1,
        episode_steps=4,
        success_hold_steps=1,
    )
    rng = np.random.default_rng(0)
    replay = Replay(layout, capacity * 4)
    folder, previous = tmp_path_factory.mktemp("blocks"), None
    for k, n in enumerate(batches):
        episodes = Episodes(
            rng.random((n, 5, 2)), rng.random((n, 4, 2)), rng.random((n, 4, 2)),
            (rng.random((n, 4)) < 0.1).astype(float),
        )  # fmt: skip
        replay.add(episodes, rng.random((n, 4)))
        write_blocks(replay, folder / str(k), previous)
        previous = folder / str(k)
    back = Replay(layout, capacity * 4)
    read_blocks(back, previous, replay.count)
    assert back.count == replay.count
    np.testing.assert_array_equal(back.rows, replay.rows)
    np.testing.assert_array_equal(back.rewarded, replay.rewarded)


def test_damaged_block_is_refused(filled, layout, tmp_path) -> None:
    replay, _, _ = filled
    write_blocks(replay, tmp_path / "replay", None)
    block = next((tmp_path / "replay").iterdir())
    block.write_bytes(block.read_bytes()[:100])
    with pytest.raises(CheckpointError, match="replay block"):
        read_blocks(Replay(layout, 480), tmp_path / "replay", replay.count)


def test_proposals_prefer_the_rare(layout) -> None:
    rng = np.random.default_rng(6)
    replay = Replay(layout, 100 * layout.episode_steps)
    episodes = make_episodes(layout, 100, rng)
    # 95 of 100 episodes sit in one corner, 5 in the other.
    episodes.observations[:95, :, :2] = rng.uniform(0.0, 0.5, size=(95, 41, 2))
    episodes.observations[95:, :, :2] = rng.uniform(3.5, 4.0, size=(5, 41, 2))
    replay.add(episodes, np.zeros_like(episodes.rewards))
    scale = unit_scale(layout)
    share = {}
    for exponent in (0.0, -1.0, -2.5):
        config = SkewConfig(
            history_bandwidth=0.2, goals=2000, weight_exponent=exponent, running_scale=False
        )
        goals, _ = propose(replay, scale, config, rng)
        share[exponent] = (goals[:, 0] > 2.0).mean()
        known = replay.rows[:100, 1:, :2].reshape(-1, 2)
        assert all(np.isclose(known, goal, atol=1e-5).all(1).any() for goal in goals[:20])
    assert share[0.0] == pytest.approx(0.05, abs=0.02)
    assert share[-1.0] == pytest.approx(0.5, abs=0.05)  # both corners have the same area
    assert share[-2.5] > 0.95


def test_a_share_of_a_batch_comes_from_the_episodes_of_the_proposals(layout) -> None:
    rng = np.random.default_rng(8)
    replay = Replay(layout, 100 * layout.episode_steps)
    episodes = make_episodes(layout, 100, rng)
    episodes.rewards[:] = 0.0
    episodes.rewards[3] = 1.0
    episodes.observations[:, :, :2] = rng.uniform(0.0, 0.5, size=(100, 41, 2))
    episodes.observations[95:, :, :2] = rng.uniform(3.5, 4.0, size=(5, 41, 2))
    replay.add(episodes, np.zeros_like(episodes.rewards))
    config = SkewConfig(history_bandwidth=0.2, goals=500, running_scale=False)
    goals, slots = propose(replay, unit_scale(layout), config, rng)
    np.testing.assert_array_equal(slots >= 95, goals[:, 0] > 2.0)
    drawn = replay.draw(8000, 1, 0.25, rng, rare=slots, rare_fraction=0.25).episode
    # The rest is uniform over 100 episodes.
    assert (drawn >= 95).mean() == pytest.approx(0.25 + 0.5 * 0.05, abs=0.03)
    assert (drawn == 3).mean() == pytest.approx(0.25 + 0.5 * 0.01, abs=0.03)
    drawn = replay.draw(8000, 1, 0.0, rng, rare=slots[:0], rare_fraction=0.25).episode
    assert (drawn >= 95).mean() == pytest.approx(0.05, abs=0.02)


def test_own_count_keeps_one_outlier_from_taking_all_goals(layout) -> None:
    rng = np.random.default_rng(7)
    replay = Replay(layout, 100 * layout.episode_steps)
    episodes = make_episodes(layout, 100, rng)
    episodes.observations[:, :, :2] *= 0.5
    episodes.observations[0, 20, :2] = 4.0  # seen once
    replay.add(episodes, np.zeros_like(episodes.rewards))
    config = SkewConfig(history_bandwidth=0.1, history_points=2000, running_scale=False)
    goals, slots = propose(replay, unit_scale(layout), config, rng)
    assert (goals[:, 0] > 3.9).mean() < 0.6
    assert len(slots) == len(goals)
