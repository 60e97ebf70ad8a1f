"""The left arm: held where it is, and compared with where the collision check takes it to be."""

from __future__ import annotations

from math import degrees

import numpy as np

from skewmi.deploy.robot.backends.egm.channel import ArmChannel
from skewmi.deploy.robot.backends.egm.motion import SpeedEstimate
from skewmi.deploy.robot.backends.egm.options import LEFT_ARM_TOLERANCE
from skewmi.deploy.robot.backends.egm.states import EgmState
from skewmi.robot_models import yumi
from skewmi.trajectory import Array

PARKED: Array = np.array(yumi.HOME["left"])
"""Where `deploy.safety.guard` has it, rad. Shape (7,)."""


class LeftArm:
    """Answers the left arm's packets so that its session lives, and watches where it stands.

    Args:
        channel: Of the left arm.
    """

    def __init__(self, channel: ArmChannel) -> None:
        self.channel = channel
        self.velocity: Array = np.zeros(7)
        """How fast it moves, rad/s. Shape (7,)."""
        self._speed = SpeedEstimate()

    @property
    def position(self) -> Array | None:
        """Where it was last seen, rad; None if it never was. Shape (7,)."""
        packet = self.channel.watch.packet
        return None if packet is None else packet.q

    def serve(self) -> None:
        """Answer what has come."""
        taken = self.channel.take()
        if taken is None:
            if self._lost is not None:
                self.velocity = np.zeros(7)
            return
        self.channel.hold()
        if taken.begins:
            self._speed.forget()
        self.velocity = self._speed.add(self.channel.watch.clock.time_ns, taken.packet.q)

    @property
    def _lost(self) -> str | None:
        """Why it may be elsewhere than where it was last seen; None if it may not."""
        watch = self.channel.watch
        silent = watch.packet is not None and watch.state in (EgmState.SILENT, EgmState.REFUSED)
        return watch.readiness() if silent else None

    def misplaced(self) -> str | None:
        """Why the collision check cannot be trusted; None if it can, or nothing is known."""
        q, lost = self.position, self._lost
        if q is None:
            return None
        if lost is not None:
            return (
                f"the left arm is not heard of any more ({lost}), and the collision check takes it "
                "to be at home: start its program again, or, with the arm at home, this robot "
                "server with --egm-listen-left none"
            )
        off = np.abs(q - PARKED)
        worst = int(np.argmax(off))
        if off[worst] <= LEFT_ARM_TOLERANCE:
            return None
        return (
            f"the left arm's axis {yumi.ABB_AXES[worst]} is {degrees(float(off[worst])):.1f} deg "
            f"away from home, where the collision check takes it to be; at most "
            f"{degrees(LEFT_ARM_TOLERANCE):g} deg are allowed: move the arm there"
        )

    @property
    def summary(self) -> str:
        """For the status."""
        if self.position is None:
            return "never heard of; taken to be at home"
        state = self.channel.watch.state.value
        return f"{state}; {self.misplaced() or 'at home'}"
