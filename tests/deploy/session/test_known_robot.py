"""What a session says and assumes where its robot server knows something else."""

from __future__ import annotations

import pytest
from robot_servers import description
from unknown_robots import exact_calibration

from skewmi.calibration.calibration_use import fingerprint
from skewmi.deploy.session.known_robot import agree_on_calibration

KNOWN = exact_calibration(delay_ms=30.0)
OTHER = exact_calibration(delay_ms=31.0)


def test_fingerprints_tell_calibrations_apart() -> None:
    assert fingerprint(KNOWN) == fingerprint(exact_calibration(delay_ms=30.0))
    assert fingerprint(KNOWN) != fingerprint(OTHER)


def test_who_knows_the_same_is_told_nothing_and_waits_for_nothing() -> None:
    for known, theirs in ((None, ""), (KNOWN, fingerprint(KNOWN))):
        found = agree_on_calibration(known, description(calibration=theirs))
        assert (found.delay_s, found.note) == (0.0, None)


@pytest.mark.parametrize(
    ("known", "theirs", "delay_s", "said"),
    [
        (KNOWN, "", 0.030, "uses no calibration"),
        (KNOWN, fingerprint(OTHER), 0.0, "uses another calibration"),
        (None, fingerprint(OTHER), 0.0, "this session none of servos"),
    ],
)
def test_who_knows_something_else_is_told(
    known: object, theirs: str, delay_s: float, said: str
) -> None:
    found = agree_on_calibration(known, description(calibration=theirs))  # type: ignore[arg-type]
    assert found.delay_s == delay_s
    assert found.note is not None
    assert said in found.note
    assert "--calibration" in found.note
