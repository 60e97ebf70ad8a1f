"""The commander's lease: every short history of calls, compared with what it must remember."""

from __future__ import annotations

from itertools import product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.deploy.safety.lease import CommanderLease
from skewmi.errors import CommandRefusedError

# Neither is first in the order of both bytes and age, so that no order can pass for identity.
GIDS = (bytes(range(16)), bytes(range(16, 0, -1)), bytes(range(100, 116)))
TIMEOUT = 100


def follow_gripper(lease: CommanderLease, gid: bytes, sequence: int | None = None) -> None:
    """What happens to a gripper command that is fine otherwise; checking alone changes nothing."""
    before = lease.gripper_holder, lease.gripper_sequence
    try:
        lease.check_gripper(gid, sequence)
    finally:
        assert (lease.gripper_holder, lease.gripper_sequence) == before
    lease.renew_gripper(gid, sequence)


def again(gid: bytes) -> bytes:
    """An equal gid that is another object, as every message from the wire brings one."""
    return bytes(bytearray(gid))


def held_by(gid: bytes, sequence: int = 5, now: int = 10) -> CommanderLease:
    lease = CommanderLease(TIMEOUT)
    lease.open(0)
    lease.renew(gid, sequence, now)
    return lease


def test_a_new_lease_is_nobodys_and_does_not_expire() -> None:
    lease = CommanderLease(TIMEOUT)
    assert (lease.holder, lease.sequence) == (None, 0)
    assert (lease.gripper_holder, lease.gripper_sequence) == (None, 0)
    assert not lease.expired(10**18)
    for gid in GIDS:
        lease.check(gid, 0)


@pytest.mark.parametrize("ours", GIDS)
@pytest.mark.parametrize("sender", GIDS)
@pytest.mark.parametrize("sequence", range(8))
def test_only_the_commander_is_heard_and_only_in_order(
    ours: bytes, sender: bytes, sequence: int
) -> None:
    lease = held_by(ours)
    if sender != ours:
        with pytest.raises(CommandRefusedError) as caught:
            lease.check(again(sender), sequence)
        assert str(caught.value) == (
            f"sender {sender.hex()[:8]} is not the commander {ours.hex()[:8]}"
        )
    elif sequence <= 5:
        with pytest.raises(CommandRefusedError, match=rf"^sequence {sequence} does not follow 5:"):
            lease.check(again(sender), sequence)
    else:
        lease.check(again(sender), sequence)
    assert (lease.holder, lease.sequence) == (ours, 5), "checking changes nothing"


@pytest.mark.parametrize("ours", GIDS)
@pytest.mark.parametrize("silence", range(TIMEOUT - 3, TIMEOUT + 4))
@pytest.mark.parametrize("renewed", [0, 10, 10**12])
def test_silence_beyond_the_timeout_frees_the_arm(ours: bytes, silence: int, renewed: int) -> None:
    lease = held_by(ours, now=renewed)
    now = renewed + silence
    assert lease.expired(now) == (silence > TIMEOUT)
    if silence <= TIMEOUT:
        with pytest.raises(CommandRefusedError) as caught:
            lease.open(now)
        assert str(caught.value) == (
            f"commander {ours.hex()[:8]} holds the arm; stop it first (skewmi stop)"
        )
        assert lease.holder == ours
    else:
        lease.open(now)
        assert (lease.holder, lease.sequence) == (None, 0)
        assert not lease.expired(now + TIMEOUT)
        assert lease.expired(now + TIMEOUT + 1), "an open lease that nobody takes up ends, too"


def test_a_clock_far_behind_does_not_free_the_arm() -> None:
    lease = held_by(GIDS[0], now=1000)
    for now in range(0, 1000, 50):
        assert not lease.expired(now)


@pytest.mark.parametrize("ours", GIDS)
@pytest.mark.parametrize("sender", GIDS)
@pytest.mark.parametrize("sequence", [None, *range(1, 8)])
def test_the_gripper_hears_one_sender_in_order(
    ours: bytes, sender: bytes, sequence: int | None
) -> None:
    lease = CommanderLease(TIMEOUT)
    lease.open(0)
    follow_gripper(lease, ours, 5)
    assert (lease.gripper_holder, lease.gripper_sequence) == (ours, 5)
    if sender != ours:
        with pytest.raises(CommandRefusedError) as caught:
            follow_gripper(lease, again(sender), sequence)
        assert str(caught.value) == (
            f"sender {sender.hex()[:8]} is not the gripper's commander {ours.hex()[:8]}"
        )
    elif sequence is not None and sequence <= 5:
        with pytest.raises(
            CommandRefusedError, match=rf"^gripper sequence {sequence} does not follow 5:"
        ):
            follow_gripper(lease, again(sender), sequence)
    else:
        follow_gripper(lease, again(sender), sequence)
    accepted = sender == ours and sequence is not None and sequence > 5
    assert lease.gripper_sequence == (sequence if accepted else 5)
    assert lease.gripper_holder == ours


def test_a_gripper_message_without_a_number_makes_its_sender_the_only_one() -> None:
    lease = CommanderLease(TIMEOUT)
    follow_gripper(lease, GIDS[1])
    assert (lease.gripper_holder, lease.gripper_sequence) == (GIDS[1], 0)
    follow_gripper(lease, again(GIDS[1]), 1)


@pytest.mark.parametrize("first", range(4))
def test_the_first_gripper_message_opens_the_count_from_any_number(first: int) -> None:
    lease = CommanderLease(TIMEOUT)
    follow_gripper(lease, GIDS[1], first)
    for repeated in range(first + 1):
        with pytest.raises(CommandRefusedError):
            follow_gripper(lease, GIDS[1], repeated)
    follow_gripper(lease, GIDS[1], first + 1)


@pytest.mark.parametrize("how", ["close", "open"])
def test_closing_forgets_both_commanders(how: str) -> None:
    lease = held_by(GIDS[0])
    follow_gripper(lease, GIDS[1], 7)
    if how == "close":
        lease.close()
        assert not lease.expired(10**18)
    else:
        lease.open(10 + TIMEOUT + 1)
    assert (lease.holder, lease.sequence) == (None, 0)
    assert (lease.gripper_holder, lease.gripper_sequence) == (None, 0)
    lease.check(GIDS[2], 0)
    follow_gripper(lease, GIDS[2], 1)


@settings(deadline=None)
@given(
    st.lists(
        st.tuples(st.sampled_from(GIDS), st.integers(0, 6), st.integers(1, TIMEOUT + 20)),
        max_size=12,
    )
)
def test_accepted_messages_rise_per_commander_however_they_arrive(
    messages: list[tuple[bytes, int, int]],
) -> None:
    """The law behind both checks, for any history: who is heard is one, and its numbers rise."""
    lease, now = CommanderLease(TIMEOUT), 0
    lease.open(now)
    last: tuple[bytes, int, int] | None = None
    for gid, sequence, later in messages:
        now += later
        if lease.expired(now):
            lease.open(now)
            last = None
        fits = last is None or (gid == last[0] and sequence > last[1] and now - last[2] <= TIMEOUT)
        if fits:
            lease.check(again(gid), sequence)
            lease.renew(again(gid), sequence, now)
            last = (gid, sequence, now)
        else:
            with pytest.raises(CommandRefusedError):
                lease.check(again(gid), sequence)


def test_every_pair_of_numbers() -> None:
    for first, second in product(range(1, 6), repeat=2):
        lease = held_by(GIDS[0], sequence=first)
        follow_gripper(lease, GIDS[1], first)
        if second > first:
            lease.check(GIDS[0], second)
            follow_gripper(lease, GIDS[1], second)
        else:
            with pytest.raises(CommandRefusedError):
                lease.check(GIDS[0], second)
            with pytest.raises(CommandRefusedError):
                follow_gripper(lease, GIDS[1], second)


def test_whoever_shows_that_it_is_there_keeps_the_arm() -> None:
    lease = held_by(GIDS[0])
    lease.extend(TIMEOUT)
    assert not lease.expired(2 * TIMEOUT)
    assert lease.expired(2 * TIMEOUT + 1)
    assert lease.holder == GIDS[0]
