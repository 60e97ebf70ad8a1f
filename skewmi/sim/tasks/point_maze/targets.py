"""Points that the maze is to be walked to: five, each the centre of a reward region.

The area of interest is everything free whose region is free, too. It is cut into five parts of
equal area by how long the shortest way from the start is, so that five draws cannot all fall near,
and one point is drawn uniformly in each (numpy's default generator, seed 2020, rounded to 0.01 m).
In the part that holds the target of the published code, (-4, 0), that one takes the place of the
draw; it is the default.

`docs/make_targets_picture.py` draws them again; a test compares.
"""

from __future__ import annotations

RADIUS = 0.15
"""Radius of the reward region, m: the published code's."""

TARGETS = {
    "t1": (0.57, 0.77),
    "t2": (-0.44, 4.13),
    "t3": (-4.36, 1.42),
    "t4": (-4.0, 0.0),
    "t5": (-7.92, -2.75),
}
"""x and y by name, world, m; the nearest first."""
DEFAULT = "t4"
"""That of the published code."""
