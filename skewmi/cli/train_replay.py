"""A later look at a training: what `train --live` would have shown, from the run's directory."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from skewmi.errors import CheckpointError
from skewmi.extras import require
from skewmi.outputs import check_output

APPLICATION = "skewmi_training"


def replay_training(
    run_dir: Path, out: Path | None, *, live: bool, overwrite: bool, as_json: bool
) -> int:
    """Write or show the view of a run. Returns 0.

    Args:
        run_dir: Of the run.
        out: Rerun file to write; by default beside the directory.
        live: Open a viewer instead.
        overwrite: Replace an existing file.
        as_json: Print one JSON document.

    Raises:
        CheckpointError: There is no run in the directory, or nothing of it yet.
        ConfigurationError: It cannot be written or shown, or not to its end.
    """
    target = out or run_dir.with_name(f"{run_dir.name}.rrd")
    if live:
        document = _draw(run_dir, None)
    else:
        check_output(target, overwrite=overwrite)
        document = _draw(run_dir, target)
    if as_json:
        print(json.dumps({"rrd": None if live else str(target), **document}))
        return 0
    print(f"{document['trajectories']:,} trajectories, {document['iterations']:,} iterations")
    if not live:
        print(f"wrote {target}; open it with: rerun {target}")
    return 0


def _draw(run_dir: Path, file: Path | None) -> dict[str, Any]:
    """Draw into a file, or in a viewer; how much there was."""
    require("a replay", "rerun")
    # Late, because Rerun takes a while to import and wrong options should fail at once.
    import rerun as rr

    from skewmi.deploy.replay import viewer
    from skewmi.deploy.replay.rerun_file import drawn_into
    from skewmi.evaluation.training_view import TrainingView
    from skewmi.train.follow import RunFollower

    follower = RunFollower(run_dir)
    news, facts = follower.look(), follower.facts()
    if news is None or facts is None:
        raise CheckpointError(f"{run_dir} is no run directory: it has no readable config.json")
    if news.nothing:
        raise CheckpointError(f"{run_dir} has nothing to show yet")
    name = run_dir.resolve().name
    stream = rr.RecordingStream(APPLICATION, recording_id=name)
    if file is None:
        stream.connect_grpc(viewer.spawn_viewer("use --out and open the file elsewhere"))
        TrainingView(stream, facts, name, live=False).draw(news)
        viewer.send_rest(stream)
    else:
        with drawn_into(stream, file):
            TrainingView(stream, facts, name, live=False).draw(news)
    rows = news.rows.get("trajectories", ())
    return {"trajectories": int(news.episodes[-1]) + 1 if len(news.episodes) else 0,
            "iterations": len(rows)}  # fmt: skip
