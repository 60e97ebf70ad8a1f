"""Turn a recording into a Rerun file, or show it in a viewer.

The view has the robot and the scene moving, the hand in its workspace, every joint's position,
velocity, acceleration and jerk against its limits, torques and contact forces, what success needs,
the policy's input and output, lateness and cycle times, and the state machines' events; its legend
says what is missing. Recordings whose recorder was killed are shown as far as they go. Of a
training, given by its run directory, what `skewmi train --live` shows is drawn.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import tyro

from skewmi.errors import ConfigurationError
from skewmi.progress import progress
from skewmi.smoothness import LIMITS


@dataclass(frozen=True)
class ReplayCommand:
    """Options of `skewmi replay`."""

    recording: Annotated[Path, tyro.conf.Positional]
    """MCAP file written by `skewmi deploy --record`, or the run directory of a training."""
    out: Path | None = None
    """Rerun file to write; by default the recording's name with .rrd."""
    live: bool = False
    """Open a Rerun viewer instead of writing a file."""
    overwrite: bool = False
    """Replace an existing file; never the recording."""
    json: bool = False
    """Print the summary as one JSON document."""


def run_replay(options: ReplayCommand) -> int:
    """Write or show the replay. Returns 0."""
    if options.live and options.out is not None:
        raise ConfigurationError("give --live or --out, not both")
    if options.recording.is_dir():
        from skewmi.cli.train_replay import replay_training

        return replay_training(
            options.recording,
            options.out,
            live=options.live,
            overwrite=options.overwrite,
            as_json=options.json,
        )
    # Late, because Rerun takes a while to import and wrong options should fail at once.
    from skewmi.deploy.replay.replay import show_replay, write_replay

    out = options.out or options.recording.with_suffix(".rrd")
    with progress(str(options.recording.name), "parts") as bar:
        if options.live:
            report = show_replay(options.recording, bar)
        else:
            report = write_replay(options.recording, out, overwrite=options.overwrite, progress=bar)
    if options.json:
        written = None if options.live else str(out)
        print(json.dumps({"rrd": written, **asdict(report)}))
        return 0
    note = "" if report.complete else " (ends early: its recorder was killed)"
    print(f"{report.duration_s:.1f} s recorded{note}")
    for time_s in report.success_s:
        print(f"success at {time_s:.1f} s")
    for name, share in report.limit_use.items():
        print(f"largest commanded {name}: {100 * share:.0f} % of its limit")
    for (frequency, limit), value in zip(LIMITS.items(), report.smoothness.values(), strict=False):
        print(
            f"power of the commanded acceleration above {frequency:g} Hz, least smooth joint: "
            f"{value:.1%} ({limit:.0%} count as smooth)"
        )
    if report.tracking_error_mm is not None:
        print(
            f"largest distance from commanded to measured hand: {report.tracking_error_mm:.1f} mm"
        )
    if report.malformed:
        print(f"{report.malformed} messages could not be decoded and are left out")
    for words in report.notes:
        print(words)
    if not options.live:
        print(f"wrote {out}; open it with: rerun {out}")
    return 0
