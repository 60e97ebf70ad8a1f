"""Reads what a training writes into its run directory, while it writes: only what is new.

For whoever watches, from a process of their own: nothing is asked of the training, whose files are
whole whenever they are there. Loads neither networks nor the tensor library.
"""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open

from skewmi.errors import LayoutMismatchError
from skewmi.policy_io import Array, PolicyLayout
from skewmi.train.blocks import block_name, split

MOST_EPISODES = 400
"""That are read in one look: of a longer past, some from all of it."""
_TORN = (
    OSError,
    EOFError,
    ValueError,
    KeyError,
    TypeError,
    IndexError,
    SafetensorError,
    LayoutMismatchError,
)
"""What reading raises where the training is replacing a file; the next look finds another."""


@dataclass(frozen=True)
class RunFacts:
    """What a run is, from its config.json."""

    layout: PolicyLayout
    grid: tuple[str, ...]
    """State fields that its coverage is measured in."""
    convergence_fraction: float
    """Rewarded share of the last states that counts as converged."""
    preset: str


@dataclass(frozen=True)
class News:
    """What has come since the last look."""

    rows: dict[str, Array]
    """New rows of metrics.csv, by column; NaN where a cell is empty. Shape (n,)."""
    episodes: NDArray[np.int64]
    """Numbers of new episodes, from 0. Shape (m,)."""
    states: Array
    """They passed through. Shape (m, steps + 1, state_dim)."""
    rewards: Array
    """Extrinsic. Shape (m, steps)."""
    proposals: Array | None
    """Present goals, shape (k, state_dim), if they are others than before."""
    discoveries: dict[str, int] = field(default_factory=dict)
    """Trajectory of the first time, by event; new ones."""
    converged_at: int | None = None
    """Trajectories after which it converged, if it is told for the first time."""

    @property
    def nothing(self) -> bool:
        """Whether there is none."""
        return not (len(self.episodes) or len(self.rows.get("step", ())))


class RunFollower:
    """Follows the run in a directory, from its beginning.

    Args:
        run_dir: May not exist yet.
    """

    def __init__(self, run_dir: Path) -> None:
        self._run_dir = run_dir
        self._facts: RunFacts | None = None
        self._row_count = self._episode_count = 0
        self._checkpoint = ""
        self._proposals: Array | None = None
        self._known: set[str] = set()
        self._converged = False

    def facts(self) -> RunFacts | None:
        """What the run is; None before it has begun."""
        if self._facts is None:
            try:
                self._facts = _facts(json.loads((self._run_dir / "config.json").read_text()))
            except _TORN:
                return None
        return self._facts

    def look(self) -> News | None:
        """What is new; None before the run has begun."""
        facts = self.facts()
        if facts is None:
            return None
        rows = self._new_rows()
        try:
            return self._new_checkpoint(facts, rows)
        except _TORN:
            return _rows_alone(facts, rows)

    def _new_rows(self) -> dict[str, Array]:
        try:
            with (self._run_dir / "metrics.csv").open(newline="") as file:
                table = list(csv.DictReader(file))
        except OSError:
            return {}
        # The last line may be half written, and a run that goes on drops rows at first.
        whole = [row for row in table if None not in row.values() and row["step"].isdigit()]
        new = whole[self._row_count :]
        self._row_count = len(whole)
        names = new[0].keys() if new else ()
        return {name: np.array([_number(row[name]) for row in new]) for name in names}

    def _new_checkpoint(self, facts: RunFacts, rows: dict[str, Array]) -> News:
        root = self._run_dir / "checkpoints"
        names = sorted(p.name for p in root.iterdir() if p.name.isdigit()) if root.is_dir() else []
        if not names or names[-1] == self._checkpoint:
            return _rows_alone(facts, rows)
        folder = root / names[-1]
        state = json.loads((folder / "state.json").read_text())
        goal_dim, proposals = _goals(folder, facts.layout.state_dim)
        known = self._proposals
        same = proposals is None or (known is not None and np.array_equal(proposals, known))
        episodes, states, rewards = self._new_episodes(
            folder, int(state["episodes"]), facts.layout, goal_dim
        )
        found = {
            name: int(first["trajectory"])
            for name, first in state["discoveries"].items()
            if name not in self._known
        }
        converged_at = state.get("converged_at")
        told = None if self._converged or converged_at is None else int(converged_at)
        # Nothing is remembered before everything has been read.
        self._checkpoint, self._episode_count = names[-1], int(state["episodes"])
        self._proposals = self._proposals if same else proposals
        self._known |= set(found)
        self._converged |= told is not None
        new_proposals = None if same else proposals
        return News(rows, episodes, states, rewards, new_proposals, found, told)

    def _new_episodes(
        self, folder: Path, count: int, layout: PolicyLayout, goal_dim: int
    ) -> tuple[NDArray[np.int64], Array, Array]:
        d, reward = layout.state_dim, len(layout.observation) + len(layout.action) + goal_dim
        held = [p.name.split("-") for p in (folder / "replay").glob("episodes-*.npy")]
        first = max(self._episode_count, min((int(start) for _, start, _ in held), default=count))
        wanted = np.unique(
            np.linspace(first, count - 1, min(MOST_EPISODES, count - first)).round().astype(int)
        )
        states, rewards = [], []
        for start, length in split(first, count):
            inside = wanted[(wanted >= start) & (wanted < start + length)]
            if len(inside):
                path = folder / "replay" / block_name(start, length)
                rows = np.load(path, mmap_mode="r", allow_pickle=False)[inside - start]
                states.append(rows[:, :, :d].astype(np.float64))
                rewards.append(rows[:, :-1, reward].astype(np.float64))
        steps = layout.episode_steps
        return (
            wanted.astype(np.int64),
            np.concatenate([np.zeros((0, steps + 1, d)), *states]),
            np.concatenate([np.zeros((0, steps)), *rewards]),
        )


def _rows_alone(facts: RunFacts, rows: dict[str, Array]) -> News:
    steps, d = facts.layout.episode_steps, facts.layout.state_dim
    no_episodes = np.zeros(0, np.int64)
    return News(rows, no_episodes, np.zeros((0, steps + 1, d)), np.zeros((0, steps)), None)


def _facts(content: dict[str, Any]) -> RunFacts:
    config = content["config"]
    layout = PolicyLayout.from_json(json.dumps(content["layout"]))
    grid = tuple(axis["field"] for axis in config["task_metrics"]["grid"])
    fraction = float(config["metrics"]["convergence_fraction"])
    return RunFacts(layout, grid, fraction, str(config["preset"]))


def _goals(folder: Path, state_dim: int) -> tuple[int, Array | None]:
    """Size of a goal, and the present ones of a checkpoint; None if they are no states."""
    with safe_open(folder / "weights.safetensors", framework="numpy") as tensors:
        names = list(tensors.keys())
        goal_dim = int(tensors.get_slice("evaluation_goal").get_shape()[0])
        found = [name for name in names if name.split("/")[-1] == "proposals"]
        if not found or goal_dim != state_dim:
            return goal_dim, None
        return goal_dim, np.asarray(tensors.get_tensor(found[0]), dtype=np.float64)


def _number(cell: str) -> float:
    try:
        return float(cell or "nan")
    except ValueError:
        return float("nan")
