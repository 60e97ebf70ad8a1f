"""How a view is laid out: 3D and events on the left, curves in tabs on the right."""

from __future__ import annotations

from typing import Any

import rerun.blueprint as rrb

from skewmi.deploy.replay.style import TIMELINE

QUANTITIES = ("position", "velocity", "acceleration", "jerk")
"""Of each joint, as fractions of its limits."""

TRAIL_S = 20.0
"""What a live view shows of the past, s: an episode."""


def blueprint(title: str, *, policy: bool, scene: tuple[str, ...], live: bool) -> Any:
    """The layout.

    Args:
        title: Name of the 3D view.
        policy: Whether there are observations to show.
        scene: Names of the scene's joints.
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
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                _space(title, lately),
                rrb.TextLogView(origin="/events", name="state machines"),
                row_shares=[3, 1],
            ),
            rrb.Tabs(*_tabs(policy, scene, lately), name="curves", active_tab=0),
            column_shares=[5, 4],
        ),
        rrb.TimePanel(
            timeline=TIMELINE, state="collapsed", play_state="following" if live else None
        ),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        auto_views=False,
    )


def _tabs(policy: bool, scene: tuple[str, ...], lately: Any) -> list[Any]:
    """Curves of joints and hand, and of policy and scene where there are any."""

    def curves(origin: str, name: str, *, legend: bool = True) -> Any:
        return rrb.TimeSeriesView(
            origin=origin,
            name=name,
            plot_legend=rrb.PlotLegend(visible=legend),
            time_ranges=lately,
        )

    tabs = [
        rrb.Vertical(
            # One legend is enough: four would cover the curves.
            *(
                curves(f"/joints/{name}", f"{name} / limit", legend=name == QUANTITIES[0])
                for name in QUANTITIES
            ),
            row_shares=[3, 2, 2, 2],
            name="joints against limits",
        ),
        rrb.BarChartView(
            origin="/joints/spectrum",
            name="commanded acceleration, % of its power per Hz (last bar: 30 Hz and more)",
        ),
        rrb.Vertical(
            curves("/hand/commanded", "hand in workspace box, commanded"),
            curves("/hand/measured", "hand in workspace box, measured"),
            curves("/hand/error", "commanded - measured, mm"),
            name="hand against box",
        ),
    ]
    if policy:
        tabs.append(
            rrb.Vertical(
                curves("/policy/observation_in_range", "observation, 0..1 of its range"),
                curves("/policy/action", "action"),
                name="policy",
            )
        )
    if scene:
        tabs.append(
            rrb.Vertical(*(curves(f"/scene_joints/{name}", name) for name in scene), name="scene")
        )
    return tabs


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
