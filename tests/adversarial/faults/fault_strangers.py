"""Rows of those who publish on the robot server's topics without being it."""

from __future__ import annotations

from fault_cell import FAULT, GOES_ON, Fault
from fault_kinds import copied, stranger
from fault_rows import ASKED, PATIENT_MS, Expect, Row

from skewmi.deploy.wire.topics import YUMI_JOINT_STATES, YUMI_SCENE_STATES, YUMI_STATUS, Topic


def _somebody(what: str, topic: Topic) -> Row:
    inject = stranger(topic)
    named = Expect(GOES_ON, f"not believed: {topic.name} stranger")
    fault = Fault(what, inject, inject, lead_ms=PATIENT_MS)
    return Row(fault, named, named, ASKED, go_on="nothing to do")


def _same_id(what: str, topic: Topic) -> Row:
    inject = copied(topic)
    twice = Expect(FAULT, f"on {topic.name}: what the robot server sends cannot be told from")
    return Row(Fault(what, inject, inject), twice, twice, twice)


STRANGERS = (
    _somebody("somebody else's joint states", YUMI_JOINT_STATES),
    _somebody("somebody else's scene: lid shut, button pressed", YUMI_SCENE_STATES),
    _somebody("somebody else's status: in fault", YUMI_STATUS),
    _same_id("joint states also from somebody with the same id", YUMI_JOINT_STATES),
    _same_id("scene states also from somebody with the same id", YUMI_SCENE_STATES),
)
