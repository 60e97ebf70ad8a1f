"""What commands have in common that take a task: its choices, how it may differ, what is known."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import tyro

from skewmi.calibration.calibration_file import read_calibration
from skewmi.errors import ConfigurationError
from skewmi.sim import tasks

TASK_NAMES = "{" + ",".join(tasks.names()) + "}"
"""The tasks of this installation, as help texts list choices."""

TaskName = Annotated[str, tyro.conf.arg(metavar=TASK_NAMES)]
OptionalTaskName = Annotated[str | None, tyro.conf.arg(metavar=TASK_NAMES)]


def variation_option(task: str, variation: str | None) -> dict[str, str]:
    """The task option that a `--variation` means: what the file says, so that it may change later.

    Args:
        task: Whose keys and bundled files.
        variation: File, or name of a bundled one; None for the nominal model, which is no option.

    Raises:
        NotFoundError: There is no such task or file.
        ConfigurationError: The task has no variations, or a key or value is not allowed.
    """
    if variation is None:
        return {}
    variations = tasks.find(task).variations
    if not variations.keys:
        raise ConfigurationError(f"task {task!r} has nothing that varies; leave out --variation")
    found = variations.resolve(variation)
    return {} if found.is_nominal else {"variation": found.to_json()}


def calibration_option(task: str, calibration: Path | None) -> dict[str, str]:
    """The task option that a `--calibration` means: what the file says, so that it may change.

    Args:
        task: Of the robot that is known.
        calibration: The file; None if nothing is known, which is no option.

    Raises:
        NotFoundError: There is no such task or file.
        ConfigurationError: The task has no robot, or the file is no calibration of this one.
    """
    if calibration is None:
        return {}
    if tasks.find(task).arm is None:
        raise ConfigurationError(f"task {task!r} has no robot; leave out --calibration")
    return {"calibration": json.dumps(read_calibration(calibration).as_mapping())}
