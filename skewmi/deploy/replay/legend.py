"""The words beside a view: what its colors mean, and what is not to be seen in it."""

from __future__ import annotations

from skewmi.deploy.replay.data import Run, Subject
from skewmi.deploy.replay.timing import REGULAR

_COLORS = """\
**In 3D**
- **orange** wires and line: the arm as commanded, way of its hand
- **blue** line: way of the measured hand; the solid arm is the measured one
- **green** box: the workspace, which the commanded hand may not leave

**In curves**
- **x red, y green, z blue**, darker: edges of the workspace; each joint has its color
- **orange** commanded, **blue** measured, **grey** limits and thresholds
"""


class Legend:
    """Says what has been missing so far.

    Args:
        subject: What is known of the run.
        live: The run is under way.
    """

    def __init__(self, subject: Subject, *, live: bool) -> None:
        self._subject, self._live = subject, live
        self._torque = self._zeros = self._forces = self._placed = self._scene = False
        self._policy = self._timed = False
        self._intervals: set[str] = set()

    def see(self, run: Run) -> None:
        """Take note of what a stretch of the run has."""
        has_torque = bool(run.torque.values.any())
        self._zeros |= len(run.torque.time_s) > 0
        self._torque |= has_torque
        self._forces |= len(run.forces.time_s) > 0
        self._placed |= bool(run.placements)
        self._scene |= len(run.scene.time_s) > 0
        self._policy |= bool(run.observation.names)
        self._timed |= len(run.spare.time_s) > 0
        self._intervals |= set(run.intervals)

    def text(self) -> str:
        """Markdown."""
        missing = self.missing()
        so_far = " so far" if self._live else ""
        words = "".join(f"- {line}\n" for line in missing) or "- nothing that a view can show\n"
        return f"{_COLORS}\n**Not told{so_far}**\n{words}"

    def missing(self) -> list[str]:
        """What is not in the run, in words."""
        subject = self._subject
        found = []
        if not self._torque:
            zeros = " (it sends zeros)" if self._zeros else ""
            found.append(f"joint torques: this robot measures none{zeros}")
        if not self._forces:
            found.append("contact forces: only a simulated robot tells them")
        if not self._scene:
            found.append("the scene's joints: nobody published them")
        if subject.geometry is None:
            found.append("the scene's shapes")
        elif not self._placed:
            varied = ", although it varies" if subject.variation else ""
            found.append(
                f"where the scene really stands{varied}: it is drawn where it is described"
            )
        if not subject.limits:
            found.append("limits of the joints")
        if subject.layout is None:
            found.append("the task's layout: no workspace, no thresholds")
        if not self._policy:
            found.append("what a policy saw and did")
        return found + self._missing_times()

    def _missing_times(self) -> list[str]:
        found = []
        if self._subject.lock_step:
            found.append("lateness of commands: in lock-step robot and session wait for each other")
        elif not self._timed:
            found.append("lateness of commands: nothing tells when they were sent")
        for kind in REGULAR:
            if kind.label not in self._intervals:
                where = " (recordings have them)" if self._live and kind is REGULAR[-1] else ""
                found.append(f"times of the {kind.label}{where}")
        return found
