"""What a policy of OpenPressClose sees and does, and when it has succeeded.

Numbers are from the Skew-Explore "yumi_door_button" environment unless a comment says otherwise.
"""

from __future__ import annotations

from skewmi.policy_io import TIME_FIELD, ActionField, Ball, Field, PolicyLayout, Workspace
from skewmi.robot_models import frames, yumi
from skewmi.sim.tasks.open_press_close import parts

SIM_DT = 0.004
"""Time step of the physics, s: the grid of the robot's own command interface."""
CONTROL_DT = 0.1
"""Time between two actions, s. The original takes 1 s; its arm is a hundred times lighter."""
SUBSTEPS = 25
"""Physics steps per control step."""
WATCH_SUBSTEPS = 5
"""Physics steps between two looks at whether the hand follows its command: 20 ms, a cycle of the
deployed planner."""
EPISODE_STEPS = 200

HAND_STEP = 0.015
"""Hand travel per control step and axis at action 1.0, m: 150 mm/s. (The published code moves
10 mm per action along z; with that the button was found a good deal later.)"""
FINGER_STEP = 0.0025
"""Finger travel per control step at action 1.0, m: the gripper's 25 mm/s."""
FINGER_MAX = yumi.GRIPPER.travel
"""Travel of a finger from closed to open, m."""
GRIPPER_OPENING = 0.014
"""Finger travel while the policy does not move the fingers, m: the bar fits between them with
the hook behind it."""

FREE_LEAD = 1.0
"""How far the command may run ahead of a hand that follows it, in full actions."""
HELD_LEAD = 0.2
"""The same where something holds the hand up: 3 mm, which the scene's servos turn into 40 N at
most (in the stiffest direction; some 7 N sideways)."""
STOP_LEAD = 0.45
"""Stall at which a command stops before its step is over: 7 mm. A late arm (40 ms) that starts to
move is 0.4 behind."""

LID_SHUT = 0.035
"""Largest lid angle that counts as shut, rad: the lid's edge is then 5 mm above its rest."""
BOX_TOLERANCE = 0.002
"""How far outside its box the hand may be in the reward region, m."""
PRESSED_MIN = 0.010
"""Smallest button depth that counts as pressed, m (the paper's 1 cm)."""
PRESSED_MAX = 0.032
"""The button's stop, with room for the softness of a simulated stop, m."""


def make_layout(*, gripper_action: bool = False, time_input: bool = False) -> PolicyLayout:
    """The layout of the task.

    Args:
        gripper_action: Adds the speed of the fingers as fourth action (the published code has
            it, the paper's text does not); without it the fingers keep their opening.
        time_input: Adds the time as last observation, as step index / episode steps.
    """
    x, y, z = frames.BASE_IN_WORLD.tolist()
    qw, qx, qy, qz = frames.HAND_DOWN_QUATERNION_WXYZ.tolist()
    workspace = Workspace(
        low=(-0.019, -0.155, 0.190),
        high=(0.001, 0.135, 0.355),
        start=(-0.009, -0.1345, 0.270),
        base_position=(x, y, z),
        hand_quaternion_wxyz=(qw, qx, qy, qz),
        free_lead=FREE_LEAD,
        held_lead=HELD_LEAD,
        stop_lead=STOP_LEAD,
        start_configuration=yumi.PRESS_START_CONFIGURATION,
        gripper_opening=GRIPPER_OPENING,
    )
    observation = [
        Field(f"hand_{axis}", "m", "world", low, high)
        for axis, low, high in zip("xyz", workspace.low, workspace.high, strict=True)
    ]
    observation += [
        Field("gripper", "m", "finger", 0.0, FINGER_MAX),
        Field("lid_angle", "rad", "hinge", 0.0, parts.LID_MAX),
        Field("button_depth", "m", "slide", 0.0, parts.BUTTON_TRAVEL),
    ]
    if time_input:
        observation.append(Field(TIME_FIELD, "1", "episode", 0.0, 1.0))
    action = [ActionField(f"hand_{axis}", "m/step", "world", HAND_STEP) for axis in "xyz"]
    if gripper_action:
        action.append(ActionField("gripper", "m/step", "finger", FINGER_STEP))
    return PolicyLayout(
        task="open_press_close",
        observation=tuple(observation),
        action=tuple(action),
        reward_region=(
            *(
                Ball((f"hand_{axis}",), ((low + high) / 2,), (high - low) / 2 + BOX_TOLERANCE)
                for axis, low, high in zip("xyz", workspace.low, workspace.high, strict=True)
            ),
            Ball(("lid_angle",), (0.0,), LID_SHUT),
            Ball(
                ("button_depth",),
                ((PRESSED_MIN + PRESSED_MAX) / 2,),
                (PRESSED_MAX - PRESSED_MIN) / 2,
            ),
        ),
        control_dt=CONTROL_DT,
        episode_steps=EPISODE_STEPS,
        success_hold_steps=10,
        workspace=workspace,
    )
