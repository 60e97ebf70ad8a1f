"""Our definitions of ROS 2 messages are those that rosbags brings."""

from __future__ import annotations

from typing import Any

import pytest
from rosbags.typesys import Stores, get_typestore

from skewmi.deploy.wire import ros2_types
from skewmi.deploy.wire.ros2_definitions import DEFINITIONS
from skewmi.deploy.wire.topics import CONTROLLER_STATE, TOPICS


@pytest.fixture(scope="module")
def jazzy() -> Any:
    return get_typestore(Stores.ROS2_JAZZY)


# rosbags has no control_msgs; its type hash is held by test_controller_state.py.
@pytest.mark.parametrize("name", sorted(set(DEFINITIONS) - {CONTROLLER_STATE}))
def test_a_definition_is_that_of_the_release(jazzy: Any, name: str) -> None:
    ours = ros2_types.store()
    assert ours.fielddefs[name] == jazzy.fielddefs[name]
    assert ours.hash_rihs01(name) == jazzy.hash_rihs01(name)
    assert ours.generate_msgdef(name, ros_version=2) == jazzy.generate_msgdef(name, ros_version=2)


def test_every_topic_has_its_type() -> None:
    assert {topic.type_name for topic in TOPICS} <= set(ros2_types.store().types)
