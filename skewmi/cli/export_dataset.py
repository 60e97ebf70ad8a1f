"""Turn recordings into a data set that imitation learners read: a LeRobotDataset.

Each control step of a policy is a frame: what it saw (`observation.state`, in the units of the
policy's layout), what it answered (`action`, in -1..1) and the measured joints. Recordings have no
pictures, so the data set has none, unless --camera has them drawn from the recorded states of robot
and scene. All recordings must be of one task, of policies that see and do the same.
"""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro
from numpy.typing import NDArray

from skewmi import extras
from skewmi.cli import numbers
from skewmi.deploy.wire import topics
from skewmi.errors import ConfigurationError, NotFoundError, OutputError
from skewmi.evaluation.film import draw, joint_series
from skewmi.evaluation.lerobot_dataset import DatasetWriter, Feature
from skewmi.evaluation.lerobot_pictures import Pictures
from skewmi.evaluation.recorded_episodes import RecordedEpisode, RecordedRun, read_run
from skewmi.outputs import make_folder, writing
from skewmi.progress import progress
from skewmi.sim import tasks

MAX_SIZE = 4096

_SAME_STEP = 0.05
"""Part by which the control steps of recordings may differ."""


@dataclass(frozen=True)
class ExportDatasetCommand:
    """Options of `skewmi export-dataset`."""

    recordings: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """MCAP files of `skewmi deploy --record`."""
    out: Path
    """Folder to write."""
    format: Literal["lerobot"] = "lerobot"
    """Of the data set: LeRobotDataset 3.0."""
    instruction: str | None = None
    """What the task is in words, for learners that read them; by default the task's name."""
    only_successes: bool = False
    """Leave out episodes that did not solve the task."""
    camera: str | None = None
    """Draw each step from this camera of the simulated scene, such as `close` or `overview`."""
    width: int = 320
    """Of those pictures, pixels."""
    height: int = 240
    """Of those pictures, pixels."""
    overwrite: bool = False
    """Replace an existing data set."""
    json: bool = False
    """Print what was written as one JSON document."""


def run_export_dataset(options: ExportDatasetCommand) -> int:
    """Export. Returns 0."""
    numbers.require("--width", options.width, 1, MAX_SIZE)
    numbers.require("--height", options.height, 1, MAX_SIZE)
    if not options.recordings:
        raise ConfigurationError("no recording given; name MCAP files of skewmi deploy --record")
    extras.require("`skewmi export-dataset`", "pyarrow", *(["PIL"] if options.camera else []))
    _check_folder(options)
    runs = [read_run(path) for path in options.recordings]
    _check_alike(runs)
    for note in (note for run in runs for note in run.notes):
        sys.stderr.write(f"{note}\n")
    chosen = [
        (run, episode)
        for run in runs
        for episode in run.episodes
        if episode.success or not options.only_successes
    ]
    if not chosen:
        raise ConfigurationError("no episode solved the task; leave out --only-successes")
    task = options.instruction or runs[0].layout.task.replace("_", " ")
    with _folder_aside(options.out) as folder, writing(options.out):
        frames = _write(options, folder, runs, chosen, task)
    document = {
        "folder": str(options.out),
        "episodes": len(chosen),
        "successes": sum(episode.success for _, episode in chosen),
        "frames": frames,
        "task": task,
        "pictures": options.camera,
    }
    if options.json:
        print(json.dumps(document))
        return 0
    print(
        f"wrote {options.out}: {len(chosen)} episodes ({document['successes']} solved), {frames} "
        f"frames, {'no pictures' if options.camera is None else f'camera {options.camera!r}'}"
    )
    return 0


def _write(
    options: ExportDatasetCommand,
    folder: Path,
    runs: Sequence[RecordedRun],
    chosen: Sequence[tuple[RecordedRun, RecordedEpisode]],
    task: str,
) -> int:
    """Write everything; the number of frames."""
    first = runs[0]
    pictures = None
    if options.camera is not None:
        pictures = Pictures(options.camera, options.width, options.height)
    writer = DatasetWriter(
        folder,
        {
            "observation.state": Feature("float32", first.layout.observation_names),
            "observation.joint_positions": Feature("float32", first.joint_names),
            "action": Feature("float32", tuple(field.name for field in first.layout.action)),
            "next.reward": Feature("float32"),
            "next.done": Feature("bool"),
            "next.success": Feature("bool"),
        },
        1.0 / first.step_s,
        task,
        pictures,
    )
    total = sum(len(episode.stamps_ns) for _, episode in chosen)
    done = 0
    with progress("writing", "frames") as bar:
        for run, episode in chosen:
            last = np.arange(len(episode.stamps_ns)) == len(episode.stamps_ns) - 1
            drawn = () if pictures is None else _drawn(run, episode, pictures)
            writer.add(
                {
                    "observation.state": episode.observation,
                    "observation.joint_positions": episode.joint_positions,
                    "action": episode.action,
                    "next.reward": episode.reward,
                    "next.done": last,
                    "next.success": last & episode.success,
                },
                drawn,
            )
            done += len(last)
            bar(done, total)
    writer.finish(_about(first, [episode for _, episode in chosen]))
    return done


def _drawn(
    run: RecordedRun, episode: RecordedEpisode, pictures: Pictures
) -> list[NDArray[np.uint8]]:
    arm = tasks.find(run.layout.task).arm
    if arm is None:
        raise ConfigurationError(f"task {run.layout.task!r} has no robot scene to draw")
    shown = [topics.YUMI_JOINT_STATES, *([topics.YUMI_SCENE_STATES] if arm.joints else [])]
    return draw(
        arm,
        [joint_series(run.recording, topic) for topic in shown],
        episode.stamps_ns,
        width=pictures.width,
        height=pictures.height,
        camera=pictures.camera,
    )


def _about(first: RecordedRun, episodes: Sequence[RecordedEpisode]) -> dict[str, Any]:
    """Where the data comes from."""
    kept = (
        "policy",
        "seed",
        "limit_profile",
        "robot_model_hash",
        "variation",
        "calibration",
        "box_pose",
    )
    metadata = first.recording.metadata
    return {
        "layout": json.loads(first.layout.to_json()),
        "run": {name: metadata[name] for name in kept if name in metadata},
        "episodes": [
            {"recording": e.source.name, "episode": e.number, "outcome": e.outcome}
            for e in episodes
        ],
    }


def _check_alike(runs: Sequence[RecordedRun]) -> None:
    """Raises ConfigurationError unless all recordings go into one data set."""
    first = runs[0]
    for run in runs[1:]:
        what = None
        if run.layout.hash() != first.layout.hash():
            what = f"layout {run.layout.task!r} ({run.layout.hash()[:12]})"
            of_first = f"{first.layout.task!r} ({first.layout.hash()[:12]})"
        elif run.joint_names != first.joint_names:
            what, of_first = f"joints {run.joint_names}", str(first.joint_names)
        elif abs(run.step_s - first.step_s) > _SAME_STEP * first.step_s:
            what = f"control steps of {run.step_s * 1e3:.0f} ms"
            of_first = f"{first.step_s * 1e3:.0f} ms"
        if what is not None:
            raise ConfigurationError(
                f"{run.recording.path} has {what}, {first.recording.path} has {of_first}; export "
                "them apart"
            )


def _check_folder(options: ExportDatasetCommand) -> None:
    """Raises OutputError if the data set must not or cannot be written."""
    out = options.out
    for given in options.recordings:
        if given.resolve().is_relative_to(out.resolve()):
            raise OutputError(f"{out} holds {given}, which is read; give another --out")
    if out.exists() and not options.overwrite:
        raise OutputError(f"{out} exists; give another --out or --overwrite")
    if out.exists() and not (out / "meta" / "info.json").is_file():
        raise OutputError(f"{out} is no data set, so it is not replaced; give another --out")
    make_folder(out.resolve().parent)
    missing = [str(path) for path in options.recordings if not path.is_file()]
    if missing:
        raise NotFoundError(f"no recording at {', '.join(missing)}")


@contextmanager
def _folder_aside(out: Path) -> Iterator[Path]:
    """An empty folder that takes the place of `out` when the block is left, unless it fails."""
    target = out.resolve()
    draft = target.with_name(f".{target.name}.part")
    shutil.rmtree(draft, ignore_errors=True)
    try:
        yield make_folder(draft)
        if target.exists():
            shutil.rmtree(target)
        draft.rename(target)
    finally:
        shutil.rmtree(draft, ignore_errors=True)
