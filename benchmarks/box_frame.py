"""What it is worth to know where the box stands: boxes up to 25 mm and 10 degrees off their place.

Each is drawn, and known as well as touching finds it. Policy, robot and seeds are the same with and
without that knowledge, in the batched simulation and through the deployed chain in lock-step.

    python benchmarks/box_frame.py --boxes 10 --json --out results/box_frame.json
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from common import argument_parser, print_result, progress, write_result

# isort: split
from moved_boxes import calibration_at

from skewmi.calibration.calibration_file import write_calibration

SHIFT, TURN_DEG = 0.025, 10.0
"""Largest displacement, m in any direction, and degrees."""
CONTACT = ("hand_force_peak_n", "hand_force_standing_n", "arm_force_peak_n", "hand_tilt_deg",
           "outside_box_mm")  # fmt: skip


def drawn(rng: np.random.Generator) -> tuple[float, float, float]:
    """Uniform in the disc of places and in the turn: x, y, m, and degrees."""
    distance, angle = SHIFT * np.sqrt(rng.random()), rng.uniform(-np.pi, np.pi)
    turn = rng.uniform(-TURN_DEG, TURN_DEG)
    return float(distance * np.cos(angle)), float(distance * np.sin(angle)), float(turn)


def run(*words: str) -> dict[str, Any]:
    """A command of skewmi, and the document that it prints."""
    done = subprocess.run(
        [sys.executable, "-m", "skewmi.cli.main", *words, "--json"],
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode not in (0, 1):
        raise SystemExit(f"skewmi {' '.join(words)} failed: {done.stderr[-800:]}")
    found: dict[str, Any] = json.loads(done.stdout[done.stdout.index("{") :])
    return found


def both_ways(args: argparse.Namespace, *more: str) -> dict[str, Any]:
    """Episodes in simulation and deployed."""
    asked = (args.policy, "--seed", str(args.seed), *more)
    told = {
        "simulated": run("evaluate", *asked, "--episodes", str(args.episodes)),
        "deployed": run("deploy", *asked, "--episodes", str(args.deployed), "--lock-step"),
    }
    return {
        where: {
            "successes": document["successes"],
            "episodes": document["episodes"],
            "stops": document.get("stops", []),
            "contact": {name: document["contact"][name]["max"] for name in CONTACT},
        }
        for where, document in told.items()
    }


def one_box(args: argparse.Namespace, number: int, folder: Path) -> dict[str, Any]:
    rng = np.random.default_rng([args.seed, number])
    x, y, yaw_deg = drawn(rng)
    off = rng.normal(0.0, (args.error_mm / 1e3, args.error_mm / 1e3, args.error_deg))
    variation = folder / f"{number}.yaml"
    variation.write_text(json.dumps({"box_pose": {"x": x, "y": y, "yaw_deg": yaw_deg}}))
    calibration = calibration_at(x + off[0], y + off[1], yaw_deg + off[2])
    known = write_calibration(folder / f"{number}.known.yaml", calibration)
    return {
        "number": number,
        "true": {"x": x, "y": y, "yaw_deg": yaw_deg},
        "known_less_true": dict(zip(("x", "y", "yaw_deg"), off.tolist(), strict=True)),
        "not_known": both_ways(args, "--variation", str(variation)),
        "known": both_ways(args, "--variation", str(variation), "--calibration", str(known)),
    }


def totals(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Of several boxes."""
    found: dict[str, Any] = {}
    for where in ("simulated", "deployed"):
        found[where] = {
            "successes": sum(row[where]["successes"] for row in rows),
            "episodes": sum(row[where]["episodes"] for row in rows),
            "stops": sum(len(row[where]["stops"]) for row in rows),
            "largest_contact": {
                name: max(row[where]["contact"][name] for row in rows) for name in CONTACT
            },
        }
    return found


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--boxes", type=int, default=10, help="how many are drawn")
    parser.add_argument("--episodes", type=int, default=50, help="of each box, simulated")
    parser.add_argument("--deployed", type=int, default=4, help="of each box, deployed")
    parser.add_argument("--policy", default="open_press_close")
    parser.add_argument(
        "--error-mm", type=float, default=0.05, help="standard deviation of what is known, x and y"
    )
    parser.add_argument("--error-deg", type=float, default=0.03, help="the same of the turn")
    args = parser.parse_args()
    in_place = both_ways(args)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(args.boxes):
            rows.append(one_box(args, number, Path(folder)))
            progress(json.dumps(rows[-1]))
    results = {
        "in_place": totals([in_place]),
        "not_known": totals([row["not_known"] for row in rows]),
        "known": totals([row["known"] for row in rows]),
        "boxes": rows,
    }
    keys = ("boxes", "episodes", "deployed", "policy", "error_mm", "error_deg")
    document = write_result(
        "box_frame",
        results,
        args.out,
        seed=args.seed,
        config={key: getattr(args, key) for key in keys},
    )
    print_result(document, as_json=args.json)


if __name__ == "__main__":
    main()
