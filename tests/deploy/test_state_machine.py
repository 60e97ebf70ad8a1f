"""The tables of states: every transition, and what no sequence of events can do."""

from __future__ import annotations

from enum import Enum
from itertools import product
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skewmi.deploy.robot.states import (
    ACCEPTS_COMMANDS,
    ENDPOINT_TABLE,
    EndpointEvent,
    EndpointState,
)
from skewmi.deploy.session.states import BRAKING, DAEMON_TABLE, DaemonEvent, DaemonState
from skewmi.deploy.state_machine import StateMachine, TransitionTable
from skewmi.errors import ConfigurationError

PAGE = Path(__file__).parents[2] / "docs" / "deploy-states.md"
MACHINES = [(ENDPOINT_TABLE, EndpointEvent), (DAEMON_TABLE, DaemonEvent)]


@pytest.mark.parametrize(("table", "events"), MACHINES)
def test_every_pair_of_state_and_event_acts_as_its_table_says(table, events) -> None:
    for state, event in product(type(table.initial), events):
        machine = StateMachine(table)
        machine.state = state
        changed = machine.fire(event, "because", stamp_ns=7)
        assert machine.state is table.moves.get((state, event), state)
        assert changed == (machine.state is not state)
        if changed:
            assert machine.reason == "because"
            (transition,) = machine.log
            assert (transition.source, transition.target) == (state, machine.state)
            assert (transition.event, transition.stamp_ns) == (event.value, 7)
        else:
            assert machine.log == []


@given(st.lists(st.sampled_from(EndpointEvent), max_size=30))
def test_endpoint_never_leaves_motion_but_through_rest_or_fault(events) -> None:
    moving = {EndpointState.EXECUTING, EndpointState.STOPPING}
    machine = StateMachine(ENDPOINT_TABLE)
    for event in events:
        before = machine.state
        machine.fire(event, "test", 0)
        if before in moving and machine.state not in moving:
            assert event in (EndpointEvent.AT_REST, EndpointEvent.FAULT)
        if before not in ACCEPTS_COMMANDS:
            assert machine.state is not EndpointState.EXECUTING


@given(st.lists(st.sampled_from(EndpointEvent), max_size=30))
def test_stop_and_rest_always_disarm_the_endpoint(events) -> None:
    machine = StateMachine(ENDPOINT_TABLE)
    for event in [*events, EndpointEvent.STOP, EndpointEvent.AT_REST]:
        machine.fire(event, "test", 0)
    assert machine.state is EndpointState.DISARMED


@given(st.lists(st.sampled_from(DaemonEvent), max_size=40))
def test_daemon_runs_only_after_preflight_and_start_motion(events) -> None:
    machine = StateMachine(DAEMON_TABLE)
    visited = [machine.state]
    for event in events:
        if machine.fire(event, "test", 0):
            visited.append(machine.state)  # noqa: PERF401
    for index, state in enumerate(visited):
        if state is DaemonState.RUNNING:
            assert visited[index - 2 : index] == [DaemonState.PREFLIGHT, DaemonState.TO_START]
        if state is DaemonState.HOLDING:
            assert visited[index - 1] in BRAKING


def test_every_daemon_state_can_end_and_done_is_final() -> None:
    for state in DaemonState:
        assert DaemonState.DONE in DAEMON_TABLE.reachable(state)
    assert DAEMON_TABLE.reachable(DaemonState.DONE) == {DaemonState.DONE}


def test_every_daemon_state_that_can_move_the_arm_answers_a_fault() -> None:
    for state in (DaemonState.TO_START, DaemonState.RUNNING, *BRAKING):
        assert DAEMON_TABLE.next(state, DaemonEvent.FAULT) is DaemonState.FAULT


@pytest.mark.parametrize(("table", "events"), MACHINES)
def test_the_page_shows_the_table(table, events) -> None:
    assert table.markdown(events) in PAGE.read_text()


def test_log_keeps_the_newest() -> None:
    machine = StateMachine(ENDPOINT_TABLE, log_limit=4)
    for stamp in range(10):
        event = EndpointEvent.ARM if stamp % 2 == 0 else EndpointEvent.STOP
        machine.fire(event, "test", stamp)
    assert [transition.stamp_ns for transition in machine.log] == [6, 7, 8, 9]


def test_callback_sees_each_transition_once() -> None:
    seen = []
    machine = StateMachine(ENDPOINT_TABLE, seen.append)
    machine.fire(EndpointEvent.STOP, "nothing to stop", 1)
    machine.fire(EndpointEvent.ARM, "test", 2)
    assert seen == machine.log
    assert str(seen[0]) == "disarmed -> holding (arm: test)"


class Light(Enum):
    RED = "red"
    GREEN = "green"


def test_table_with_a_state_that_nothing_leads_to_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="green"):
        TransitionTable(Light.RED, {(Light.GREEN, Light.RED): Light.RED})
