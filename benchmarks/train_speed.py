"""How long a training takes: so many environment steps of a task, by the command that users call.

    python benchmarks/train_speed.py --json

Calls `skewmi train` without a target, one seed after the other, and tells its wall clock, starting
and compiling included. A figure is worth something if nothing else runs: the load of the machine
before each run stands beside it.
"""

from __future__ import annotations

import argparse
import os
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

from bundled_policy import run
from common import argument_parser, print_result, write_result

PARTS = ("seconds_rollout", "seconds_goals", "seconds_update")


def one(options: argparse.Namespace, seed: int) -> dict[str, Any]:
    """Train once, in a folder that is thrown away."""
    load, started = os.getloadavg()[0], time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        told = run(
            "train", "--task", options.task, "--preset", options.preset, "--unrewarded",
            "--seed", str(seed), "--steps", str(options.steps), "--threads", str(options.threads),
            "--run-dir", str(Path(folder) / "run"), "--quiet",
        )  # fmt: skip
    return {
        "seed": seed,
        "minutes": round((time.monotonic() - started) / 60.0, 2),
        "steps": told["steps"],
        "updates": told["metrics"]["updates"],
        "entropy": told["metrics"]["entropy"],
        "last_iteration_s": {name: round(told["metrics"][name], 3) for name in PARTS},
        "load_before": round(load, 2),
    }


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--task", default="point_maze", help="to train")
    parser.add_argument("--preset", default="improved-return-then-explore", help="to train with")
    parser.add_argument("--steps", type=int, default=400_000, help="of the environment")
    parser.add_argument("--seeds", type=int, default=1, help="how many, from --seed on")
    parser.add_argument("--threads", type=int, default=1, help="of each training")
    options = parser.parse_args()
    runs = [one(options, options.seed + k) for k in range(options.seeds)]
    data = {"median_minutes": statistics.median(r["minutes"] for r in runs), "runs": runs}
    config = {name: getattr(options, name) for name in ("task", "preset", "steps", "threads")}
    document = write_result("train_speed", data, options.out, seed=options.seed, config=config)
    print_result(document, as_json=options.json)


if __name__ == "__main__":
    main()
