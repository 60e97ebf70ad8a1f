"""Angles that the door is to be opened to: five, each the centre of a reward region.

The area of interest is what the hand can do with this door: from 0.10 rad, where the region of a
target is as far from the shut door as it is wide, to 1.45 rad, where it ends short of the stop,
against which a door could simply be thrown. It is cut into five parts of equal width, so that five
draws cannot all fall together, and one angle is drawn uniformly in each (numpy's default generator,
seed 2020, rounded to 0.01 rad). In the part that holds the target of the published code, 1.216 rad,
that one takes the place of the draw; it is the default.

`docs/make_targets_picture.py` draws them again; a test compares.
"""

from __future__ import annotations

AREA = (0.10, 1.45)
"""Lowest and highest angle, rad."""
RADIUS = 0.035
"""Half-width of the reward region, rad: the published code's."""

TARGETS = {"t1": 0.23, "t2": 0.51, "t3": 0.87, "t4": 1.10, "t5": 1.216}
"""Angles by name, rad."""
DEFAULT = "t5"
"""That of the published code."""
