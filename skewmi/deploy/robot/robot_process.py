"""The process behind `process.spawn_robot`: a robot that needs no options but those of a run.

    python -m skewmi.deploy.robot.robot_process TASK

TASK is a JSON object, see `serve`. Standard output: the robot server's description as one line of
JSON once it is ready. Standard error: changes of its state, and what went wrong, a line each. The
end of standard input is the end of the robot. This is `skewmi robot` without its command line,
which takes as long to read as a scene to compile.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from skewmi.calibration.calibration_file import read_calibration
from skewmi.deploy.robot.backends import BackendOptions
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.robot.log import told_from_a_thread
from skewmi.deploy.robot.run import serve_robot
from skewmi.deploy.wire.transport import TransportConfig
from skewmi.errors import SkewmiError
from skewmi.robot_models import limits as joint_limits


def serve(task: Mapping[str, Any], stop: threading.Event) -> None:
    """Serve a robot until `stop` is set.

    Args:
        task: "backend", "task", "limits", "listen", "domain", "lock_step" and maybe "variation"
            and "calibration", as the options of `skewmi robot`.
        stop: Set by a signal, or at the end of standard input.

    Raises:
        SkewmiError: As `serve_robot`.
    """
    calibration = task.get("calibration")
    serve_robot(
        task["backend"],
        BackendOptions(task["task"], task.get("variation"), task["lock_step"]),
        TransportConfig.for_robot(
            task["listen"], domain=task["domain"], lock_step=task["lock_step"]
        ),
        joint_limits.profile(task["limits"]),
        stop,
        on_ready=_tell_ready,
        calibration=None if calibration is None else read_calibration(Path(calibration)),
    )


def _tell_ready(description: RobotDescription) -> None:
    print(description.to_json(), flush=True)  # noqa: T201


def _say(line: str) -> None:
    with suppress(OSError):  # Who started us may be gone; the arm comes first.
        print(line, file=sys.stderr, flush=True)  # noqa: T201


def _wait_for_end_of_input(stop: threading.Event) -> None:
    # Not through sys.stdin: a thread that waits in its buffer cannot be left at exit.
    while os.read(sys.stdin.fileno(), 4096):
        pass
    stop.set()


def main() -> int:
    """Entry point."""
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: stop.set())
    threading.Thread(target=_wait_for_end_of_input, args=(stop,), daemon=True).start()
    try:
        with told_from_a_thread(_say):
            serve(json.loads(sys.argv[1]), stop)
    except SkewmiError as error:
        _say(f"skewmi robot: {' '.join(str(error).split())}")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
