"""What each ingredient of a method brings: runs without it beside runs of the whole, over seeds.

    python benchmarks/sweep_ingredients.py --folder runs/return-then-explore --refresh 16

Of a sweep's collected results: entropy of the visited states at a refresh of the goals, of every
seed, as interquartile mean with a 95 % percentile bootstrap over seeds (as rliable reports runs,
arXiv:2108.13264), and the difference to the whole method.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from common import argument_parser, print_result, write_result
from scipy import stats

RESAMPLES = 10_000


def interquartile_mean(values: np.ndarray, axis: int = -1) -> Any:
    """Mean without the lowest and the highest quarter."""
    return stats.trim_mean(values, 0.25, axis=axis)


def difference(first: np.ndarray, second: np.ndarray, axis: int = -1) -> Any:
    """Of interquartile means."""
    return interquartile_mean(first, axis) - interquartile_mean(second, axis)


def interval(samples: tuple[np.ndarray, ...], statistic: Any, seed: int) -> list[float]:
    """95 % percentile bootstrap over seeds."""
    found = stats.bootstrap(
        samples,
        statistic,
        n_resamples=RESAMPLES,
        method="percentile",
        rng=np.random.default_rng(seed),
        vectorized=True,
    )
    return [float(found.confidence_interval.low), float(found.confidence_interval.high)]


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Every configuration of both groups."""
    runs = pd.read_csv(options.folder / "results.csv")
    curves = pd.read_csv(options.folder / "curves.csv", low_memory=False)
    at = curves[curves["refresh"] == options.refresh].set_index("run")[options.metric]

    def values(rows: pd.DataFrame) -> np.ndarray:
        found = at.reindex(rows.sort_values("seed")["run"]).to_numpy()
        if not found.size or np.isnan(found).any():
            raise SystemExit(f"not all runs have {options.metric} at refresh {options.refresh}")
        return found

    whole = values(runs[runs["group"] == options.whole])
    figures: dict[str, Any] = {
        "whole": {
            "seeds": whole.tolist(),
            "interquartile_mean": float(interquartile_mean(whole)),
            "interval_95": interval((whole,), interquartile_mean, options.seed),
        },
        "parts": {},
    }
    for name, rows in runs[runs["group"] == options.parts].groupby("configuration"):
        own = values(rows)
        figures["parts"][name] = {
            "seeds": own.tolist(),
            "interquartile_mean": float(interquartile_mean(own)),
            "interval_95": interval((own,), interquartile_mean, options.seed),
            "to_whole": float(difference(own, whole)),
            "to_whole_interval_95": interval((own, whole), difference, options.seed),
        }
    return figures


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--folder", type=Path, required=True, help="of the sweep's results")
    parser.add_argument("--whole", default="explore", help="group of the whole method")
    parser.add_argument("--parts", default="parts", help="group of runs without one ingredient")
    parser.add_argument("--metric", default="entropy", help="column of the curves")
    parser.add_argument("--refresh", type=int, default=16, help="of the goals")
    options = parser.parse_args()
    config = {name: getattr(options, name) for name in ("whole", "parts", "metric", "refresh")}
    document = write_result(
        "sweep_ingredients", measure(options), options.out, seed=options.seed, config=config
    )
    print_result(document, as_json=options.json)


if __name__ == "__main__":
    main()
