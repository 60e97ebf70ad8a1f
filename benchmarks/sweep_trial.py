"""A sweep file tried out: every run of it, one seed, until the goals have been proposed once.

    python benchmarks/sweep_trial.py --file sweeps/paper.yaml --folder runs/trial --json

Runs `skewmi sweep` with few steps (what is done already in the folder is not done again) and
`skewmi figures`, and tells whether all runs came to their end, what they said meanwhile, and what
the figures lack. The times are those of this machine, whatever else ran on it.
"""

from __future__ import annotations

import argparse
import collections
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from bundled_policy import run
from common import argument_parser, print_result, progress, write_result

from skewmi.child import child_command
from skewmi.sweep.places import LOG, RESULT, RUN
from skewmi.sweep.run_folder import read_parts, read_result


def sweep(options: argparse.Namespace) -> dict[str, Any]:
    """What `skewmi sweep` tells at the end, also when runs failed."""
    arguments = [
        "sweep", str(options.file), "--out", str(options.folder), "--seeds", str(options.seeds),
        "--steps", str(options.steps), "--processes", str(options.processes),
    ]  # fmt: skip
    progress(f"skewmi {' '.join(arguments)}")
    command = child_command("-m", "skewmi.cli.main", *arguments, "--json")
    output = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False).stdout
    document: dict[str, Any] = json.loads(output)
    return document


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """All figures."""
    document = sweep(options)
    told = document["runs"]
    folders = {entry["run"]: options.folder / "runs" / entry["run"] for entry in told}
    results = {name: read_result(folder) for name, folder in folders.items()}
    parts = {name: read_parts(folder) for name, folder in folders.items()}
    ended = [folder for name, folder in folders.items() if results[name] is not None]
    states = collections.Counter(entry["state"] for entry in told)
    refreshes = collections.Counter(r["refreshes"] for r in results.values() if r is not None)
    steps = collections.Counter(entry["steps"] for entry in told)
    seconds = [entry["seconds"] for entry in told]
    drawn = run("figures", str(options.folder), "--overwrite")
    return {
        "runs": len(told),
        "states": dict(states),
        "all_done": states["done"] == len(told),
        "failed": document["failed"],
        "said": {name: text for name, f in folders.items() if (text := said(f))},
        "begun_again": {name: len(p) - 1 for name, p in parts.items() if len(p) > 1},
        "commits": sorted({part["version"] for p in parts.values() for part in p}),
        # How often goals were proposed, or the bonus's network was trained, and steps: of how many.
        "refreshes": {str(count): runs for count, runs in sorted(refreshes.items())},
        "steps": {str(count): runs for count, runs in sorted(steps.items())},
        "seconds": {
            "of_all_runs": sum(seconds),
            "least": min(seconds),
            "most": max(seconds),
            "first_begun_to_last_ended": wall(ended),
        },
        "figures": {
            "files": [Path(path).name for path in drawn["files"]],
            "lack": drawn["missing"],
        },
    }


def said(run_dir: Path) -> str:
    """What a run's workers wrote: warnings and errors, nothing else."""
    log = run_dir / LOG
    return log.read_text(errors="replace").strip() if log.exists() else ""


def wall(folders: list[Path]) -> float | None:
    """From the first run's beginning to the last one's end, breaks of the sweep included, s."""
    if not folders:
        return None
    begin = min((folder / RUN).stat().st_mtime for folder in folders)
    return max((folder / RESULT).stat().st_mtime for folder in folders) - begin


def main() -> int:
    parser = argument_parser(__doc__)
    parser.add_argument("--file", type=Path, default=Path("sweeps/paper.yaml"), help="sweep file")
    parser.add_argument("--folder", type=Path, required=True, help="of the sweep")
    parser.add_argument("--seeds", type=int, default=1, help="of each group, the first ones")
    parser.add_argument("--steps", type=int, default=2_000, help="of every run, environment steps")
    parser.add_argument("--processes", type=int, default=1, help="runs at the same time")
    options = parser.parse_args()
    config = {"file": str(options.file)}
    config |= {key: getattr(options, key) for key in ("seeds", "steps", "processes")}
    document = write_result("sweep_trial", measure(options), options.out, seed=None, config=config)
    print_result(document, as_json=options.json)
    return 0 if document["all_done"] else 1


if __name__ == "__main__":
    sys.exit(main())
