"""Whether a session and its robot server know the same of the robot, and what follows from it."""

from __future__ import annotations

from dataclasses import dataclass

from skewmi.box_frame import box_displacement
from skewmi.calibration.calibration_file import Calibration
from skewmi.calibration.calibration_use import (
    fingerprint,
    known_delay_s,
    require_robot,
)
from skewmi.deploy.robot.description import RobotDescription
from skewmi.errors import ConfigurationError
from skewmi.robot_models.base_frame import BoxPose


@dataclass(frozen=True)
class CalibrationAgreement:
    """What follows from a session's calibration and the robot server's.

    Attributes:
        delay_s: Of the arm behind its commands, s: 0 where the robot server makes up for it.
        note: For the user, if the two know different things.
    """

    delay_s: float
    note: str | None


def agree_on_calibration(
    known: Calibration | None, described: RobotDescription
) -> CalibrationAgreement:
    """Compare what a session and its robot server know.

    Args:
        known: By the session; None if nothing is.
        described: The robot server's own words.

    Raises:
        ConfigurationError: The session's is of another kind of robot.
    """
    theirs = described.calibration
    if known is not None:
        require_robot(known, described.backend, described.egm.get("speed_share"))
    if known is None or (known.servo is None and known.egm is None):
        note = (
            ""
            if not theirs
            else (
                f"the robot server uses the calibration {theirs}, this session none of servos: "
                "give it the same --calibration"
            )
        )
        return CalibrationAgreement(0.0, note or None)
    ours = fingerprint(known)
    if theirs == ours:
        return CalibrationAgreement(0.0, None)
    uses = f"uses another calibration ({theirs})" if theirs else "uses no calibration"
    note = (
        f"the robot server {uses}, so that its servos do not get the feed-forward of this one "
        f"({ours}): start it with the same --calibration"
    )
    # A robot server that has one makes up for the delay that it knows.
    return CalibrationAgreement(0.0 if theirs else known_delay_s(known), note)


def agree_on_box(known: Calibration | None, described: RobotDescription) -> BoxPose | None:
    """See that a session and its robot server have the task's box at the same place.

    They judge motion in the frame of that box: with two of them, one would send what the other
    refuses, or nobody would know where the hand is.

    Args:
        known: By the session; None if nothing is.
        described: The robot server's own words.

    Returns:
        Where it stands; None if neither has looked for it.

    Raises:
        ConfigurationError: They have it at two places, or one of them at none, or too far away.
        TransportError: What the robot server tells of it is not to be understood.
    """
    ours, theirs = box_displacement(known), described.box
    if ours is None:
        if theirs is None:
            return None
        raise ConfigurationError(
            f"the robot server works with a calibration of the scene ({theirs.words}), this "
            "session with none: give it the same --calibration, or restart the robot server "
            "without"
        )
    mine = BoxPose(*ours, *((0.0, 0.0) if theirs is None else (theirs.origin_x, theirs.origin_y)))
    if theirs is None:
        raise ConfigurationError(
            f"{mine.words}, and the robot server works as if it stood at its place: restart it "
            "with the same --calibration, or give this session none of the scene"
        )
    if mine != theirs:
        raise ConfigurationError(
            f"{mine.words}, and the robot server has it at {1e3 * theirs.x:+.3f} mm, "
            f"{1e3 * theirs.y:+.3f} mm and {theirs.yaw_deg:+.4f} degrees: restart it with the same "
            "--calibration"
        )
    return theirs
