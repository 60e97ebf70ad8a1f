"""Point maze: how much Skew-Explore visits compared with a random policy, same steps, same seed.

    python benchmarks/point_maze.py --json --out results/point_maze.json

Explores with the `improved` preset and with uniform random actions for as many environment steps,
without a target as the publication does, and measures both with the same code: the published
entropy and coverage (ceilings 55.1 and 0.427 in this maze) and the sound ones. Writes a picture
beside the document. One thread; some two minutes on an idle core.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from common import argument_parser, print_result, progress, write_result

from skewmi.cli.train_options import starting_config
from skewmi.sim import tasks
from skewmi.train.config import TrainConfig
from skewmi.train.config_json import to_document
from skewmi.train.history import visited_states
from skewmi.train.log import read_metrics
from skewmi.train.run import TrainResult, run_train

mpl.use("Agg")
from matplotlib import pyplot as plt

CURVES = ("entropy", "coverage", "differential_entropy", "covered_cells")


def random_policy(config: TrainConfig) -> TrainConfig:
    """The same run with uniform random actions and no learning."""
    return replace(
        config,
        preset="random",
        rollout=replace(config.rollout, random_steps=config.total_steps + 1),
        learner=replace(config.learner, updates_per_step=0.0),
    )


def measure(config: TrainConfig, run_dir: Path) -> tuple[TrainResult, dict[str, Any]]:
    """Run and reduce to what the document holds."""
    env = tasks.make_batch(
        config.task, config.rollout.num_envs, num_threads=1, seed=config.seed,
        **dict(config.task_options),
    )  # fmt: skip
    result = run_train(config, env, run_dir, progress=False)
    table = read_metrics(run_dir)
    curves = {name: [round(x, 4) for x in table[name]] for name in ("trajectories", *CURVES)}
    return result, {
        **{name: table[name][-1] for name in CURVES},
        "refreshes": result.refreshes,
        "seconds": round(result.seconds, 1),
        "curves": curves,
    }


def draw(runs: dict[str, dict[str, Any]], folders: dict[str, Path], path: Path) -> None:
    """Visited states of both, and the two published curves."""
    env = tasks.make_batch("point_maze", 1)
    x, y = np.meshgrid(np.linspace(-12, 4, 321), np.linspace(-6, 6, 241))
    walls = np.where(env.reachable(np.stack((x, y), -1)), 0.0, 0.3)
    figure, axes = plt.subplots(1, 4, figsize=(15, 3.6), layout="constrained")
    for axis, (name, folder) in zip(axes, folders.items(), strict=False):
        states, _ = visited_states(folder)
        axis.imshow(walls, extent=(-12, 4, -6, 6), origin="lower", cmap="Greys", vmin=0, vmax=1)
        every = max(1, states.shape[0] * states.shape[1] // 40_000)
        axis.scatter(
            states[..., 0].ravel()[::every], states[..., 1].ravel()[::every],
            c=np.repeat(np.arange(len(states)), states.shape[1])[::every],
            s=1.0, linewidths=0, rasterized=True,
        )  # fmt: skip
        axis.set(title=f"{name}: {len(states)} trajectories", xlabel="x [m]", ylabel="y [m]")
    for axis, curve, ceiling in zip(axes[2:], ("entropy", "coverage"), (55.1, 0.427), strict=True):
        for name, run in runs.items():
            axis.plot(run["curves"]["trajectories"], run["curves"][curve], label=name)
        axis.axhline(ceiling, color="0.5", linestyle=":", label="ceiling of the maze")
        axis.set(title=f"{curve} (as published)", xlabel="trajectories", ylim=(0, None))
    axes[2].legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=80)


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--steps", type=int, default=100_000, help="environment steps of each run")
    options = parser.parse_args()
    config = replace(
        starting_config("point_maze", "improved"),
        rewarded=False,
        seed=options.seed,
        total_steps=options.steps,
    )
    runs: dict[str, dict[str, Any]] = {}
    with tempfile.TemporaryDirectory() as folder:
        folders = {name: Path(folder) / name for name in ("random policy", "Skew-Explore")}
        for name, c in zip(folders, (random_policy(config), config), strict=True):
            progress(f"{name}: {config.total_steps:,} steps")
            _, runs[name] = measure(c, folders[name])
            progress("  " + ", ".join(f"{k} {runs[name][k]:.3g}" for k in CURVES))
        if options.out is not None:
            options.out.parent.mkdir(parents=True, exist_ok=True)
            draw(runs, folders, options.out.with_suffix(".png"))
    data = {
        "ceilings": {"entropy": 55.1, "coverage": 0.427},
        "random": runs["random policy"],
        "skew_explore": runs["Skew-Explore"],
    }
    document = write_result(
        "point_maze", data, options.out, seed=options.seed, config=to_document(config)
    )
    print_result(document, as_json=options.json)


if __name__ == "__main__":
    main()
