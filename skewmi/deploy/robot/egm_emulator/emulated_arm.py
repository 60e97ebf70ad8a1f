"""One arm of the emulated controller: its program, its control law, its packets.

Pure: `cycle` is one cycle of the controller. Which bytes travel when is the business of `wires`,
and what the servos make of the target that of whoever owns the arm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from skewmi.deploy.robot.backends.egm.packets import (
    FeedbackPacket,
    Motors,
    ReferencePacket,
)
from skewmi.deploy.robot.backends.egm.program import ProgramSettings
from skewmi.deploy.robot.egm_emulator.control_law import ControlLaw, Target
from skewmi.deploy.robot.egm_emulator.controller_states import (
    ARM_TABLE,
    SENDING,
    ArmEvent,
    ArmState,
    mci_of,
    rapid_of,
)
from skewmi.deploy.robot.egm_emulator.poses import FlangePoses
from skewmi.deploy.state_machine import StateMachine, Transition
from skewmi.robot_models import yumi
from skewmi.robot_models.yumi import Side
from skewmi.trajectory import Array

PREPARING_S = 0.2
"""MoveAbsJ, EGMGetId, EGMSetupUC and EGMActJoint of an arm that stands at its fine point already;
public programs also wait up to a second between two sessions."""

ACTIVATED_S = 0.05
"""From EGMActJoint, with which packets begin, to EGMRunJoint."""

COMM_ERROR = "41822: no data from the UdpUc device for CommTimeout (ERR_UDPUC_COMM)"
RANGE_ERROR = "External Motion Interface input out of bounds"
SYSTEM_FAILURE = "10014: system failure state"

_ROUNDING = 1e-6
"""rad: degrees on the wire and back."""


@dataclass(frozen=True)
class ArmOptions:
    """How a controller serves an arm.

    Attributes:
        side: Which arm.
        settings: Of its program.
        period_s: Of a cycle.
        lag_s: From the desired position to the servos.
        robotware: 6 or 7.
        start_us: The controller's clock at first, microseconds since 1970.
        tells_utilization: RobotWare before 6.10 does not.
        tells_time: RobotWare before 6.07.01 does not.
        rapid_undefined: A restarted IRC5 says UNDEFINED although its program runs.
    """

    side: Side
    settings: ProgramSettings = field(default_factory=ProgramSettings)
    period_s: float = 0.004032
    lag_s: float = 0.020
    robotware: int = 6
    start_us: int = 1_700_000_000_000_000
    tells_utilization: bool = True
    tells_time: bool = True
    rapid_undefined: bool = False


class EmulatedArm:
    """An arm of the controller.

    Args:
        options: How it is served.
        q: Where the arm is, rad. Shape (7,).
        on_transition: Called after every change of its program's state.
    """

    def __init__(
        self,
        options: ArmOptions,
        q: Array,
        on_transition: Callable[[Transition[ArmState]], None] | None = None,
    ) -> None:
        self.options = options
        self.machine = StateMachine(ARM_TABLE, on_transition)
        self.motors_on = True
        self.errors: list[str] = []
        """The event log, newest last."""
        self.sessions = 0
        self._law = ControlLaw(options.settings, q, options.period_s, options.lag_s)
        self._poses = FlangePoses(options.side)
        self._cycles = 0
        self._state_since = 0
        self._sequence = 0
        self._silent_cycles = 0
        self._target = Target(np.array(q, dtype=np.float64), np.zeros(7))

    @property
    def state(self) -> ArmState:
        return self.machine.state

    @property
    def sending(self) -> bool:
        return self.state in SENDING

    @property
    def desired(self) -> Array:
        """Where the controller wants the joints to be, rad. Shape (7,)."""
        return self._law.desired

    def start(self) -> None:
        """PP to Main and Start; nothing without motors."""
        if self.motors_on:
            self._fire(ArmEvent.START, "started")

    def stop(self) -> None:
        """Stop the program."""
        self._fire(ArmEvent.STOP, "stopped")

    def switch_motors(self, *, on: bool) -> None:
        """Motors on or off; off stops the program, too, which has to be started again."""
        if self.motors_on and not on:
            final = self.options.settings.do_not_restart_after_motors_off
            self._fire(ArmEvent.MOTORS_OFF_FINAL if final else ArmEvent.MOTORS_OFF, "motors off")
        self.motors_on = on

    def restart_controller(self, q: Array) -> None:
        """Switch it off and on again, with the arm at `q`, shape (7,), rad."""
        self._fire(ArmEvent.RESTART, "restarted")
        self.place(q)

    def place(self, q: Array) -> None:
        """The arm has been moved to `q`, shape (7,), rad, by hand or by a reset of the scene."""
        self._law.rest_at(q)
        self._target = Target(np.array(q, dtype=np.float64), np.zeros(7))

    def packet(self, q: Array) -> FeedbackPacket:
        """What the controller tells in this cycle; call it once a cycle, and only if `sending`.

        Args:
            q: Measured, rad. Shape (7,).
        """
        options = self.options
        clock_us = options.start_us + round(self._cycles * options.period_s * 1e6)
        rapid = rapid_of(self.state)
        flange, planned_flange = self._poses.of(q, self._law.desired)
        packet = FeedbackPacket(
            sequence=self._sequence,
            q=q,
            motors=Motors.ON if self.motors_on else Motors.OFF,
            mci=mci_of(self.state),
            rapid=type(rapid).UNDEFINED if options.rapid_undefined else rapid,
            clock_us=clock_us if options.tells_time else None,
            time_ms=(clock_us // 1000) % (1 << 32),
            planned_q=self._law.desired.copy(),
            converged=self._converged,
            utilization=self._law.utilization if options.tells_utilization else None,
            flange=flange,
            planned_flange=planned_flange,
            robotware=options.robotware,
            move_index=self.sessions if options.robotware >= 7 else None,
        )
        self._sequence += 1
        return packet

    def cycle(self, reference: ReferencePacket | None) -> Target:
        """Let one cycle pass.

        Args:
            reference: The one message that was read in it, if there was one.

        Returns:
            What the servos follow.
        """
        self._cycles += 1
        if reference is not None and not self._check(reference):
            reference = None
        if self.state is ArmState.GUIDED:
            self._silent_cycles = 0 if reference is not None else self._silent_cycles + 1
            self._target = self._law.step(reference)
            self._end_if_due()
        elif self.motors_on and self.state is not ArmState.DOWN:
            self._target = self._law.brake()
        else:
            # Brakes: what was on its way to the servos does not get there.
            self._law.rest_at(self._target.q)
            self._target = Target(self._target.q, np.zeros(7))
        self._go_on()
        return self._target

    def _check(self, reference: ReferencePacket) -> bool:
        """Whether a message can be followed; what cannot be ends the session, or the controller."""
        if self.state is not ArmState.GUIDED:
            return True
        values = reference.q if reference.v is None else np.append(reference.q, reference.v)
        if not np.isfinite(values).all():
            self._fire(ArmEvent.NOT_FINITE, SYSTEM_FAILURE)
            return False
        low, high = yumi.POSITION_LOWER - _ROUNDING, yumi.POSITION_UPPER + _ROUNDING
        if not ((low <= reference.q) & (reference.q <= high)).all():
            self._fire(ArmEvent.OUT_OF_RANGE, RANGE_ERROR)
            return False
        return True

    @property
    def _converged(self) -> bool:
        """Met once the joints are within the limits; the session ends after CondTime of it."""
        return self._law.within_s > 0.0

    def _end_if_due(self) -> None:
        settings = self.options.settings
        if self._silent_cycles * self.options.period_s >= settings.comm_timeout_s:
            self._fire(ArmEvent.COMM_TIMEOUT, COMM_ERROR)
        elif self._law.within_s > settings.cond_time_s:
            self._fire(ArmEvent.CONVERGED, f"within limits for {settings.cond_time_s:g} s")

    def _go_on(self) -> None:
        """The steps of the program that only take their time."""
        elapsed_s = (self._cycles - self._state_since) * self.options.period_s
        if self.state is ArmState.PREPARING and self._law.resting and elapsed_s >= PREPARING_S:
            self._sequence = 0
            self._fire(ArmEvent.READY, "at a fine point")
        elif self.state is ArmState.ACTIVATED and elapsed_s >= ACTIVATED_S:
            self._law.start()
            self._silent_cycles = 0
            self.sessions += 1
            self._fire(ArmEvent.RUN, f"session {self.sessions}")
        elif self.state is ArmState.ENDING and self._law.resting:
            self._fire(ArmEvent.AT_REST, "at rest")

    def _fire(self, event: ArmEvent, reason: str) -> None:
        if self.machine.fire(event, reason, round(self._cycles * self.options.period_s * 1e9)):
            self._state_since = self._cycles
            if reason in (COMM_ERROR, RANGE_ERROR, SYSTEM_FAILURE):
                self.errors.append(reason)
