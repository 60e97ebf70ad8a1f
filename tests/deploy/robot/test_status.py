"""The robot server's status on the wire: what goes in comes out, and nonsense is refused."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.deploy.robot.states import ServerEvent, ServerState
from skewmi.deploy.robot.status import STATUS_NAME, RobotStatus
from skewmi.deploy.wire.messages import ERROR, OK, WARN, Status, decode_status, encode_status
from skewmi.errors import TransportError

COUNTS = st.integers(0, 2**40)
TEXTS = st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=40)
CHANGES = st.one_of(
    st.just((None, None)),
    st.tuples(st.sampled_from(ServerState), st.sampled_from(ServerEvent)),
)


@settings(deadline=None)
@given(
    state=st.sampled_from(ServerState),
    counts=st.tuples(COUNTS, COUNTS, COUNTS, COUNTS, COUNTS, COUNTS),
    texts=st.tuples(TEXTS, TEXTS, TEXTS),
    stamps=st.lists(st.none() | st.integers(-1, 2**62), max_size=5),
    late=st.booleans(),
    commander=st.just(b"") | st.binary(min_size=16, max_size=16),
    change=CHANGES,
)
def test_what_is_encoded_is_decoded(state, counts, texts, stamps, late, commander, change) -> None:
    accepted, refused, of_commander, slips, broken, dropped = counts
    status = RobotStatus(
        stamp_ns=123_456_789_000,
        state=state,
        reason=texts[0],
        accepted=accepted,
        refused=refused,
        refusal=texts[1],
        refused_stamps_ns=tuple(stamps),
        out_of_step=late,
        refused_of_commander=of_commander,
        commander=commander,
        slips=slips,
        broken_of_commander=broken,
        last_refusal=texts[2],
        dropped=dropped,
        workspace=texts[2],
        cycles_untold=slips,
        source=change[0],
        event=change[1],
    )
    assert RobotStatus.decode(status.encode()) == status


def test_keys_and_level_on_the_wire_are_what_others_read() -> None:
    status = RobotStatus(
        7,
        ServerState.HOLDING,
        "armed",
        refused_stamps_ns=(5, None),
        commander_refused_stamps_ns=(5, 9),
    )
    sent = decode_status(status.encode())
    assert (sent.name, sent.level, sent.message) == ("skewmi_robot", OK, "holding: armed")
    assert sent.values == {
        "state": "holding",
        "reason": "armed",
        "accepted": "0",
        "refused": "0",
        "refusal": "",
        "refused_stamps_ns": "5 None",
        "out_of_step": "True",
        "refused_of_commander": "0",
        "commander": "",
        "slips": "0",
        "broken_of_commander": "0",
        "last_refusal": "",
        "dropped": "0",
        "commander_refused_stamps_ns": "5 9",
        "workspace": "task",
        "cycles_untold": "0",
    }
    told = RobotStatus(
        7, ServerState.FAULT, "", source=ServerState.HOLDING, event=ServerEvent.FAULT
    )
    sent = decode_status(told.encode())
    assert (sent.level, sent.values["from"], sent.values["event"]) == (ERROR, "holding", "fault")
    assert decode_status(RobotStatus(7, ServerState.HOLDING, "", refused=1).encode()).level == WARN


def test_others_statuses_are_not_ours() -> None:
    assert RobotStatus.decode(encode_status(Status(0, "camera", OK, "", {}))) is None


@pytest.mark.parametrize(
    "change",
    [
        {"state": "asleep"},
        {"accepted": "many"},
        {"commander": "xyz"},
        {"refused_stamps_ns": "soon"},
        {"from": "bed", "event": "alarm"},
    ],
)
def test_nonsense_of_that_name_is_refused(change: dict[str, str]) -> None:
    good = decode_status(RobotStatus(0, ServerState.HOLDING, "armed").encode())
    wrong = encode_status(Status(0, STATUS_NAME, OK, "", good.values | change))
    with pytest.raises(TransportError, match="status cannot be read"):
        RobotStatus.decode(wrong)
    with pytest.raises(TransportError, match="status cannot be read"):
        RobotStatus.decode(encode_status(Status(0, STATUS_NAME, OK, "", {})))
