"""What a session makes of refusals, whichever statuses reach it."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.deploy.robot.refusals import Refusal, Refusals
from skewmi.deploy.robot.states import ServerState
from skewmi.deploy.robot.status import RobotStatus
from skewmi.deploy.session.refused import LateChunkError
from skewmi.deploy.session.robot_client import RobotClient
from skewmi.errors import CommandRefusedError

OURS = b"o" * 16
PREFIX = "the robot server refused a command: "


class Publisher:
    gid = OURS


class Inbox:
    """Statuses that reached the session."""

    def __init__(self) -> None:
        self.samples: list[Inbox] = []

    def drain(self) -> list[Inbox]:
        samples, self.samples = self.samples, []
        return samples

    def put(self, payload: bytes) -> None:
        sample = Inbox()
        sample.payload = payload
        self.samples.append(sample)

    payload = b""


class Everybody:
    """A trust that nobody disturbs."""

    server = ""

    def look(self) -> None:
        """Nobody else is heard."""


def open_client(inbox: Inbox) -> RobotClient:
    publishers = Publisher(), Publisher()
    return RobotClient(None, Everybody(), *publishers, inbox, dry_run=False)  # type: ignore[arg-type]


def told(refusals: Refusals) -> RobotStatus:
    """As the robot server's publisher makes a status."""
    untold = refusals.take()
    return RobotStatus(
        0,
        ServerState.EXECUTING,
        "",
        refused=refusals.count,
        refusal="; ".join(refusal.reason for refusal in untold[:3]),
        out_of_step=all(r.out_of_step for r in untold if r.of_commander),
        refused_of_commander=refusals.of_commander,
        broken_of_commander=refusals.broken_of_commander,
        last_refusal=refusals.last_of_commander,
        commander=OURS,
    )


REFUSALS = st.builds(
    Refusal,
    reason=st.sampled_from(["", "\x00\n", "joint jerk: 2 is outside the bound 1", "late"]),
    out_of_step=st.booleans(),
    of_commander=st.booleans(),
)
ROUNDS = st.lists(st.tuples(st.lists(REFUSALS, max_size=4), st.booleans()), max_size=8)
"""What is refused between two statuses, and whether the second one arrives."""


@settings(deadline=None, max_examples=300)
@given(ROUNDS)
def test_whatever_is_lost_a_refusal_has_a_reason_and_a_broken_command_is_no_late_one(
    rounds: list[tuple[list[Refusal], bool]],
) -> None:
    refusals, inbox = Refusals(), Inbox()
    client = open_client(inbox)
    untold: list[Refusal] = []
    for refused, arrives in [*rounds, ([], True)]:
        for refusal in refused:
            refusals.note(refusal)
        untold += [refusal for refusal in refused if refusal.of_commander]
        status = told(refusals)
        if not arrives:
            continue
        inbox.put(status.encode())
        if not untold:
            client.check(late_is_final=False)
            continue
        with pytest.raises(CommandRefusedError) as raised:
            client.check(late_is_final=False)
        late = all(refusal.out_of_step for refusal in untold)
        assert isinstance(raised.value, LateChunkError) is late
        assert str(raised.value).removeprefix(PREFIX).strip()
        untold = []


def test_late_ones_are_final_where_the_robot_waits() -> None:
    refusals, inbox = Refusals(), Inbox()
    client = open_client(inbox)
    refusals.note(Refusal("too late", out_of_step=True, of_commander=True))
    inbox.put(told(refusals).encode())
    with pytest.raises(CommandRefusedError, match="too late") as raised:
        client.check(late_is_final=True)
    assert not isinstance(raised.value, LateChunkError)


def test_a_status_of_an_older_robot_server_without_a_reason_says_so() -> None:
    inbox = Inbox()
    client = open_client(inbox)
    status = RobotStatus(0, ServerState.HOLDING, "", refused_of_commander=1, commander=OURS)
    inbox.put(status.encode())
    with pytest.raises(LateChunkError, match="its reason was lost on the way"):
        client.check(late_is_final=False)


def test_a_broken_command_ends_a_recovery(monkeypatch: pytest.MonkeyPatch) -> None:
    refusals, inbox = Refusals(), Inbox()
    client = open_client(inbox)
    at_rest = type("At", (), {"state": "holding", "commanded_position": (0.0,) * 7, "reason": ""})
    monkeypatch.setattr(client, "_ask", lambda: at_rest)
    refusals.note(Refusal("too late", out_of_step=True, of_commander=True))
    inbox.put(told(refusals).encode())
    assert client.wait_for_hold().shape == (7,)
    refusals.note(Refusal("joint jerk", of_commander=True))
    inbox.put(told(refusals).encode())
    with pytest.raises(CommandRefusedError, match="joint jerk"):
        client.wait_for_hold()
