"""The kinds of figures that a sweep file may ask for, by name."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from skewmi.evaluation.sweep_figures import ablation, convergence, curves, visits
from skewmi.evaluation.sweep_figures.figure import Drawn, Request
from skewmi.evaluation.sweep_figures.runs import SweepRuns
from skewmi.evaluation.sweep_figures.visits import Scene

FRAMES = "frames"
"""Drawn by whoever can step and render a task; see `skewmi figures`."""

KINDS: dict[str, tuple[str, ...]] = {
    "exploration": curves.EXPLORATION_KEYS,
    "learning": curves.LEARNING_KEYS,
    "ablation": ablation.KEYS,
    "convergence": convergence.KEYS,
    "visits": visits.KEYS,
    "targets": visits.TARGET_KEYS,
    FRAMES: ("configuration", "frames"),
}
"""Kind -> keys of its own."""

_OF_TABLES = {
    "exploration": curves.draw_exploration,
    "learning": curves.draw_learning,
    "ablation": ablation.draw_ablation,
    "convergence": convergence.draw_convergence,
}
_OF_STATES = {"visits": visits.draw_visits, "targets": visits.draw_targets}


def draw(
    request: Request, runs: SweepRuns, scenes: Mapping[str, Scene], stem: Path, dpi: int
) -> Drawn:
    """Draw a figure of any kind but `FRAMES`.

    Args:
        request: What the sweep file asks for.
        runs: Of the sweep.
        scenes: By task, for pictures of states.
        stem: Of the files, without suffix.
        dpi: Dots per inch.

    Raises:
        ConfigurationError: The request does not fit the results.
        NotFoundError: It names a group that is not there.
        OutputError: A file cannot be written.
    """
    if request.draw in _OF_STATES:
        return _OF_STATES[request.draw](request, runs, scenes, stem, dpi)
    return _OF_TABLES[request.draw](request, runs, stem, dpi)
