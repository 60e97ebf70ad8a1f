"""What a session says and assumes where its robot server knows something else."""

from __future__ import annotations

import pytest
from robot_servers import description
from unknown_robots import exact_calibration, exact_egm_calibration

from skewmi.calibration.calibration_use import fingerprint
from skewmi.deploy.session.known_robot import agree_on_calibration
from skewmi.errors import ConfigurationError

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


def test_a_calibration_of_another_kind_of_robot_is_refused() -> None:
    egm = exact_egm_calibration(lag_ms=18.0)
    for known, backend, told in ((KNOWN, "egm", "behind EGM"), (egm, "sim", "guided by EGM")):
        with pytest.raises(ConfigurationError, match=told):
            agree_on_calibration(known, description(backend=backend))
    found = agree_on_calibration(egm, description(backend="egm", egm={"speed_share": 1.0}))
    assert found.delay_s == pytest.approx(0.018)
    with pytest.raises(ConfigurationError, match="--egm-feed-forward"):
        agree_on_calibration(egm, description(backend="egm", egm={"speed_share": 0.8}))
