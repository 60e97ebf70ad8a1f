"""The bundled policy: success in the batched simulation, under randomisation, and deployed.

    python benchmarks/bundled_policy.py --json

Runs the commands a user would: `evaluate` on the nominal model and under the documented
randomisation (with the distribution of contact forces), and `deploy` on the simulated robot over
Zenoh, in lock-step and in real time. Takes about five minutes on two cores.
"""

from __future__ import annotations

import argparse
import json
import subprocess
from collections.abc import Callable
from typing import Any

from common import argument_parser, print_result, progress, write_result

from skewmi.child import child_command
from skewmi.deploy.policy import OnnxPolicy

KEPT_OF_DEPLOY = (
    "episodes",
    "successes",
    "success_rate",
    "lock_step",
    "limit_profile",
    "limit_fractions",
    "cycle_ms",
    "cycles",
    "missed_cycles",
    "granted",
    "stops",
    "contact",
    "smoothness",
)


PARTS = ["nominal", "randomised", "lock_step", "lock_step_randomised", "real_time"]


def run(*arguments: str) -> dict[str, Any]:
    """Output of one command as the dictionary that it prints."""
    progress(f"skewmi {' '.join(arguments)}")
    command = child_command("-m", "skewmi.cli.main", *arguments, "--json")
    output = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout
    document: dict[str, Any] = json.loads(output)
    return document


def deploy(name: str, seed: int, episodes: int, *extra: str) -> dict[str, Any]:
    """Figures of deployed episodes."""
    report = run("deploy", name, "--seed", str(seed), "--episodes", str(episodes), *extra)
    figures = {key: report[key] for key in KEPT_OF_DEPLOY}
    steps = [e["steps"] for e in report["per_episode"] if e["outcome"] == "success"]
    figures["steps_to_success"] = {"min": min(steps), "max": max(steps)} if steps else None
    return figures


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """All figures."""
    name, seed = options.policy, options.seed
    many = ("--episodes", str(options.episodes), "--seed", str(seed))
    metadata = OnnxPolicy.load(name).metadata
    return {
        "policy": name,
        "training": {
            key: metadata.get(key)
            for key in (
                "method",
                "preset",
                "seed",
                "environment_steps",
                "updates",
                "checkpoint_sha256",
            )
        },
        "evaluate": chosen(
            options.parts,
            nominal=lambda: run("evaluate", name, *many),
            randomised=lambda: run("evaluate", name, *many, "--variation", "randomised"),
        ),
        "deploy": chosen(
            options.parts,
            lock_step=lambda: deploy(name, seed, options.deployed, "--lock-step"),
            lock_step_randomised=lambda: deploy(
                name, seed, options.deployed, "--lock-step", "--variation", "randomised"
            ),
            real_time=lambda: deploy(name, seed, options.real_time),
        ),
    }


def chosen(parts: list[str], **measured: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Figures of those parts that were asked for, in their order."""
    return {part: measure() for part, measure in measured.items() if part in parts}


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--policy", default="open_press_close", help="bundled name or file")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS, help="of it")
    parser.add_argument("--episodes", type=int, default=500, help="evaluated, each model")
    parser.add_argument("--deployed", type=int, default=50, help="in lock-step, each model")
    parser.add_argument("--real-time", type=int, default=5, help="deployed in real time")
    options = parser.parse_args()
    keys = ("policy", "parts", "episodes", "deployed", "real_time")
    config = {key: getattr(options, key) for key in keys}
    document = write_result(
        "bundled_policy", measure(options), options.out, seed=options.seed, config=config
    )
    print_result(document, as_json=options.json)


if __name__ == "__main__":
    main()
