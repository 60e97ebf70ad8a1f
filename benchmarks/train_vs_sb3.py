"""Time until a far point of the maze is found and reached: ours beside Stable-Baselines3's.

    python benchmarks/train_vs_sb3.py --json --rows rows.jsonl --out results/train_vs_sb3.json

PointMaze with the target (-8, 0), the farthest from the start, rewarded within 0.15 m. For each
seed ours (preset `improved-return-then-explore`) is trained until its deterministic policy reaches
the target in 90 % of 20 episodes, twice in a row; then each setting of the peer's SAC with
HerReplayBuffer gets up to --cap times as long. Every run is a process of its own, one at a time,
with one thread. `speedup` is against whichever of the peer's settings did best.

The same for all: the maze, its starts (spread by one step, or all episodes would be equal), inputs
and their scaling, hidden layers of 128 and 128, MKL's kernels (those of `skewmi train`), and who
judges when (`tests/support`); looking at a policy stops the clock, importing packages does not
count, compiling does, and nobody writes files. The peer is looked at five times as often. Not the
same: ours explores with 25 copies, and learns of the target by meeting it; the peer is told where
it is from the start. It gets rewards of -1 and 0, with which its settings were tuned, and its own
number of updates per step. `train_vs_sb3_sides.py` says where its settings come from.

--rows keeps what is finished, one line a run, and goes on from it. A run takes minutes to an hour.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from common import argument_parser, print_result, progress, write_result
from time_to_success import compare

from skewmi import matrix_kernels

matrix_kernels.take_fast_kernels()  # before torch is imported, for both sides

from train_vs_sb3_sides import (  # noqa: E402
    EPISODES,
    OURS,
    PEERS,
    RADIUS,
    START_NOISE,
    TARGET,
    train,
)

BAR = 0.9
IN_A_ROW = 2


def settings(options: argparse.Namespace) -> dict[str, Any]:
    """What rows that belong together have in common."""
    return {
        "target": list(TARGET),
        "radius": RADIUS,
        "start_noise": START_NOISE,
        "episodes": EPISODES,
        "bar": BAR,
        "in_a_row": IN_A_ROW,
        "cap": options.cap,
        "steps": options.steps,
        "kernels": matrix_kernels.name_of_taken(),
    }


def read_rows(path: Path | None, wanted: dict[str, Any]) -> list[dict[str, Any]]:
    """Finished runs of a file; a line that a kill has cut short is none.

    Raises:
        SystemExit: They are of other settings.
    """
    rows: list[dict[str, Any]] = []
    if path is None or not path.is_file():
        return rows
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    for row in rows:
        if row["settings"] != wanted:
            differing = [name for name in wanted if row["settings"].get(name) != wanted[name]]
            raise SystemExit(
                f"{path} has runs with another {', '.join(differing)}: give the same options, or "
                "another file"
            )
    return rows


def keep(path: Path | None, row: dict[str, Any]) -> None:
    """Append a finished run to the file."""
    if path is None:
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    text = path.read_text(encoding="utf-8") if path.is_file() else ""
    cut = "\n" if text and not text.endswith("\n") else ""
    with path.open("a", encoding="utf-8") as file:
        file.write(cut + json.dumps(row) + "\n")


def run_process(
    side: str, seed: int, limit_s: float | None, options: argparse.Namespace
) -> dict[str, Any]:
    """Train one side in a process of its own, with nothing compiled before; its row."""
    command = [sys.executable, __file__, "--one", side, "--seed", str(seed)]
    command += [] if limit_s is None else ["--limit-s", str(limit_s)]
    command += [] if options.steps is None else ["--steps", str(options.steps)]
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "TORCHINDUCTOR_CACHE_DIR": cache, "OMP_NUM_THREADS": "1"}
        ended = subprocess.run(
            command, env=environment, stdout=subprocess.PIPE, text=True, check=False
        )
    if ended.returncode != 0:
        raise SystemExit(f"{side}, seed {seed} ended with {ended.returncode}; see above")
    row: dict[str, Any] = json.loads(ended.stdout.strip().splitlines()[-1])
    return {**row, "settings": settings(options)}


def all_runs(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Those of the file, and those that it lacks."""
    rows = read_rows(options.rows, settings(options))
    done = {(row["side"], row["seed"]): row for row in rows}
    for seed in range(options.seed, options.seed + options.seeds):
        for side in (OURS, *options.peers):
            if (side, seed) in done:
                progress(f"seed {seed}, {side}: from {options.rows}")
                continue
            limit_s = None if side == OURS else options.cap * done[OURS, seed]["wall_s"]
            allowed = "" if limit_s is None else f", at most {limit_s:.0f} s"
            progress(f"seed {seed}, {side}{allowed}:")
            row = run_process(side, seed, limit_s, options)
            keep(options.rows, row)
            done[side, seed] = row
            progress(
                f"  {'solved' if row['solved'] else 'not solved'}: {row['wall_s']:.0f} s, "
                f"{row['steps']:,} steps, {row['peak_memory_mib']['process']:.0f} MiB"
            )
    return list(done.values())


def options_of(arguments: list[str] | None = None) -> argparse.Namespace:
    """Parse and check."""
    parser = argument_parser(__doc__)
    parser.add_argument("--seeds", type=int, default=5, help="how many, from --seed on")
    parser.add_argument("--cap", type=float, default=10.0, help="times our time that the peer gets")
    parser.add_argument("--rows", type=Path, default=None, help="file of finished runs (JSONL)")
    parser.add_argument(
        "--peers", nargs="+", choices=[*PEERS], default=[*PEERS], help="settings of the peer"
    )
    parser.add_argument("--steps", type=int, default=None, help="our budget; else the preset's")
    parser.add_argument("--one", choices=[OURS, *PEERS], default=None, help=argparse.SUPPRESS)
    parser.add_argument("--limit-s", type=float, default=None, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.seeds < 1 or options.cap <= 0.0:
        parser.error(f"--seeds {options.seeds} and --cap {options.cap} must be above 0")
    return options


def main() -> None:
    options = options_of()
    if options.one is not None:
        row = train(
            options.one, options.seed, limit_s=options.limit_s, steps=options.steps, bar=BAR,
            in_a_row=IN_A_ROW,
        )  # fmt: skip
        print(json.dumps(row))
        return
    rows = all_runs(options)
    data = {**compare(rows, OURS), "runs": rows}
    config = {**settings(options), "seeds": options.seeds, "peers": options.peers}
    document = write_result("train_vs_sb3", data, options.out, seed=options.seed, config=config)
    print_result(document, as_json=options.json)


if __name__ == "__main__":
    main()
