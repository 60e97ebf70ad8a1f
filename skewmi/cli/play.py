"""Show a policy in simulation: in a Rerun viewer, in the browser, or in a file. No deployment.

One episode after the other, or several copies side by side (--copies), with --variation each of
them another robot and scene. Without a screen the browser is used, and the address told. Exit code
0, whatever became of the episodes; 130 if Ctrl-C came before their end.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console

from skewmi import policies
from skewmi.cli import numbers
from skewmi.cli.interrupt import stop_on_signal
from skewmi.cli.policies import Which, load_policy_from, make_env, task_options
from skewmi.cli.task_flags import OptionalTaskName, calibration_option, variation_option
from skewmi.errors import ConfigurationError, LayoutMismatchError
from skewmi.outputs import check_output
from skewmi.policy_io import Policy
from skewmi.progress import progress

APPLICATION = "skewmi_play"
MAX_COPIES = 64
BUNDLED = ", ".join(policies.bundled()) or "there is none"


@dataclass(frozen=True)
class PlayCommand:
    """Options of `skewmi play`."""

    policy: Annotated[
        Path | None,
        tyro.conf.Positional,
        tyro.conf.arg(help=f"Run directory, ONNX file, or a bundled policy: {BUNDLED}."),
    ] = None
    task: OptionalTaskName = None
    """Task to show; default: the policy's."""
    agent: Literal["policy", "zero", "random"] = "policy"
    """Who acts: the policy, or a baseline that always or randomly does anything."""
    episodes: int = 1
    """Episodes of each copy, one after the other."""
    copies: int = 1
    """Copies side by side, 1..64."""
    seed: int = 0
    """Of start states and variations, and of the random agent."""
    which: Which = "latest"
    """Which checkpoint of a run directory."""
    variation: str | None = None
    """How robot and scene differ from the nominal ones: a variation file (YAML), or the name of a
    bundled one, as `randomised`; each copy and episode draws its own."""
    calibration: Path | None = None
    """What is known of the robot: a calibration file (YAML) of `skewmi calibrate`."""
    option: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """Option of the task, NAME=VALUE with VALUE in JSON; may be repeated."""
    web: bool = False
    """Show it in the browser, served on this machine until Ctrl-C."""
    out: Path | None = None
    """Write a Rerun file (.rrd) instead of showing it."""
    overwrite: bool = False
    """Replace an existing file."""
    json: bool = False
    """Print one JSON document on the last line."""


def run_play(options: PlayCommand) -> int:
    """Run the episodes and show them. Returns 0, 130 if it was interrupted before the end."""
    numbers.require("--copies", options.copies, 1, MAX_COPIES)
    numbers.require("--episodes", options.episodes, 1, 1000)
    if options.web and options.out is not None:
        raise ConfigurationError("give --web or --out, not both")
    if options.out is not None:
        check_output(options.out, overwrite=options.overwrite, inputs=[options.policy])
    policy, env = _made(options)
    document = _shown(options, policy, env, Console(stderr=True))
    if options.out is not None:
        document["rrd"] = str(options.out)
    _tell(document, options)
    return 0


def _made(options: PlayCommand) -> tuple[Policy, Any]:
    """The policy and its environment."""
    policy: Policy | None = None
    if options.agent == "policy":
        if options.policy is None:
            raise ConfigurationError(
                f"give a run directory, an ONNX file or a bundled policy ({BUNDLED}), or --agent "
                "zero|random with --task"
            )
        policy = load_policy_from(options.policy, options.which)
    elif options.task is None:
        raise ConfigurationError(f"--agent {options.agent} needs --task")
    task = options.task or (policy.layout.task if policy is not None else "")
    if policy is not None and policy.layout.task != task:
        raise LayoutMismatchError(
            f"{options.policy} was trained on task {policy.layout.task!r}, --task is {task!r}"
        )
    made = task_options(task, None if policy is None else policy.layout, options.option)
    made |= variation_option(task, options.variation)
    made |= calibration_option(task, options.calibration)
    env = make_env(task, options.copies, options.copies, 0, options.seed, made)
    if policy is None:
        from skewmi.evaluation.agents import RandomAgent, ZeroAgent

        zero = options.agent == "zero"
        policy = ZeroAgent(env.layout) if zero else RandomAgent(env.layout, options.seed)
    return policy, env


def _shown(options: PlayCommand, policy: Policy, env: Any, console: Console) -> dict[str, Any]:
    """Run the episodes, and show them where the options say; what became of them."""
    # Late: Rerun takes a while to import, and wrong options should fail at once.
    import rerun as rr

    from skewmi.deploy.replay import viewer, web
    from skewmi.deploy.replay.rerun_file import drawn_into

    title = "random" if options.policy is None else options.policy.stem
    stream = rr.RecordingStream(APPLICATION)
    stream.send_recording_name(f"{title} on {env.layout.task}")
    address: str | None = None
    if options.out is not None:
        with drawn_into(stream, options.out):
            found = _played(options, policy, env, stream)
    else:
        if options.web or not viewer.has_screen():
            ports = web.free_ports()
            web.serve(stream, ports)
            address = web.address(ports)
            console.print(f"open {address} in a browser", highlight=False, soft_wrap=True)
        else:
            stream.connect_grpc(viewer.spawn_viewer("use --web, or --out FILE"))
        found = _played(options, policy, env, stream)
        viewer.send_rest(stream, timeout_s=30.0)
    if address is not None:
        # Only here: an end that is asked for earlier must not wait for the last episode.
        with stop_on_signal() as stop:
            console.print("all episodes are there; Ctrl-C ends the server")
            stop.wait()
    succeeded = sum(step > 0 for step in found)
    return {
        "task": env.layout.task,
        "episodes": len(found),
        "succeeded": succeeded,
        "first_success_step": found,
        "address": address,
    }


def _played(options: PlayCommand, policy: Policy, env: Any, stream: Any) -> list[int]:
    """Run and draw the episodes; at which step each succeeded first."""
    from skewmi.cli.play_stage import make_stage
    from skewmi.evaluation.play import play

    stage = make_stage(env, stream)
    with progress(f"playing {env.layout.task}") as bar:
        return play(
            policy,
            env,
            stage,
            stream,
            options.episodes,
            options.seed,
            on_round=lambda done, won: bar(done, options.episodes, f"{won} succeeded"),
        )


def _tell(document: dict[str, Any], options: PlayCommand) -> None:
    if options.json:
        print(json.dumps(document))
        return
    print(f"{document['succeeded']} of {document['episodes']} episodes succeeded")
    if "rrd" in document:
        print(f"wrote {document['rrd']}; open it with: rerun {document['rrd']}")
