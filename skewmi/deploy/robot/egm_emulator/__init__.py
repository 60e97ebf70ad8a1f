"""An ABB controller with no ABB: the other side of EGM, with the simulated scene behind it."""
