"""DoorOpen from its sparse reward to the deployed chain: learned, exported, deployed.

    python benchmarks/door_open_deployed.py --folder runs/door --json

For each of the five targets: return-then-explore under a variation until it has converged and for
some trajectories more (a run in the folder goes on, or is taken as it is), `export-onnx`,
`evaluate` on the nominal model, under the documented randomisation, and under variation `deployed`,
where commands are as late as a session's, and `deploy` on the simulated robot, over Zenoh and in
lock-step: nominal, randomised, and nominal at half speed. Some eight minutes of training and three
of the rest a target.
"""

from __future__ import annotations

import argparse
import json
import subprocess
from pathlib import Path
from typing import Any

from bundled_policy import deploy, run
from common import argument_parser, print_result, progress, write_result

from skewmi.child import child_command
from skewmi.sim.tasks.door_open.targets import TARGETS

VARIATIONS = ("randomised", "deployed")
PRESET = "improved-return-then-explore"
STEPS = 200_000
"""At which a run that has not converged is given up."""


def trained(options: argparse.Namespace, target: str) -> dict[str, Any]:
    """The run of a target: what it found and when, and how far it was trained on after that."""
    run_dir = options.folder / target
    given = ["--task", "door_open", "--preset", PRESET, "--option", f"target={target}"]
    given += ["--seed", str(options.seed), "--variation", options.variation]
    given += ["--resume", "--run-dir", str(run_dir)]
    progress(f"training towards {target} in {run_dir}")
    document = train(*given, "--steps", str(STEPS), "--stop-on-convergence")
    if document["converged_at"] is not None:
        steps_each = document["steps"] // document["trajectories"]
        steps = (document["converged_at"] + options.after) * steps_each
        if steps > document["steps"]:
            document = train(*given, "--steps", str(steps))
    return {
        "trajectories": document["trajectories"],
        "converged_at": document["converged_at"],
        "converged_at_paper": document["converged_at_paper"],
    }


def train(*given: str) -> dict[str, Any]:
    """`skewmi train` with these options; its document."""
    command = child_command("-m", "skewmi.cli.main", "train", *given, "--json")
    output = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout
    document: dict[str, Any] = json.loads(output)
    return document


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Figures of every target."""
    found = {}
    seed = options.seed
    many = ("--episodes", str(options.episodes), "--seed", str(seed))
    for target in options.targets:
        training = trained(options, target)
        policy = str(options.folder / f"{target}.onnx")
        exported = run("export-onnx", str(options.folder / target), "--out", policy, "--overwrite")
        record = str(options.folder / f"{target}.mcap")
        found[target] = {
            "training": training,
            "largest_difference_to_torch": exported["max_difference"],
            "evaluate": {
                "nominal": evaluated(policy, *many),
                **{name: evaluated(policy, *many, "--variation", name) for name in VARIATIONS},
            },
            "deploy": {
                "nominal": deploy(
                    policy, seed, options.deployed, "--lock-step", "--record", record, "--overwrite"
                ),
                "randomised": deploy(
                    policy, seed, options.deployed, "--lock-step", "--variation", "randomised"
                ),
                "half_speed": deploy(
                    policy, seed, options.deployed, "--lock-step", "--speed", "0.5"
                ),
            },
        }
    return {"targets": found}


def evaluated(*given: str) -> dict[str, Any]:
    """What of an evaluation is kept."""
    report = run("evaluate", *given)
    kept = {key: report[key] for key in ("episodes", "successes", "success_rate")}
    return kept | {"hand_force_peak_n": report["contact"]["hand_force_peak_n"]}


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--folder", type=Path, required=True, help="of runs, policies, recordings")
    parser.add_argument(
        "--targets", nargs="+", choices=[*TARGETS], default=[*TARGETS], help="which"
    )
    parser.add_argument(
        "--variation", choices=VARIATIONS, default="deployed", help="that runs are trained under"
    )
    parser.add_argument(
        "--after", type=int, default=200, help="trajectories that are trained on once converged"
    )
    parser.add_argument("--episodes", type=int, default=200, help="evaluated, each model")
    parser.add_argument("--deployed", type=int, default=20, help="deployed, each way")
    options = parser.parse_args()
    keys = ("targets", "variation", "after", "episodes", "deployed")
    config = {key: getattr(options, key) for key in keys} | {"preset": PRESET, "steps": STEPS}
    document = write_result(
        "door_open_deployed", measure(options), options.out, seed=options.seed, config=config
    )
    print_result(document, as_json=options.json)


if __name__ == "__main__":
    main()
