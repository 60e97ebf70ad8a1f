"""From a recording to Rerun: a file, or a viewer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr

from skewmi.deploy.recording.believed import Believed, believed_part
from skewmi.deploy.recording.reader import read_recording
from skewmi.deploy.replay import viewer
from skewmi.deploy.replay.assembler import understand
from skewmi.deploy.replay.data import Run
from skewmi.deploy.replay.policy_part import policy_smoothness
from skewmi.deploy.replay.rerun_file import drawn_into
from skewmi.deploy.replay.view import RunView
from skewmi.outputs import check_output

APPLICATION = "skewmi_replay"


@dataclass(frozen=True)
class ReplayReport:
    """What a replay shows."""

    duration_s: float
    messages: dict[str, int]
    """Number by topic, of those shown."""
    malformed: int
    """Messages that could not be decoded and are left out."""
    complete: bool
    """False if the recording ends early: its recorder was killed."""
    success_s: tuple[float, ...]
    """When the policy succeeded, s after the first stamp; once per episode."""
    limit_use: dict[str, float]
    """Largest |commanded| as a fraction of its limit, over all joints."""
    smoothness: dict[str, float]
    """Of the motion that the policy commanded, see `policy_part.policy_smoothness`."""
    tracking_error_mm: float | None
    """Largest distance from commanded to measured hand, mm."""
    notes: tuple[str, ...] = ()
    """Whose messages are left out as not believed, in words."""


Progress = Callable[[int, int, str], None]
"""Parts done, of how many, and what is being done."""
_PARTS = 3


def _silent(done: int, total: int, words: str) -> None:
    del done, total, words


def write_replay(
    recording_path: Path,
    rrd_path: Path,
    *,
    overwrite: bool = False,
    progress: Progress = _silent,
) -> ReplayReport:
    """Write a Rerun file.

    Args:
        recording_path: An MCAP recording.
        rrd_path: File to write; appears only when it is complete.
        overwrite: Replace an existing file, but never the recording.
        progress: Told how far it is.

    Raises:
        ConfigurationError: The recording cannot be used, or the file must not or cannot be
            written.
    """
    check_output(rrd_path, overwrite=overwrite, inputs=[recording_path])
    run, believed = _understood(recording_path, progress)
    stream = rr.RecordingStream(APPLICATION, recording_id=recording_path.stem)
    with drawn_into(stream, rrd_path):
        RunView(stream, run.subject, recording_path.stem).draw(run)
    return _report(run, believed)


def show_replay(recording_path: Path, progress: Progress = _silent) -> ReplayReport:
    """Open a Rerun viewer on a recording.

    Raises:
        ConfigurationError: The recording cannot be used, or no viewer can be started, or
            it does not take everything.
    """
    run, believed = _understood(recording_path, progress)
    stream = rr.RecordingStream(APPLICATION, recording_id=recording_path.stem)
    stream.connect_grpc(viewer.spawn_viewer("use --out and open the file elsewhere"))
    RunView(stream, run.subject, recording_path.stem).draw(run)
    viewer.send_rest(stream)
    return _report(run, believed)


def _understood(recording_path: Path, progress: Progress) -> tuple[Run, Believed]:
    progress(0, _PARTS, "reading")
    believed = believed_part(read_recording(recording_path))
    progress(1, _PARTS, "understanding")
    run = understand(believed.recording)
    progress(2, _PARTS, "drawing")
    return run, believed


def _report(run: Run, believed: Believed) -> ReplayReport:
    recording = believed.recording
    counts = {topic: len(messages) for topic, messages in recording.messages.items()}
    motion, limits = run.commanded, run.subject.limits
    use = {}
    for name, values in (("velocity", motion.v), ("acceleration", motion.a), ("jerk", motion.jerk)):
        if name in limits and len(values):
            use[name] = float(np.abs(values / limits[name]).max())
    error = run.error.values
    error_mm = 1e3 * float(np.linalg.norm(error, axis=1).max()) if len(error) else None
    return ReplayReport(
        duration_s=run.duration_s,
        messages=counts,
        malformed=run.malformed,
        complete=recording.complete,
        success_s=run.success_s,
        limit_use=use,
        smoothness=policy_smoothness(recording),
        tracking_error_mm=error_mm,
        notes=believed.notes,
    )
