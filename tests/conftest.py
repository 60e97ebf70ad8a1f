"""Imported before any test: skewmi switches the telemetry of what it depends on off."""

import skewmi  # noqa: F401
