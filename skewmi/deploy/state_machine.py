"""State machines as complete tables: every state answers every event, and says why it moved.

The tables of the session (`session.states`) and of the robot server (`robot.states`) are plain
data. `docs/deploy-states.md` shows them, and a test keeps page and tables equal.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Generic, TypeVar

from skewmi.errors import ConfigurationError

S = TypeVar("S", bound=Enum)
E = TypeVar("E", bound=Enum)


@dataclass(frozen=True)
class Transition(Generic[S]):
    """One change of state.

    `stamp_ns` is the time of the machine's owner: the server's clock for the server, and the
    newest robot server stamp the session has seen for the session.
    """

    stamp_ns: int
    source: S
    target: S
    event: str
    reason: str

    def __str__(self) -> str:
        return f"{self.source.value} -> {self.target.value} ({self.event}: {self.reason})"


class TransitionTable(Generic[S, E]):
    """Which event leads where. Pairs that are not listed leave the state as it is.

    Args:
        initial: The state to start in.
        moves: (state, event) -> next state.

    Raises:
        ConfigurationError: A state cannot be reached from `initial`.
    """

    def __init__(self, initial: S, moves: Mapping[tuple[S, E], S]) -> None:
        self.initial = initial
        self.moves = dict(moves)
        unreachable = [state for state in type(initial) if state not in self.reachable(initial)]
        if unreachable:
            raise ConfigurationError(
                f"states {[state.value for state in unreachable]} cannot be reached from "
                f"{initial.value!r}"
            )

    def next(self, state: S, event: E) -> S:
        return self.moves.get((state, event), state)

    def reachable(self, start: S) -> set[S]:
        """Every state that some sequence of events leads to from `start`, itself included."""
        found = {start}
        while True:
            more = {target for (source, _), target in self.moves.items() if source in found}
            if more <= found:
                return found
            found |= more

    def markdown(self, events: type[E]) -> str:
        """The table as Markdown: one row per state, one column per event, `.` for no change."""
        names = [event.value for event in events]
        lines = ["| state | " + " | ".join(names) + " |", "|---" * (len(names) + 1) + "|"]
        for state in type(self.initial):
            targets = (self.next(state, event) for event in events)
            cells = ["." if target is state else target.value for target in targets]
            lines.append(f"| **{state.value}** | " + " | ".join(cells) + " |")
        return "\n".join(lines)


class StateMachine(Generic[S, E]):
    """A table, its present state and the log of what happened.

    Not thread-safe: its owner's loop alone fires events.

    Args:
        table: Which event leads where.
        on_transition: Called after every change of state; must not raise.
        log_limit: Oldest transitions beyond this many are dropped.
    """

    def __init__(
        self,
        table: TransitionTable[S, E],
        on_transition: Callable[[Transition[S]], None] | None = None,
        log_limit: int = 10_000,
    ) -> None:
        self.table = table
        self.state = table.initial
        self.reason = "started"
        self.log: list[Transition[S]] = []
        self.on_transition = on_transition
        self._log_limit = log_limit

    def fire(self, event: E, reason: str, stamp_ns: int) -> bool:
        """Let an event act. Returns whether the state changed."""
        source = self.state
        target = self.table.next(source, event)
        if target is source:
            return False
        self.state = target
        self.reason = reason
        transition = Transition(stamp_ns, source, target, event.value, reason)
        if len(self.log) >= self._log_limit:
            del self.log[0]
        self.log.append(transition)
        if self.on_transition is not None:
            self.on_transition(transition)
        return True
