"""What a session says and assumes where its robot server knows something else."""

from __future__ import annotations

import pytest
from moved_boxes import ORIGIN, calibration_at
from robot_servers import description
from unknown_robots import exact_calibration, exact_egm_calibration

from skewmi.calibration.calibration_use import fingerprint
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.session.agreement import check_same_box
from skewmi.deploy.session.known_robot import agree_on_box, agree_on_calibration
from skewmi.errors import ConfigurationError, TransportError
from skewmi.robot_models.base_frame import NOMINAL_BASE, BoxPose

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


AT = (0.02, -0.012, 8.0)


def told(displacement: tuple[float, float, float] | None, **changes: object) -> RobotDescription:
    pose = {} if displacement is None else BoxPose(*displacement, *ORIGIN).as_mapping()
    return RobotDescription.from_json(description(box_pose=pose, **changes).to_json())


def test_who_has_the_box_at_the_same_place_works_in_its_frame() -> None:
    assert agree_on_box(None, told(None)) is None
    assert agree_on_box(KNOWN, told(None)) is None
    assert agree_on_box(calibration_at(*AT), told(AT)) == BoxPose(*AT, *ORIGIN)
    assert told(AT).base_frame == BoxPose(*AT, *ORIGIN).base_frame()
    assert told(None).base_frame == NOMINAL_BASE


@pytest.mark.parametrize(
    ("ours", "theirs", "why"),
    [
        (None, AT, "this session with none"),
        (None, (0.0, 0.0, 0.0), "this session with none"),
        (AT, None, "as if it stood at its place"),
        ((0.0, 0.0, 0.0), None, "as if it stood at its place"),
        (AT, (0.02, -0.012, 8.001), r"has it at \+20.000 mm"),
        ((0.02, -0.012, 7.9999999999), AT, r"has it at \+20.000 mm"),
        (AT, (-0.02, 0.012, -8.0), "restart it with the same"),
        ((0.06, 0.0, 0.0), AT, "put the box nearer"),
    ],
)
def test_who_has_the_box_somewhere_else_is_refused(ours: object, theirs: object, why: str) -> None:
    for servo in (None, KNOWN):
        known = servo if ours is None else calibration_at(*ours, servo=servo)  # type: ignore[misc]
        with pytest.raises(ConfigurationError, match=why) as refused:
            agree_on_box(known, told(theirs))  # type: ignore[arg-type]
        assert "--calibration" in str(refused.value) or "calibrate scene" in str(refused.value)


@pytest.mark.parametrize(
    "nonsense",
    [
        {"x": 0.0},
        {**BoxPose(*AT, *ORIGIN).as_mapping(), "x": 0.3},
        {**BoxPose(*AT, *ORIGIN).as_mapping(), "yaw_deg": float("nan")},
        {**BoxPose(*AT, *ORIGIN).as_mapping(), "origin_x": float("inf")},
        {**BoxPose(*AT, *ORIGIN).as_mapping(), "z": 0.0},
    ],
)
def test_a_robot_server_that_tells_nonsense_of_a_box_is_not_worked_with(
    nonsense: dict[str, float],
) -> None:
    with pytest.raises(TransportError, match="tells of a box"):
        agree_on_box(calibration_at(*AT), description(box_pose=nonsense))


def test_a_box_that_moves_after_the_agreement_ends_the_session() -> None:
    for agreed, now in ((AT, None), (None, AT), (AT, (0.02, -0.012, 8.001))):
        with pytest.raises(ConfigurationError, match="elsewhere than before"):
            check_same_box(told(agreed).box_pose, told(now))
    for same in (None, AT):
        check_same_box(told(same).box_pose, told(same))
