"""OpenPressClose as the registry keeps it."""

from __future__ import annotations

import math

from skewmi.batch_env import Condition, Event, GridAxis, TaskMetrics
from skewmi.sim.arm.spec import arm_task_spec
from skewmi.sim.task_spec import Caption
from skewmi.sim.tasks.open_press_close.definition import ARM, BUTTON, LID

_LID, _BUTTON = LID.field.name, BUTTON.field.name

SPEC = arm_task_spec(
    ARM,
    metrics=TaskMetrics(
        # The code's grid for this task has one point per hand and gripper axis; its metrics are
        # about lid and button.
        grid=(GridAxis(_LID, 0.0, 2.5, 10), GridAxis(_BUTTON, 0.0, 0.03, 5)),
        unit_range=True,
        events=(
            Event("lid above 30 degrees", (Condition(_LID, low=0.5236),)),
            Event("lid above 90 degrees", (Condition(_LID, low=1.5708),)),
            Event("button pressed", (Condition(_BUTTON, low=0.010),)),
            Event(
                "lid below 15 degrees after pressing",
                (Condition(_BUTTON, low=0.010), Condition(_LID, high=0.2618)),
            ),
        ),
    ),
    planes=((_LID, _BUTTON),),
    captions=(
        Caption(_LID, "lid", "deg", 180.0 / math.pi, 3),
        Caption(_BUTTON, "button", "mm", 1e3, 2),
    ),
)
