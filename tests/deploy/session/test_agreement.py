"""What policy, session and robot server must agree on."""

from __future__ import annotations

from typing import Any

import pytest
from robot_servers import description
from slow_limits import slowed

from skewmi.deploy.robot.description import limit_values
from skewmi.deploy.session.agreement import check_agreement
from skewmi.errors import (
    ConfigurationError,
    LayoutMismatchError,
)
from skewmi.robot_models import limits as joint_limits
from skewmi.robot_models import yumi
from skewmi.sim.tasks.open_press_close.definition import make_layout

LAB = joint_limits.profile("lab")
NAMES = yumi.joint_names("right")


def test_agreement_passes_only_if_everything_agrees() -> None:
    check_agreement(make_layout(), yumi.MODEL_HASH, LAB, description())
    check_agreement(make_layout(), None, slowed(LAB, 0.3), description())


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"task": "door_open"}, LayoutMismatchError),
        ({"layout_hashes": ("0" * 64,)}, LayoutMismatchError),
        ({"robot_model_hash": "0" * 64}, LayoutMismatchError),
        ({"joint_names": NAMES[::-1]}, ConfigurationError),
        ({"grid_ns": 8_000_000}, ConfigurationError),
        ({"state_period_ns": 4_000_000}, ConfigurationError),
        ({"limits": limit_values(joint_limits.profile("careful"))}, ConfigurationError),
        ({"limits": limit_values(slowed(LAB, 0.99))}, ConfigurationError),
        ({"limits": {}}, ConfigurationError),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, dict) else "",
)
def test_every_disagreement_is_refused(changes: dict[str, Any], error: type) -> None:
    with pytest.raises(error):
        check_agreement(make_layout(), yumi.MODEL_HASH, LAB, description(**changes))
