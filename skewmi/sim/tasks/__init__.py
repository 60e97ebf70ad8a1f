"""The tasks by name."""

from skewmi.sim.tasks.registry import TASKS, layout, make_batch

__all__ = ["TASKS", "layout", "make_batch"]
