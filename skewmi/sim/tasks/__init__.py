"""The tasks. A task is a folder here and a line below; `docs/extending.md` says how to add one.

Packages outside of this one register theirs by an entry point of the group `skewmi.tasks`. The
first task is that of commands which are not told any.
"""

from skewmi.sim.tasks.registry import default, find, layout, make_batch, names, register, with_arm

__all__ = ["default", "find", "layout", "make_batch", "names", "register", "with_arm"]

register("open_press_close", "skewmi.sim.tasks.open_press_close.task:SPEC")
register("door_open", "skewmi.sim.tasks.door_open.task:SPEC")
register("point_maze", "skewmi.sim.tasks.point_maze.task:SPEC")
