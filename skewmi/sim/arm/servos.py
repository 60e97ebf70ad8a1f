"""Servos of the arm for work in contact."""

from __future__ import annotations

import numpy as np

from skewmi.robot_models import servo

_KP = np.array([300.0, 300.0, 200.0, 200.0, 600.0, 600.0, 300.0])
CONTACT_SERVO = servo.DEFAULT.with_changes(
    kp=_KP,
    kd=servo.critical_damping(_KP, servo.ARMATURE),
    force_limit=np.array([12.5, 12.5, 6.0, 6.0, 6.0, 6.0, 6.0]),
)
"""A soft arm bounds the force that the following error of the hand can build up, and a wrist that
is stiff and strong for its size keeps the hand upright under it (the joints' own wrist stiffness
is above 450 N m/rad): with the wrist at 100 N m/rad and 2 N m a sideways push of 12 N at the
fingertips overpowered it, and the hand tilted by up to 40 degrees. An estimate like
`servo.DEFAULT`, to be replaced by identified values."""
