"""Imported before any test: skewmi switches the telemetry of what it depends on off."""

from hypothesis import HealthCheck, settings

import skewmi  # noqa: F401

# No example has a time to keep: a slow or busy computer is no fault of what is tested.
settings.register_profile(
    "any-computer", deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("any-computer")
