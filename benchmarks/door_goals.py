"""What decides which goals the publication's numbers propose on the door, from states of a sweep.

    python benchmarks/door_goals.py --folder results/paper_reduced --json

Goals are proposed as training proposes them (preset `paper-reduced`: candidates are visited states
with a kernel's noise, weighted by a power of their density), from the states that a sweep has kept
of its runs on the door. Of every run, and of every setting of bandwidth and power:

- `effective_candidates`: 1 / sum of squared weights, of 10,000 candidates; least and most of five
  draws, of the others the means.
- `noise_decides`: rank correlation of a candidate's weight with the square of its own noise.
- `rarity_decides`: the same with the density of the state that it comes from, reversed.
- `open_in_states`, `open_in_goals`: share with the flap open by more than 0.1 rad.

A sweep keeps 12,000 states of a run, training takes 50,000 for its density.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from common import argument_parser, print_result, write_result
from scipy.stats import spearmanr

from skewmi.train.density import kernel_log_density
from skewmi.train.exploration.goals import skew_weights

FIELDS = ["hand_x", "hand_y", "hand_z", "gripper", "door_angle"]
OPEN_RAD = 0.1
CANDIDATES, DRAWS = 10_000, 5
SETTINGS = {"as published": (0.1, -1.1), "wider": (0.3, -1.1), "wider and steeper": (0.3, -2.5)}
"""Bandwidth of the history's kernels in running standard deviations, and the power."""


def proposed(
    states: np.ndarray, bandwidth: float, power: float, rng: np.random.Generator
) -> dict[str, float]:
    """Figures of one draw of candidates from one run's states. Shape (n, 5)."""
    points = (states - states.mean(0)) / states.std(0)
    index = rng.integers(len(points), size=CANDIDATES)
    noise = rng.standard_normal((CANDIDATES, points.shape[1]))
    candidates = points[index] + bandwidth * noise
    weights = skew_weights(kernel_log_density(candidates, points, bandwidth, self_count=0.0), power)
    rarity = -kernel_log_density(points[index], points, bandwidth, self_count=0.0)
    is_open = states[:, FIELDS.index("door_angle")] > OPEN_RAD
    return {
        "effective_candidates": float(1.0 / np.square(weights).sum()),
        "noise_decides": float(spearmanr(weights, np.square(noise).sum(1)).statistic),
        "rarity_decides": float(spearmanr(weights, rarity).statistic),
        "open_in_states": float(is_open.mean()),
        "open_in_goals": float(weights[is_open[index]].sum()),
    }


def of_run(states: np.ndarray, bandwidth: float, power: float, seed: int) -> dict[str, Any]:
    """Over all draws."""
    rng = np.random.default_rng(seed)
    draws = pd.DataFrame([proposed(states, bandwidth, power, rng) for _ in range(DRAWS)])
    effective = draws.pop("effective_candidates").round(2)
    return {
        "effective_candidates": [effective.min(), effective.max()],
        **draws.mean().round(3).to_dict(),
    }


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """By setting and run."""
    states = pd.read_parquet(options.folder / "states.parquet")
    runs = dict(iter(states[states["door_angle"].notna()].groupby("run")))
    return {
        name: {"bandwidth": bandwidth, "power": power}
        | {
            run: of_run(rows[FIELDS].to_numpy(float), bandwidth, power, options.seed)
            for run, rows in runs.items()
        }
        for name, (bandwidth, power) in SETTINGS.items()
    }


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--folder", type=Path, required=True, help="a sweep's results")
    options = parser.parse_args()
    config = {"folder": options.folder.name, "candidates": CANDIDATES, "open_rad": OPEN_RAD}
    document = write_result(
        "door_goals", measure(options), options.out, seed=options.seed, config=config
    )
    print_result(document, as_json=options.json)


if __name__ == "__main__":
    main()
