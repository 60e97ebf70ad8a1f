"""A row of the matrix: a fault, and what must come of it in every phase."""

from __future__ import annotations

from dataclasses import dataclass

from fault_cell import AS_ASKED, Fault, Observed, Phase


@dataclass(frozen=True)
class Expect:
    """What must be observed."""

    verdict: str
    """One, or several with " or " between, where a race decides."""
    says: str = ""
    """Words that report or status must contain."""

    def matches(self, observed: Observed) -> bool:
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
class Row:
    """A fault, the expectations, and how a user goes on."""

    fault: Fault
    start: Expect | DoesNotApply
    running: Expect | DoesNotApply
    stopping: Expect | DoesNotApply
    hardest: Phase = Phase.RUNNING
    """Where the fast tests try it."""
    go_on: str = "run again"

    def cell(self, phase: Phase) -> Expect | DoesNotApply:
        cells = {Phase.START: self.start, Phase.RUNNING: self.running}
        return cells.get(phase, self.stopping)


ASKED = Expect(AS_ASKED, "disarmed by its commander")
PATIENT_MS = 100.0
"""Lead of runs that shall go on without a pause on a busy machine, too."""
