"""How stiff an arm's hand is, from the stiffness of its servos, beside the arm of training.

A force f on the hand of an arm with servo stiffness K moves it by C f, with the compliance
C = J K^-1 J^T. What moves the hand of a known arm by e would move that of training, with compliance
C0, by C0 C^-1 e: that is what a following error is worth as a force. Numpy only.
"""

from __future__ import annotations

import numpy as np

from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.robot_models.servo import CONTACT_SERVO
from skewmi.robot_models.yumi import Array


def hand_stiffness(kp: Array, configuration: Array, training_kp: Array = CONTACT_SERVO.kp) -> Array:
    """The right hand's stiffness relative to training's, in no direction more than that.

    Directions in which the hand is stiffer than in training count as equal: the policy has not met
    bounds that are tighter than training's.

    Args:
        kp: Servo stiffness of the known arm, N m/rad. Shape (7,).
        configuration: At which, rad. Shape (7,).
        training_kp: Servo stiffness in training, N m/rad. Shape (7,).

    Returns:
        The matrix M of e0 = M e, axes of the robot base frame. Shape (3, 3).
    """
    jacobian = ArmKinematics("right").jacobian(np.asarray(configuration))[:3]
    compliance = (jacobian / kp) @ jacobian.T
    trained = (jacobian / training_kp) @ jacobian.T
    size, axes = np.linalg.eigh(trained)
    root, inverse_root = (axes * np.sqrt(size)) @ axes.T, (axes / np.sqrt(size)) @ axes.T
    # Symmetric, so that its eigenvalues are the ratios of stiffness along three directions.
    ratio, directions = np.linalg.eigh(root @ np.linalg.inv(compliance) @ root)
    matrix: Array = root @ (directions * np.minimum(ratio, 1.0)) @ directions.T @ inverse_root
    return matrix
