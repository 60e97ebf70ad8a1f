"""How close servo identification comes, from commands and positions at 50 Hz alone.

Robots are drawn from the documented ranges (servo 0.4 to 1.6, friction 0 to 2 N m, delay 0 to
40 ms), follow an excitation in the simulation of the whole scene, and are identified with the bare
model of the arm. A motion with the next seed is held out. What
the model has not may be added: with `--mass-error` the masses and inertias of the arm differ from
the model's, which then knows that they may (`inertia_uncertainty`): only the ratios to stiffness
are to be right; with `--stiction` joints have more friction at rest than in motion (Stribeck), and
a friction is right if it is one of those between; with `--offset` measured angles are not the true
ones.

    python benchmarks/servo_identification.py --robots 10 --seconds 60 --json
"""

from __future__ import annotations

import argparse
import json
import time
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import asdict
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from common import argument_parser, print_result, progress, write_result

# isort: split
from calibrations import DrawnRobot, UnknownToModel

from skewmi.calibration.clear_space import ClearSpace
from skewmi.calibration.excitation import Excitation
from skewmi.calibration.excitation_choice import excitation_centre
from skewmi.calibration.servo_identification import (
    ServoIdentification,
    identify_servos,
    position_rms,
)
from skewmi.calibration.servo_model import DelayedServo, ServoModel
from skewmi.calibration.servo_recording import ServoRecording
from skewmi.cli.calibrate_recordings import read_excitation
from skewmi.cli.main import main as skewmi_command
from skewmi.robot_models import limits
from skewmi.robot_models.servo import CONTACT_SERVO
from skewmi.trajectory import Array, JointTrajectory

FRICTION_ROOM = 0.010
"""N m that a friction may be off, if that is more than 5 %."""
HELD_OUT_S = 10.0


def motion(args: argparse.Namespace, seconds: float, seed: int) -> JointTrajectory:
    return Excitation(seconds, seed).motion(
        excitation_centre(), limits.profile(args.limits), ClearSpace()
    )


def one_robot(args: argparse.Namespace, number: int) -> dict[str, Any]:
    rng = np.random.default_rng([args.seed, number])
    robot = DrawnRobot.draw(rng)
    unknown = draw_unknown(args, rng)
    seed = args.seed + 2 * number
    lengths = ((args.seconds, seed), (HELD_OUT_S, seed + 1))
    excited = time.perf_counter()
    if args.deployed:
        recording, held_out = (
            deployed(args, robot.variation(args.noise, s, unknown), length, s)
            for length, s in lengths
        )
    else:
        recording, held_out = (
            robot.record(motion(args, length, s), args.noise, s, unknown=unknown)
            for length, s in lengths
        )
    excited = time.perf_counter() - excited
    model = ServoModel(CONTACT_SERVO.kd / CONTACT_SERVO.kp, threads=args.threads)
    begin, worked = time.perf_counter(), time.process_time()
    found = identify_servos(
        # A uniform error within +-e has a standard deviation of e / sqrt(3).
        model,
        [recording],
        CONTACT_SERVO,
        inertia_uncertainty=args.mass_error / 3.0**0.5,
    )
    seconds, work = time.perf_counter() - begin, time.process_time() - worked
    rms = [
        float(np.sqrt((position_rms(model, servo, held_out) ** 2).mean()))
        for servo in (DelayedServo(CONTACT_SERVO, 0.0), found.servo)
    ]
    row = errors(found, truth(robot))
    row["held_by_95"] |= friction_held(found, robot, unknown.stiction_scale)
    return row | {
        "delay_ms": robot.delay_ms,
        "seconds_of_exciting_both": excited,
        "unknown": asdict(unknown),
        "residual_rms_rad": found.residual_rms,
        "residual_autocorrelation": found.autocorrelation_time,
        "held_out_rms_nominal_rad": rms[0],
        "held_out_rms_calibrated_rad": rms[1],
        "held_out_ratio": rms[0] / rms[1],
        "seconds_of_computing": seconds,
        # Of all threads: what a machine that others use does not change much.
        "seconds_of_processor": work,
    }


def draw_unknown(args: argparse.Namespace, rng: np.random.Generator) -> UnknownToModel:
    mass_scale = 1.0 + float(rng.uniform(-args.mass_error, args.mass_error))
    return UnknownToModel(
        mass_scale,
        float(rng.uniform(1.0, args.stiction)),
        float(np.exp(rng.uniform(np.log(0.01), np.log(0.2)))),
        tuple(rng.uniform(-args.offset, args.offset, 7).tolist()),
    )


def friction_held(
    found: ServoIdentification, robot: DrawnRobot, stiction_scale: float
) -> dict[str, int]:
    """How many intervals of friction and friction/kp hold one between motion and rest."""
    held = {}
    for name in ("frictionloss", "frictionloss_over_kp"):
        moving, estimate = truth(robot)[name], found.estimates[name]
        at_rest = stiction_scale * moving
        held[name] = int(((estimate.low <= at_rest) & (moving <= estimate.high)).sum())
    return held


def deployed(
    args: argparse.Namespace, variation: dict[str, Any], seconds: float, seed: int
) -> ServoRecording:
    """Made by the command line, on a robot server of its own."""
    with TemporaryDirectory() as folder:
        file, out = Path(folder) / "robot.yaml", Path(folder) / "excitation.mcap"
        # JSON is YAML.
        file.write_text(json.dumps(variation))
        arguments = ["calibrate", "excite", "--variation", str(file), "--limits", args.limits]
        arguments += ["--seconds", str(seconds), "--seed", str(seed), "--out", str(out)]
        with redirect_stdout(StringIO()), redirect_stderr(StringIO()) as words:
            code = skewmi_command([*arguments, "--lock-step"])
        if code:
            raise SystemExit(words.getvalue())
        return read_excitation(out).recording


def truth(robot: DrawnRobot) -> dict[str, Array]:
    own = robot.parameters(CONTACT_SERVO)
    return {
        "kp": own.kp,
        "kd": own.kd,
        "frictionloss": own.frictionloss,
        "kd_over_kp": own.kd / own.kp,
        "frictionloss_over_kp": own.frictionloss / own.kp,
        "delay": np.array([robot.delay_ms / 1e3]),
    }


def errors(found: ServoIdentification, true: dict[str, Array]) -> dict[str, Any]:
    """Errors in parts of a hundred and absolute, and how many intervals hold the truth."""
    row: dict[str, Any] = {"held_by_95": {}, "half_width_percent": {}}
    for name, values in true.items():
        estimate = found.estimates[name]
        held = (estimate.low <= values) & (values <= estimate.high)
        row["held_by_95"][name] = int(held.sum())
        half = (estimate.high - estimate.low) / 2.0
        if name == "delay":
            row["delay_error_ms"] = 1e3 * float(estimate.value[0] - values[0])
            row["delay_half_width_ms"] = 1e3 * float(half[0])
            continue
        row[f"{name}_error_percent"] = 100.0 * np.abs(estimate.value / values - 1.0)
        row["half_width_percent"][name] = float(100.0 * np.median(half / values))
    off = np.abs(found.estimates["frictionloss"].value - true["frictionloss"])
    row["frictionloss_error_n_m"] = off
    allowed = np.maximum(0.05 * true["frictionloss"], FRICTION_ROOM)
    row["frictionloss_within_5_percent_or_10_mnm"] = int((off <= allowed).sum())
    return row


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    result: dict[str, Any] = {"robots": len(rows), "held_by_95": {}, "error": {}}
    for name in rows[0]["held_by_95"]:
        of = len(rows) * (1 if name == "delay" else 7)
        part = sum(row["held_by_95"][name] for row in rows) / of
        result["held_by_95"][name] = round(part, 4)
    constants = ("kp", "kd", "frictionloss", "delay")
    counted = sum(row["held_by_95"][name] for row in rows for name in constants)
    result["held_by_95"]["all_constants"] = round(counted / (22 * len(rows)), 4)
    for key in [key for key in rows[0] if key.endswith(("_error_percent", "_error_n_m"))]:
        values = np.concatenate([row[key] for row in rows])
        result["error"][key] = {"median": np.median(values), "largest": values.max()}
    delays = np.abs([row["delay_error_ms"] for row in rows])
    result["error"]["delay_error_ms"] = {"median": np.median(delays), "largest": delays.max()}
    within = sum(row["frictionloss_within_5_percent_or_10_mnm"] for row in rows)
    result["frictionloss_within_5_percent_or_10_mnm"] = f"{within} of {7 * len(rows)}"
    result["smallest_held_out_ratio"] = min(row["held_out_ratio"] for row in rows)
    result["longest_processor_s"] = max(row["seconds_of_processor"] for row in rows)
    result["longest_computing_s"] = max(row["seconds_of_computing"] for row in rows)
    return result


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--robots", type=int, default=10, help="how many are drawn")
    parser.add_argument("--seconds", type=float, default=60.0, help="of excitation")
    parser.add_argument("--limits", default="lab", help="profile of the motion")
    parser.add_argument(
        "--deployed",
        action="store_true",
        help="record by `skewmi calibrate excite`, in lock-step, through robot server and link",
    )
    parser.add_argument("--noise", type=float, default=1e-4, help="of joint positions, rad")
    parser.add_argument("--mass-error", type=float, default=0.0, help="masses within +- this part")
    parser.add_argument("--stiction", type=float, default=1.0, help="friction at rest, up to")
    parser.add_argument("--offset", type=float, default=0.0, help="of angles, within +- rad")
    parser.add_argument("--threads", type=int, default=2, help="that simulate candidates")
    args = parser.parse_args()
    rows = []
    for number in range(args.robots):
        row = one_robot(args, number)
        rows.append(row)
        kp, kd = row["kp_error_percent"].max(), row["kd_error_percent"].max()
        progress(
            f"robot {number}: kp {kp:.2f} %, kd {kd:.2f} %, "
            f"friction {row['frictionloss_error_n_m'].max():.3f} N m, "
            f"delay {row['delay_error_ms']:+.3f} ms, {row['seconds_of_processor']:.1f} s"
        )
    config = {
        key: getattr(args, key)
        for key in (
            *("robots", "seconds", "limits", "deployed", "noise"),
            *("mass_error", "stiction", "offset", "threads"),
        )
    }
    document = write_result(
        "servo_identification",
        {"summary": summary(rows), "each": rows},
        args.out,
        seed=args.seed,
        config=config,
    )
    print_result(document, as_json=args.json)


if __name__ == "__main__":
    main()
