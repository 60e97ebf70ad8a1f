"""What a calibration is worth: success of a policy on unknown robots, before and after.

Robots are drawn from the documented ranges (stiffness and damping 0.4 to 1.6 of the nominal ones,
dry friction 0 to 2 N m and 0.5 in the wrist, delay 0 to 40 ms, contact friction 0.3 to 1.2); their
lids stay where they are left, unless `--lid` says otherwise: with less friction than 0.1 N m they
fall shut by themselves, and up to which angle depends on it. Each runs in the batched simulation as
it is, and again with a calibration file that has its constants with a relative error of 1.5 %
(standard deviation).

    python benchmarks/calibrated_robots.py --robots 8 --episodes 20 --json
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from common import argument_parser, print_result, progress, write_result

from skewmi.calibration.calibration_file import (
    Calibration,
    Constant,
    ServoCalibration,
    write_calibration,
)
from skewmi.cli.policies import load_policy_from, make_env, task_options
from skewmi.cli.task_flags import calibration_option
from skewmi.evaluation.rollout import run_episodes
from skewmi.policy_io import Policy
from skewmi.robot_models.servo import CONTACT_SERVO
from skewmi.trajectory import Array

LARGEST_FRICTION: Array = np.array([2.0, 2.0, 2.0, 2.0, 0.5, 0.5, 0.5])
"""N m."""


@dataclass(frozen=True)
class UnknownRobot:
    """A robot of the documented ranges."""

    kp_scale: Array
    kd_scale: Array
    frictionloss: Array
    """N m."""
    delay_ms: float
    contact_friction: float
    lid_friction: float | None = None
    """N m; None for the nominal one."""

    @staticmethod
    def draw(rng: np.random.Generator, lid: Sequence[float] | None = None) -> UnknownRobot:
        robot = UnknownRobot(
            rng.uniform(0.4, 1.6, 7),
            rng.uniform(0.4, 1.6, 7),
            rng.uniform(0.0, LARGEST_FRICTION),
            float(rng.uniform(0.0, 40.0)),
            float(rng.uniform(0.3, 1.2)),
        )
        return robot if lid is None else replace(robot, lid_friction=float(rng.uniform(*lid)))

    def variation(self) -> str:
        """The content of a variation file that says what it is."""
        servo = {
            "kp_scale": self.kp_scale.tolist(),
            "kd_scale": self.kd_scale.tolist(),
            "frictionloss": self.frictionloss.tolist(),
            "delay_ms": self.delay_ms,
        }
        robot = {"servo": servo, "contact": {"friction": self.contact_friction}}
        lid = {} if self.lid_friction is None else {"lid": {"frictionloss": self.lid_friction}}
        return json.dumps(robot | lid)

    def calibration(self, error: float, rng: np.random.Generator) -> Calibration:
        """What is known of it, each constant with this relative error (standard deviation)."""

        def known(true: Array | float) -> Constant:
            off = np.atleast_1d(true) * (1.0 + error * rng.standard_normal(np.size(true)))
            value = tuple(map(float, off))
            return Constant(value, value, value, (False,) * len(value))

        kp, kd = self.kp_scale * CONTACT_SERVO.kp, self.kd_scale * CONTACT_SERVO.kd
        servo = ServoCalibration(
            kp=known(kp),
            kd=known(kd),
            frictionloss=known(self.frictionloss),
            armature=known(CONTACT_SERVO.armature),
            kd_over_kp=known(kd / kp),
            frictionloss_over_kp=known(self.frictionloss / kp),
            delay_ms=known(self.delay_ms),
        )
        return Calibration("2026-01-01T00:00:00Z", "benchmark", servo)


def successes(policy: Policy, args: argparse.Namespace, options: dict[str, Any]) -> int:
    """Of `--episodes` in the batched simulation."""
    task = policy.layout.task
    options = task_options(task, policy.layout, ()) | options
    env = make_env(task, 0, args.episodes, args.threads, args.seed, options)
    return int(run_episodes(policy, env, args.episodes, args.seed).success.sum())


def one_robot(policy: Policy, args: argparse.Namespace, number: int) -> dict[str, Any]:
    rng = np.random.default_rng([args.seed, number])
    robot = UnknownRobot.draw(rng, args.lid)
    varied = {"variation": robot.variation()}
    before = successes(policy, args, varied)
    with tempfile.TemporaryDirectory() as folder:
        file = write_calibration(
            Path(folder) / "calibration.yaml", robot.calibration(args.error, rng)
        )
        known = calibration_option(policy.layout.task, file)
        after = successes(policy, args, varied | known)
    progress(f"robot {number}: {before} before, {after} after, of {args.episodes}")
    return {
        "robot": json.loads(robot.variation()),
        "successes_before": before,
        "successes_after": after,
    }


def summary(args: argparse.Namespace, rows: list[dict[str, Any]]) -> dict[str, float]:
    episodes = len(rows) * args.episodes
    return {
        f"success_rate_{when}": sum(row[f"successes_{when}"] for row in rows) / episodes
        for when in ("before", "after")
    }


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--policy", default="open_press_close")
    parser.add_argument("--robots", type=int, default=8)
    parser.add_argument("--episodes", type=int, default=20, help="of each robot")
    parser.add_argument("--error", type=float, default=0.015, help="of a calibration's constants")
    parser.add_argument("--lid", type=float, nargs=2, help="friction of the lid from, to, N m")
    parser.add_argument("--threads", type=int, default=0, help="0 for all cores")
    args = parser.parse_args()
    policy = load_policy_from(Path(args.policy), "latest")
    rows = [one_robot(policy, args, number) for number in range(args.robots)]
    document = write_result(
        "calibrated_robots",
        {"summary": summary(args, rows), "each": rows},
        args.out,
        seed=args.seed,
        config={
            key: getattr(args, key) for key in ("policy", "robots", "episodes", "error", "lid")
        },
    )
    print_result(document, as_json=args.json)


if __name__ == "__main__":
    main()
