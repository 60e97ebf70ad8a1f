"""What each ingredient contributes on OpenPressClose: the same runs with one thing changed.

    python benchmarks/open_press_close_ablation.py --runs runs/* \\
        --base results/open_press_close.json

Aggregates finished run directories of `skewmi train --task open_press_close
--stop-on-convergence` with other numbers (or `--preset paper`), or, without --runs, trains every
variant of `VARIANTS` one after the other (an hour or two on one core). What a run differs in is
read from its configuration. Runs that found nothing stay in the document.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from common import REPOSITORY, argument_parser, print_result, progress, write_result
from open_press_close import PACE, TASK, comparable, describe, evaluate

from skewmi.cli.train import train
from skewmi.cli.train_options import starting_config
from skewmi.errors import SkewmiError
from skewmi.evaluation.learning import read_record
from skewmi.train.config import TrainConfig
from skewmi.train.config_json import to_document

VARIANTS: dict[str, Callable[[TrainConfig], TrainConfig]] = {
    "no rare episodes": lambda c: replace(c, learner=replace(c.learner, rare_fraction=0.0)),
    "1-step returns": lambda c: replace(c, learner=replace(c.learner, n_step=1)),
    "gripper commanded": lambda c: replace(
        c, task_options=(*c.task_options, ("gripper_action", True))
    ),
}
KEPT = (
    "seed",
    "preset",
    "trajectories",
    "environment_steps",
    "updates",
    "rewarded_episodes",
    "first_discoveries",
    "converged_after_trajectories",
    "converged_after_seconds",
    "seconds",
)


def differences(config: TrainConfig) -> dict[str, Any]:
    """What a configuration has that the `improved` preset has not, by dotted name."""

    def flat(value: Any, path: str) -> dict[str, Any]:
        if not isinstance(value, dict):
            return {path: value}
        parts = (flat(v, f"{path}.{k}" if path else k) for k, v in value.items())
        return {name: leaf for part in parts for name, leaf in part.items()}

    ours, base = to_document(comparable(config)), to_document(comparable(starting_config(TASK)))
    ours["task_options"], base["task_options"] = (
        dict(content["task_options"]) for content in (ours, base)
    )
    left, right = flat(ours, ""), flat(base, "")
    return {name: value for name, value in left.items() if right.get(name) != value}


def train_variants(options: argparse.Namespace, root: Path) -> list[Path]:
    """Train every variant with every seed, one after the other; continues what is there."""
    folders = []
    for name, change in VARIANTS.items():
        for seed in options.seeds:
            folder = root / f"{name.replace(' ', '-')}-{seed}"
            progress(f"{name}, seed {seed}: training in {folder}")
            config = replace(
                change(starting_config(TASK)),
                seed=seed,
                total_steps=options.steps,
                stop_on_convergence=True,
            )
            train(config, folder, resume=True, progress=False)
            folders.append(folder)
    return folders


def row(folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    """One run."""
    record = read_record(folder)
    run = describe(record)
    evaluation = evaluate(record, options.episodes, options.seed, 1)
    changed = differences(record.config)
    progress(f"{folder.name}: {changed or 'nothing changed'}: converged at {record.converged_at}")
    return {
        "changed": changed if record.config.preset == "improved" else f"preset {run['preset']}",
        **{name: run[name] for name in KEPT},
        "success_rate": evaluation["success_rate"],
        "contact": evaluation["contact"],
    }


def main() -> int:
    parser = argument_parser(__doc__, seed=1000)
    parser.set_defaults(out=REPOSITORY / "results" / f"{TASK}_ablation.json")
    parser.add_argument("--runs", type=Path, nargs="+", help="run directories to aggregate")
    parser.add_argument("--base", type=Path, help="document of the runs with nothing changed")
    parser.add_argument("--episodes", type=int, default=200, help="evaluated per run")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0], help="to train")
    parser.add_argument("--steps", type=int, default=600_000, help="budget of each training")
    options = parser.parse_args()
    torch.set_num_threads(1)
    try:
        with tempfile.TemporaryDirectory() as folder:
            folders = options.runs or train_variants(options, Path(folder))
            data: dict[str, Any] = {"runs": [row(folder, options) for folder in folders]}
    except SkewmiError as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return 2
    if options.base is not None:
        base = json.loads(options.base.read_text())
        data["base"] = [{name: run[name] for name in KEPT} for run in base["runs"]]
    config = {"episodes": options.episodes, "varies_between_runs": sorted(PACE)}
    document = write_result(f"{TASK}_ablation", data, options.out, seed=options.seed, config=config)
    print_result(document, as_json=options.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
