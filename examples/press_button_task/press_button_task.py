"""A task of its own package: press a button on the table with the closed hand.

Everything that `skewmi` needs to train, evaluate, export, film and deploy it is the `SPEC` at the
end, which the entry point in pyproject.toml names.
"""

from __future__ import annotations

import mujoco
import numpy as np

from skewmi.batch_env import Condition, Event, GridAxis, TaskMetrics
from skewmi.policy_io import Ball, Field
from skewmi.sim.arm.arm_task import ArmTask, SensedJoint
from skewmi.sim.arm.spec import arm_task_spec
from skewmi.sim.arm.table import GREY, STIFF_FRICTION, STIFF_LIMIT, add_box
from skewmi.sim.arm.variation_keys import ARM_KEYS, joint_key, pose_keys
from skewmi.sim.task_spec import Caption
from skewmi.sim.variation import VariationKey, Variations

TRAVEL = 0.030
"""Depth of the button's lower stop, m; 0 is up."""
PRESSED = 0.015
"""Smallest depth that counts as pressed, m."""
FRICTIONLOSS = 3.0
"""Dry friction of the slide, N: holds the button where it is pushed."""

# Low and high corner, world, m: x forward from the robot, y to its left, z up, table top at 0.
BASE = ((-0.040, -0.020, 0.000), (0.040, 0.060, 0.018))
BUTTON = ((-0.025, -0.005, 0.052), (0.025, 0.045, 0.060))

SLIDE = SensedJoint(
    name="knob_slide",
    field=Field("knob_depth", "m", "slide", 0.0, TRAVEL),
    noise_key="sensors.knob_noise",
)


def add_parts(spec: mujoco.MjSpec) -> None:
    """Add the button and its base to the robot's model."""
    stand = spec.worldbody.add_body(name="stand")
    add_box(stand, "stand_base", BASE, GREY)
    centre = np.mean(BUTTON, axis=0)
    knob = stand.add_body(name="knob", pos=centre, gravcomp=1.0)
    knob.add_joint(
        name=SLIDE.name,
        type=mujoco.mjtJoint.mjJNT_SLIDE,
        axis=(0.0, 0.0, -1.0),
        range=(0.0, TRAVEL),
        limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        frictionloss=FRICTIONLOSS,
        damping=[5.0, 0.0, 0.0],
        **STIFF_FRICTION,
        **STIFF_LIMIT,
    )
    add_box(knob, "knob_plate", BUTTON, (0.95, 0.75, 0.15, 1.0), origin=centre, mass=0.05)


ARM = ArmTask(
    name="press_button",
    low=(-0.06, -0.12, 0.17),
    high=(0.06, 0.06, 0.30),
    start=(0.0, -0.06, 0.27),
    # python -m skewmi.robot_models.start_search --start 0 -0.06 0.27 \
    #     --low -0.06 -0.12 0.17 --high 0.06 0.06 0.30
    start_configuration=(
        1.318812165201,
        -0.808234526058,
        -1.309416619551,
        0.740217655079,
        -1.981700211059,
        1.2508439323,
        2.960422456906,
    ),
    joints=(SLIDE,),
    add_parts=add_parts,
    success=(Ball((SLIDE.field.name,), ((PRESSED + TRAVEL) / 2,), (TRAVEL - PRESSED) / 2 + 0.002),),
    gripper_opening=0.005,
    success_hold_steps=5,
    episode_steps=100,
    variations=Variations(
        keys=(
            *ARM_KEYS,
            joint_key("knob.frictionloss", "dof_frictionloss", SLIDE.name, 0.0, 20.0, "N"),
            *pose_keys("stand_pose", "stand"),
            VariationKey("sensors.knob_noise", 0.0, 0.01, "m"),
        ),
        packages=("skewmi.sim",),
    ),
)

SPEC = arm_task_spec(
    ARM,
    metrics=TaskMetrics(
        grid=(GridAxis("hand_z", 0.17, 0.30, 10), GridAxis("knob_depth", 0.0, TRAVEL, 5)),
        unit_range=True,
        events=(Event("knob touched", (Condition("knob_depth", low=0.002),)),),
    ),
    planes=(("hand_z", "knob_depth"),),
    captions=(Caption("knob_depth", "knob", "mm", 1e3, width=2),),
)
