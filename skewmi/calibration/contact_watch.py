"""When a creeping finger touches: the measured arm stays behind where its servos would take it.

The servo model says where the joints would be in free space under the commands really sent, delay
and friction included. Seen at the finger tip along the way,

    d = n . J (q_predicted - q_measured)

is small and changes slowly in free space, for what the model has wrong (friction, mostly) is the
same for as long as the joints turn the same way. In contact the finger stands still, and d grows
as fast as the finger was to creep. So a touch is d more than `THRESHOLD` above its median over a
while before.

What this growth presses with: the servos are springs, C = sum_j J_j J_j^T / kp_j. A finger that can
slip along the face yields by n C n per newton, one that sticks to it by 1 / (n C^-1 n), and less
if friction holds a joint, so that it is no spring. Which of these it is cannot be told from
positions; the force is told for the stiffest: an upper estimate.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from skewmi.calibration.egm_prediction import EgmPrediction
from skewmi.calibration.finger_contact import TIP
from skewmi.calibration.servo_prediction import ServoPrediction
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.robot_models.yumi import Array
from skewmi.trajectory import JointTrajectory

THRESHOLD = 0.4e-3
"""Growth of the deviation that is a touch, m: noise of 1e-4 rad in each joint is 0.1 mm."""
FREE_WAY = 0.008
"""Of the finger from where it rested, on which nothing can be in its way, m: joints that friction
held come loose meanwhile, which a model with a wrong friction takes for contact. No contact is
noticed and no force told there: a motion may begin only where so much way is known to be free."""
_SETTLED, _BEFORE = 10, 25
"""The median is over states that are between so many and so many 20 ms old."""
_MOVING = 2
"""States in a row that have to say so."""


def tip_jacobian(arm: ArmKinematics, q: Array) -> Array:
    """Velocity of the finger tips' middle by joint velocities, base frame, m/rad. Shape (3, 7)."""
    jacobian = arm.jacobian(q)
    lever = TIP * arm.forward(q)[1][:, 2]
    tip: Array = jacobian[:3] + np.cross(jacobian[3:], lever, axisa=0, axisc=0)
    return tip


def stiffest(direction: Array, jacobian: Array, stiffness: Array) -> float:
    """How stiff the finger tips can be along a direction, N/m: stuck sideways, or a joint held.

    Args:
        direction: Unit vector. Shape (3,).
        jacobian: Of the tips. Shape (3, 7).
        stiffness: Of the joints, N m/rad. Shape (7,).
    """
    compliance = (jacobian / stiffness) @ jacobian.T
    sticking = float(direction @ np.linalg.solve(compliance, direction))
    parts = (direction @ jacobian) ** 2 / stiffness
    return max(sticking, 1.0 / float(parts.sum() - parts.max()))


class ContactWatch:
    """Watches one guarded motion after the other.

    Args:
        prediction: Of the arm in free space.
        threshold: See `THRESHOLD`, m.

    Attributes:
        touched: Whether the motion has met something.
        force: What it presses with now at most, along its way, N; never negative.
        deviation: By how much the finger stays behind, m.
    """

    def __init__(
        self, prediction: ServoPrediction | EgmPrediction, threshold: float = THRESHOLD
    ) -> None:
        self._prediction = prediction
        self._threshold = threshold
        self._stiffness = prediction.servo.parameters.kp
        self._arm = ArmKinematics("right")
        self.touched, self.force, self.deviation = False, 0.0, 0.0

    def begin(self, q: Array, commanded: Array, direction: Array) -> None:
        """A motion begins from rest, where `FREE_WAY` ahead is free; what was learned is forgotten.

        Args:
            q: Where the arm rests, measured, rad. Shape (7,).
            commanded: Where it is told to rest, rad. Shape (7,).
            direction: Of the finger's way, unit vector in the base frame. Shape (3,).
        """
        self._prediction.begin(q, commanded)
        self._direction = np.array(direction)
        self._from = np.array(commanded)
        self._past: deque[float] = deque(maxlen=_BEFORE)
        self._normal = 0.0
        self._in_a_row = 0
        self.touched, self.force, self.deviation = False, 0.0, 0.0

    def look(self, commands: JointTrajectory, q: Array) -> None:
        """A state has come.

        Args:
            commands: What was commanded in each 4 ms since the last one.
            q: Measured, rad. Shape (7,).
        """
        predicted = self._prediction.step(commands)
        jacobian = tip_jacobian(self._arm, q)
        row = self._direction @ jacobian
        self.deviation = float(row @ (predicted - q))
        # Without a command it is not known how far the way has led: not "nowhere", where contact
        # would become what is usual.
        if not self.touched and len(commands):
            self._judge(float(row @ (commands.q[-1] - self._from)))
        excess = max(self.deviation - self._normal, 0.0)
        self.force = excess * stiffest(self._direction, jacobian, self._stiffness)

    def _judge(self, way: float) -> None:
        self._past.append(self.deviation)
        if way < FREE_WAY:
            self._past.clear()
            self._normal = self.deviation
            return
        past = list(self._past)
        # What may be contact already is no part of the comparison.
        self._normal = float(np.median(past[:-_SETTLED] if len(past) > _SETTLED else past[:1]))
        behind = self.deviation - self._normal > self._threshold
        self._in_a_row = self._in_a_row + 1 if behind else 0
        self.touched = self._in_a_row >= _MOVING
