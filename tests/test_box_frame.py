"""What a calibration makes of a task's workspace."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from moved_boxes import ORIGIN, calibration_at, drawn, found_at, hand_by_mujoco
from unknown_robots import exact_calibration

from skewmi.box_frame import LEAST_CLEARANCE, box_displacement, box_pose, placed
from skewmi.calibration.calibration_file import Constant
from skewmi.errors import ConfigurationError
from skewmi.policy_io import PolicyLayout, Workspace
from skewmi.robot_models import yumi
from skewmi.robot_models.base_frame import BoxPose
from skewmi.robot_models.frames import HAND_DOWN
from skewmi.sim.tasks.open_press_close.definition import make_layout


def workspace() -> Workspace:
    found = make_layout().workspace
    assert found is not None
    return found


def test_the_hand_starts_in_the_same_pose_before_the_box() -> None:
    rng = np.random.default_rng(7)
    for displacement in (*(drawn(rng) for _ in range(6)), (0.05, 0.05, 20.0), (-0.05, 0.05, -20.0)):
        found = placed(workspace(), BoxPose(*displacement, *ORIGIN))
        q = np.array(found.start_configuration)
        position, rotation = hand_by_mujoco(q, displacement)
        np.testing.assert_allclose(position, found.start, atol=1e-8)
        np.testing.assert_allclose(rotation, HAND_DOWN, atol=1e-8)
        assert (q > yumi.POSITION_LOWER).all()
        assert (q < yumi.POSITION_UPPER).all()
        same = replace(
            found,
            base_position=workspace().base_position,
            base_yaw=0.0,
            start_configuration=workspace().start_configuration,
        )
        assert same == workspace(), "nothing else of the workspace may change"


def test_nothing_known_changes_nothing() -> None:
    before = workspace()
    assert placed(before, None) is before
    assert placed(before, BoxPose(0.0, 0.0, 0.0, *ORIGIN)) is before
    assert box_displacement(None) is None
    assert box_displacement(exact_calibration()) is None
    assumed = Constant.known(0.0)
    scene = replace(found_at(0.0, 0.0, 0.0), x=assumed, y=assumed, yaw_deg=assumed)
    assert box_displacement(replace(exact_calibration(), scene=scene)) is None


def test_the_middle_of_an_interval_counts_however_wide_it_is() -> None:
    known = calibration_at(0.01, -0.02, 3.0)
    wide = replace(known, scene=found_at(0.01, -0.02, 3.0, half_width=0.5))
    assert box_displacement(known) == box_displacement(wide) == (0.01, -0.02, 3.0)


def test_a_task_without_a_box_refuses_the_place_of_one() -> None:
    assert box_pose(None, None, "door_open") is None
    with pytest.raises(ConfigurationError, match=r"door_open.*without that section"):
        box_pose((0.01, 0.0, 0.0), None, "door_open")


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"start": (0.5, -0.1345, 0.27)}, "cannot be put at the task's start"),
        ({"high": (0.35, 0.135, 0.355)}, "cannot reach all corners|singular|joint"),
        ({"low": (-0.30, -0.155, 0.190)}, "cannot reach all corners|torso|joint"),
        ({"high": (0.001, 0.135, 0.80)}, "cannot reach all corners|joint|singular"),
    ],
)
def test_a_box_that_the_arm_cannot_serve_is_refused(changes: dict[str, object], why: str) -> None:
    with pytest.raises(ConfigurationError, match=why) as refused:
        placed(replace(workspace(), **changes), BoxPose(0.02, 0.01, 5.0, *ORIGIN))  # type: ignore[arg-type]
    assert "+20.000 mm along x" in str(refused.value)
    assert "calibrate scene" in str(refused.value)


@pytest.mark.parametrize("what", ["joint", "singular", "table", "torso"])
def test_every_room_that_is_asked_for_is_looked_at(
    what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    from skewmi.robot_models import start_search
    from skewmi.robot_models.start_search import Rating

    found = {
        "joint_margin": 1.0,
        "singular_value": 1.0,
        "table_clearance": LEAST_CLEARANCE + 1e-6,
        "body_clearance": LEAST_CLEARANCE + 1e-6,
    }
    rating = lambda: Rating(np.array([True]), **{k: np.array([v]) for k, v in found.items()})  # noqa: E731
    monkeypatch.setattr(start_search, "rate", lambda *_, **__: rating())
    box = BoxPose(0.02, 0.01, 5.0, *ORIGIN)
    placed(workspace(), box)
    field = next(
        name for name in found if what in name or (what == "torso" and name.startswith("body"))
    )
    for too_little in (0.019, float("nan")):
        found[field] = too_little
        with pytest.raises(ConfigurationError, match=f"{what}.* would be .* is allowed"):
            placed(workspace(), box)


def test_layouts_of_old_policies_keep_their_hash_and_a_turned_base_survives() -> None:
    layout = make_layout()
    assert "base_yaw" not in layout.to_json()
    moved = replace(layout, workspace=placed(workspace(), BoxPose(0.0, 0.01, 5.0, *ORIGIN)))
    assert PolicyLayout.from_json(moved.to_json()) == moved
    assert moved.hash() != layout.hash()
    assert PolicyLayout.from_json(layout.to_json()) == layout
