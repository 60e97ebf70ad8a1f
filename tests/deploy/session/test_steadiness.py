"""How old states may be, and what is done on a computer that does not keep up."""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skewmi.deploy import run as deploy_run
from skewmi.deploy.options import DeployOptions
from skewmi.deploy.report import DeployReport, EpisodeReport
from skewmi.deploy.session import steadiness
from skewmi.deploy.session.observer import (
    MAX_JOINT_AGE_S,
    MOST_JOINT_AGE_S,
    Observer,
    allowed_age_s,
)
from skewmi.deploy.session.scene_states import StaleStateError
from skewmi.deploy.session.session import Session
from skewmi.deploy.session.steadiness import ENOUGH, TooBusyError, check_steadiness
from skewmi.deploy.session.timing import BUSY_ADVICE, CycleTimes
from skewmi.sim.tasks.open_press_close.definition import make_layout

ADVICE = ("--lead-ms", "--lock-step", "skewmi doctor")


def empty_report(*, lock_step: bool) -> DeployReport:
    """Of a run that has not begun."""
    return DeployReport(
        task="",
        robot="",
        limit_profile="",
        speed=1.0,
        lock_step=lock_step,
        dry_run=False,
        velocity_fraction=1.0,
        planned_episodes=2,
    )


@given(st.floats(0.008, 0.1), st.floats(0.008, 0.1))
def test_a_longer_lead_admits_older_states_up_to_a_bound(one: float, other: float) -> None:
    short, long = sorted((one, other))
    assert MAX_JOINT_AGE_S <= allowed_age_s(short) <= allowed_age_s(long) <= MOST_JOINT_AGE_S
    assert allowed_age_s(long) > long, "a state may be older than the lead"


def test_ages_at_the_ends() -> None:
    assert allowed_age_s(0.024) == MAX_JOINT_AGE_S == 0.1
    assert allowed_age_s(0.1) == MOST_JOINT_AGE_S == pytest.approx(0.3)


@pytest.mark.parametrize("max_age_s", [0.02, 0.05])
def test_states_that_do_not_come_stop_the_arm_with_advice(max_age_s: float) -> None:
    silent = SimpleNamespace(drain=list, others=str)
    observer = Observer(
        silent,
        SimpleNamespace(),
        SimpleNamespace(),
        make_layout(),
        lock_step=False,
        state_period_s=0.02,
        max_age_s=max_age_s,
    )
    started = time.monotonic()
    with pytest.raises(StaleStateError) as raised:
        observer.next_state()
    assert time.monotonic() - started >= max_age_s
    assert "no new joint state for" in str(raised.value)
    assert f"at most {1e3 * max_age_s:.0f} ms are allowed" in str(raised.value)
    assert all(words in str(raised.value) for words in ADVICE)


class States:
    """An observer whose states come so far apart."""

    max_age_s = 0.1

    def __init__(self, *gaps_s: float) -> None:
        self._gaps = list(gaps_s)
        self.asked = 0

    def forget(self) -> None:
        """Nothing has come."""

    def next_state(self) -> None:
        self.asked += 1
        if self._gaps:
            gap_s = self._gaps.pop(0)
            time.sleep(min(gap_s, self.max_age_s))
            if gap_s > self.max_age_s:
                raise StaleStateError("none came")
        else:
            time.sleep(0.001)


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What is granted, and a watch that is over sooner."""
    granted = ["gc frozen"]

    class HotLoop:
        def __init__(self, *, priority: bool) -> None:
            assert priority

        def __enter__(self) -> list[str]:
            return granted

        def __exit__(self, *_: object) -> None:
            """Nothing was changed."""

    monkeypatch.setattr(steadiness, "hot_loop", HotLoop)
    monkeypatch.setattr(steadiness, "WATCHED_S", 0.15)
    return granted


@pytest.mark.parametrize("gap_s", [0.06, 0.2])
def test_a_gap_is_noticed_and_told_with_advice(watched: list[str], gap_s: float) -> None:
    with pytest.raises(TooBusyError) as raised:
        check_steadiness(States(0.001, gap_s), lambda: None)
    assert all(words in str(raised.value) for words in ADVICE)
    assert "50 ms are allowed" in str(raised.value)
    assert ENOUGH * States.max_age_s == 0.05


def test_what_every_cycle_does_counts(watched: list[str]) -> None:
    with pytest.raises(TooBusyError):
        check_steadiness(States(), lambda: time.sleep(0.08))


def test_with_a_priority_nothing_is_watched(watched: list[str]) -> None:
    watched.append("SCHED_FIFO")
    states = States(0.2)
    check_steadiness(states, lambda: None)
    assert states.asked == 0


def test_a_robot_that_can_wait_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """The run begins again in lock-step, and says so."""
    told: list[str] = []
    runs: list[DeployOptions] = []

    def run(policy: object, options: DeployOptions, *_: object) -> DeployReport:
        runs.append(options)
        if not options.lock_step:
            raise TooBusyError("this computer is too busy")
        return empty_report(lock_step=True)

    monkeypatch.setattr(deploy_run, "_run", run)
    policy = SimpleNamespace(layout=make_layout())
    report = deploy_run.run_deploy(policy, DeployOptions(seed=3), on_event=told.append)
    assert [(options.lock_step, options.seed) for options in runs] == [(False, 3), (True, 3)]
    (note,) = report.notes
    assert told == [note]
    assert "too busy" in note
    assert "--lock-step" in note


@pytest.mark.parametrize("can_wait", [True, False])
@pytest.mark.parametrize(
    ("outcome", "reason", "late"),
    [
        ("stopped", f"no new joint state for 100 ms; {BUSY_ADVICE}", True),
        ("stopped", "skewmi stop", False),
        ("success", "the task is solved", False),
    ],
)
def test_a_run_that_comes_too_late_is_given_up_where_the_robot_can_wait(
    outcome: str, reason: str, late: bool, can_wait: bool
) -> None:
    """Anywhere else the next episode follows."""
    report = empty_report(lock_step=False)

    def run(index: int) -> tuple[EpisodeReport, bool]:
        return EpisodeReport(index, outcome, reason, 3, 0, {}), True

    senders = SimpleNamespace(strangers=lambda: ())
    session = Session(
        DeployOptions(episodes=2, lock_step=True),
        cast(Any, SimpleNamespace(run=run)),
        cast(Any, SimpleNamespace(fire=lambda event, why: None)),
        cast(Any, SimpleNamespace(senders=senders)),
        cast(Any, SimpleNamespace(usage=None, missed_cycles=0)),
        CycleTimes(),
        report,
        threading.Event(),
        can_wait,
        lambda text: None,
    )
    if late and can_wait:
        with pytest.raises(TooBusyError, match="no new joint state"):
            session.run()
        assert len(report.episodes) == 1
    else:
        session.run()
        assert len(report.episodes) == 2
