"""Imported before any test: skewmi switches the telemetry of what it depends on off."""

import os

from hypothesis import HealthCheck, settings

import skewmi  # noqa: F401
from skewmi import matrix_kernels

# Which kernels multiply would depend on whether a test before has imported torch.
os.environ.setdefault(matrix_kernels.VARIABLE, "default")

# No example has a time to keep: a slow or busy computer is no fault of what is tested.
settings.register_profile(
    "any-computer", deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("any-computer")
