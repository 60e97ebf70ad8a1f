"""How close touching comes to where the box stands, and how gently, through the deployed chain.

Boxes are drawn within 6 mm and 4 degrees of where they are believed to stand, and robots from the
documented ranges (servo 0.4 to 1.6, friction 0 to 2 N m, in the wrist 0 to 0.5, delay 0 to 40 ms).
What `skewmi calibrate scene` knows of the servos is as wrong as `skewmi calibrate servo` leaves it.

    python benchmarks/scene_registration.py --poses 10 --out results/scene_registration.json
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from common import argument_parser, print_result, progress, write_result

# isort: split
from calibrations import DrawnRobot, known_servo

from skewmi import __version__
from skewmi.calibration.calibration_file import Calibration, write_calibration
from skewmi.calibration.scene_faces import SHIFT, TURN
from skewmi.robot_models.servo import CONTACT_SERVO

WRIST_FRICTION = 0.5
"""Largest of the last three joints, N m."""
ERRORS = {"error_mm": 0.3, "error_deg": 0.05, "hand_force_peak_n": 15.0, "arm_force_peak_n": 0.0}
"""What each pose must keep."""


def one_pose(args: argparse.Namespace, number: int, folder: Path) -> dict[str, Any]:
    rng = np.random.default_rng([args.seed, number])
    drawn = DrawnRobot.draw(rng)
    friction = np.concatenate(
        (drawn.frictionloss[:4], WRIST_FRICTION / 2.0 * drawn.frictionloss[4:])
    )
    robot = DrawnRobot(drawn.kp_scale, drawn.kd_scale, friction, drawn.delay_ms)
    x, y = rng.uniform(-SHIFT, SHIFT, 2)
    yaw_deg = float(np.degrees(rng.uniform(-TURN, TURN)))
    lid_deg = float(rng.uniform(-10.0, 10.0))
    variation = robot.variation(args.noise, args.seed + number) | {
        "box_pose": {"x": float(x), "y": float(y), "yaw_deg": yaw_deg},
    }
    variation["sensors"]["lid_bias_deg"] = lid_deg
    files = [folder / f"{number}.{name}" for name in ("json", "known.yaml", "found.yaml")]
    files[0].write_text(json.dumps(variation))
    servo = known_servo(robot.parameters(CONTACT_SERVO), robot.delay_ms, args.servo_error, rng)
    created = datetime.now(UTC).isoformat(timespec="seconds")
    write_calibration(files[1], Calibration(created, __version__, servo=servo))
    command = [sys.executable, "-m", "skewmi.cli.main", "calibrate", "scene"]
    command += ["--variation", str(files[0]), "--out", str(files[2]), "--json"]
    command += ["--calibration", str(files[1])] if not args.unknown_servo else []
    command += [] if args.real_time else ["--lock-step"]
    begun = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        return {"number": number, "failed": done.stdout[-500:] + done.stderr[-500:]}
    found = json.loads(done.stdout.splitlines()[-1])
    pose = found["box_pose"]
    errors = np.array([pose["x"]["value"] - x, pose["y"]["value"] - y])
    true = {"x": float(x), "y": float(y), "yaw_deg": yaw_deg}
    return {
        "number": number,
        "true": true,
        "error_mm": 1e3 * float(np.linalg.norm(errors)),
        "error_x_mm": 1e3 * float(errors[0]),
        "error_y_mm": 1e3 * float(errors[1]),
        "error_deg": abs(pose["yaw_deg"]["value"] - yaw_deg),
        "half_width": {n: (pose[n]["high"] - pose[n]["low"]) / 2.0 for n in true},
        "held_by_95": {n: pose[n]["low"] <= true[n] <= pose[n]["high"] for n in true},
        "lid_error_deg": abs(found["lid_bias_deg"]["value"] - lid_deg),
        "touches": found["touches"],
        "largest_force_estimate_n": found["largest_force_n"],
        "hand_force_peak_n": found["contact"]["hand_force_peak_n"],
        "arm_force_peak_n": found["contact"]["arm_force_peak_n"],
        "robot_seconds": found["robot_seconds"],
        "missed_cycles": found["missed_cycles"],
        "usage": found["usage"],
        "seconds": time.perf_counter() - begun,
    }


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    good = [row for row in rows if "failed" not in row]
    result: dict[str, Any] = {"poses": len(rows), "failed": len(rows) - len(good)}
    if not good:
        return result
    for name, most in ERRORS.items():
        values = [row[name] for row in good]
        result[name] = {
            "median": float(np.median(values)),
            "largest": max(values),
            "allowed": most,
            "kept": f"{sum(value <= most for value in values)} of {len(rows)}",
        }
    held = [held for row in good for held in row["held_by_95"].values()]
    result["held_by_95"] = f"{sum(held)} of {len(held)}"
    result["largest_lid_error_deg"] = max(row["lid_error_deg"] for row in good)
    residuals = [abs(t["residual_mm"]) for row in good for t in row["touches"]]
    result["largest_residual_mm"] = max(residuals)
    ratio = [row["largest_force_estimate_n"] / row["hand_force_peak_n"] for row in good]
    result["force_estimate_to_true"] = {"lowest": min(ratio), "highest": max(ratio)}
    result["longest_robot_seconds"] = max(row["robot_seconds"] for row in good)
    return result


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--poses", type=int, default=10, help="how many are drawn")
    parser.add_argument("--noise", type=float, default=1e-4, help="of joint positions, rad")
    parser.add_argument("--servo-error", type=float, default=0.015, help="of what is known, a part")
    parser.add_argument("--unknown-servo", action="store_true", help="give no calibration")
    parser.add_argument("--real-time", action="store_true", help="not in lock-step")
    args = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(args.poses):
            row = one_pose(args, number, Path(folder))
            rows.append(row)
            progress(f"pose {number}: {row['failed']}" if "failed" in row else _line(row))
    keys = ("poses", "noise", "servo_error", "unknown_servo", "real_time")
    document = write_result(
        "scene_registration",
        {"summary": summary(rows), "each": rows},
        args.out,
        seed=args.seed,
        config={key: getattr(args, key) for key in keys},
    )
    print_result(document, as_json=args.json)


def _line(row: dict[str, Any]) -> str:
    return (
        f"pose {row['number']}: {row['error_mm']:.3f} mm ({row['error_x_mm']:+.3f}, "
        f"{row['error_y_mm']:+.3f}), {row['error_deg']:.4f} deg, hand "
        f"{row['hand_force_peak_n']:.1f} N (estimated {row['largest_force_estimate_n']:.1f}), arm "
        f"{row['arm_force_peak_n']:.1f} N, {row['robot_seconds']:.0f} s, {row['seconds']:.0f} s"
    )


if __name__ == "__main__":
    main()
