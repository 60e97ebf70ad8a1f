"""Excite, identify, touch and deploy on controllers guided by EGM that nobody knows, in real time.

Bridge, UDP and emulated controller are processes of their own; all else goes through the command
line. Drawn for each: servo stiffness 0.7 to 1.3, the lag 10 to 20 ms, the box within 5 mm and 3
degrees, the shut lid's reading within 2 degrees. Gain and corner of the emulated law are 20 /s and
20 Hz. The computer should have nothing else to do. A controller takes some six minutes.

    python benchmarks/egm_calibration.py --controllers 3 --json --out results/egm_calibration.json
"""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from common import argument_parser, print_result, progress, write_result
from egm_episodes import SKEWMI, chain

CLOSED_MM = "5"
"""Opening of the fingers that touch."""


def command(*arguments: str) -> dict[str, Any]:
    """What a command prints with --json, and its exit code."""
    result = subprocess.run(
        [*SKEWMI, *arguments, "--json"], stdout=subprocess.PIPE, text=True, check=False
    )
    document: dict[str, Any] = json.loads(result.stdout.strip().splitlines()[-1])
    return document | {"exit": result.returncode}


def one_controller(seed: int, number: int, seconds: float, episodes: int) -> dict[str, Any]:
    rng = np.random.default_rng([seed, number])
    pose = {
        name: float(rng.uniform(-bound, bound))
        for name, bound in (("x", 0.005), ("y", 0.005), ("yaw_deg", 3.0))
    }
    lag_ms, lid_deg = float(rng.uniform(10.0, 20.0)), float(rng.uniform(-2.0, 2.0))
    robot = {
        "servo": {"kp_scale": rng.uniform(0.7, 1.3, 7).tolist()},
        "sensors": {"joint_noise": 1e-4, "lid_bias_deg": lid_deg},
        "box_pose": pose,
    }
    row: dict[str, Any] = {"controller": number, "robot": robot, "lag_ms": lag_ms}
    with TemporaryDirectory() as name:
        file, recording, servo, known = (
            str(Path(name) / n) for n in ("robot.yaml", "e.mcap", "servo.yaml", "known.yaml")
        )
        Path(file).write_text(json.dumps(robot))  # JSON is YAML
        with chain(lag_ms, 1.0, ["--gripper-opening-mm", CLOSED_MM], file) as locator:
            progress(f"controller {number}: excite")
            at = ("--connect", locator)
            asked = ("--seconds", str(seconds), "--seed", str(number), "--out", recording)
            excited = command("calibrate", "excite", *at, *asked)
            row["excite"] = {k: excited.get(k) for k in ("exit", "stops", "missed_cycles", "usage")}
            progress(f"controller {number}: servo")
            identified = command("calibrate", "servo", recording, "--out", servo)
            row["servo"] = {k: identified.get(k) for k in ("exit", "egm", "residual_rms_rad")}
            row["servo"]["delay_ms"] = identified.get("servo", {}).get("delay_ms")
            progress(f"controller {number}: scene")
            row["scene"] = command(
                "calibrate", "scene", *at, "--calibration", servo, "--out", known
            )
        with chain(lag_ms, 1.0, ["--calibration", known], file) as locator:
            progress(f"controller {number}: deploy")
            flags = ("--episodes", str(episodes), "--seed", str(seed), "--calibration", known)
            told = command("deploy", "open_press_close", "--connect", locator, *flags)
            row["deploy"] = {k: told.get(k) for k in ("successes", "episodes", "stops")}
    progress(json.dumps(row))
    return row


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    found = [r for r in rows if r["scene"]["exit"] == 0]
    truth = [r["robot"]["box_pose"] for r in found]
    pose = [r["scene"]["box_pose"] for r in found]

    def worst(name: str, scale: float) -> float:
        pairs = zip(pose, truth, strict=True)
        return max(scale * abs(p[name]["value"] - t[name]) for p, t in pairs)

    return {
        "controllers": len(rows),
        "scenes_found": len(found),
        "largest_error_x_mm": worst("x", 1e3) if found else None,
        "largest_error_y_mm": worst("y", 1e3) if found else None,
        "largest_error_yaw_deg": worst("yaw_deg", 1.0) if found else None,
        "inside_intervals": sum(
            p[n]["low"] <= t[n] <= p[n]["high"]
            for p, t in zip(pose, truth, strict=True)
            for n in ("x", "y", "yaw_deg")
        ),
        "largest_force_n": max((r["scene"]["largest_force_n"] for r in found), default=None),
        "deployed": sum(r["deploy"]["successes"] or 0 for r in rows),
    }


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--controllers", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=30.0, help="of excitation")
    parser.add_argument("--episodes", type=int, default=5, help="deployed on each")
    args = parser.parse_args()
    rows = [
        one_controller(args.seed, number, args.seconds, args.episodes)
        for number in range(args.controllers)
    ]
    document = write_result(
        "egm_calibration",
        {"summary": summary(rows), "each": rows},
        args.out,
        seed=args.seed,
        config={key: getattr(args, key) for key in ("controllers", "seconds", "episodes")},
    )
    print_result(document, as_json=args.json)


if __name__ == "__main__":
    main()
