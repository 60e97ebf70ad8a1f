"""How an arm behind EGM follows, and how far it runs on: measured on the emulated controller.

Simulated time, no sockets: the arm's program and control law with the simulated servos behind them,
answered in every cycle. Two tables:

* tracking: a straight line of the hand at 100 mm/s, back and forth; joint error of what is measured
  against what is commanded at the same time, RMS over the motion, and the same against what was
  commanded one delay ago;
* run-on: after a steady motion answers end; how far the arm goes beyond the last reference, for one
  joint (deg) and for the flange at the admitted speed (mm).

    python benchmarks/egm_motion.py --json --out results/egm_motion.json
"""

from __future__ import annotations

from dataclasses import asdict, replace
from math import degrees, radians
from typing import Any

import numpy as np
from common import argument_parser, print_result, progress, write_result

from skewmi.deploy.motion.planner import Planner
from skewmi.deploy.robot.backends.egm.options import EgmOptions
from skewmi.deploy.robot.backends.egm.packets import ReferencePacket
from skewmi.deploy.robot.backends.egm.program import ProgramSettings
from skewmi.deploy.robot.backends.mujoco.simulation import ArmSimulation
from skewmi.deploy.robot.egm_emulator.control_law import ControlLaw
from skewmi.deploy.robot.egm_emulator.controller_states import ArmState
from skewmi.deploy.robot.egm_emulator.emulated_arm import ArmOptions, EmulatedArm
from skewmi.deploy.robot.egm_emulator.plant import ScenePlant
from skewmi.robot_models import limits
from skewmi.sim.arm.scene import workspace_of
from skewmi.trajectory import CYCLE_TICKS, GRID_NS, Array, JointTrajectory

PERIOD_S = 0.004032
SPEED = 0.100
"""Of the hand, m/s."""
LINE = 0.08
"""Length of the straight line along y, m."""
ABB = ProgramSettings(gain=5.0, comm_timeout_s=1.0, ramp_in_s=0.5, ramp_out_s=0.5)
CHOICES = {
    "abb": ABB,
    "k5_short": replace(ABB, comm_timeout_s=0.1, ramp_out_s=0.1),
    "k10": ProgramSettings(gain=10.0),
    "rapid": ProgramSettings(),
    "k20_50ms": ProgramSettings(comm_timeout_s=0.05, ramp_out_s=0.05),
}
"""What was compared; `rapid` is what `rapid/` sets."""


def planned_line(simulation: ArmSimulation) -> JointTrajectory:
    """Back and forth in the task's box, as the deployed planner does it, on the grid."""
    workspace = workspace_of(simulation.layout)
    planner = Planner(workspace, limits.profile("lab"))
    planner.reset(np.array(workspace.start_configuration))
    start = np.array(workspace.start)
    parts = []
    cycles = round(LINE / SPEED / 0.02)
    for leg in (1, -1, 1, -1):
        for cycle in range(cycles):
            done = (cycle + 1) / cycles
            part = done if leg > 0 else 1.0 - done
            planner.set_target(start + np.array([0.0, part * LINE, 0.02]), 0.02)
            parts.append(planner.step().part(slice(0, CYCLE_TICKS)))
    motion = parts[0]
    for part_of in parts[1:]:
        motion = JointTrajectory.concatenate(motion, part_of)
    return motion


def tracking(
    simulation: ArmSimulation,
    motion: JointTrajectory,
    settings: ProgramSettings,
    lag_s: float,
    feed_forward: float,
) -> dict[str, float]:
    """Joint errors over the line, deg."""
    simulation.reset(seed=0)
    plant = ScenePlant(simulation, PERIOD_S)
    start = motion.q[0]
    arm = EmulatedArm(
        ArmOptions("right", replace(settings, comm_timeout_s=60.0), PERIOD_S, lag_s), start
    )
    arm.start()
    commanded, speeds, measured = [], [], []
    since, number = 0.0, 0
    duration_s = (len(motion) - 1) * GRID_NS / 1e9
    while since < duration_s + 0.5:
        q = plant.position("right")
        reference = None
        if arm.sending:
            arm.packet(q)
            point = motion.at(int(since * 1e9))
            v = point.v if since <= duration_s else np.zeros(7)
            reference = ReferencePacket(number, 0, point.q, feed_forward * v)
            number += 1
            if arm.state is ArmState.GUIDED and arm.sessions and number > 100:
                commanded.append(point.q)
                speeds.append(v)
                measured.append(q.copy())
                since += PERIOD_S
        plant.follow({"right": arm.cycle(reference)})
    return errors(np.array(commanded), np.array(speeds), np.array(measured))


def errors(commanded: Array, speeds: Array, measured: Array) -> dict[str, float]:
    """RMS at the same time, the delay that explains most of it, and RMS with it taken out."""
    behind = commanded - measured
    delay_s = float((behind * speeds).sum() / (speeds**2).sum())
    late = degrees(float(np.sqrt((behind**2).mean())))
    aligned = degrees(float(np.sqrt(((behind - delay_s * speeds) ** 2).mean())))
    return {
        "rms_deg": round(late, 4),
        "delay_ms": round(1e3 * delay_s, 2),
        "rms_without_delay_deg": round(aligned, 4),
    }


def runs_on(settings: ProgramSettings, feed_forward: float, speed_deg: float) -> float:
    """How far a joint goes beyond its last reference once answers end, deg."""
    law = ControlLaw(settings, np.zeros(7), PERIOD_S, 0.020)
    q, v = np.zeros(7), np.zeros(7)
    v[0] = radians(speed_deg)
    for number in range(round(2.0 / PERIOD_S)):
        q = q + v * PERIOD_S
        law.step(ReferencePacket(number, 0, q, feed_forward * v))
    for _ in range(round(settings.comm_timeout_s / PERIOD_S)):
        law.step(None)
    while not law.resting:
        law.brake()
    return degrees(float(law.desired[0] - q[0]))


def measure() -> dict[str, Any]:
    """Both tables."""
    simulation = ArmSimulation()
    motion = planned_line(simulation)
    followed: list[dict[str, Any]] = []
    for name, settings in CHOICES.items():
        for lag_ms in (10.0, 20.0):
            for feed_forward in (0.0, 0.8, 1.0):
                progress(f"tracking {name}, lag {lag_ms:g} ms, feed-forward {feed_forward:g}")
                followed.append(
                    {
                        "choice": name,
                        "lag_ms": lag_ms,
                        "feed_forward": feed_forward,
                        **tracking(simulation, motion, settings, lag_ms / 1e3, feed_forward),
                    }
                )
    ran_on = []
    for name, settings in CHOICES.items():
        for feed_forward in (0.0, 0.8, 1.0):
            runs_on_s = settings.runs_on_s(feed_forward)
            admitted = EgmOptions(program=settings, feed_forward=feed_forward).admitted_speed
            ran_on.append(
                {
                    "choice": name,
                    "feed_forward": feed_forward,
                    "deg": {
                        f"{speed} deg/s": round(runs_on(settings, feed_forward, speed), 2)
                        for speed in (10, 28, 60)
                    },
                    "formula_s": round(runs_on_s, 4),
                    "flange_mm_at_100_mm_s": round(100.0 * runs_on_s, 2),
                    "flange_mm_at_250_mm_s": round(250.0 * runs_on_s, 2),
                    "admitted_mm_s_for_10_mm": None
                    if admitted == float("inf")
                    else round(1e3 * admitted),
                }
            )
    return {
        "choices": {name: asdict(settings) for name, settings in CHOICES.items()},
        "tracking_at_100_mm_s": followed,
        "run_on": ran_on,
    }


def main() -> None:
    arguments = argument_parser(__doc__).parse_args()
    config = {"period_s": PERIOD_S, "speed_m_s": SPEED, "line_m": LINE}
    document = write_result("egm_motion", measure(), arguments.out, config=config)
    print_result(document, as_json=arguments.json)


if __name__ == "__main__":
    main()
