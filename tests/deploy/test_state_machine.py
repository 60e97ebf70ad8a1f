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
    SERVER_TABLE,
    ServerEvent,
    ServerState,
)
from skewmi.deploy.session.states import BRAKING, SESSION_TABLE, SessionEvent, SessionState
from skewmi.deploy.state_machine import StateMachine, TransitionTable
from skewmi.errors import ConfigurationError

PAGE = Path(__file__).parents[2] / "docs" / "deploy-states.md"
MACHINES = [(SERVER_TABLE, ServerEvent), (SESSION_TABLE, SessionEvent)]


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


@given(st.lists(st.sampled_from(ServerEvent), max_size=30))
def test_robot_server_never_leaves_motion_but_through_rest_or_fault(events) -> None:
    moving = {ServerState.EXECUTING, ServerState.STOPPING}
    machine = StateMachine(SERVER_TABLE)
    for event in events:
        before = machine.state
        machine.fire(event, "test", 0)
        if before in moving and machine.state not in moving:
            assert event in (ServerEvent.AT_REST, ServerEvent.FAULT)
        if before not in ACCEPTS_COMMANDS:
            assert machine.state is not ServerState.EXECUTING


@given(st.lists(st.sampled_from(ServerEvent), max_size=30))
def test_stop_and_rest_always_disarm_the_robot_server(events) -> None:
    machine = StateMachine(SERVER_TABLE)
    for event in [*events, ServerEvent.STOP, ServerEvent.AT_REST]:
        machine.fire(event, "test", 0)
    assert machine.state is ServerState.DISARMED


@given(st.lists(st.sampled_from(SessionEvent), max_size=40))
def test_session_runs_only_after_preflight_and_start_motion(events) -> None:
    machine = StateMachine(SESSION_TABLE)
    visited = [machine.state]
    for event in events:
        if machine.fire(event, "test", 0):
            visited.append(machine.state)  # noqa: PERF401
    for index, state in enumerate(visited):
        if state is SessionState.RUNNING:
            assert visited[index - 2 : index] == [SessionState.PREFLIGHT, SessionState.TO_START]
        if state is SessionState.HOLDING:
            assert visited[index - 1] in BRAKING


def test_every_session_state_can_end_and_done_is_final() -> None:
    for state in SessionState:
        assert SessionState.DONE in SESSION_TABLE.reachable(state)
    assert SESSION_TABLE.reachable(SessionState.DONE) == {SessionState.DONE}


def test_every_session_state_that_can_move_the_arm_answers_a_fault() -> None:
    for state in (SessionState.TO_START, SessionState.RUNNING, *BRAKING):
        assert SESSION_TABLE.next(state, SessionEvent.FAULT) is SessionState.FAULT


@pytest.mark.parametrize(("table", "events"), MACHINES)
def test_the_page_shows_the_table(table, events) -> None:
    assert table.markdown(events) in PAGE.read_text()


def test_log_keeps_the_newest() -> None:
    machine = StateMachine(SERVER_TABLE, log_limit=4)
    for stamp in range(10):
        event = ServerEvent.ARM if stamp % 2 == 0 else ServerEvent.STOP
        machine.fire(event, "test", stamp)
    assert [transition.stamp_ns for transition in machine.log] == [6, 7, 8, 9]


def test_callback_sees_each_transition_once() -> None:
    seen = []
    machine = StateMachine(SERVER_TABLE, seen.append)
    machine.fire(ServerEvent.STOP, "nothing to stop", 1)
    machine.fire(ServerEvent.ARM, "test", 2)
    assert seen == machine.log
    assert str(seen[0]) == "disarmed -> holding (arm: test)"


class Light(Enum):
    RED = "red"
    GREEN = "green"


def test_table_with_a_state_that_nothing_leads_to_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="green"):
        TransitionTable(Light.RED, {(Light.GREEN, Light.RED): Light.RED})
