"""How close the law of a controller guided by EGM is identified, from what was asked and positions.

The emulated controller's own code, without a network and without waiting: gain 2 to 20 /s, corner
4 to 40 Hz, lag 0 to 30 ms, friction half to twice the nominal, all drawn; positions at 248 Hz with
noise. The bridge was told 20 /s and 20 Hz. A motion with the next seed is held out. Each finished
controller is told on standard error, so that a run that is cut off is not lost.

    python benchmarks/egm_law.py --controllers 10 --seconds 10 --json
"""

from __future__ import annotations

import argparse
import json
import time
from functools import partial
from multiprocessing import get_context
from typing import Any

import numpy as np
from common import argument_parser, print_result, progress, write_result

# isort: split
from egm_arms import DrawnEgm

from skewmi.calibration.egm_identification import EgmIdentifier, egm_position_rms
from skewmi.calibration.egm_law import EgmLaw
from skewmi.calibration.egm_model import EgmArm
from skewmi.calibration.excitation import Excitation
from skewmi.calibration.excitation_choice import excitation_centre
from skewmi.calibration.servo_model import DelayedServo, ServoModel
from skewmi.robot_models import limits
from skewmi.robot_models.servo import CONTACT_SERVO
from skewmi.trajectory import JointTrajectory

ANNOUNCED = EgmLaw(20.0, 20.0)
HELD_OUT_S = 4.0
FLANGE_SPEED = 0.18
"""What a bridge with the program of `rapid/` admits, m/s."""


def motion(seconds: float, seed: int) -> JointTrajectory:
    asked = Excitation(seconds, seed, tcp_speed=FLANGE_SPEED)
    return asked.motion(excitation_centre(), limits.profile("lab"))


def one_controller(args: argparse.Namespace, number: int) -> dict[str, Any]:
    rng = np.random.default_rng([args.seed, number])
    drawn, seed = DrawnEgm.draw(rng), args.seed + 2 * number
    friction = CONTACT_SERVO.frictionloss * rng.uniform(0.5, 2.0, 7)
    robot = {"seed": 0, "servo": {"frictionloss": friction.tolist()}}
    recording = drawn.record(motion(args.seconds, seed), args.noise, seed, robot)
    held_out = drawn.record(motion(HELD_OUT_S, seed + 1), args.noise, seed + 1, robot)
    model = ServoModel(CONTACT_SERVO.kd / CONTACT_SERVO.kp)
    worked = time.process_time()
    found = EgmIdentifier(model, [recording], CONTACT_SERVO, ANNOUNCED).run()
    worked = time.process_time() - worked
    nominal = EgmArm(ANNOUNCED, DelayedServo(CONTACT_SERVO, 0.0))
    before, after = (
        float(np.sqrt((egm_position_rms(model, arm, held_out) ** 2).mean()))
        for arm in (nominal, found.arm)
    )
    truths = {
        "gain": drawn.law.gain,
        "low_pass": drawn.law.low_pass_hz,
        "delay": drawn.delay_s,
    }
    row: dict[str, Any] = {"controller": number}
    for name, true in truths.items():
        low, value, high = (
            float(getattr(found.estimates[name], part)[0]) for part in ("low", "value", "high")
        )
        row[name] = {
            "true": true,
            "value": value,
            "low": low,
            "high": high,
            "held": low <= true <= high,
        }
    return row | {
        "residual_rms_rad": float(np.sqrt((found.residual_rms**2).mean())),
        "residual_autocorrelation": float(found.autocorrelation_time.max()),
        "held_out_rms_nominal_rad": before,
        "held_out_rms_calibrated_rad": after,
        "held_out_ratio": before / after,
        "seconds_of_processor": worked,
    }


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    names = ("gain", "low_pass", "delay")
    off = {name: [abs(r[name]["value"] - r[name]["true"]) for r in rows] for name in names}
    return {
        "controllers": len(rows),
        "held_by_95": {name: sum(r[name]["held"] for r in rows) for name in names},
        "largest_error_gain_percent": max(
            100.0 * e / r["gain"]["true"] for e, r in zip(off["gain"], rows, strict=True)
        ),
        "largest_error_low_pass_percent": max(
            100.0 * e / r["low_pass"]["true"] for e, r in zip(off["low_pass"], rows, strict=True)
        ),
        "largest_error_delay_ms": 1e3 * max(off["delay"]),
        "smallest_held_out_ratio": min(r["held_out_ratio"] for r in rows),
        "longest_processor_s": max(r["seconds_of_processor"] for r in rows),
    }


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--controllers", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=10.0, help="length of each motion")
    parser.add_argument("--noise", type=float, default=1e-4, help="of a reading, rad")
    parser.add_argument("--processes", type=int, default=2, help="beside one another")
    args = parser.parse_args()
    rows = []
    with get_context("spawn").Pool(args.processes) as pool:
        for row in pool.imap(partial(one_controller, args), range(args.controllers)):
            progress(json.dumps(row))
            rows.append(row)
    document = write_result(
        "egm_law",
        {"summary": summary(rows), "each": rows},
        args.out,
        seed=args.seed,
        config={key: getattr(args, key) for key in ("controllers", "seconds", "noise")},
    )
    print_result(document, as_json=args.json)


if __name__ == "__main__":
    main()
