"""Rows of the matrix: a fault, and what must come of it in each column."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

from fault_cell import AS_ASKED, Fault, Phase

EGM_COLUMN = "running, EGM bridge + emulator"


class Seen(Protocol):
    """What cells are judged by."""

    @property
    def verdict(self) -> str: ...

    @property
    def said(self) -> str: ...


@dataclass(frozen=True)
class Expect:
    """What must be observed."""

    verdict: str
    """One, or several with " or " between, where a race decides."""
    says: str = ""
    """Words that report or status must contain."""

    def matches(self, observed: Seen) -> bool:
        """Whether it is what was observed."""
        return observed.verdict in self.verdict.split(" or ") and self.says in observed.said

    def text(self) -> str:
        return f"**{self.verdict}**" + (f": {self.says}" if self.says else "")


@dataclass(frozen=True)
class DoesNotApply:
    """Why a fault cannot happen in a phase."""

    why: str

    def text(self) -> str:
        return f"– ({self.why})"


@dataclass(frozen=True)
class Case:
    """One cell: what is done, and what is expected."""

    column: str
    fault: Fault
    phase: Phase
    expect: Expect


@dataclass(frozen=True)
class Row:
    """A fault, the expectations, and how a user goes on."""

    fault: Fault
    start: Expect | DoesNotApply
    running: Expect | DoesNotApply
    stopping: Expect | DoesNotApply
    hardest: Phase = Phase.RUNNING
    """Where the fast tests try it."""
    go_on: str = "run again"
    egm: Expect | DoesNotApply | None = None
    """While running, with the EGM bridge and an emulated controller; None: the same."""

    @property
    def cases(self) -> list[Case]:
        """All columns in which something happens."""
        columns = [(phase.value, self.fault, phase, self.cell(phase)) for phase in Phase]
        columns.append((EGM_COLUMN, self.egm_fault, Phase.RUNNING, self.behind_egm))
        return [
            Case(name, fault, phase, expect)
            for name, fault, phase, expect in columns
            if isinstance(expect, Expect)
        ]

    @property
    def behind_egm(self) -> Expect | DoesNotApply:
        """See `egm`."""
        return self.running if self.egm is None else self.egm

    @property
    def egm_fault(self) -> Fault:
        """The fault there: in real time, the only pace of a controller."""
        return replace(self.fault, egm=True, lock_step=False)

    def cell(self, phase: Phase) -> Expect | DoesNotApply:
        cells = {Phase.START: self.start, Phase.RUNNING: self.running}
        return cells.get(phase, self.stopping)


ASKED = Expect(AS_ASKED, "disarmed by its commander")
PATIENT_MS = 100.0
"""Lead of runs that shall go on without a pause on a busy machine, too."""
