"""The point maze as the registry keeps it."""

from __future__ import annotations

from skewmi.batch_env import Condition, Event, GridAxis, TaskMetrics
from skewmi.sim.task_spec import Caption, TaskSpec
from skewmi.sim.tasks.point_maze import maze, targets
from skewmi.sim.tasks.point_maze.batch import PointMazeBatch
from skewmi.sim.tasks.point_maze.scene import MazeCamera

SPEC = TaskSpec(
    name="point_maze",
    layout=maze.layout,
    batch=PointMazeBatch,
    camera=MazeCamera,
    layout_switches=("time_input",),
    targets=(targets.DEFAULT, *(name for name in targets.TARGETS if name != targets.DEFAULT)),
    metrics=TaskMetrics(
        grid=(GridAxis("x", -12.0, 4.0, 50), GridAxis("y", -6.0, 6.0, 50)),
        events=(
            Event("left half", (Condition("x", high=-5.0),)),
            Event("left corridor", (Condition("x", high=-7.0), Condition("y", -2.0, 2.0))),
        ),
    ),
    # Half of the preset's burst: one run each took 225 trajectories instead of 200, but 2.2 minutes
    # instead of 3.0. Who watches counts minutes.
    demo=(
        "--preset",
        "improved-return-then-explore",
        "--option",
        "target=t2",
        "--learner.burst-updates-per-step",
        "0.8",
    ),
    captions=(Caption("x", "x", "m"), Caption("y", "y", "m")),
)
