"""What commands have in common that take a task: its choices, and how it may differ."""

from __future__ import annotations

from typing import Annotated

import tyro

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
