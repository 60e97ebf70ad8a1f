"""From an arm's task to what the registry keeps."""

from __future__ import annotations

from functools import partial
from typing import Any

from skewmi.sim.arm.arm_task import LAYOUT_SWITCHES, ArmTask
from skewmi.sim.arm.batch import ArmBatch
from skewmi.sim.arm.camera import ArmCamera
from skewmi.sim.task_spec import TaskSpec


def arm_task_spec(arm: ArmTask, **details: Any) -> TaskSpec:
    """The `TaskSpec` of a task with an arm.

    Args:
        arm: The task.
        details: What else there is to say: `metrics`, `planes`, `captions`, `presets`.
    """
    return TaskSpec(
        name=arm.name,
        layout=arm.layout,
        batch=partial(ArmBatch, arm),
        camera=ArmCamera,
        layout_switches=LAYOUT_SWITCHES,
        targets=arm.target_names,
        variations=arm.variations,
        arm=arm,
        **details,
    )
