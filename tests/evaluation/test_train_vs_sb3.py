"""The comparison of trainings: the maze as the peer sees it, and rows that are finished already."""

from __future__ import annotations

import json
import runpy
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
RUNS = {("ours", 0): 20.0, ("far", 0): 200.0, ("ours", 1): 30.0, ("far", 1): 300.0}
"""Side and seed to seconds; the peer is at its cap."""


@pytest.fixture
def scripts(monkeypatch: pytest.MonkeyPatch):
    """Runs one of the two files, as the name that it is given."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    yield lambda name, run_name: runpy.run_path(str(BENCHMARKS / name), run_name=run_name)
    for name in ("common", "train_vs_sb3_sides"):
        sys.modules.pop(name, None)


def test_the_peer_is_told_where_to_go_and_paid_there_alone(scripts) -> None:
    sides = scripts("train_vs_sb3_sides.py", "sides")
    env, target = sides["PeerMaze"](), np.array(sides["TARGET"])
    bare = sides["maze"](1, 3)
    rng = np.random.default_rng(0)
    observation, _ = env.reset(seed=3)
    seen = bare.reset(3)
    assert env.unwrapped.layout.observation == bare.layout.observation
    for _ in range(60):
        for name, value in observation.items():
            assert value in env.observation_space[name]
            assert (np.abs(value) <= 1.0).all()
        # The same place, and the goal, in the scale that ours gives its networks.
        whole = {"observation": seen[0], "achieved_goal": seen[0, :2], "desired_goal": target}
        for name, value in env.scaled(whole).items():
            np.testing.assert_array_equal(value, observation[name])
        action = rng.uniform(-1, 1, 2).astype(np.float32)
        observation, reward, terminated, truncated, _ = env.step(action)
        seen = bare.step(action[None]).observation
        goals = observation["achieved_goal"], observation["desired_goal"]
        assert reward == env.compute_reward(*goals, None) == -1.0
        assert not terminated
        assert not truncated
    # Where a place is the goal, or near enough to it.
    places = env.scaled({"x": target + np.array([[0.0, 0.0], [0.14, 0.0], [0.0, 0.16]])})["x"]
    assert env.compute_reward(places, goals[1], None).tolist() == [0.0, 0.0, -1.0]
    assert bare.compute_reward(target) == 1.0


def call(
    scripts, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *arguments: str
) -> tuple[str, str]:
    monkeypatch.setattr(sys, "argv", ["train_vs_sb3.py", *arguments])
    capsys.readouterr()
    scripts("train_vs_sb3.py", "__main__")
    said = capsys.readouterr()
    return said.out, said.err


@pytest.fixture
def rows(scripts, tmp_path: Path) -> Path:
    """A file of finished runs; a kill has cut short the line after them."""
    script: dict[str, Any] = scripts("train_vs_sb3.py", "rows")
    settings = script["settings"](script["options_of"]([]))
    path = tmp_path / "rows.jsonl"
    lines = [
        json.dumps(
            {
                "side": side, "seed": seed, "solved": side == "ours", "wall_s": wall,
                "processor_s": wall, "steps": 1000, "peak_memory_mib": {"process": 400.0},
                "settings": settings,
            }
        )
        for (side, seed), wall in RUNS.items()
    ]  # fmt: skip
    path.write_text("\n".join([*lines, '{"side": "ou']))
    return path


def test_finished_runs_are_not_made_again(scripts, monkeypatch, capsys, rows: Path) -> None:
    known = ("--rows", str(rows), "--seeds", "2", "--peers", "far", "--json")
    out, error = call(scripts, monkeypatch, capsys, *known)
    document = json.loads(out)
    assert error.count("from ") == len(RUNS)
    assert (document["speedup"], document["speedup_is_a_lower_bound"]) == (10.0, True)
    assert document["against"]["far"]["solved"] == 0
    assert len(document["runs"]) == len(RUNS)


def test_runs_of_another_cap_are_refused(scripts, monkeypatch, capsys, rows: Path) -> None:
    with pytest.raises(SystemExit, match="another cap: give the same options"):
        call(scripts, monkeypatch, capsys, "--rows", str(rows), "--cap", "2")


def test_a_new_row_begins_its_own_line(scripts, rows: Path) -> None:
    script: dict[str, Any] = scripts("train_vs_sb3.py", "rows")
    settings = script["settings"](script["options_of"]([]))
    script["keep"](rows, {"side": "far", "seed": 2, "settings": settings})
    assert len(script["read_rows"](rows, settings)) == len(RUNS) + 1
