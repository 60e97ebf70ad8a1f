"""The whole way of a calibration, on robots that nobody knows: excite, servo, scene, deploy.

Robots are drawn as in `calibrated_robots.py`, by default with the scene's box displaced by up to
5 mm and 3 degrees, too. Each is what its robot server is; all else goes through the command line:
`calibrate excite`, `calibrate servo` and, with `--scene`, `calibrate scene`, which finds the box by
touching it and without which nothing is told of it; then the policy in the batched simulation
(`evaluate`) and through the deployed chain in lock-step (`deploy`), before and after. A robot takes
minutes; `--rows FILE` keeps what is finished, and goes on from it. With `--keep FOLDER` robots and
their calibrations stay there, and are not made again.

    python benchmarks/calibrated_deployment.py --robots 50 --rows rows.jsonl --out results.json
"""

from __future__ import annotations

import argparse
import json
import shutil
import time
from collections.abc import Callable
from contextlib import ExitStack, redirect_stderr, redirect_stdout
from functools import partial
from io import StringIO
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from calibrated_robots import UnknownRobot
from common import argument_parser, print_result, progress, write_result

from skewmi.cli.main import main as skewmi_command

POSE = {"x": 0.005, "y": 0.005, "yaw_deg": 3.0}
"""Largest displacement of the box, m and degrees."""


def command(*arguments: str) -> dict[str, Any]:
    """What a command prints with --json.

    Raises:
        RuntimeError: It prints nothing: it could not be carried out, say because a busy computer
            did not start the robot server in time. That is no failure of the robot.
    """
    with redirect_stdout(StringIO()) as out, redirect_stderr(StringIO()) as errors:
        code = skewmi_command([*arguments, "--json"])
    lines = out.getvalue().strip()
    if not lines:
        words = (errors.getvalue().strip().splitlines() or ["nothing"])[-1]
        raise RuntimeError(f"skewmi {' '.join(arguments)} ended with {code} and said: {words}")
    document: dict[str, Any] = json.loads(lines)
    return document


def calibrate_servos(
    args: argparse.Namespace, number: int, file: Path, out: Path
) -> dict[str, Any]:
    """Excite a robot and identify its servos."""
    recording = file.with_name("excitation.mcap")
    begin = time.perf_counter()
    excited = command(
        *("calibrate", "excite", "--variation", str(file), "--lock-step", "--overwrite"),
        *("--seconds", str(args.seconds), "--seed", str(number), "--out", str(recording)),
    )
    excite_s, begin = time.perf_counter() - begin, time.perf_counter()
    servo = command("calibrate", "servo", str(recording), "--out", str(out), "--overwrite")
    recording.unlink()
    return {
        "excite": {k: excited.get(k) for k in ("stops", "usage", "missed_cycles")},
        "excite_s": excite_s,
        "servo_s": time.perf_counter() - begin,
        "residual_rms_rad": servo.get("residual_rms_rad"),
    }


def calibrate_scene(known: Path, file: Path, out: Path) -> dict[str, Any]:
    """Touch the box of a robot whose servos are known."""
    begin = time.perf_counter()
    scene = command(
        *("calibrate", "scene", "--variation", str(file), "--lock-step", "--overwrite"),
        *("--calibration", str(known), "--out", str(out)),
    )
    seconds, force = time.perf_counter() - begin, scene.get("largest_force_n")
    # Without a pose it was stopped, and the robot goes on with what is known of its servos.
    pose = {name: told["value"] for name, told in scene.get("box_pose", {}).items() if name in POSE}
    if not pose:
        shutil.copy(known, out)
    return {"scene": {"box_pose": pose, "largest_force_n": force, "seconds": seconds}}


def once(file: Path, make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """What is made and told, or what the file keeps of an earlier time."""
    if not file.is_file():
        file.write_text(json.dumps(make()))
    told: dict[str, Any] = json.loads(file.read_text())
    return told


def one_robot(args: argparse.Namespace, number: int) -> dict[str, Any]:
    rng = np.random.default_rng([args.seed, number])
    robot = json.loads(UnknownRobot.draw(rng, args.lid).variation())
    robot["box_pose"] = {
        name: float(args.pose * rng.uniform(-bound, bound)) for name, bound in POSE.items()
    }
    robot["sensors"] = {"joint_noise": 1e-4}
    row: dict[str, Any] = {"number": number, "robot": robot}
    with ExitStack() as stack:
        if args.keep is None:
            folder = Path(stack.enter_context(TemporaryDirectory()))
        else:
            folder = args.keep / f"robot-{number}"
            folder.mkdir(parents=True, exist_ok=True)
        file, known = folder / "robot.yaml", folder / "calibration.yaml"
        # JSON is YAML.
        if file.is_file() and json.loads(file.read_text()) != robot:
            raise SystemExit(f"{file} is another robot: give --keep an empty folder")
        file.write_text(json.dumps(robot))
        row |= once(folder / "made.json", partial(calibrate_servos, args, number, file, known))
        if args.scene:
            servos, known = known, folder / "with_scene.yaml"
            row |= once(folder / "scene.json", partial(calibrate_scene, servos, file, known))
        for when, more in (("before", ()), ("after", ("--calibration", str(known)))):
            varied = ("--variation", str(file), *more)
            seed = ("--seed", str(args.seed))
            if args.simulated:
                told = command(
                    *("evaluate", args.policy, *varied, *seed),
                    *("--episodes", str(args.simulated)),
                )
                row[f"simulated_{when}"] = told.get("successes", 0)
            told = command(
                *("deploy", args.policy, "--lock-step", *varied, *seed),
                *("--episodes", str(args.episodes)),
            )
            row[f"deployed_{when}"] = told.get("successes", 0)
            row[f"stops_{when}"] = told.get("stops")
            row[f"contact_{when}"] = {
                name: metrics["max"] for name, metrics in told.get("contact", {}).items()
            }
    return row


def summary(args: argparse.Namespace, rows: list[dict[str, Any]]) -> dict[str, Any]:
    result: dict[str, Any] = {"robots": len(rows)}
    for where, episodes in (("simulated", args.simulated), ("deployed", args.episodes)):
        for when in ("before", "after"):
            counts = [row.get(f"{where}_{when}", 0) for row in rows]
            result[f"{where}_{when}"] = f"{sum(counts)} of {episodes * len(rows)}"
            if when == "after":
                result[f"{where}_robots_always"] = sum(count == episodes for count in counts)
    touched = [row for row in rows if row.get("scene", {}).get("box_pose")]
    if touched:
        result["boxes_found"] = len(touched)
        found = [row["scene"]["box_pose"] for row in touched]
        for name in POSE:
            wrong = [
                abs(f[name] - r["robot"]["box_pose"][name])
                for f, r in zip(found, touched, strict=True)
            ]
            result[f"box_{name}_off"] = max(wrong)
        result["touching_force_n"] = max(row["scene"]["largest_force_n"] for row in touched)
    for name in (
        "hand_force_peak_n",
        "hand_force_standing_n",
        "arm_force_peak_n",
        "outside_box_mm",
    ):
        values = [row["contact_after"][name] for row in rows if name in row["contact_after"]]
        result[f"{name}_after"] = max(values, default=None)
    return result


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--policy", default="open_press_close")
    parser.add_argument("--robots", type=int, default=50)
    parser.add_argument("--seconds", type=float, default=30.0, help="of excitation")
    parser.add_argument("--episodes", type=int, default=2, help="deployed, of each robot")
    parser.add_argument("--simulated", type=int, default=20, help="episodes; 0 for none")
    parser.add_argument("--pose", type=float, default=1.0, help="part of the box's displacement")
    parser.add_argument("--lid", type=float, nargs=2, help="friction of the lid from, to, N m")
    parser.add_argument("--rows", type=Path, default=None, help="file of finished robots (JSONL)")
    parser.add_argument("--scene", action="store_true", help="find the box by touching it, too")
    parser.add_argument("--keep", type=Path, default=None, help="folder of robots, calibrated")
    parser.add_argument("--processes", type=int, default=1, help="robots at the same time")
    args = parser.parse_args()
    rows = []
    if args.rows is not None and args.rows.is_file():
        rows = [json.loads(line) for line in args.rows.read_text().splitlines()]
    # Started anew, so that nothing of one robot's run is in the next one's.
    with get_context("spawn").Pool(args.processes, maxtasksperchild=1) as pool:
        for row in pool.imap(partial(one_robot, args), range(len(rows), args.robots)):
            rows.append(row)
            if args.rows is not None:
                with args.rows.open("a") as file:
                    file.write(json.dumps(row) + "\n")
            progress(
                f"robot {row['number']}: simulated {row.get('simulated_before')} -> "
                f"{row.get('simulated_after')} of {args.simulated}, deployed "
                f"{row['deployed_before']} -> {row['deployed_after']} of {args.episodes}"
            )
    keys = ("policy", "robots", "seconds", "episodes", "simulated", "pose", "lid", "scene")
    document = write_result(
        "calibrated_deployment",
        {"summary": summary(args, rows), "each": rows},
        args.out,
        seed=args.seed,
        config={key: getattr(args, key) for key in keys},
    )
    print_result(document, as_json=args.json)


if __name__ == "__main__":
    main()
