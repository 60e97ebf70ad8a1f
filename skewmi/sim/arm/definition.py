"""What every task with an arm has in common: time steps, step sizes, following errors.

Numbers are from the Skew-Explore "yumi_door_button" environment unless a comment says otherwise.
"""

from __future__ import annotations

from skewmi.robot_models import yumi
from skewmi.trajectory import CYCLE_TICKS, GRID_S

SIM_DT = GRID_S
"""Time step of the physics, s: the grid of the robot's own command interface."""
CONTROL_DT = 0.1
"""Time between two actions, s. The original takes 1 s; its arm is a hundred times lighter."""
SUBSTEPS = 25
"""Physics steps per control step."""
WATCH_SUBSTEPS = CYCLE_TICKS
"""Physics steps between two looks at whether the hand follows its command: 20 ms, a cycle of the
deployed planner."""

HAND_STEP = 0.015
"""Hand travel per control step and axis at action 1.0, m: 150 mm/s. (The published code moves
10 mm per action along z; with that a button was found a good deal later.)"""
FINGER_STEP = 0.0025
"""Finger travel per control step at action 1.0, m: the gripper's 25 mm/s."""
FINGER_MAX = yumi.GRIPPER.travel
"""Travel of a finger from closed to open, m."""

FREE_FOLLOWING_ERROR = 1.0
"""How far the command may be ahead of a hand that follows it, in full actions."""
HELD_FOLLOWING_ERROR = 0.2
"""The same where something blocks the hand: 3 mm, which the servos for work in contact turn into
40 N at most (in the stiffest direction; some 7 N sideways)."""
STOP_BLOCKAGE = 0.45
"""Blockage at which a command stops before its step is over: 7 mm. A late arm (40 ms) that starts
to move is 0.4 behind."""

BOX_TOLERANCE = 0.002
"""How far outside its box the hand may be in the reward region, m."""
