"""Results of a made-up sweep: curves that are known, of two configurations on two tasks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from skewmi.evaluation.sweep_figures.runs import SweepRuns
from skewmi.sweep.tables import Tables, as_columns

REFRESHES = 4


def row(configuration: str, task: str, seed: int, **more: Any) -> dict[str, Any]:
    """A run: its entropy grows with its configuration's and its seed's number."""
    level = 10.0 * (1 + ["one", "two"].index(configuration)) + seed
    return {
        "group": "g", "configuration": configuration, "task": task, "target": None, "seed": seed,
        "state": "done", "sigma": 2.0 if configuration == "two" else None, "entropy": level,
        "converged_at": None, "trajectories": 100, "run": f"{configuration}-{task}-{seed}", **more,
    }  # fmt: skip


def curve(facts: dict[str, Any]) -> list[dict[str, Any]]:
    """Its entropy rises by straight lines to its last one, at trajectories 25, 50, 75, 100."""
    return [
        {"run": facts["run"], "step": 5000.0 * k, "trajectories": 25.0 * k, "refresh": float(k),
         "entropy": facts["entropy"] * k / REFRESHES, "covered_cells": 0.2 * k}
        for k in range(1, REFRESHES + 1)
    ]  # fmt: skip


@pytest.fixture
def make_runs() -> Callable[..., SweepRuns]:
    """Runs of a sweep from rows of results, with curves of all that have begun."""

    def make(rows: list[dict[str, Any]]) -> SweepRuns:
        curves = [point for r in rows if r["state"] != "waiting" for point in curve(r)]
        generator = np.random.default_rng(0)
        states = {
            "run": [rows[0]["run"]] * 200,
            "trajectory": np.repeat(np.arange(1, 101), 2).tolist(),
            "x": generator.uniform(-12, 4, 200).tolist(),
            "y": generator.uniform(-6, 6, 200).tolist(),
        }
        return SweepRuns(Tables(as_columns(rows), as_columns(curves), states))

    return make


@pytest.fixture
def rows() -> list[dict[str, Any]]:
    return [row(c, t, s) for t in ("maze", "door") for c in ("one", "two") for s in (0, 1, 2)]
