"""Episodes in files: everything comes back, whatever the ring has overwritten."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.errors import CheckpointError
from skewmi.train.blocks import LARGEST, read_blocks, split, write_blocks
from skewmi.train.replay import Episodes, Replay


@settings(deadline=None)
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
    history = Replay(layout, capacity * 4, 2)
    folder, previous = tmp_path_factory.mktemp("blocks"), None
    for k, n in enumerate(batches):
        episodes = Episodes(
            rng.random((n, 5, 2)), rng.random((n, 4, 2)), rng.random((n, 4, 2)),
            (rng.random((n, 4)) < 0.1).astype(float),
        )  # fmt: skip
        history.add(episodes, rng.random((n, 4)))
        write_blocks(history, folder / str(k), previous)
        previous = folder / str(k)
    back = Replay(layout, capacity * 4, 2)
    read_blocks(back, previous, history.count)
    assert back.count == history.count
    np.testing.assert_array_equal(back.rows, history.rows)
    np.testing.assert_array_equal(back.rewarded, history.rewarded)


def test_damaged_block_is_refused(filled, layout, tmp_path) -> None:
    history, _, _ = filled
    write_blocks(history, tmp_path / "replay", None)
    block = next((tmp_path / "replay").iterdir())
    block.write_bytes(block.read_bytes()[:100])
    with pytest.raises(CheckpointError, match="replay block"):
        read_blocks(Replay(layout, 480, 2), tmp_path / "replay", history.count)
