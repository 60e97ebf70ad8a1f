"""Descriptions of robot servers on the wire."""

from __future__ import annotations

import pytest
from robot_servers import description

from skewmi.deploy.robot.description import RobotDescription
from skewmi.errors import (
    TransportError,
)


def test_descriptions_survive_the_wire_at_full_precision() -> None:
    assert RobotDescription.from_json(description().to_json()) == description()


@pytest.mark.parametrize("text", ["", "{}", "[]", "null", '{"backend": "sim"}'])
def test_what_is_no_description_is_refused(text: str) -> None:
    with pytest.raises(TransportError, match="description"):
        RobotDescription.from_json(text)
