"""Episodes of a policy in simulation, drawn in Rerun while they are run.

Copies of a task with a robot stand side by side in 3D; of any other task the pictures of its own
camera are shown. Beside them the state of every copy against time, and what became of each episode.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Protocol

import mujoco
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from skewmi.batch_env import BatchEnv
from skewmi.evaluation.model_view import TIMELINE, ModelView, copy_path
from skewmi.policy_io import Array, Policy, PolicyLayout, require_same_layout
from skewmi.success import first_success_step

SPACING = (1.3, 1.1)
"""Between copies, m: an arm reaches 0.56 m to either side."""
_PALETTE = (
    (230, 75, 60), (60, 160, 255), (80, 185, 90), (245, 165, 35),
    (190, 100, 220), (70, 190, 210), (200, 200, 60), (150, 150, 150),
)  # fmt: skip


class Stage(Protocol):
    """Draws what a batch does."""

    def look(self) -> None:
        """A step has been made: remember where everything is."""

    def draw(self, time_s: Array) -> None:
        """Draw what was remembered at these times, and forget it. Shape (n,)."""

    def view(self) -> Any:
        """Rerun's view of it."""


class ModelStage:
    """Copies of a MuJoCo model; a `Stage`.

    Args:
        recording: A `rerun.RecordingStream`.
        model: With what is seen.
        qpos: Positions of all copies now. Shape (n, nq).
        fields: What differs in the copies' models now, by field; each shape (n, ...).
        n: Copies.
    """

    def __init__(
        self,
        recording: Any,
        model: mujoco.MjModel,
        qpos: Callable[[], Array],
        fields: Callable[[], dict[str, Array]],
        n: int,
    ) -> None:
        self._qpos, self._fields, self._n = qpos, fields, n
        columns = math.ceil(math.sqrt(n))
        places = np.array([(k // columns, k % columns, 0) for k in range(n)], dtype=np.float64)
        self._offsets = (places - places.mean(axis=0)) * (*SPACING, 0.0)
        self._view = ModelView(recording, model, self._offsets)
        self._seen: list[Array] = []

    def look(self) -> None:
        """See `Stage.look`."""
        self._seen.append(np.array(self._qpos()))

    def draw(self, time_s: Array) -> None:
        """See `Stage.draw`."""
        seen, fields = np.array(self._seen), self._fields()
        for index in range(self._n):
            own = {name: values[index] for name, values in fields.items()}
            self._view.draw(index, time_s, seen[:, index], own)
        self._seen.clear()

    def view(self) -> Any:
        """See `Stage.view`."""
        reach = float(np.abs(self._offsets).max()) if self._n > 1 else 0.0
        eye = np.array([0.9, -0.8, 0.75]) * (1.0 + 1.1 * reach)
        return rrb.Spatial3DView(
            origin="/copies",
            name="simulation",
            eye_controls=rrb.EyeControls3D(
                position=eye, look_target=(-0.1, 0.0, 0.15), eye_up=(0.0, 0.0, 1.0)
            ),
        )


class PictureStage:
    """Pictures of a task's own camera; a `Stage`.

    Args:
        recording: A `rerun.RecordingStream`.
        picture: Of a copy now. Shape (height, width, 3).
        n: Copies.
    """

    def __init__(self, recording: Any, picture: Callable[[int], Any], n: int) -> None:
        self._recording, self._picture, self._n = recording, picture, n
        self._seen: list[list[Any]] = []

    def look(self) -> None:
        """See `Stage.look`."""
        self._seen.append([self._picture(index) for index in range(self._n)])

    def draw(self, time_s: Array) -> None:
        """See `Stage.draw`."""
        for moment, pictures in zip(time_s, self._seen, strict=True):
            self._recording.set_time(TIMELINE, duration=float(moment))
            for index, picture in enumerate(pictures):
                self._recording.log(copy_path(index), rr.Image(picture).compress(jpeg_quality=90))
        self._seen.clear()

    def view(self) -> Any:
        """See `Stage.view`."""
        views = [
            rrb.Spatial2DView(origin=copy_path(index), name=f"copy {index + 1}")
            for index in range(self._n)
        ]
        return rrb.Grid(*views, name="simulation")


def play(
    policy: Policy,
    env: BatchEnv,
    stage: Stage,
    recording: Any,
    rounds: int,
    seed: int,
    *,
    on_round: Callable[[int, int], None] = lambda done, episodes: None,
) -> list[int]:
    """Run rounds of episodes, and draw each when it is over.

    Args:
        policy: Whose layout must be the environment's.
        env: The task; all its copies are shown.
        stage: Draws them.
        recording: A `rerun.RecordingStream`.
        rounds: Episodes of each copy.
        seed: Of the environment.
        on_round: Told how many rounds are done, and how many episodes succeeded so far.

    Returns:
        First step of success of every episode, 0 where there was none, round by round.

    Raises:
        LayoutMismatchError: The policy was made for another layout.
    """
    require_same_layout(env.layout, policy.layout, "the policy")
    layout, n = env.layout, env.num_envs
    names = [field.name for field in layout.state_fields]
    recording.send_blueprint(_blueprint(stage, layout))
    _style(recording, layout, n)
    found: list[int] = []
    for number in range(rounds):
        observation = env.reset(seed) if number == 0 else env.reset()
        policy.reset()
        stage.look()
        states, inside = [observation[:, : len(names)]], []
        for _ in range(layout.episode_steps):
            result = env.step(policy.act(observation))
            observation = result.observation
            stage.look()
            states.append(observation[:, : len(names)])
            inside.append(result.success)
        begin = number * (layout.episode_steps + 1) * layout.control_dt
        time_s = np.asarray(begin + np.arange(layout.episode_steps + 1) * layout.control_dt)
        stage.draw(time_s)
        first = first_success_step(layout, np.array(inside))
        _draw_curves(recording, names, time_s, np.array(states))
        _tell(recording, number, time_s, first, layout.control_dt)
        found += first.tolist()
        on_round(number + 1, sum(step > 0 for step in found))
    return found


def _blueprint(stage: Stage, layout: PolicyLayout) -> Any:
    curves = [
        rrb.TimeSeriesView(
            origin=f"/state/{field.name}",
            name=f"{field.name} [{field.unit}]",
            # One is enough: more would cover the curves.
            plot_legend=rrb.PlotLegend(visible=number == 0),
        )
        for number, field in enumerate(layout.state_fields)
    ]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                stage.view(),
                rrb.TextLogView(origin="/episodes", name="episodes"),
                row_shares=[4, 1],
            ),
            rrb.Vertical(*curves, name="state"),
            column_shares=[2, 1],
        ),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed", play_state="playing", loop_mode="all"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        auto_views=False,
    )


def _style(recording: Any, layout: PolicyLayout, n: int) -> None:
    recording.log("/copies", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    colors = [_PALETTE[index % len(_PALETTE)] for index in range(n)]
    for field in layout.state_fields:
        labels = [f"copy {index + 1}" for index in range(n)]
        look = rr.SeriesLines(names=labels, colors=colors, widths=[1.5] * n)
        recording.log(f"/state/{field.name}", look, static=True)


def _draw_curves(recording: Any, names: list[str], time_s: Array, states: Array) -> None:
    """Of every field, all copies. Shape of states (steps, n, fields)."""
    times = [rr.TimeColumn(TIMELINE, duration=time_s)]
    for column, name in enumerate(names):
        columns = rr.Scalars.columns(scalars=states[:, :, column])
        recording.send_columns(f"/state/{name}", indexes=times, columns=columns)


def _tell(recording: Any, number: int, time_s: Array, first: Any, control_dt: float) -> None:
    for index, step in enumerate(first.tolist()):
        name = f"episode {number + 1}, copy {index + 1}"
        if step > 0:
            recording.set_time(TIMELINE, duration=float(time_s[step]))
            words, level = f"{name}: success after {step * control_dt:.1f} s", "INFO"
        else:
            recording.set_time(TIMELINE, duration=float(time_s[-1]))
            words, level = f"{name}: no success", "WARN"
        recording.log("/episodes", rr.TextLog(words, level=level))
