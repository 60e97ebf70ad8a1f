"""Which packets count and where sessions begin, and what the bridge then says is missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.deploy.robot.backends.egm.clock import NOMINAL_PERIOD_NS, ControllerClock
from skewmi.deploy.robot.backends.egm.packets import FeedbackPacket, Mci, Motors, Rapid
from skewmi.deploy.robot.backends.egm.session import Accepted, Ignored, Received, judge
from skewmi.deploy.robot.backends.egm.states import EGM_TABLE, EgmEvent, EgmState
from skewmi.deploy.robot.backends.egm.watch import ControllerWatch

CYCLE_US = 4032
SENDER = ("192.168.125.1", 6599)
START_US = 1_700_000_000_000_000


def packet(number: int, **changes: object) -> FeedbackPacket:
    """The packet of cycle `number`."""
    base = FeedbackPacket(
        sequence=number,
        q=np.zeros(7),
        motors=Motors.ON,
        mci=Mci.RUNNING,
        rapid=Rapid.RUNNING,
        clock_us=START_US + number * CYCLE_US,
    )
    return replace(base, **changes)  # type: ignore[arg-type]


def received(number: int, late_ms: float = 0.0, **changes: object) -> Received:
    at_ns = number * CYCLE_US * 1000 + int(late_ms * 1e6)
    return Received(packet(number, **changes), SENDER, at_ns, at_ns)


def test_every_next_packet_counts_once() -> None:
    assert judge(received(8), received(7)) == Accepted(1, "")


@settings(deadline=None)
@given(st.integers(2, 24))
def test_lost_packets_are_cycles_all_the_same(lost: int) -> None:
    assert judge(received(7 + lost), received(7)) == Accepted(lost, "")


def test_the_sequence_goes_round() -> None:
    before, after = received(7, sequence=2**32 - 1), received(8, sequence=0)
    assert judge(after, before) == Accepted(1, "")


@pytest.mark.parametrize(
    ("now", "before", "why"),
    [
        (received(7, 3), received(7), "duplicate"),
        (received(6, 6), received(7), "overtaken"),
        (received(8, clock_us=None), received(7), "6.07.01"),
        (replace(received(8), sender=("192.168.125.1", 1)), received(7), "while 192.168.125.1"),
    ],
)
def test_packets_that_do_not_count(now: Received, before: Received, why: str) -> None:
    verdict = judge(now, before)
    assert isinstance(verdict, Ignored)
    assert why in verdict.why


@pytest.mark.parametrize(
    ("now", "before", "why"),
    [
        (received(7), None, "first"),
        (received(8, sequence=0), received(7), "starts again at 0"),
        (received(8, sequence=7), received(7), "starts again at 7"),
        (received(8, sequence=100), received(7), "jumped by 93"),
        (received(40), received(7), "no packet for 0.13 s"),
        (received(8), received(7, motors=Motors.OFF), "follows references from now on"),
        (received(8), received(7, mci=Mci.STOPPED), "follows references from now on"),
        (received(8), received(7, mci=Mci.ERROR), "follows references from now on"),
        (received(8), received(7, rapid=Rapid.STOPPED), "follows references from now on"),
        (replace(received(40), sender=("192.168.125.1", 1)), received(7), "no packet for"),
        (
            replace(received(8), read_ns=received(40).read_ns),
            received(7),
            "this computer was held up for 0.13 s",
        ),
    ],
)
def test_where_a_session_begins(now: Received, before: Received | None, why: str) -> None:
    verdict = judge(now, before)
    assert isinstance(verdict, Accepted)
    assert why in verdict.begins


def test_a_restarted_controller_may_say_that_rapid_is_undefined() -> None:
    watch = watched(received(0, rapid=Rapid.UNDEFINED))
    assert watch.state is EgmState.RAMPING


def watched(*packets: Received, ramp_ms: int = 100) -> ControllerWatch:
    watch = ControllerWatch(ramp_ms * 1_000_000, 0)
    for one in packets:
        watch.note(one)
    return watch


def test_missing_steps_are_told_in_order() -> None:
    watch = watched()
    steps = [(watch.readiness(), "no packet")]
    for number, changes in enumerate(
        (
            {"clock_us": None},
            {"motors": Motors.OFF, "rapid": Rapid.STOPPED, "mci": Mci.STOPPED},
            {"rapid": Rapid.STOPPED, "mci": Mci.STOPPED},
            {"mci": Mci.STOPPED},
            {"mci": Mci.ERROR},
            {},
        )
    ):
        watch.note(received(number, **changes))
        steps.append((watch.readiness(), ""))
    words = ("no packet", "6.07.01", "motors", "RAPID", "not running", "EGM error", "ramp")
    for (missing, _), word in zip(steps, words, strict=True):
        assert missing is not None
        assert word in missing
    for number in range(6, 40):
        watch.note(received(number))
    assert watch.readiness() is None


def test_a_program_that_an_error_has_stopped_is_told_with_it() -> None:
    watch = watched(received(0, rapid=Rapid.STOPPED, mci=Mci.ERROR))
    missing = watch.readiness()
    assert missing is not None
    assert "RAPID program is stopped, after an EGM error" in missing


def test_ramp_is_held_after_each_beginning() -> None:
    watch = watched(*(received(n) for n in range(40)))
    assert watch.state is EgmState.GUIDING
    watch.note(received(40, sequence=0))
    assert watch.state is EgmState.RAMPING
    assert watch.sessions == 2
    for number in range(1, 24):
        watch.note(received(40 + number, sequence=number))
    assert watch.readiness() is not None
    for number in range(24, 30):
        watch.note(received(40 + number, sequence=number))
    assert watch.readiness() is None


def test_peaks_of_utilization_pass_and_more_does_not() -> None:
    watch = watched(*(received(n) for n in range(40)))
    for number in range(40, 60):
        watch.note(received(number, utilization=400.0 if number % 5 == 0 else 20.0))
        assert watch.state is EgmState.GUIDING
    for number in range(60, 90):
        watch.note(received(number, utilization=120.0))
    assert watch.state is EgmState.OVERLOADED
    assert "utilisation" in str(watch.readiness())
    watch.note(received(90, utilization=50.0))
    assert watch.state is EgmState.GUIDING


def test_silence_is_noticed_and_what_follows_is_a_new_session() -> None:
    watch = watched(*(received(n) for n in range(40)))
    last_ns = received(39).arrival_ns
    watch.note_time(last_ns + 99_000_000)
    assert watch.state is EgmState.GUIDING
    watch.note_time(last_ns + 100_000_000)
    assert watch.state is EgmState.SILENT
    assert "0.1 s" in str(watch.readiness())
    noted = watch.note(received(70))
    assert noted.accepted
    assert "no packet for" in noted.begins


def test_what_is_of_no_use_is_told_and_forgotten() -> None:
    watch = watched()
    watch.note_unusable("3 bytes that are no EgmRobot", 1_000)
    assert watch.state is EgmState.REFUSED
    assert watch.readiness() == "3 bytes that are no EgmRobot"
    watch.note_time(200_000_000)
    assert watch.state is EgmState.SILENT
    watch.note(received(100))
    watch.note_unusable("strangers do not disturb a session", 404_000_000)
    assert watch.state is EgmState.RAMPING


@pytest.mark.parametrize("looks", [range(1, 101), range(100, 101)], ids=["often", "once"])
def test_what_is_wrong_with_datagrams_is_told_as_soon_as_they_are_missed(looks: range) -> None:
    watch = watched(*(received(n) for n in range(40)))
    last_ns = received(39).arrival_ns
    for ms in range(1, 101):
        watch.note_unusable("a joint that is not a finite number", last_ns + ms * 1_000_000)
        if ms in looks:
            watch.note_time(last_ns + ms * 1_000_000)
    assert watch.state is EgmState.REFUSED
    assert watch.readiness() == "a joint that is not a finite number"


def test_clock_follows_the_packets_time_and_never_goes_back() -> None:
    rng = np.random.default_rng(3)
    clock = ControllerClock(1_000)
    clock.begin(START_US, 0)
    told, shown = [0.0], [clock.time_ns - 1_000]
    tick = 0
    while tick < 5000:
        # 0.5 % of the packets are lost, and the times have 100 us of jitter.
        step = 2 if rng.random() < 0.005 else 1
        tick += step
        true_us = tick * 4032.0 * 1.003
        clock.advance(step, START_US + int(true_us + rng.normal(0.0, 100.0)))
        told.append(true_us * 1000)
        shown.append(clock.time_ns - 1_000)
    error = np.array(shown) - np.array(told)
    assert np.all(np.diff(shown) > 0)
    assert np.abs(error[1000:]).max() < 150e3
    assert clock.period_ns == pytest.approx(NOMINAL_PERIOD_NS * 1.003, rel=0.01)


def test_clock_does_not_follow_somebody_who_sets_it() -> None:
    clock = ControllerClock(0)
    clock.begin(START_US, 0)
    for tick in range(1, 500):
        clock.advance(1, START_US + tick * CYCLE_US + (0 if tick < 250 else -3_600_000_000))
    assert clock.time_ns == pytest.approx(499 * CYCLE_US * 1000, rel=1e-6)


def test_clock_takes_slower_sampling_from_the_first_packets() -> None:
    clock = ControllerClock(0)
    clock.begin(START_US, 0)
    clock.advance(1, START_US + 2 * CYCLE_US)
    assert clock.period_ns == pytest.approx(2 * CYCLE_US * 1000)


@settings(deadline=None)
@given(st.lists(st.sampled_from(EgmEvent), max_size=30))
def test_only_a_session_and_its_ramp_lead_to_guiding(events: list[EgmEvent]) -> None:
    state, ramped = EgmState.SILENT, False
    for event in events:
        state = EGM_TABLE.next(state, event)
        if event in (EgmEvent.SESSION, EgmEvent.NOT_GUIDED, EgmEvent.SILENCE):
            ramped = False
        ramped = ramped or (event is EgmEvent.RAMPED and state is EgmState.GUIDING)
        if state in (EgmState.GUIDING, EgmState.OVERLOADED):
            assert ramped
