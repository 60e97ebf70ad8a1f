"""A motion that solves OpenPressClose through the policy interface alone.

It sees only observations and gives only actions in [-1, 1]; every phase ends on what it sees, not
on time, so that it works through chains with other delays too. Satisfies `policy_io.Policy`.
"""

from __future__ import annotations

import numpy as np

from skewmi.policy_io import Array, PolicyLayout

HINGE_Y, HINGE_Z = -0.005, 0.075
"""The lid's hinge line, world, m."""
BAR_RADIUS = 0.1406
BAR_ANGLE = 0.2959
"""The handle's bar from the hinge: distance, m, and elevation with the lid shut, rad."""
OPEN_ANGLE = 1.97
"""How far the lid is pushed open, rad: the handle is then low enough for the hand to pass over
and near enough for the hand to get behind it."""
TIP = 0.1357
"""Fingertips below the hand frame, m."""
MIDDLE_X = -0.009
"""Middle of the handle, world, m."""
GAIN = 0.45
"""Part of the remaining distance commanded per step."""
TOLERANCE = 0.004
"""A way point is reached within this distance, m."""


def bar_position(lid_angle: float) -> Array:
    """Centre of the handle's bar, y and z in world, m. Shape (2,)."""
    angle = BAR_ANGLE + lid_angle
    return np.array([HINGE_Y - BAR_RADIUS * np.cos(angle), HINGE_Z + BAR_RADIUS * np.sin(angle)])


class ScriptedOpenPressClose:
    """Hook the handle, lift, push the lid over, press the button, push the lid shut."""

    PHASES = (
        "centre", "lower", "hook", "lift", "push_open", "release", "return", "press",
        "rise", "cross", "behind", "push_shut", "press_shut", "rest",
    )  # fmt: skip

    def __init__(self, layout: PolicyLayout) -> None:
        """Args: layout: Of the task; with or without the gripper action and the time."""
        self.layout = layout
        self._names = layout.observation_names
        self.reset()

    def reset(self) -> None:
        """Begin with the first phase."""
        self.phase = self.PHASES[0]

    def act(self, observation: Array) -> Array:
        """Action for one observation. Shape (observation_dim,) -> (action_dim,)."""
        value = dict(zip(self._names, np.asarray(observation, dtype=float), strict=True))
        hand = np.array([value["hand_x"], value["hand_y"], value["hand_z"]])
        lid, depth = float(value["lid_angle"]), float(value["button_depth"])
        self._advance(hand, lid, depth)
        target = self._target(hand, lid)
        action = np.zeros(self.layout.action_dim)
        action[:3] = np.clip(GAIN * (target - hand) / self.layout.action_scale[:3], -1.0, 1.0)
        if self.layout.action_dim == 4:
            assert self.layout.workspace is not None
            error = self.layout.workspace.gripper_opening - value["gripper"]
            action[3] = np.clip(GAIN * error / self.layout.action_scale[3], -1.0, 1.0)
        return action

    def _advance(self, hand: Array, lid: float, depth: float) -> None:
        """Go to the next phase when what this one is for can be seen to be done."""
        _, y, z = hand
        while True:
            done = {
                "centre": abs(y + 0.1345) < TOLERANCE,
                "lower": z < 0.2285,
                "hook": y < -0.1445,
                "lift": lid > 0.8,
                "push_open": lid > OPEN_ANGLE - 0.05,
                "release": z > 0.340,
                "return": y < -0.070,
                "press": depth > 0.0125,
                "rise": z > 0.300,
                "cross": y > 0.122,
                "behind": z < 0.318,
                "push_shut": lid < 0.55,
                "press_shut": lid < 0.015,
                "rest": False,
            }[self.phase]
            if not done:
                return
            self.phase = self.PHASES[self.PHASES.index(self.phase) + 1]

    def _target(self, hand: Array, lid: float) -> Array:
        """Where the hand should go now, world, m. Shape (3,)."""
        _, y, z = hand
        match self.phase:
            case "centre":
                goal = (-0.1345, 0.262)
            case "lower":
                goal = (-0.1345, 0.222)
            case "hook":
                goal = (-0.150, 0.224)
            case "lift":
                # The hook's top, 10 mm above the tips, stays under the bar on its arc.
                # At first straight up, or it would slip out before it carries.
                ahead = bar_position(lid + 0.22)
                goal_y = ahead[0] - 0.007 if lid > 0.12 else bar_position(lid)[0] - 0.006
                goal = (goal_y, ahead[1] + TIP - 0.014)
            case "push_open":
                # The other finger pushes the bar from behind, so the hook is free at the end.
                ahead = bar_position(min(lid + 0.18, OPEN_ANGLE))
                goal = (ahead[0] + 0.012, bar_position(lid)[1] + TIP - 0.022)
            case "release":
                goal = (y, 0.360)
            case "return":
                goal = (-0.090, 0.352 if y > -0.01 else 0.300)
            case "press":
                goal = (-0.080, 0.170)
            case "rise":
                goal = (-0.075, 0.352)
            case "cross":
                goal = (0.135, 0.352)
            case "behind":
                goal = (0.133, 0.300)
            case "push_shut":
                # The outer face of the -y finger pushes the bar, at the height of the tips.
                ahead = bar_position(lid - 0.25)
                push = min(ahead[0] + 0.026, y - 0.015)
                goal = (push, max(ahead[1], bar_position(lid)[1]) + TIP - 0.022)
            case "press_shut":
                # Slower the less the lid is open: it shall not be slammed.
                goal = (-0.085, z - 0.008 - 0.025 * min(lid, 0.6))
            case _:
                # Takes the weight off the lid, but stays so low that the hook cannot catch the bar.
                goal = (y, 0.220)
        return np.array([MIDDLE_X, *goal])
