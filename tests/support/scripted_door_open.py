"""A motion that solves DoorOpen, whichever its target, through the policy interface alone.

It sees only observations and gives only actions in [-1, 1]; every phase ends on what it sees, not
on time. Satisfies `policy_io.Policy`.
"""

from __future__ import annotations

import numpy as np

from skewmi.policy_io import Array, PolicyLayout

HINGE_Y, HINGE_Z = -0.05, 0.075
"""The door's hinge line, world, m."""
BAR_Y, BAR_Z = 0.025, 0.090
"""Centre of the handle's bar with the door shut, world, m."""
MIDDLE_X = -0.08
"""Middle of the bar, world, m."""
CORNER_Y, CORNER_Z = -0.015, 0.1207
"""From the bar to a hand in whose hooked finger it lies: the bar (radius 5 mm) touches the finger
(20 mm from the middle) and the hook's top (10 mm above the tip, which is 135.7 mm down), m."""
GAIN = 0.45
"""Part of the remaining distance commanded per step."""
CAREFUL_GAIN = 0.2
"""The same for the end of the lift: the hook cannot take a door back that a late hand has lifted
too far. With the lead beyond the target it is 0.26, about where a delay of one step overshoots."""
AHEAD = 0.25
"""How far ahead of the door the hand is sent on its arc, rad."""
CLOSE = 0.010
"""The door is where it shall be within this angle, rad."""


def bar_position(angle: float) -> Array:
    """Centre of the handle's bar, y and z in world, m. Shape (2,)."""
    y, z = BAR_Y - HINGE_Y, BAR_Z - HINGE_Z
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([HINGE_Y + cos * y - sin * z, HINGE_Z + sin * y + cos * z])


class ScriptedDoorOpen:
    """Lower the hook beside the bar, bring it under the bar, lift the door on its arc, wait."""

    PHASES = ("beside", "lower", "hook", "lift", "rest")

    def __init__(self, layout: PolicyLayout) -> None:
        """Args: layout: Of the task; with or without the gripper action and the time."""
        self.layout = layout
        self._names = layout.observation_names
        (ball,) = (ball for ball in layout.reward_region if ball.fields == ("door_angle",))
        self.target = ball.centre[0]
        self.reset()

    def reset(self) -> None:
        """Begin with the first phase."""
        self.phase = self.PHASES[0]

    def act(self, observation: Array) -> Array:
        """Action for one observation. Shape (observation_dim,) -> (action_dim,)."""
        value = dict(zip(self._names, np.asarray(observation, dtype=float), strict=True))
        hand = np.array([value["hand_x"], value["hand_y"], value["hand_z"]])
        angle = float(value["door_angle"])
        self._advance(hand, angle)
        action = np.zeros(self.layout.action_dim)
        careful = self.phase == "lift" and self.target - angle < AHEAD
        step = (CAREFUL_GAIN if careful else GAIN) * (self._goal(hand, angle) - hand)
        action[:3] = np.clip(step / self.layout.action_scale[:3], -1.0, 1.0)
        if self.layout.action_dim == 4:
            assert self.layout.workspace is not None
            error = self.layout.workspace.gripper_opening - value["gripper"]
            action[3] = np.clip(GAIN * error / self.layout.action_scale[3], -1.0, 1.0)
        return action

    def _advance(self, hand: Array, angle: float) -> None:
        """Go to the next phase when what this one is for can be seen to be done."""
        x, y, z = hand
        while True:
            done = {
                "beside": abs(x - MIDDLE_X) < 0.005 and y > 0.024,
                "lower": z < 0.2065,
                "hook": y < 0.0135,
                "lift": angle > self.target - CLOSE,
                "rest": False,
            }[self.phase]
            if not done:
                return
            self.phase = self.PHASES[self.PHASES.index(self.phase) + 1]

    def _goal(self, hand: Array, angle: float) -> Array:
        """Where the hand should go now, world, m. Shape (3,)."""
        match self.phase:
            case "beside":
                return np.array([MIDDLE_X, 0.027, 0.29])
            case "lower":
                return np.array([MIDDLE_X, 0.027, 0.2045])
            case "hook":
                return np.array([MIDDLE_X, 0.011, 0.2045])
            case "lift":
                # A little beyond the target: the arm gives way under the door's weight.
                ahead = min(angle + AHEAD, self.target + 0.3 * (self.target - angle))
                y, z = bar_position(ahead)
                return np.array([MIDDLE_X, y + CORNER_Y, z + CORNER_Z])
            case _:
                return hand
