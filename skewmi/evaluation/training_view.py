"""Draws a training in Rerun: what it has visited, where it is sent, and how often it succeeds.

From what `train.follow` reads in the run directory; the time axis counts trajectories.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr

from skewmi.evaluation.training_layout import (
    BLUE,
    GREEN,
    GREY,
    LEGEND,
    ORANGE,
    TIMELINE,
    Plane,
    hand_columns,
    layout_of,
    planes_of,
)
from skewmi.policy_io import Array
from skewmi.train.follow import News, RunFacts

_SERIES = {
    "/success": (
        ("rewarded_fraction", "episodes rewarded", BLUE),
        ("evaluation_fraction", "last states rewarded, evaluation", GREEN),
    ),
    "/coverage": (
        ("covered_cells", "reachable cells visited", BLUE),
        ("coverage", "as published", GREY),
    ),
    "/entropy": (("differential_entropy", "of visited states", BLUE),),
}
"""Columns of the run's table that are drawn, with what they are called."""
_MOST_GROUPS = 40
"""Moments that a long past is shown in."""


class TrainingView:
    """A training as it goes on; sends the blueprint with the first news.

    Args:
        recording: A `rerun.RecordingStream`.
        facts: What the run is.
        title: Of the view.
        live: Follow the newest.
    """

    def __init__(self, recording: Any, facts: RunFacts, title: str, *, live: bool) -> None:
        self._recording, self._facts = recording, facts
        self._planes = planes_of(facts)
        self._hand = hand_columns(facts)
        self._generator = np.random.default_rng(0)
        self._moments = 0
        recording.send_blueprint(layout_of(facts, title, live=live))
        words = LEGEND if self._hand is None else f"{LEGEND}{_HAND_WORDS}"
        document = rr.TextDocument(words, media_type=rr.MediaType.MARKDOWN)
        recording.log("/legend", document, static=True)
        for plane in self._planes:
            _draw_frame(recording, plane)
        self._style_curves()
        workspace = facts.layout.workspace
        if self._hand is not None and workspace is not None:
            sizes = np.subtract(workspace.high, workspace.low)
            box = rr.Boxes3D(
                mins=[workspace.low],
                sizes=[sizes],
                colors=[GREEN],
                radii=[0.0005],
                fill_mode="majorwireframe",
            )
            recording.log("/hand/workspace", box, static=True)

    def draw(self, news: News) -> None:
        """Draw what is new."""
        self._draw_states(news)
        self._draw_curves(news)
        self._draw_proposals(news)
        self._tell(news)

    def _draw_states(self, news: News) -> None:
        """Points of new episodes, in as many moments as there were, or some of them."""
        count = len(news.episodes)
        if not count:
            return
        ends = news.rows.get("trajectories", np.zeros(0))
        moments = max(1, min(_MOST_GROUPS, len(ends)))
        for part in np.array_split(np.arange(count), moments):
            if len(part):
                self._recording.set_time(TIMELINE, sequence=int(news.episodes[part[-1]]) + 1)
                self._draw_points(news.states[part, 1:], news.rewards[part] > 0.0)

    def _draw_points(self, states: Array, rewarded: Any) -> None:
        states, rewarded = states.reshape(-1, states.shape[-1]), rewarded.ravel()
        # So many that a view of a whole run stays quick, the first moments having the most.
        most = max(60, 90_000 // (100 + self._moments))
        self._moments += 1
        if len(states) > most:
            chosen = self._generator.choice(len(states), most, replace=False)
            states, rewarded = states[chosen], rewarded[chosen]
        colors = np.where(rewarded[:, None], np.array(GREEN), np.array(GREY)).astype(np.uint8)
        newest = np.where(rewarded[:, None], np.array(GREEN), np.array(BLUE)).astype(np.uint8)
        for plane in self._planes:
            points = plane.points(states)
            radius = 0.35
            self._recording.log(
                f"{plane.path}/visited", rr.Points2D(points, colors=colors, radii=[radius])
            )
            self._recording.log(
                f"{plane.path}/newest", rr.Points2D(points, colors=newest, radii=[1.4 * radius])
            )
        if self._hand is not None:
            hand = states[:, self._hand]
            self._recording.log("/hand/visited", rr.Points3D(hand, colors=colors, radii=[0.0008]))
            self._recording.log("/hand/newest", rr.Points3D(hand, colors=newest, radii=[0.0012]))

    def _draw_proposals(self, news: News) -> None:
        if news.proposals is None:
            return
        if len(news.episodes):
            self._recording.set_time(TIMELINE, sequence=int(news.episodes[-1]) + 1)
        for plane in self._planes:
            points = plane.points(news.proposals)
            self._recording.log(
                f"{plane.path}/proposals", rr.Points2D(points, colors=[ORANGE], radii=[0.9])
            )
        if self._hand is not None:
            hand = news.proposals[:, self._hand]
            self._recording.log(
                "/hand/proposals", rr.Points3D(hand, colors=[ORANGE], radii=[0.002])
            )

    def _style_curves(self) -> None:
        for path, curves in _SERIES.items():
            for name, label, color in curves:
                look = rr.SeriesLines(names=[label], colors=[color], widths=[1.5])
                self._recording.log(f"{path}/{name}", look, static=True)
        share = self._facts.convergence_fraction
        look = rr.SeriesLines(names=[f"converged: {share:.0%}"], colors=[GREY], widths=[1.0])
        self._recording.log("/success/converged", look, static=True)

    def _draw_curves(self, news: News) -> None:
        trajectories = news.rows.get("trajectories", np.zeros(0))
        if not len(trajectories):
            return
        for path, curves in _SERIES.items():
            for name, _, _ in curves:
                values = news.rows.get(name, np.full(len(trajectories), math.nan))
                known = np.isfinite(values)
                self._send(f"{path}/{name}", trajectories[known], values[known])
        share = np.full(len(trajectories), self._facts.convergence_fraction)
        self._send("/success/converged", trajectories, share)

    def _send(self, path: str, trajectories: Array, values: Sequence[float] | Array) -> None:
        if len(values):
            self._recording.send_columns(
                path,
                indexes=[rr.TimeColumn(TIMELINE, sequence=trajectories.astype(np.int64))],
                columns=rr.Scalars.columns(scalars=np.asarray(values)),
            )

    def _tell(self, news: News) -> None:
        """A row for each thing that was found, and for convergence."""
        rows = [(trajectory, f"first {name}") for name, trajectory in news.discoveries.items()]
        if news.converged_at is not None:
            rows.append((news.converged_at, "converged"))
        for trajectory, words in sorted(rows):
            self._recording.set_time(TIMELINE, sequence=trajectory)
            self._recording.log("/found", rr.TextLog(words, level="INFO"))


_HAND_WORDS = "- green box in 3D: the workspace of the hand\n"


def _draw_frame(recording: Any, plane: Plane) -> None:
    """The square that a plane fills, with its ends in units."""
    square = [(0, 0), (100, 0), (100, -100), (0, -100), (0, 0)]
    recording.log(
        f"{plane.path}/frame",
        rr.LineStrips2D([square], colors=[GREY], radii=[0.15]),
        static=True,
    )
    positions, labels = plane.labels()
    recording.log(
        f"{plane.path}/ends",
        rr.Points2D(positions, labels=labels, colors=[GREY], radii=[0.1], show_labels=True),
        static=True,
    )
