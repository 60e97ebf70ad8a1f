"""DoorOpen as the registry keeps it."""

from __future__ import annotations

import math

from skewmi.batch_env import Condition, Event, GridAxis, TaskMetrics
from skewmi.sim.arm.spec import arm_task_spec
from skewmi.sim.task_spec import Caption
from skewmi.sim.tasks.door_open.definition import ARM, DOOR, GRIPPER_OPENING

_DOOR = DOOR.field.name

SPEC = arm_task_spec(
    ARM,
    metrics=TaskMetrics(
        # The published grid: 10 x 10 x 10 x 2 x 10 points, each axis scaled to [0, 1]. The upper
        # end of the fingers' is where they stay while no action moves them; without such an action
        # half of the points can never be covered.
        grid=(
            *(
                GridAxis(f"hand_{axis}", low, high, 10)
                for axis, low, high in zip("xyz", ARM.low, ARM.high, strict=True)
            ),
            GridAxis("gripper", 0.0, GRIPPER_OPENING, 2),
            GridAxis(_DOOR, DOOR.field.low, DOOR.field.high, 10),
        ),
        unit_range=True,
        events=(
            Event("door above 6 degrees", (Condition(_DOOR, low=0.1047),)),
            Event("door above 30 degrees", (Condition(_DOOR, low=0.5236),)),
            Event("door above 60 degrees", (Condition(_DOOR, low=1.0472),)),
        ),
    ),
    planes=(("hand_z", _DOOR), ("hand_x", "hand_y")),
    captions=(Caption(_DOOR, "door", "deg", 180.0 / math.pi, 3),),
)
