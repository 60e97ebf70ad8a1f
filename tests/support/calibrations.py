"""Calibrations to write, and a simulated robot to identify."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from skewmi.calibration.calibration_file import (
    Calibration,
    Constant,
    RecordingReference,
    SceneCalibration,
    ServoCalibration,
)
from skewmi.calibration.servo_recording import ServoRecording
from skewmi.deploy.robot.backends.mujoco.simulation import ArmSimulation
from skewmi.robot_models.servo import ServoParameters
from skewmi.trajectory import CYCLE_TICKS, GRID_S, Array, JointTrajectory


@dataclass(frozen=True)
class UnknownToModel:
    """What a robot has and the servo model has not."""

    mass_scale: float = 1.0
    """Of the arm's masses and inertias."""
    stiction_scale: float = 1.0
    """Friction at rest, of that of a fast joint."""
    stribeck_velocity: float = 0.1
    """rad/s at which that has mostly gone."""
    joint_offset: tuple[float, ...] = (0.0,) * 7
    """Measured less true angles, rad."""


@dataclass(frozen=True)
class DrawnRobot:
    """A robot of the documented ranges: factors on stiffness and damping, friction, delay."""

    kp_scale: Array
    kd_scale: Array
    frictionloss: Array
    """N m."""
    delay_ms: float

    @staticmethod
    def draw(rng: np.random.Generator) -> DrawnRobot:
        """Servos of 0.4 to 1.6, friction of 0 to 2 N m, a delay of 0 to 40 ms."""
        return DrawnRobot(
            rng.uniform(0.4, 1.6, 7),
            rng.uniform(0.4, 1.6, 7),
            rng.uniform(0.0, 2.0, 7),
            float(rng.uniform(0.0, 40.0)),
        )

    def parameters(self, nominal: ServoParameters) -> ServoParameters:
        """Its servos."""
        return nominal.with_changes(
            kp=self.kp_scale * nominal.kp,
            kd=self.kd_scale * nominal.kd,
            frictionloss=self.frictionloss,
        )

    def variation(
        self, joint_noise: float, seed: int, unknown: UnknownToModel | None = None
    ) -> dict[str, Any]:
        """The content of a variation file; arguments as in `record`."""
        unknown = UnknownToModel() if unknown is None else unknown
        return {
            "seed": seed,
            "servo": {
                "kp_scale": self.kp_scale.tolist(),
                "kd_scale": self.kd_scale.tolist(),
                "frictionloss": self.frictionloss.tolist(),
                "delay_ms": self.delay_ms,
                "stiction_scale": unknown.stiction_scale,
                "stribeck_velocity": unknown.stribeck_velocity,
            },
            "arm": {"mass_scale": unknown.mass_scale},
            "sensors": {"joint_noise": joint_noise, "joint_offset": list(unknown.joint_offset)},
        }

    def record(
        self,
        motion: JointTrajectory,
        joint_noise: float,
        seed: int,
        unknown: UnknownToModel | None = None,
    ) -> ServoRecording:
        """What it measures every 20 ms while it follows a motion.

        Args:
            motion: Commanded.
            joint_noise: Standard deviation of a reading, rad.
            seed: Of the noise.
            unknown: What else it has; nothing by default.
        """
        variation = self.variation(joint_noise, seed, unknown)
        simulation = ArmSimulation(None, motion.q[0], json.dumps(variation))
        times, positions, efforts = [], [], []
        for tick in range(len(motion)):
            if tick % CYCLE_TICKS == 0:
                times.append(tick * GRID_S)
                state = simulation.robot_state(0)
                positions.append(state.position[:7].copy())
                efforts.append(state.effort[:7].copy())
            simulation.command = motion.point(tick)
            simulation.step()
        contact = simulation.contact.summary()
        assert contact["arm_force_peak_n"] == contact["hand_force_peak_n"] == 0.0, contact
        return ServoRecording(motion, np.array(times), np.array(positions), np.array(efforts))


def known_servo(
    servo: ServoParameters, delay_ms: float, error: float, rng: np.random.Generator
) -> ServoCalibration:
    """A calibration of servos that is wrong by up to a part of each constant, either way."""

    def constant(values: Array) -> Constant:
        off = values * (1.0 + error * rng.choice((-1.0, 1.0), len(values)))
        low, high = off * (1.0 - 2.0 * error), off * (1.0 + 2.0 * error)
        return Constant(*(tuple(row.tolist()) for row in (off, low, high)), (False,) * len(values))

    kp, kd, friction = (constant(getattr(servo, n)) for n in ("kp", "kd", "frictionloss"))
    ratios = [constant(np.array(part.value) / np.array(kp.value)) for part in (kd, friction)]
    armature = Constant(*(tuple(servo.armature.tolist()),) * 3, (True,) * 7)
    return ServoCalibration(kp, kd, friction, armature, *ratios, constant(np.array([delay_ms])))


def full_calibration() -> Calibration:
    """One with every section and numbers that YAML must not round."""
    rng = np.random.default_rng(5)

    def constant(size: int) -> Constant:
        low, value, high = np.sort(rng.uniform(0.1, 3.0, (3, size)), axis=0)
        flags = tuple(bool(flag) for flag in rng.integers(0, 2, size))
        return Constant(tuple(value.tolist()), tuple(low.tolist()), tuple(high.tolist()), flags)

    return Calibration(
        created="2026-01-02T03:04:05Z",
        version="1.2.3",
        servo=ServoCalibration(
            *(constant(7) for _ in range(6)), constant(1), constant(7), constant(7)
        ),
        scene=SceneCalibration(
            *(constant(1) for _ in range(4)),
            covariance=((1e-8, 2e-9, 0.0), (2e-9, 3e-8, 1e-7), (0.0, 1e-7, 4e-4)),
        ),
        recordings=(RecordingReference("excite: 1.mcap", "0123456789abcdef" * 4),),
        checks={"residual_rms_rad": 1.0 / 3.0},
        warnings=("kp of yumi_joint_6_r is not identified: 3 to 400 N m/rad",),
    )
