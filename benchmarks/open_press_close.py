"""OpenPressClose from its sparse reward: when each seed finds what, converges, and how it ends.

    python benchmarks/open_press_close.py --runs runs/s0 runs/s1 runs/s2 --concurrent 2

Aggregates finished run directories of `skewmi train --task open_press_close
--stop-on-convergence`, or, without --runs, trains --seeds one after the other (some 20 minutes a
seed on one core). Every run's final policy then acts deterministically in fresh episodes with
random starts. Writes a document and, beside it, a picture; runs that found or learned nothing
stay in both, and in the medians as infinitely late (null where the median is). A run trained
with a variation is evaluated with it.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from common import (
    REPOSITORY,
    argument_parser,
    commit,
    machine_info,
    print_result,
    progress,
    write_result,
)

from skewmi.cli.task_flags import variation_option
from skewmi.cli.train_options import starting_config
from skewmi.errors import ConfigurationError, SkewmiError
from skewmi.evaluation.contact import recorder_for, summarise_contact
from skewmi.evaluation.learning import RunRecord, draw_learning, read_record
from skewmi.evaluation.rollout import run_episodes, summarise
from skewmi.sim import tasks
from skewmi.train.config import TrainConfig
from skewmi.train.config_json import to_document
from skewmi.train.policy import load_policy
from skewmi.train.run import run_train

TASK = "open_press_close"
PACE: dict[str, Any] = {
    "seed": 0, "total_steps": 1, "minutes": None, "stop_on_convergence": False, "threads": 1
}  # fmt: skip
"""What runs of one document may differ in, set to the same for comparison."""
SUCCESS_FIGURES = ("episodes", "successes", "success_rate", "success_rate_interval_95")


def train_seeds(options: argparse.Namespace, root: Path) -> list[Path]:
    """Train one after the other; continues what a directory holds already."""
    folders = []
    for seed in options.seeds:
        config = replace(
            starting_config(TASK, options.preset),
            seed=seed,
            threads=options.threads,
            minutes=options.minutes,
            stop_on_convergence=True,
        )
        config = replace(
            config,
            task_options=config.task_options
            + tuple(variation_option(TASK, options.variation).items()),
        )
        if options.steps is not None:
            config = replace(config, total_steps=options.steps)
        folders.append(root / f"seed-{seed}")
        progress(f"seed {seed}: training in {folders[-1]}")
        env = tasks.make_batch(
            TASK, config.rollout.num_envs, num_threads=config.threads, seed=seed,
            **dict(config.task_options),
        )  # fmt: skip
        result = run_train(config, env, folders[-1], resume=True, progress=False)
        progress(f"  stopped by {result.stopped_by} after {result.trajectories:,} trajectories")
    return folders


def comparable(config: TrainConfig) -> TrainConfig:
    """The configuration without what may differ between seeds."""
    return replace(config, **PACE)


def require_one_experiment(records: Sequence[RunRecord]) -> None:
    """Medians over runs need runs of one configuration, each seed once.

    Raises:
        ConfigurationError: They are not.
    """
    seeds = [record.config.seed for record in records]
    if len(set(seeds)) < len(seeds):
        raise ConfigurationError(f"seeds {seeds} repeat; give each seed's run once")
    first = records[0]
    for record in records:
        if record.config.task != TASK:
            raise ConfigurationError(f"{record.run_dir} is a run of {record.config.task}")
        ours, theirs = (to_document(comparable(r.config)) for r in (record, first))
        differing = [name for name in ours if ours[name] != theirs[name]]
        if differing or record.layout.hash() != first.layout.hash():
            raise ConfigurationError(
                f"{record.run_dir} and {first.run_dir} differ in "
                f"{', '.join(differing) or 'their layout'}; make a document of each"
            )


def evaluate(record: RunRecord, episodes: int, seed: int, threads: int) -> dict[str, Any]:
    """How often the run's latest policy succeeds, and how it touches things meanwhile."""
    policy = load_policy(record.run_dir)
    options: dict[str, Any] = dict(record.config.task_options)
    env = tasks.make_batch(TASK, min(episodes, 50), num_threads=threads, seed=seed, **options)
    recorder = recorder_for(env)
    figures = summarise(run_episodes(policy, env, episodes, seed, observer=recorder))
    return {
        **{name: figures[name] for name in SUCCESS_FIGURES},
        "first_success_time_s": figures["first_success_time_s"],
        "contact": None if recorder is None else summarise_contact(recorder.values),
    }


def recorded_commit(run_dir: Path) -> str | None:
    """The commit a run was made with, if its header says so."""
    value = json.loads((run_dir / "config.json").read_text()).get("commit")
    return None if value is None else str(value)


def describe(record: RunRecord) -> dict[str, Any]:
    """What a run was and when things happened in it."""
    config, converged_at = record.config, record.converged_at
    options: dict[str, Any] = dict(config.task_options)
    variation = options.pop("variation", None)
    recorded = recorded_commit(record.run_dir)
    x, y = record.curve
    return {
        "seed": config.seed,
        "preset": config.preset,
        "task_options": options,
        "variation": "nominal" if variation is None else json.loads(variation),
        "commit": recorded or commit(),
        "commit_from": "the run" if recorded else "the tree at aggregation; the run recorded none",
        "trajectories": record.trajectories,
        "environment_steps": record.state["step"],
        "updates": record.state["updates"],
        "rewarded_episodes": record.state["rewarded_episodes"],
        "first_discoveries": {
            name: first and first["trajectory"] for name, first in record.discoveries.items()
        },
        "converged": converged_at is not None,
        "converged_after_trajectories": converged_at,
        "converged_after_seconds": _rounded(
            None if converged_at is None else record.seconds_at(converged_at)
        ),
        "seconds": _rounded(record.seconds),
        "threads": config.threads,
        "evaluation_share": record.state["evaluation_fraction"],
        "curve": {
            "trajectories": [int(v) for v in x],
            "evaluation_share": [round(float(v), 4) for v in y],
        },
    }


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 1)


def median(values: Sequence[float | None]) -> float | None:
    """Median with missing values as infinitely large; None where that is infinite."""
    middle = statistics.median(math.inf if value is None else value for value in values)
    return None if math.isinf(middle) else middle


def medians(runs: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Over runs, of everything one compares."""
    events = runs[0]["first_discoveries"]
    return {
        "first_discoveries": {
            name: median([run["first_discoveries"][name] for run in runs]) for name in events
        },
        **{
            name: median([run[name] for run in runs])
            for name in ("converged_after_trajectories", "converged_after_seconds")
        },
        "success_rate": median([run["evaluation"]["success_rate"] for run in runs]),
    }


def aggregate(folders: Sequence[Path], options: argparse.Namespace) -> dict[str, Any]:
    """Read, evaluate, draw, write."""
    records = [read_record(folder) for folder in folders]
    require_one_experiment(records)
    records.sort(key=lambda record: record.config.seed)
    runs = []
    for record in records:
        evaluation = evaluate(record, options.episodes, options.seed, options.threads)
        runs.append({**describe(record), "evaluation": evaluation})
        progress(
            f"seed {record.config.seed}: {evaluation['successes']} of {evaluation['episodes']} "
            f"episodes succeed; converged after {record.converged_at} trajectories"
        )
    cores = machine_info()["cores"]
    data = {
        "converged_runs": sum(run["converged"] for run in runs),
        "runs_in_all": len(runs),
        "medians": medians(runs),
        "timing": {
            "runs_side_by_side": options.concurrent,
            "cores": cores,
            "note": f"wall clock; {options.concurrent} run(s) at a time shared {cores} cores"
            if options.concurrent is not None
            else "wall clock; what else ran on the machine is not recorded",
        },
        "runs": runs,
    }
    options.out.parent.mkdir(parents=True, exist_ok=True)
    planes = tasks.find(TASK).planes
    draw_learning(records, options.out.with_suffix(".png"), dpi=80, planes=planes)
    config = {
        **to_document(comparable(records[0].config)),
        "episodes": options.episodes,
        "varies_between_runs": sorted(PACE),
    }
    for name in PACE:
        del config[name]
    return write_result(TASK, data, options.out, seed=options.seed, config=config)


def main() -> int:
    parser = argument_parser(__doc__, seed=1000)
    parser.set_defaults(out=REPOSITORY / "results" / f"{TASK}.json")
    parser.add_argument("--runs", type=Path, nargs="+", help="run directories to aggregate")
    parser.add_argument(
        "--concurrent", type=int, help="how many of --runs were trained at the same time"
    )
    parser.add_argument("--episodes", type=int, default=200, help="evaluated per run")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2], help="to train")
    parser.add_argument("--preset", default="improved", help="to train")
    parser.add_argument("--variation", help="to train with: file or bundled name")
    parser.add_argument("--minutes", type=float, default=45.0, help="budget of each training")
    parser.add_argument("--steps", type=int, help="budget of each training, environment steps")
    parser.add_argument("--threads", type=int, default=1, help="of training and evaluation")
    parser.add_argument("--work", type=Path, help="keep trained runs here, and continue them")
    options = parser.parse_args()
    # Small networks on several threads wait for each other more than they compute.
    torch.set_num_threads(options.threads)
    try:
        if options.runs is not None:
            document = aggregate(options.runs, options)
        else:
            options.concurrent = 1
            with tempfile.TemporaryDirectory() as folder:
                root = Path(folder) if options.work is None else options.work
                document = aggregate(train_seeds(options, root), options)
    except SkewmiError as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return 2
    print_result(document, as_json=options.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
