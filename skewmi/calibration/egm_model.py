"""An arm behind EGM, as identification simulates it: the controller's law, a lag, then servos.

Times are counted in cycles of the controller, each taken for one step of 4 ms: a controller whose
cycles take T is the same as one with cycles of 4 ms whose law is faster by T / 4 ms, and so on for
every constant with a time in it. `EgmArm.slower` converts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skewmi.calibration.egm_law import EgmLaw, desired_motions
from skewmi.calibration.servo_model import (
    DelayedServo,
    ServoModel,
    between_states,
    late_targets,
)
from skewmi.calibration.servo_recording import ServoRecording
from skewmi.errors import ConfigurationError
from skewmi.robot_models.yumi import Array
from skewmi.trajectory import GRID_S, JointTrajectory

SHORTEST_PERIOD_S, LONGEST_PERIOD_S = 0.001, 0.05
"""Cycles of controllers."""
SAME_PERIOD = 1e-3
"""Relative difference of two recordings' cycles that is of no account."""


@dataclass(frozen=True)
class EgmArm:
    """A candidate.

    Attributes:
        law: Of the controller.
        servo: Behind it. Its delay is the lag: from when a reference is for until what the law
            makes of it is the servos' target, network and reading included.
    """

    law: EgmLaw
    servo: DelayedServo

    def slower(self, factor: float) -> EgmArm:
        """The arm whose time passes more slowly by a factor: it takes that much longer for all."""
        own = self.servo.parameters
        return EgmArm(
            EgmLaw(self.law.gain / factor, self.law.low_pass_hz / factor),
            DelayedServo(
                own.with_changes(
                    kp=own.kp / factor**2,
                    kd=own.kd / factor,
                    frictionloss=own.frictionloss / factor**2,
                    force_limit=own.force_limit / factor**2,
                ),
                factor * self.servo.delay_s,
            ),
        )


@dataclass(frozen=True, eq=False)
class EgmRecording:
    """A motion that a controller was asked for through EGM.

    Attributes:
        motion: One sample of 4 ms for each cycle: references and measured positions. Its
            velocities are per 4 ms of cycles.
        period_s: That a cycle really takes.
        speed_share: Part of the reference's speed that was sent as speed reference, 0..1.

    Raises:
        ConfigurationError: A value makes no sense.
    """

    motion: ServoRecording
    period_s: float
    speed_share: float

    def __post_init__(self) -> None:
        if not SHORTEST_PERIOD_S <= self.period_s <= LONGEST_PERIOD_S:
            raise ConfigurationError(
                f"cycles of {1e3 * self.period_s:.3f} ms; a controller's take "
                f"{1e3 * SHORTEST_PERIOD_S:g} to {1e3 * LONGEST_PERIOD_S:g} ms"
            )
        if not 0.0 <= self.speed_share <= 1.0:
            raise ConfigurationError(
                f"the share of the speed that was sent is {self.speed_share}; it must be in 0..1"
            )

    @staticmethod
    def of_cycles(
        references: JointTrajectory,
        cycles: NDArray[np.int64],
        positions: Array,
        period_s: float,
        speed_share: float,
    ) -> EgmRecording:
        """From what happened in each cycle.

        Args:
            references: Of every cycle, rad, rad/s, rad/s^2: n samples, `period_s` apart.
            cycles: In which positions were measured, counted from the first, rising. Shape (m,).
            positions: Measured, rad. Shape (m, 7).
            period_s: Of a cycle.
            speed_share: See the class.
        """
        stretch = period_s / GRID_S
        commands = JointTrajectory(references.q, stretch * references.v, stretch**2 * references.a)
        motion = ServoRecording(commands, GRID_S * np.asarray(cycles, dtype=np.float64), positions)
        return EgmRecording(motion, period_s, speed_share)

    @property
    def stretch(self) -> float:
        """A cycle by 4 ms."""
        return self.period_s / GRID_S


class EgmModel:
    """Simulates arms behind EGM, in cycles.

    Args:
        servos: Simulates what is behind the law.
        speed_share: Part of the reference's speed that is sent as speed reference.
    """

    def __init__(self, servos: ServoModel, speed_share: float) -> None:
        self.servos = servos
        self.speed_share = speed_share

    def positions(self, candidates: Sequence[EgmArm], recording: ServoRecording) -> Array:
        """Where each candidate is when positions were measured.

        Args:
            candidates: c of them, in times of cycles.
            recording: One sample for each cycle.

        Returns:
            rad. Shape (c, m, 7).

        Raises:
            SimulationError: A candidate's states are not finite.
        """
        commands = recording.commands
        # Candidates often differ in their servos alone.
        laws = list(dict.fromkeys(candidate.law for candidate in candidates))
        desired, speeds = desired_motions(laws, commands.q, self.speed_share * commands.v, GRID_S)
        wanted = desired + self.servos.velocity_lead * speeds
        targets = np.array(
            [late_targets(wanted[laws.index(c.law)], c.servo.delay_s) for c in candidates]
        )
        # An arm that rests gets what it rests at; friction may hold it off that.
        q, v = self.servos.driven(
            [c.servo.parameters for c in candidates], targets, recording.start
        )
        return between_states(q, v, recording.times_s)
