"""Reward regions in pictures, read back from what is drawn."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure

from skewmi.evaluation import drawing
from skewmi.policy_io import ActionField, Ball, Field, PolicyLayout
from skewmi.sim.tasks.open_press_close.definition import make_layout


def drawn_extent(layout: PolicyLayout, fields: tuple[str, str]) -> np.ndarray | None:
    """Lowest and highest of both coordinates of the outline; None if there is none."""
    names = [field.name for field in layout.state_fields]
    axis = Figure().add_subplot()
    if not drawing.draw_region(axis, layout, [names.index(name) for name in fields]):
        assert not axis.collections
        return None
    (contour,) = axis.collections
    vertices = np.concatenate([path.vertices for path in contour.get_paths()])
    return np.array([vertices.min(axis=0), vertices.max(axis=0)])


@pytest.mark.parametrize("fields", [("lid_angle", "button_depth"), ("hand_y", "lid_angle")])
def test_bounds_of_each_field_are_drawn_whatever_the_others_are(fields: tuple[str, str]) -> None:
    layout = make_layout()
    extent = drawn_extent(layout, fields)
    assert extent is not None
    for k, name in enumerate(fields):
        (ball,) = [ball for ball in layout.reward_region if ball.fields == (name,)]
        (field,) = [field for field in layout.state_fields if field.name == name]
        cell = (field.high - field.low) / 500
        low, high = ball.centre[0] - ball.radius, ball.centre[0] + ball.radius
        assert extent[0, k] == pytest.approx(max(low, field.low), abs=cell)
        assert extent[1, k] == pytest.approx(min(high, field.high), abs=cell)


def layout_of(*region: Ball) -> PolicyLayout:
    return PolicyLayout(
        task="test",
        observation=tuple(Field(name, "m", "world", -1.0, 1.0) for name in "xyz"),
        action=(ActionField("v", "m", "world", 0.01),),
        reward_region=region,
        control_dt=0.1,
        episode_steps=10,
        success_hold_steps=1,
        workspace=None,
    )


def test_a_ball_in_more_fields_throws_its_shadow() -> None:
    extent = drawn_extent(layout_of(Ball(("x", "y", "z"), (0.1, -0.2, 0.3), 0.4)), ("x", "z"))
    np.testing.assert_allclose(extent, [[-0.3, -0.1], [0.5, 0.7]], atol=4e-3)


def test_where_nothing_is_bounded_nothing_is_drawn() -> None:
    assert drawn_extent(layout_of(Ball(("y",), (0.0,), 0.1)), ("x", "z")) is None


def test_a_region_as_large_as_the_ranges_is_not_drawn() -> None:
    assert drawn_extent(make_layout(), ("hand_y", "hand_z")) is None


@pytest.mark.parametrize("width", [2.0, 3.5, 12.0])
def test_titles_stay_within_the_figure(width: float) -> None:
    words = "Table 1: trajectories to convergence, mean and deviation over seeds"
    title = f"{words}\nshort"
    figure, _ = drawing.new_axes(1, 1, width, 2.0)
    drawing.set_title(figure, title, 11)
    shown = figure._suptitle
    extent = shown.get_window_extent()
    assert extent.x0 >= 0.0
    assert extent.x1 <= figure.bbox.width
    lines = shown.get_text().split("\n")
    assert lines[-1] == "short"
    assert " ".join(lines[:-1]) == words
    # As many lines as it takes, and no more.
    assert (len(lines) == 2) == (width == 12.0)
