"""How often the policies of a sweep succeed at the moment that their runs converged.

    python benchmarks/sweep_success.py --folder runs/return-then-explore --task open_press_close

Every converged run of the task in the sweep's folder goes through `skewmi evaluate`: deterministic
episodes on the nominal model, from starts that training has not seen.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from bundled_policy import run
from common import argument_parser, print_result, write_result


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Success of every run, and the least."""
    found = []
    for result in sorted(options.folder.glob(f"runs/{options.task}-*/result.json")):
        told = json.loads(result.read_text())
        if told["converged_at"] is None:
            continue
        report = run(
            "evaluate", str(result.parent), "--episodes", str(options.episodes),
            "--seed", str(options.seed),
        )  # fmt: skip
        found.append(
            {
                "run": result.parent.name,
                "converged_at": told["converged_at"],
                "successes": report["successes"],
                "success_rate": report["success_rate"],
            }
        )
    rates = [entry["success_rate"] for entry in found]
    return {"runs": len(found), "least_success_rate": min(rates, default=None), "each": found}


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--folder", type=Path, required=True, help="of the sweep")
    parser.add_argument("--task", required=True, help="whose runs")
    parser.add_argument("--episodes", type=int, default=200, help="of each")
    options = parser.parse_args()
    config = {"task": options.task, "episodes": options.episodes}
    document = write_result(
        "sweep_success", measure(options), options.out, seed=options.seed, config=config
    )
    print_result(document, as_json=options.json)


if __name__ == "__main__":
    main()
