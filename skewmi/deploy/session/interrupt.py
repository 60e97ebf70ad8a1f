"""Requests to stop, and what they become in the session."""

from __future__ import annotations

import threading

from skewmi.errors import SkewmiError


class StopRequestedError(SkewmiError):
    """Somebody asked the arm to stop; no further episode is started."""


def check_interrupt(stop: threading.Event) -> None:
    """Go on unless the run is to end.

    Raises:
        StopRequestedError: `stop` is set.
    """
    if stop.is_set():
        raise StopRequestedError("interrupted")
