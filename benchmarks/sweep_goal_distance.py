"""How near its goal an episode of a sweep's runs ends, and how far away goals are.

    python benchmarks/sweep_goal_distance.py --folder runs/paper-reduced --group ablation

Of every run of the group, from the episodes that it keeps: the distance between the last state and
the last goal of an episode, and between that goal and the first state, as medians over three spans
of trajectories. In the units of the state: only for tasks whose fields all have one, as the maze.
"""

from __future__ import annotations

import argparse
import statistics
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from common import argument_parser, print_result, progress, write_result

from skewmi.train.checkpoint import read_run_header
from skewmi.train.history import pursued_goals

SPANS = ((100, 300), (900, 1_100), (1_800, 2_000))
"""Trajectories of a run, from the first to before the second."""


def distances(run_dir: Path) -> list[dict[str, float]]:
    """Medians of one run, by span."""
    config, layout = read_run_header(run_dir)
    states, goals = pursued_goals(run_dir)
    d = goals.shape[-1]
    whole = len(states) * layout.episode_steps >= config.total_steps
    if not whole or len({field.unit for field in layout.state_fields[:d]}) > 1:
        raise SystemExit(f"{run_dir} does not keep all episodes, or its states have several units")
    to_goal = np.linalg.norm(states[:, -1, :d] - goals[:, -1], axis=1)
    to_start = np.linalg.norm(states[:, 0, :d] - goals[:, -1], axis=1)
    return [
        {
            "to_goal": float(np.median(to_goal[start:end])),
            "goal_to_start": float(np.median(to_start[start:end])),
        }
        for start, end in SPANS
    ]


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Every configuration of the group: by span, the mean over seeds and every seed."""
    runs = pd.read_csv(options.folder / "results.csv")
    runs = runs[(runs["group"] == options.group) & (runs["state"] == "done")]
    figures: dict[str, Any] = {}
    for name, rows in runs.groupby("configuration"):
        progress(str(name))
        seeds = rows.sort_values("seed")
        each = [distances(options.folder / "runs" / run) for run in seeds["run"]]
        figures[str(name)] = {
            "seeds": seeds["seed"].tolist(),
            "spans": [
                {"trajectories": list(span)}
                | {
                    key: {
                        "mean": round(statistics.mean(run[k][key] for run in each), 3),
                        "each": [round(run[k][key], 3) for run in each],
                    }
                    for key in each[0][k]
                }
                for k, span in enumerate(SPANS)
            ],
        }
    return {"group": options.group, "configurations": figures}


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--folder", type=Path, required=True, help="of the sweep, with its runs")
    parser.add_argument("--group", required=True, help="of its file")
    options = parser.parse_args()
    document = write_result(
        "sweep_goal_distance",
        measure(options),
        options.out,
        seed=options.seed,
        config={"group": options.group},
    )
    print_result(document, as_json=options.json)


if __name__ == "__main__":
    main()
