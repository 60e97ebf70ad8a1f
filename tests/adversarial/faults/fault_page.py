"""docs/faults.md, made from the catalogue that the tests hold the product to."""

from __future__ import annotations

from pathlib import Path

from fault_catalog import GROUPS
from fault_cell import Phase
from fault_rows import EGM_COLUMN, Row

PAGE = Path(__file__).parents[3] / "docs" / "faults.md"

SAME = "as running"

INTRODUCTION = """\
# What happens when something fails

Every fault below is brought about in the real chain: a session process, a link, a server process
with the simulated arm, while the arm moves. `python tests/adversarial/faults/table.py` runs all of
it and writes this page only if every cell came out as shown; `tests/adversarial/faults` holds the
product to it.

Phases: **start motion** (the way to the start of an episode), **running** (the policy moves the
hand), **stopping** (somebody pressed Ctrl-C and the arm brakes). The column
**running, EGM bridge + emulator** is the same fault while the policy runs, with `skewmi robot
--backend egm` for the server and an emulated controller ([egm.md](egm.md)) for the arm, always in
real time; "as running" means that the same must come of it.

In every cell, besides what it shows:

- The positions that the robot server commanded, on its 4 ms grid, keep the limits of position,
  velocity, acceleration and jerk of each joint, of the tool's speed and of the box, by differences
  of positions and with limits stated once more; the arm comes to rest.
- The words in the cell are in the session's report or in the robot server's status.
- Afterwards the robot server is disarmed, and another run arms it and moves the arm.

Verdicts: **goes on**: the run goes on as if nothing had been. **rests, goes on**: the arm rests on
the way, then the same run goes on; the report counts missed cycles. **stopped**, **fault**: the
outcome of the episode; the arm rests, disarmed. **rests as asked**: as without the fault.
**rests, disarmed**: the same, and there is no session left to report.
"""

NOTES = """\
## Notes

- A chunk on the link that breaks a rule is refused as a whole: the arm goes on along the chunk
  before it, which ends at rest.
- Torque and distance to the robot itself are checked by the session's guard alone. The robot server
  does not know them: a sender that is no `skewmi deploy` is held to all other limits, not to these.
  In the box the hand's position is refused before anything can collide.
- A robot server that is killed commands nothing more: what the arm does then is the robot's own
  business. (A simulated arm ends with its process; motion is judged up to that moment.) Ended by
  a signal it can answer, the robot server brakes first.
- Where a controller takes the arm away (motors off, program stopped, EGM ended) nothing is
  commanded until it gives it back: motion is judged up to that moment, and from then on again.
- Nothing depends on wall clocks: they only label messages.
- A delay shorter than `--lead-ms` less 6 ms does nothing; these runs use 40 ms. On a busy computer
  a run may miss cycles without any fault; then the cell is run again.
- Who publishes on the robot server's topics without being it is left out and named in the report;
  [security.md](security.md) says what is noticed of somebody who copies its id, and what is not.
- Chunks that come twice or overtaken end the run: no link that we know does this by itself.
"""


def render() -> str:
    """The whole page."""
    lines = [INTRODUCTION]
    heading = ["fault", *(phase.value for phase in Phase), EGM_COLUMN, "to go on"]
    for group, rows in GROUPS.items():
        lines += [f"## {group}", "", _line(heading), "|---" * len(heading) + "|"]
        lines += [_line(_columns(row)) for row in rows]
        lines.append("")
    return "\n".join([*lines, NOTES])


def _columns(row: Row) -> list[str]:
    cells = [row.cell(phase).text() for phase in Phase]
    egm = row.behind_egm.text() if row.egm is not None else SAME
    return [row.fault.name.removeprefix("planned: "), *cells, egm, row.go_on]


def _line(columns: list[str]) -> str:
    return f"| {' | '.join(columns)} |"
