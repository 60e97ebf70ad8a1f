"""Draw a recorded deployment: a film and a strip of labelled frames of one episode.

Draws what the robot reported (measured joints and scene), not what was commanded.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from skewmi.cli import numbers
from skewmi.deploy.recording.believed import believed_part
from skewmi.deploy.recording.reader import read_recording
from skewmi.deploy.wire import topics
from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.evaluation.film import (
    caption,
    draw,
    joint_series,
    recorded_layout,
    running_stamps,
    split_episodes,
)
from skewmi.outputs import check_output
from skewmi.progress import progress
from skewmi.sim import tasks

MIN_RATE, MAX_RATE = 0.001, 1000.0
"""Frames per second of the episode's time; more show nothing new of a robot sampled at 250 Hz."""

MAX_FRAMES, MAX_SIZE = 1000, 8192


@dataclass(frozen=True)
class FilmCommand:
    """Options of `skewmi film`."""

    recording: Annotated[Path, tyro.conf.Positional]
    """MCAP file of `skewmi deploy --record`."""
    out: Path | None = None
    """Film to write (.gif or .webp); default: beside the recording, as .gif."""
    strip: Path | None = None
    """Also write a picture of labelled frames in sequence (.png)."""
    episode: int = 1
    """Which episode, from 1."""
    camera: str = "close"
    """Camera of the scene."""
    width: int = 480
    """Width of a frame, pixels."""
    height: int = 360
    """Height of a frame, pixels."""
    rate: float = 5.0
    """Frames per second of the episode's time."""
    frames: int = 12
    """Frames of the strip."""
    overwrite: bool = False
    """Replace existing files; never the recording."""
    json: bool = False
    """Print what was written as one JSON document."""


def run_film(options: FilmCommand) -> int:
    """Draw. Returns 0."""
    _require_numbers(options)
    out = options.out if options.out is not None else options.recording.with_suffix(".gif")
    check_output(out, overwrite=options.overwrite, inputs=[options.recording, options.strip])
    if options.strip is not None:
        check_output(options.strip, overwrite=options.overwrite, inputs=[options.recording, out])
    believed = believed_part(read_recording(options.recording))
    recording = believed.recording
    for note in believed.notes:
        sys.stderr.write(f"{note}\n")
    spec = tasks.find(recorded_layout(recording).task)
    if spec.arm is None:
        raise ConfigurationError(f"task {spec.name!r} has no robot scene to draw")
    observed = joint_series(recording, topics.POLICY_OBSERVATION)
    episodes = split_episodes(observed.stamps_ns, running_stamps(recording))
    if not 1 <= options.episode <= len(episodes):
        raise NotFoundError(
            f"{options.recording} holds {len(episodes)} episodes; --episode is {options.episode}"
        )
    start, stop = episodes[options.episode - 1]
    times = np.arange(start, stop + 1, round(1e9 / options.rate), dtype=np.int64)
    shown = [topics.YUMI_JOINT_STATES, *([topics.YUMI_SCENE_STATES] if spec.arm.joints else [])]
    with progress("drawing", "frames") as bar:
        frames = draw(
            spec.arm,
            [joint_series(recording, topic) for topic in shown],
            times,
            width=options.width,
            height=options.height,
            camera=options.camera,
            progress=bar,
        )

    from skewmi.sim import rendering

    values = observed.at(times)
    labels = [
        caption(spec.captions, observed.names, row, (t - start) / 1e9)
        for row, t in zip(values, times, strict=True)
    ]
    labelled = [rendering.label(f, text) for f, text in zip(frames, labels, strict=True)]
    rendering.write_film(out, labelled, frames_per_second=options.rate)
    written = [str(out)]
    if options.strip is not None:
        chosen = np.unique(np.linspace(0, len(frames) - 1, options.frames).round().astype(int))
        sheet = rendering.contact_sheet([frames[i] for i in chosen], [labels[i] for i in chosen])
        rendering.write_picture(options.strip, sheet)
        written.append(str(options.strip))
    document = {
        "files": written,
        "episode": options.episode,
        "episodes": len(episodes),
        "frames": len(frames),
        "duration_s": (stop - start) / 1e9,
    }
    print(json.dumps(document) if options.json else "wrote " + " and ".join(written))
    return 0


def _require_numbers(options: FilmCommand) -> None:
    """Raises ConfigurationError for a number that makes no sense."""
    numbers.require("--rate", options.rate, MIN_RATE, MAX_RATE)
    numbers.require("--frames", options.frames, 1, MAX_FRAMES)
    numbers.require("--episode", options.episode, 1, numbers.MAX_EPISODES)
    numbers.require("--width", options.width, 1, MAX_SIZE)
    numbers.require("--height", options.height, 1, MAX_SIZE)
