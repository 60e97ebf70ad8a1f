"""What a view of a training shows beside what: planes of the state, curves, words."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun.blueprint as rrb

from skewmi.policy_io import Array, Field
from skewmi.train.follow import RunFacts

TIMELINE = "trajectories"

ORANGE, BLUE, GREEN = (255, 140, 30), (60, 160, 255), (90, 200, 120)
GREY = (150, 150, 150)
_DISPLAY = {"rad": ("deg", 180.0 / math.pi), "m": ("mm", 1e3)}
"""Units people read."""
_LARGE_M = 2.0
"""Beyond this, nobody counts in mm."""
_HAND = ("hand_x", "hand_y", "hand_z")

LEGEND = """\
Each dot is a state that an episode came through.

- **blue**: in the newest episodes; **grey**: in earlier ones, some of them
- **green**: rewarded by the task
- **orange**: where the exploration would go next (its proposed goals); none if it has no goals
- curves are over trajectories, that is episodes; drag the time line to see how it grew
"""


@dataclass(frozen=True)
class Plane:
    """Two fields of the state, drawn in a square of 100 by 100, the second one upwards."""

    columns: tuple[int, int]
    fields: tuple[Field, Field]

    @property
    def name(self) -> str:
        """For people."""
        return " against ".join(f"{f.name} [{_unit(f)[0]}]" for f in reversed(self.fields))

    @property
    def path(self) -> str:
        """Entity of everything in it."""
        return f"/states/{self.fields[0].name}_{self.fields[1].name}"

    def points(self, states: Array) -> Array:
        """Where states are drawn. Shape (n, state_dim) -> (n, 2)."""
        x, y = (
            100.0 * (states[:, column] - field.low) / (field.high - field.low)
            for column, field in zip(self.columns, self.fields, strict=True)
        )
        return np.column_stack([x, -y])

    def labels(self) -> tuple[list[tuple[float, float]], list[str]]:
        """Words at the ends of both axes, and where they stand."""
        first, second = self.fields
        return (
            [(0.0, 5.0), (50.0, 9.0), (100.0, 5.0), (-7.0, 0.0), (0.0, -105.0), (-7.0, -100.0)],
            [
                *(_ends(first)[0], f"{first.name} [{_unit(first)[0]}]", _ends(first)[1]),
                *(_ends(second)[0], f"{second.name} [{_unit(second)[0]}]", _ends(second)[1]),
            ],
        )


def _unit(field: Field) -> tuple[str, float]:
    if field.unit == "m" and field.high - field.low > _LARGE_M:
        return field.unit, 1.0
    return _DISPLAY.get(field.unit, (field.unit, 1.0))


def _ends(field: Field) -> tuple[str, str]:
    scale = _unit(field)[1]
    return f"{scale * field.low:.4g}", f"{scale * field.high:.4g}"


def planes_of(facts: RunFacts) -> tuple[Plane, ...]:
    """The two fields that the task is measured in, or else its first two."""
    fields = facts.layout.state_fields
    names = [field.name for field in fields]
    chosen = [names.index(name) for name in facts.grid[:2] if name in names]
    if len(chosen) < 2:
        chosen = [0, 1]
    if len(fields) < 2:
        return ()
    return (Plane((chosen[0], chosen[1]), (fields[chosen[0]], fields[chosen[1]])),)


def hand_columns(facts: RunFacts) -> list[int] | None:
    """State fields of the hand's position; None if the task has no hand."""
    names = [field.name for field in facts.layout.state_fields]
    return [names.index(name) for name in _HAND] if set(_HAND) <= set(names) else None


def layout_of(facts: RunFacts, title: str, *, live: bool) -> Any:
    """The blueprint."""
    so_far = rrb.VisibleTimeRange(
        TIMELINE,
        start=rrb.TimeRangeBoundary.infinite(),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(*_pictures(facts, so_far), name=title),
            rrb.Vertical(
                _curves("/success", "success [share, 1 = all]", share=True),
                _curves("/coverage", "coverage [share, 1 = all]", share=True),
                _curves("/entropy", "differential entropy of visited states [nats]"),
                rrb.Horizontal(
                    rrb.TextLogView(
                        origin="/found",
                        name="found: trajectory, what",
                        columns=rrb.TextLogColumns(
                            timeline_columns=[TIMELINE], text_log_columns=["body"]
                        ),
                    ),
                    rrb.TextDocumentView(origin="/legend", name="legend"),
                ),
            ),
            column_shares=[1, 1],
        ),
        rrb.TimePanel(
            timeline=TIMELINE, state="collapsed", play_state="following" if live else None
        ),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        auto_views=False,
    )


def _curves(origin: str, name: str, *, share: bool = False) -> Any:
    axis = rrb.ScalarAxis(range=(-0.02, 1.05)) if share else None
    return rrb.TimeSeriesView(origin=origin, name=name, axis_y=axis)


def _pictures(facts: RunFacts, so_far: Any) -> list[Any]:
    """Where the hand has been, if there is one, and the planes of the state."""
    pictures: list[Any] = []
    workspace = facts.layout.workspace
    if hand_columns(facts) is not None and workspace is not None:
        middle = (np.array(workspace.low) + np.array(workspace.high)) / 2
        pictures.append(
            rrb.Spatial3DView(
                origin="/hand",
                name="visited positions of the hand",
                overrides={"/hand/visited": [rrb.VisibleTimeRanges(so_far)]},
                eye_controls=rrb.EyeControls3D(
                    position=np.add(middle, (0.26, -0.3, 0.1)),
                    look_target=middle,
                    eye_up=(0.0, 0.0, 1.0),
                ),
            )
        )
    pictures += [
        rrb.Spatial2DView(
            origin=plane.path,
            name=f"visited states, {plane.name}",
            overrides={f"{plane.path}/visited": [rrb.VisibleTimeRanges(so_far)]},
            visual_bounds=rrb.VisualBounds2D(x_range=(-22, 108), y_range=(-112, 16)),
        )
        for plane in planes_of(facts)
    ]
    return pictures
