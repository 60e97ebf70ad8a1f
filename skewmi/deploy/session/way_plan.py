"""Ways of the arm from wherever it rests to a configuration, clear of the scene, and small steps.

A way is legs that follow one another from rest to rest, each in a workspace that the robot server
grants. The direct one is a straight line in joint space. Where that would lead through something
the hand goes straight up first, until it is over the scene; where it stands too near something for
the usual clearance, as after a touch that was cut off, it does that slowly, in the workspace made
for touching, and comes nearer to nothing. Over the place where it is to go it comes down again.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from skewmi.deploy.motion.hand_line import hand_line
from skewmi.deploy.motion.joint_path import JointPath
from skewmi.deploy.safety.checks import SpaceChecks
from skewmi.deploy.safety.flange_space import CALIBRATION, TOUCH, lowest_of_hand
from skewmi.deploy.session.path_places import places_along
from skewmi.errors import ConfigurationError, KinematicsError, LimitViolationError
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.trajectory import Array

OVER = 0.006
"""How far the fingers are led over what the calibration workspace asks for, m: as much may an arm
lag."""
LEAST_RISE = 0.010
"""m."""
HIGHER = (0.0, 0.04, 0.08, 0.12, 0.16)
"""How much higher the hand goes, one after the other, if it finds no way from there, m."""
ABOVE_GOAL = (0.0, 0.05, 0.10)
"""From how far over its goal it comes down, likewise, m."""
ASIDE = 0.020
"""How far it goes aside first if it cannot go up, m."""
ARRIVED = 1e-6
"""rad."""


@dataclass(frozen=True, eq=False)
class Leg:
    """One motion from rest to rest.

    Attributes:
        workspace: In which it is made.
        path: From where the leg before it ends.
        words: What it is, for people.
    """

    workspace: str
    path: JointPath
    words: str


class WayPlanner:
    """Finds ways.

    Args:
        spaces: Checks by the workspace's name, as `way_spaces.way_spaces` makes them: those of
            "touch" permit the arm to leave where it stands.
        q: Where the arm rests, rad. Shape (7,).
    """

    def __init__(self, spaces: dict[str, SpaceChecks], q: Array) -> None:
        self._spaces, self._q = spaces, q
        self._arm = ArmKinematics("right")

    def way_to(self, q_goal: Array, workspace: str) -> list[Leg]:
        """The first way to a configuration that leads through nothing.

        Args:
            q_goal: rad. Shape (7,).
            workspace: That the last part of the way is made in: "calibration", or "task" for a goal
                outside of that.

        Returns:
            Its legs; none if the arm is there.

        Raises:
            ConfigurationError: No way was found; says why the direct one is none, and what to do.
        """
        if np.abs(q_goal - self._q).max() <= ARRIVED:
            return []
        reasons: list[str] = []
        for rise in self._rises(reasons):
            start = self._q if not rise else _end_of(rise[-1])
            for down in self._descents(q_goal, workspace, reasons):
                over = q_goal if not down else down[0].path.at(0.0)
                legs = [*rise, Leg(workspace, JointPath.line(start, over), "across"), *down]
                try:
                    self._require_free(legs[len(rise) :])
                except (LimitViolationError, KinematicsError) as error:
                    reasons.append(str(error))
                else:
                    return legs
        raise ConfigurationError(
            f"no way was found that is clear of the scene; the direct one: {reasons[0]}; lead the "
            "hand away by small steps (skewmi jog), or with the pendant, and try again"
        )

    def way_by(self, q_between: Array, q_goal: Array, workspace: str) -> list[Leg]:
        """The direct way to a configuration or, where that is not free, the one by another place.

        Args:
            q_between: In the calibration workspace, from where a way is known to exist, rad.
                Shape (7,).
            q_goal, workspace: See `way_to`.

        Raises:
            ConfigurationError: See `way_to`.
        """
        if np.abs(q_goal - self._q).max() <= ARRIVED:
            return []
        direct = [Leg(workspace, JointPath.line(self._q, q_goal), "across")]
        try:
            self._require_free(direct)
        except LimitViolationError:
            first = self.way_to(q_between, CALIBRATION)
            return [*first, *WayPlanner(self._spaces, q_between).way_to(q_goal, workspace)]
        return direct

    def line(self, step: Array, workspace: str) -> Leg:
        """A small step of the hand along a straight line.

        Args:
            step: In the base frame, whose axes are the world's, m. Shape (3,).
            workspace: In which.

        Raises:
            LimitViolationError, KinematicsError: It may not or cannot be made.
        """
        leg = Leg(workspace, self._line(self._q, step), "a step of the hand")
        self._require_free([leg])
        return leg

    def turn(self, joint: int, angle: float, workspace: str) -> Leg:
        """A small step of one joint.

        Args:
            joint: Index in the order of the chain.
            angle: rad.
            workspace: In which.

        Raises:
            LimitViolationError: It may not be made.
        """
        q = self._q.copy()
        q[joint] += angle
        leg = Leg(workspace, JointPath.line(self._q, q), "a step of a joint")
        self._require_free([leg])
        return leg

    def _line(self, q: Array, step: Array) -> JointPath:
        position, _ = self._arm.forward(q)
        return hand_line(self._arm, q, position, position + step)

    def _rises(self, reasons: list[str]) -> Iterator[list[Leg]]:
        """Legs to begin with: none, and up by more and more."""
        yield []
        first = self._first_rise(reasons)
        if not first:
            return
        yield first
        for more in HIGHER[1:]:
            try:
                up = self._line(_end_of(first[-1]), np.array([0.0, 0.0, more]))
                legs = [Leg(CALIBRATION, up, "higher")]
                self._require_free(legs)
            except (LimitViolationError, KinematicsError) as error:
                reasons.append(str(error))
                return
            yield [*first, *legs]

    def _first_rise(self, reasons: list[str]) -> list[Leg]:
        """Up until the fingers are over the scene, aside before if it must be; nothing if neither.

        Fast if there is room around the hand, else slowly.
        """
        position, rotation = self._arm.forward(self._q)
        lowest = float(lowest_of_hand(position[None], rotation[None])[0])
        above = self._spaces[CALIBRATION].space.fingers_above
        rise = np.array([0.0, 0.0, max(LEAST_RISE, above + OVER - lowest)])
        asides = [
            np.array([x, y, 0.0]) * ASIDE for x, y in ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))
        ]
        for workspace in (CALIBRATION, TOUCH):
            for aside in asides:
                try:
                    legs: list[Leg] = []
                    q = self._q
                    if aside.any():
                        legs.append(Leg(workspace, self._line(q, aside), "aside"))
                        q = _end_of(legs[0])
                    legs.append(Leg(workspace, self._line(q, rise), "straight up"))
                    self._require_free(legs)
                except (LimitViolationError, KinematicsError) as error:
                    reasons.append(str(error))
                else:
                    return legs
        return []

    def _descents(self, q_goal: Array, workspace: str, reasons: list[str]) -> Iterator[list[Leg]]:
        """Legs to end with: none, and down from more and more."""
        yield []
        for height in ABOVE_GOAL[1:]:
            try:
                path = self._line(q_goal, np.array([0.0, 0.0, height]))
            except KinematicsError as error:
                reasons.append(str(error))
                return
            yield [Leg(workspace, path.reversed(), "down")]

    def _require_free(self, legs: Sequence[Leg]) -> None:
        for leg in legs:
            self._spaces[leg.workspace].check_way(places_along(leg.path))


def _end_of(leg: Leg) -> Array:
    return leg.path.at(leg.path.length)
