"""Arms behind EGM that are asked for motions without a network: the emulator itself, in no time."""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np

from skewmi.calibration.egm_law import EgmLaw
from skewmi.calibration.egm_model import EgmRecording
from skewmi.deploy.robot.backends.egm.packets import ReferencePacket
from skewmi.deploy.robot.backends.egm.program import ProgramSettings
from skewmi.deploy.robot.backends.mujoco.simulation import ArmSimulation
from skewmi.deploy.robot.egm_emulator.controller_states import ArmState
from skewmi.deploy.robot.egm_emulator.emulated_arm import ArmOptions, EmulatedArm
from skewmi.deploy.robot.egm_emulator.plant import ScenePlant
from skewmi.trajectory import GRID_S, Array, JointTrajectory

PERIOD_S = 0.004032


@dataclass(frozen=True)
class DrawnEgm:
    """A controller's settings.

    Attributes:
        law: Of its program.
        lag_ms: From its desired position to the servos.
        speed_share: Part of the plan's speed that it is sent.
    """

    law: EgmLaw
    lag_ms: float
    speed_share: float = 1.0

    @staticmethod
    def draw(rng: np.random.Generator) -> DrawnEgm:
        """Any law of the manual's ranges that an arm can be moved with, and lags of 0 to 30 ms."""
        law = EgmLaw(float(rng.uniform(2.0, 20.0)), float(np.exp(rng.uniform(*np.log((4, 40))))))
        return DrawnEgm(law, float(rng.uniform(0.0, 30.0)))

    @property
    def delay_s(self) -> float:
        """What identification finds: the lag, and the cycle in which a reference is read."""
        return self.lag_ms / 1e3 + PERIOD_S

    def record(
        self,
        motion: JointTrajectory,
        joint_noise: float = 0.0,
        seed: int = 0,
        variation: dict[str, object] | None = None,
    ) -> EgmRecording:
        """What it measures in each of its cycles while it is asked for a motion.

        Args:
            motion: Asked for, at its own times.
            joint_noise: Standard deviation of a reading, rad.
            seed: Of the noise.
            variation: Of the arm, as in a variation file.
        """
        settings = ProgramSettings(
            gain=self.law.gain,
            low_pass_hz=self.law.low_pass_hz,
            ramp_in_s=0.005,
            max_speed_deviation_deg_s=180.0,
        )
        text = None if variation is None else json.dumps(variation)
        simulation = ArmSimulation(None, motion.q[0], text)
        plant = ScenePlant(simulation, PERIOD_S)
        arm = EmulatedArm(ArmOptions("right", settings, PERIOD_S, self.lag_ms / 1e3), motion.q[0])
        arm.start()
        rest = ReferencePacket(0, 0, motion.q[0], np.zeros(7))
        waiting: ReferencePacket | None = None
        for _ in range(200):
            plant.follow({"right": arm.cycle(rest if arm.sending else None)})
        assert arm.state is ArmState.GUIDED
        duration_s = (len(motion) - 1) * GRID_S
        times: Array = np.arange(0.0, duration_s, PERIOD_S)
        points = [motion.at(round(1e9 * t)) for t in times]
        positions = []
        for number, point in enumerate(points):
            # As in `EmulatedController.cycle`: read, tell, move; the answer is read a cycle later.
            reference, positions_now = waiting, plant.position("right").copy()
            positions.append(positions_now)
            waiting = ReferencePacket(number, 0, point.q, self.speed_share * point.v)
            plant.follow({"right": arm.cycle(reference)})
        assert arm.state is ArmState.GUIDED
        noise = np.random.default_rng(seed).normal(0.0, joint_noise, (len(times), 7))
        asked = JointTrajectory(*(np.array([getattr(p, n) for p in points]) for n in "qva"))
        return EgmRecording.of_cycles(
            asked, np.arange(len(times)), np.array(positions) + noise, PERIOD_S, self.speed_share
        )
