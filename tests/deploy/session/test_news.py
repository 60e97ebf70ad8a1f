"""The session's status on the wire: what goes in comes out, and nonsense is refused."""

from __future__ import annotations

import itertools

import pytest

from skewmi.deploy.session.news import SessionNews
from skewmi.deploy.session.states import STATUS_NAME, SessionEvent, SessionState
from skewmi.deploy.wire.messages import ERROR, OK, WARN, Status, decode_status, encode_status
from skewmi.errors import TransportError


def test_what_is_encoded_is_decoded() -> None:
    for state, source, event in itertools.product(SessionState, SessionState, SessionEvent):
        news = SessionNews(7_000_000_001, state, "because", source, event)
        assert SessionNews.decode(news.encode()) == news


def test_keys_and_level_on_the_wire_are_what_others_read() -> None:
    levels = {SessionState.FAULT: ERROR, SessionState.STOPPING: WARN}
    for state in SessionState:
        news = SessionNews(7, state, "because", SessionState.RUNNING, SessionEvent.STOP)
        sent = decode_status(news.encode())
        assert (sent.name, sent.message) == ("skewmi_deploy", f"{state.value}: because")
        assert sent.level == levels.get(state, OK)
        assert sent.values == {
            "state": state.value,
            "reason": "because",
            "from": "running",
            "event": "stop",
        }


def test_others_statuses_are_not_ours_and_nonsense_is_refused() -> None:
    assert SessionNews.decode(encode_status(Status(0, "skewmi_robot", OK, "", {}))) is None
    for values in ({}, {"state": "asleep", "reason": "", "from": "running", "event": "stop"}):
        with pytest.raises(TransportError, match="status cannot be read"):
            SessionNews.decode(encode_status(Status(0, STATUS_NAME, OK, "", values)))
