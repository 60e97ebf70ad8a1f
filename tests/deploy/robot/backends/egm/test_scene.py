"""Who may say what the scene before a controller looks like."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest
from moved_boxes import calibration_at

from skewmi.calibration.calibration_file import Calibration
from skewmi.cli.egm_flags import task_facts
from skewmi.deploy.robot.backends import BackendOptions
from skewmi.deploy.robot.backends.egm.backend import make
from skewmi.deploy.robot.backends.egm.options import EgmOptions
from skewmi.deploy.robot.backends.egm.scene import EMULATOR_STATUS, SCENE_PUBLISHER
from skewmi.deploy.wire.channels import Sample
from skewmi.deploy.wire.messages import OK, Status, encode_status
from skewmi.deploy.wire.topics import Topic

CLAIMED = bytes(range(16))


@dataclass
class Claims:
    """A link on which somebody says that he is an emulator, and publishes the scene."""

    publisher: str = CLAIMED.hex()
    subscribed: list[Topic] = field(default_factory=list)
    contact: dict[str, str] = field(default_factory=dict)

    def subscribe(self, topic: Topic) -> Claims:
        self.subscribed.append(topic)
        return self

    def drain(self) -> list[Sample]:
        values = {SCENE_PUBLISHER: self.publisher, **self.contact}
        payload = encode_status(Status(0, "emulator", OK, "emulated controller", values))
        return [Sample(payload, 1, 0, bytes(16), 0)]


def scene_of(listen: str, link: Claims, calibration: Calibration | None = None):
    options = BackendOptions(
        egm=EgmOptions(listen=listen, listen_left="none"),
        facts=task_facts("open_press_close", calibration),
        link=link,
    )
    return make(options).scene


@pytest.mark.parametrize("host", ["192.168.125.50", "0.0.0.0", "10.0.0.1"])
def test_beside_a_real_controller_nobody_is_taken_for_an_emulator(host: str) -> None:
    link = Claims()
    scene = scene_of(f"{host}:6512", link)
    assert scene is not None
    assert tuple(scene.publishers()) == ()
    assert not scene.resettable
    assert scene.contact() == {}
    assert link.subscribed == []


def test_on_this_computer_the_emulator_is_announced() -> None:
    link = Claims()
    scene = scene_of("127.0.0.1:6512", link)
    assert scene is not None
    assert tuple(scene.publishers()) == (CLAIMED,)
    assert scene.resettable
    assert link.subscribed == [EMULATOR_STATUS]


@pytest.mark.parametrize("known", [False, True])
def test_what_an_emulator_tells_against_a_box_in_its_place_is_not_told_of_another(
    known: bool,
) -> None:
    link = Claims()
    told = {"hand_force_peak_n": 3.0, "hand_tilt_deg": 8.0, "outside_box_mm": 30.0}
    link.contact = {name: str(value) for name, value in told.items()}
    scene = scene_of("127.0.0.1:6512", link, calibration_at(0.02, 0.0, 8.0) if known else None)
    assert scene is not None
    assert scene.contact() == ({"hand_force_peak_n": 3.0} if known else told)


@pytest.mark.parametrize("publisher", ["", "12", "zz" * 16, "00" * 17])
def test_emulator_that_names_no_publisher_is_none(publisher: str) -> None:
    scene = scene_of("127.0.0.1:6512", Claims(publisher))
    assert scene is not None
    assert tuple(scene.publishers()) == ()
