"""What several commands need: a policy from a path, and the environment it was made for."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from skewmi import extras, policies
from skewmi.batch_env import BatchEnv
from skewmi.cli import numbers
from skewmi.errors import ConfigurationError, NotFoundError, did_you_mean
from skewmi.policy_io import Policy, PolicyLayout

if TYPE_CHECKING:
    from skewmi.train.policy import TorchPolicy

Which = Literal["latest", "best"]

_OWN_FLAGS = ("num_envs", "num_threads", "seed", "variation", "calibration")

MAX_BATCH = 50
"""Environments stepped together by default: enough to keep the threads busy, little memory."""


def load_run(run_dir: Path, which: Which) -> TorchPolicy:
    """The policy of a run directory; imports torch.

    Raises:
        NotFoundError: torch is not installed.
        CheckpointError: The directory is not a run, or has no such checkpoint.
    """
    try:
        from skewmi.train.policy import load_policy
    except ModuleNotFoundError as error:
        raise extras.missing("reading a run directory", error) from error
    return load_policy(run_dir, which=which)


def load_policy_from(path: Path, which: Which) -> Policy:
    """A policy from a run directory or from an ONNX file.

    Raises:
        NotFoundError: The path does not exist, or torch is needed and not installed.
        PolicyFileError, LayoutMismatchError: It is a file, but no policy.
        CheckpointError: It is a directory, but no run.
    """
    if path.is_dir():
        return load_run(path, which)
    found = locate_policy(path, "a run directory of skewmi train, an ONNX file")
    from skewmi.deploy.policy import OnnxPolicy

    policy: Policy = OnnxPolicy.load(found)
    return policy


def locate_policy(path: Path, wanted: str) -> Path:
    """An existing path as it is, or the file of the bundled policy of that name.

    Args:
        path: As it was given.
        wanted: What else might be given, in words that end with "an ONNX file".

    Raises:
        NotFoundError: There is neither.
    """
    found = policies.locate(path)
    if found.exists():
        return found
    names = ", ".join(policies.bundled()) or "none"
    raise NotFoundError(
        f"{path} does not exist; give {wanted} of skewmi export-onnx, or the name of a bundled "
        f"policy ({names}){did_you_mean(str(path), policies.bundled())}"
    )


def task_options(task: str, wanted: PolicyLayout | None, given: tuple[str, ...]) -> dict[str, Any]:
    """Options of `sim.tasks.make_batch` that give a policy the environment it was made for.

    Args:
        task: One of `sim.tasks.names()`.
        wanted: Layout of the policy. What the task offers as choices in its layout is tried
            until the layouts agree; if none does, the caller's comparison says what differs.
        given: NAME=VALUE pairs of the user, VALUE in JSON; they come on top.

    Raises:
        ConfigurationError: A pair is malformed.
        NotFoundError: There is no such task.
    """
    from skewmi.sim import tasks

    options: dict[str, Any] = {}
    for chosen, layout in tasks.find(task).layouts():
        if wanted is not None and layout.hash() == wanted.hash():
            options.update(chosen)
            break
    for pair in given:
        name, equals, text = pair.partition("=")
        try:
            if not equals or not name.isidentifier():
                raise ValueError("the form is NAME=VALUE")
            if name in _OWN_FLAGS:
                raise ValueError(f"use --{name.replace('_', '-')}")
            # The name of a target needs no quotes; the task itself refuses one that is none.
            named = name == "target" and not text.startswith('"')
            options[name] = text if named else json.loads(text)
        except ValueError as error:
            raise ConfigurationError(f"task option {pair!r}: {error}") from error
    return options


def check_numbers(num_envs: int, episodes: int, num_threads: int, seed: int) -> None:
    """See that the numbers of an evaluation make sense; 0 environments or threads: automatic.

    Raises:
        ConfigurationError: One does not.
    """
    numbers.require("--num-envs", num_envs, 0, numbers.MAX_ENVS)
    numbers.require("--episodes", episodes, 1, numbers.MAX_EPISODES)
    numbers.require("--num-threads", num_threads, 0, numbers.MAX_THREADS)
    numbers.require_seed(seed)


def make_env(
    task: str, num_envs: int, episodes: int, num_threads: int, seed: int, options: dict[str, Any]
) -> BatchEnv:
    """The environment of an evaluation.

    Args:
        task: One of `sim.tasks.names()`.
        num_envs: Environments stepped together; 0: as many as episodes, at most `MAX_BATCH`.
        episodes: How many will be run.
        num_threads: 0 chooses.
        seed: Of everything random.
        options: Of the task.

    Raises:
        ConfigurationError: A number is not allowed.
        NotFoundError: There is no such task.
    """
    from skewmi.sim import tasks

    check_numbers(num_envs, episodes, num_threads, seed)
    n = num_envs or min(episodes, MAX_BATCH)
    return tasks.make_batch(task, n, num_threads=num_threads, seed=seed, **options)
