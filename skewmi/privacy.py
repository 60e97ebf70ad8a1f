"""Keeps what we depend on from sending anything: telemetry is switched off before it loads.

Every process of ours imports `skewmi` first, so `skewmi/__init__.py` calls `switch_off` once for
all; children inherit it. Of the dependencies only the ones named here send or keep anything of
the kind; `tests/test_privacy.py` traces a whole deployment, so that a new one is noticed.
"""

from __future__ import annotations

import os

SWITCHES = {
    # onnxruntime >= 1.29 looks up a host of its vendor's, uploads, and writes a device id into the
    # home folder, all at its import; its own `disable_telemetry_events` comes too late for that.
    "ORT_DISABLE_TELEMETRY": "1",
    # Ray reports the size of a cluster and the libraries used on it.
    "RAY_USAGE_STATS_ENABLED": "0",
}
"""Environment variable -> the value that keeps a dependency quiet."""

VIEWER_SWITCHES = {
    # Rerun knows two ways to switch its analytics off: a file in the user's home, which is not
    # ours to write, and being run by a build server. The Python package sends nothing.
    "CI": "1",
    "FORCE_RERUN_ANALYTICS": "0",
    "TELEMETRY_ENABLED": "false",
}
"""The same for a Rerun viewer that we start, and for it alone: other programs read CI, too."""


def switch_off() -> None:
    """Set every switch in this process's environment, whatever it was before."""
    os.environ.update(SWITCHES)


def viewer_environment() -> dict[str, str]:
    """The environment of a Rerun viewer that we start."""
    return {**os.environ, **VIEWER_SWITCHES}
