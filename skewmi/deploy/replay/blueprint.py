"""How a view is laid out: 3D, events and legend on the left, curves in tabs on the right."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import rerun.blueprint as rrb

from skewmi.deploy.replay.style import TIMELINE
from skewmi.deploy.replay.timing import REGULAR, interval_path

QUANTITIES = ("position", "velocity", "acceleration", "jerk")
"""Of each joint, as fractions of its limits."""

TRAIL_S = 20.0
"""What a live view shows of the past, s: an episode."""


def blueprint(title: str, *, policy: bool, scene: Mapping[str, str], live: bool) -> Any:
    """The layout.

    Args:
        title: Name of the 3D view.
        policy: Whether there are observations to show.
        scene: Titles of the curves of the scene's joints, by name.
        live: Follow the newest time and show the last `TRAIL_S`; else everything.
    """
    # No range at all would show the path's latest stretch only, and all of a curve.
    lately = (
        rrb.VisibleTimeRange(
            TIMELINE,
            start=rrb.TimeRangeBoundary.cursor_relative(seconds=-TRAIL_S),
            end=rrb.TimeRangeBoundary.cursor_relative(),
        )
        if live
        else None
    )
    tabs = _Tabs(lately)
    shown = [tabs.overview(scene), tabs.hand(), tabs.joints(), tabs.forces()]
    if policy:
        shown.append(tabs.policy())
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                _space(title, lately),
                rrb.Horizontal(
                    _events(),
                    rrb.TextDocumentView(origin="/legend", name="legend"),
                    column_shares=[5, 4],
                ),
                row_shares=[5, 3],
            ),
            rrb.Tabs(*shown, tabs.timing(), tabs.spectrum(), name="curves", active_tab=0),
            column_shares=[5, 4],
        ),
        rrb.TimePanel(
            timeline=TIMELINE, state="collapsed", play_state="following" if live else None
        ),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        auto_views=False,
    )


def _events() -> Any:
    return rrb.TextLogView(
        origin="/events",
        name="events: time, level, who and what",
        columns=rrb.TextLogColumns(
            timeline_columns=[TIMELINE], text_log_columns=["loglevel", "body"]
        ),
    )


class _Tabs:
    """Plots; the unit is in each one's name.

    Args:
        lately: Range of time to show; None for everything.
    """

    def __init__(self, lately: Any) -> None:
        self._lately = lately

    def _curves(self, origin: str, name: str, *, legend: bool = True) -> Any:
        return rrb.TimeSeriesView(
            origin=origin,
            name=name,
            plot_legend=rrb.PlotLegend(visible=legend, corner="RightTop"),
            time_ranges=self._lately,
        )

    def overview(self, scene: Mapping[str, str]) -> Any:
        """What the task is about, and whether it is done gently."""
        return rrb.Vertical(
            # One curve and what its title says: no legend needed.
            *(
                self._curves(f"/scene_joints/{name}", title, legend=False)
                for name, title in scene.items()
            ),
            self._curves("/hand/measured", "measured hand in world, and edges of workspace [mm]"),
            self._curves(
                "/hand/force", "contact force [N], largest of each 20 ms, gentle up to 100 N"
            ),
            self._curves("/hand/tilt", "hand tilt [deg], gentle up to 2 deg"),
            name="overview",
        )

    def hand(self) -> Any:
        """Where it is, and how far from its command."""
        return rrb.Vertical(
            self._curves("/hand/commanded", "commanded hand in world, edges of workspace [mm]"),
            self._curves("/hand/measured", "measured hand in world, edges of workspace [mm]"),
            self._curves("/hand/error", "commanded - measured hand [mm]"),
            name="hand",
        )

    def joints(self) -> Any:
        """Commanded motion against its limits."""
        return rrb.Vertical(
            # One legend is enough: four would cover the curves.
            *(
                self._curves(
                    f"/joints/{name}",
                    f"commanded {name} [1 = limit of the joint]",
                    legend=name == QUANTITIES[0],
                )
                for name in QUANTITIES
            ),
            row_shares=[3, 2, 2, 2],
            name="joints",
        )

    def forces(self) -> Any:
        """What the arm pushes with, and against."""
        return rrb.Vertical(
            self._curves("/joints/torque", "measured joint torque [N m]"),
            self._curves(
                "/hand/force", "contact force [N], largest of each 20 ms, gentle up to 100 N"
            ),
            name="forces",
        )

    def policy(self) -> Any:
        """What it saw, and what it did."""
        return rrb.Vertical(
            self._curves("/policy/observation_in_range", "observation [0..1 of its range]"),
            self._curves("/policy/action", "action [1 = most in a control step]"),
            name="policy",
        )

    def timing(self) -> Any:
        """Whether everybody was in time."""
        return rrb.Vertical(
            *(
                self._curves(
                    interval_path(kind.label),
                    f"between two {kind.label} as sent [ms], meant {kind.period_ms:g} ms",
                    legend=False,
                )
                for kind in REGULAR
            ),
            self._curves("/timing/spare", "command sent before it is due [ms]", legend=False),
            self._curves("/timing/counts", "counted since the robot server's start [1]"),
            name="timing",
        )

    def spectrum(self) -> Any:
        """At which frequencies the joints are accelerated."""
        return rrb.Vertical(
            rrb.BarChartView(
                origin="/joints/spectrum",
                name="commanded acceleration [% of its power per Hz; last bar: 30 Hz and more]",
            ),
            name="frequencies",
        )


def _space(title: str, lately: Any) -> Any:
    robots = [
        rule
        for robot in ("robot_measured", "robot_commanded")
        for rule in (f"+ /{robot}/**", f"- /{robot}/yumi/collision_geometries/**")
    ]
    paths = ("/world/path/commanded", "/world/path/measured")
    trails = {} if lately is None else {path: [rrb.VisibleTimeRanges(lately)] for path in paths}
    return rrb.Spatial3DView(
        origin="/",
        name=title,
        contents=["+ /world/**", *robots],
        overrides=trails,
        eye_controls=rrb.EyeControls3D(
            position=(0.75, -0.65, 0.65), look_target=(-0.1, -0.03, 0.2), eye_up=(0.0, 0.0, 1.0)
        ),
    )
