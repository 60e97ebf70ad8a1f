"""Success rate of a run directory or an ONNX file in the batched simulation.

An episode succeeds when its state stays inside the task's reward region for as many consecutive
steps as the task demands. Prints the rate with its 95 % Wilson interval and, where the task
measures it, how hard the robot touched things and how well it followed its commands. Exit code 0,
however many succeed.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from skewmi.cli.policies import (
    Which,
    load_policy_from,
    make_env,
    task_options,
)
from skewmi.cli.task_flags import OptionalTaskName, calibration_option, variation_option
from skewmi.errors import ConfigurationError, LayoutMismatchError
from skewmi.evaluation.agents import RandomAgent, ZeroAgent
from skewmi.evaluation.contact import contact_text, recorder_for, summarise_contact
from skewmi.evaluation.rollout import run_episodes, summarise
from skewmi.policy_io import Policy
from skewmi.progress import progress


@dataclass(frozen=True)
class EvaluateCommand:
    """Options of `skewmi evaluate`."""

    policy: Annotated[Path | None, tyro.conf.Positional] = None
    """Run directory or ONNX file. Not needed with --agent zero or random."""
    task: OptionalTaskName = None
    """Task to run; default: the one the policy was trained on."""
    agent: Literal["policy", "zero", "random"] = "policy"
    """Who acts: the given policy, or a baseline that always or randomly does anything."""
    episodes: int = 100
    """How many episodes to run."""
    seed: int = 0
    """Seed of start states and randomisation, and of the random agent."""
    which: Which = "latest"
    """Which checkpoint of a run directory."""
    num_envs: int = 0
    """Environments stepped together; 0: as many as episodes, at most 50."""
    num_threads: int = 0
    """Threads that step them; 0: automatic."""
    variation: str | None = None
    """How robot and scene differ from the nominal ones: a variation file (YAML), or the name of
    one that comes with the task, as `randomised`."""
    calibration: Path | None = None
    """What is known of the robot, whatever it is: a calibration file (YAML) of `skewmi calibrate`.
    Its servos get feed-forward from it, and the policy works in the frame of the box it knows."""
    option: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """Option of the task, NAME=VALUE with VALUE in JSON, as start_noise=0.3; may be repeated."""
    json: bool = False
    """Print one JSON document instead of text."""


def run_evaluate(options: EvaluateCommand) -> int:
    """Run the episodes and print the figures. Returns 0."""
    policy: Policy | None = None
    if options.agent == "policy":
        if options.policy is None:
            raise ConfigurationError(
                "give a run directory or an ONNX file, or --agent zero|random with --task"
            )
        policy = load_policy_from(options.policy, options.which)
    elif options.task is None:
        raise ConfigurationError(f"--agent {options.agent} needs --task")
    task = options.task or (policy.layout.task if policy is not None else "")
    if policy is not None and policy.layout.task != task:
        raise LayoutMismatchError(
            f"{options.policy} was trained on task {policy.layout.task!r}, --task is {task!r}"
        )
    env_options = task_options(task, policy.layout if policy is not None else None, options.option)
    env_options |= variation_option(task, options.variation)
    env_options |= calibration_option(task, options.calibration)
    env = make_env(
        task, options.num_envs, options.episodes, options.num_threads, options.seed, env_options
    )
    if policy is None:
        zero = options.agent == "zero"
        policy = ZeroAgent(env.layout) if zero else RandomAgent(env.layout, options.seed)
    contact = recorder_for(env)
    started = time.perf_counter()
    with progress(f"evaluating {task}", "steps") as bar:
        episodes = run_episodes(
            policy, env, options.episodes, options.seed, progress=bar, observer=contact
        )
    wall = time.perf_counter() - started
    figures: dict[str, Any] = {
        **summarise(episodes),
        "task": task,
        "agent": options.agent if options.agent != "policy" else str(options.policy),
        "seed": options.seed,
        "variation": options.variation or "nominal",
        "calibration": None if options.calibration is None else str(options.calibration),
        "num_envs": env.num_envs,
        "wall_time_s": wall,
    }
    if contact is not None:
        figures["contact"] = summarise_contact(contact.values)
    print(json.dumps(figures, indent=2) if options.json else as_text(figures))
    return 0


def as_text(figures: dict[str, Any]) -> str:
    """The figures of `run_evaluate` for people."""
    low, high = figures["success_rate_interval_95"]
    known = "" if figures["calibration"] is None else f", calibration: {figures['calibration']}"
    lines = [
        f"{figures['task']}, {figures['agent']}, seed {figures['seed']}, "
        f"model: {figures['variation']}{known}",
        f"  {figures['successes']} of {figures['episodes']} episodes succeeded: "
        f"{figures['success_rate']:.1%} (95 % interval {low:.1%} to {high:.1%})",
    ]
    first = figures["first_success_time_s"]
    if first["min"] is not None:
        lines.append(
            f"  first success after {first['median']:.1f} s in the median "
            f"({first['min']:.1f} to {first['max']:.1f} s)"
        )
    lines.append("  final state (median, min to max):")
    lines += [
        f"    {name:<14} {value['median']:10.4f} {value['min']:10.4f} to {value['max']:.4f}"
        for name, value in figures["final_state"].items()
    ]
    if "contact" in figures:
        lines += contact_text(figures["contact"])
    return "\n".join(lines)
