"""The state of the arm, out of the joint states that a robot server publishes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skewmi.deploy.wire.channels import Sample
from skewmi.deploy.wire.messages import decode_joint_states
from skewmi.errors import TransportError
from skewmi.policy_io import Array


@dataclass(frozen=True)
class ArmState:
    """One joint state message, taken apart.

    Attributes:
        stamp_ns: The robot server's clock when it was measured.
        received_ns: Our monotonic clock when it arrived.
        q: Measured arm joints, chain order, rad. Shape (7,).
        v: Measured velocities, rad/s. Shape (7,).
        gripper: Measured travel of each finger from closed, m.
    """

    stamp_ns: int
    received_ns: int
    q: Array
    v: Array
    gripper: float


class ArmStateDecoder:
    """Finds the arm and its gripper in joint states.

    Args:
        joint_names: The arm's joints in chain order.
        finger_name: The joint whose position is the gripper's opening.
    """

    def __init__(self, joint_names: tuple[str, ...], finger_name: str) -> None:
        self._joint_names = joint_names
        self._finger_name = finger_name
        self._order: tuple[tuple[str, ...], list[int], int] | None = None

    def decode(self, sample: Sample) -> ArmState:
        """Take a message apart.

        Raises:
            TransportError: It is malformed, or lacks a joint.
        """
        message = decode_joint_states(sample.payload)
        _, order, finger = self._indices(message.names)
        if not np.isfinite(message.position).all():
            raise TransportError("joint states hold positions that are not finite")
        velocity = message.velocity if len(message.velocity) else np.zeros(len(message.position))
        return ArmState(
            message.stamp_ns,
            sample.received_ns,
            message.position[order],
            velocity[order],
            float(message.position[finger]),
        )

    def _indices(self, names: tuple[str, ...]) -> tuple[tuple[str, ...], list[int], int]:
        """Where arm and finger are in a message with these names."""
        if self._order is None or self._order[0] != names:
            missing = [n for n in (*self._joint_names, self._finger_name) if n not in names]
            if missing:
                raise TransportError(f"joint states lack {missing}")
            order = [names.index(name) for name in self._joint_names]
            self._order = (names, order, names.index(self._finger_name))
        return self._order
