"""`skewmi figures` of a sweep: what its file asks for, drawn from its results."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from skewmi.errors import CheckpointError, ConfigurationError, NotFoundError
from skewmi.evaluation.rollout import run_episodes
from skewmi.evaluation.sweep_figures.figure import (
    SUFFIXES,
    Drawn,
    Request,
    read_request,
    write_figure,
)
from skewmi.evaluation.sweep_figures.kinds import FRAMES, KINDS, draw
from skewmi.evaluation.sweep_figures.runs import Entry, SweepRuns
from skewmi.evaluation.sweep_figures.visits import Scene
from skewmi.outputs import check_output
from skewmi.sim import tasks
from skewmi.sweep.sweep_file import read_sweep_file
from skewmi.sweep.tables import Tables, read_tables

FRAME_WIDTH, FRAME_HEIGHT = 480, 360
_FRAMES = 12
_AFTER = 5
"""Steps that are shown after the first success."""
_SEED = 0
"""Of the episode that is drawn."""


def draw_sweep(
    path: Path, out: Path | None, *, spec: Path | None, dpi: int, overwrite: bool
) -> dict[str, Any]:
    """Draw every figure that a sweep's file asks for.

    Args:
        path: Folder or results.parquet of the sweep.
        out: Folder of the pictures; None: figures/ in the sweep's.
        spec: Sweep file whose figures are drawn; None: the one that the sweep was run with.
        dpi: Dots per inch.
        overwrite: Whether existing files are replaced.

    Returns:
        "files": all that was written; "missing": by figure, what it lacks.

    Raises:
        NotFoundError, ConfigurationError: There are no results, or a figure does not fit them.
        OutputError: A file exists or cannot be written.
    """
    tables = read_tables(path)
    figures = tables.figures if spec is None else read_sweep_file(spec).figures
    if not figures:
        raise ConfigurationError(
            f"the sweep file of {path} asks for no figures; give one that does with --spec"
        )
    requests = [read_request(name, content, KINDS) for name, content in figures.items()]
    folder = tables.folder / "figures" if out is None else out
    for request in requests:
        for suffix in SUFFIXES:
            check_output(folder / f"{request.name}{suffix}", overwrite=overwrite)
    runs, scenes = SweepRuns(tables), _scenes(tables)
    files: list[str] = []
    missing: dict[str, list[str]] = {}
    for request in requests:
        stem = folder / request.name
        try:
            if request.draw == FRAMES:
                drawn = _draw_frames(request, runs, tables.folder / "runs", stem, dpi)
            else:
                drawn = draw(request, runs, scenes, stem, dpi)
        except NotFoundError as error:
            # Of a sweep of which only a part was run, the other figures are there.
            drawn = Drawn((), (str(error),))
        files += map(str, drawn.files)
        if drawn.missing:
            missing[request.name] = list(drawn.missing)
    return {"files": files, "missing": missing}


def as_text(document: dict[str, Any]) -> str:
    """A few lines for people."""
    lines = [*document["files"]]
    for name, lacking in document["missing"].items():
        lines += [f"{name} lacks: {line}" for line in lacking]
    return "\n".join(lines)


def _scenes(tables: Tables) -> dict[str, Scene]:
    """What pictures of states need of each task."""
    scenes = {}
    for name in dict.fromkeys(tables.results["task"]):
        spec = tasks.find(name)
        targets = spec.targets or (None,)
        layouts = {target or "default": spec.layout(target=target) if target else spec.layout()
                   for target in targets}  # fmt: skip
        first = next(iter(layouts.values()))
        fields = [field.name for field in first.state_fields]
        plane = spec.planes[0] if spec.planes else (fields[0], fields[1])
        flat = len(fields) == 2
        reachable = tasks.make_batch(name, 1, num_threads=1).reachable if flat else None
        scenes[name] = Scene(dict(sorted(layouts.items())), plane, reachable)
    return scenes


def _draw_frames(request: Request, runs: SweepRuns, folder: Path, stem: Path, dpi: int) -> Drawn:
    """Frames of one episode of a policy that was trained: of the first run that converged."""
    from skewmi.evaluation import drawing

    wanted = request.more.get("configuration")
    entries = [e for e in runs.of(request.groups) if wanted in (None, e.facts["configuration"])]
    begun = [e for e in entries if (folder / e.name / "config.json").exists()]
    if not begun:
        return Drawn((), (f"frames need a policy: no run of it is in {folder}",))
    converged = [e for e in begun if e.facts.get("converged_at") is not None]
    chosen = min(converged, key=_converged_at) if converged else max(begun, key=_fraction)
    try:
        figure, rows, success = _episode(chosen, folder, int(request.more.get("frames", _FRAMES)))
    except (CheckpointError, NotFoundError) as error:
        return Drawn((), (str(error),))
    words = "success" if success else "no success"
    drawing.set_title(
        figure,
        f"{request.title}: {chosen.facts['configuration']}, seed {chosen.facts['seed']} ({words})",
        fontsize=11,
    )
    lacking = () if success else ("the episode that is drawn does not succeed",)
    return Drawn(write_figure(figure, rows, stem, dpi), lacking)


def _converged_at(entry: Entry) -> float:
    return float(entry.facts["converged_at"])


def _fraction(entry: Entry) -> float:
    return float(entry.facts.get("evaluation_fraction") or 0.0)


def _episode(entry: Entry, folder: Path, frames: int) -> tuple[Any, list[dict[str, Any]], bool]:
    """Run an episode and lay its frames side by side; what they show, and whether it succeeded."""
    from skewmi.cli.policies import load_run
    from skewmi.evaluation import drawing
    from skewmi.train.checkpoint import read_run_header

    config, layout = read_run_header(folder / entry.name)
    policy = load_run(folder / entry.name, "best")
    spec = tasks.find(config.task)
    options: dict[str, Any] = dict(config.task_options)
    env = tasks.make_batch(config.task, 1, num_threads=1, seed=_SEED, **options)
    # Once to see when it is done: what comes after shows nothing new.
    done = int(run_episodes(policy, env, 1, _SEED).first_success_step[0])
    last = layout.episode_steps if done < 0 else min(done + _AFTER, layout.episode_steps)
    shown = np.unique(np.linspace(1, last, frames).round().astype(int))
    camera = spec.camera(env, FRAME_WIDTH, FRAME_HEIGHT)
    pictures: list[Any] = []
    observations: list[Any] = []
    step = 0

    def observe(result: Any, counted: int) -> None:
        nonlocal step
        del counted
        step += 1
        if step in shown:
            pictures.append(camera.render(0))
            observations.append(result.observation[0])

    try:
        episodes = run_episodes(policy, env, 1, _SEED, observer=observe)
    finally:
        camera.close()
    columns = min(4, len(pictures))
    figure, axes = drawing.new_axes(-(-len(pictures) // columns), columns, 3.2 * columns,
                                    2.6 * -(-len(pictures) // columns))  # fmt: skip
    rows = []
    for axis in axes.ravel():
        axis.set_axis_off()
    for axis, picture, values, at in zip(
        axes.ravel(), pictures, observations, shown.tolist(), strict=False
    ):
        axis.imshow(picture)
        named = dict(zip(layout.observation_names, map(float, values), strict=True))
        words = [caption.text(named[caption.field]) for caption in spec.captions]
        axis.set_title("  ".join([f"{at * layout.control_dt:.1f} s", *words]), fontsize=8)
        rows.append({"step": at, **named})
    return figure, rows, bool(episodes.success[0])
