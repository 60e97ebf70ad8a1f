"""The whole chain in a few minutes: a policy deployed on the simulated YuMi, and one trained.

Runs the very commands a user would type, one after the other, and shows each. First a policy that
comes with the package is deployed, filmed and made a replay: something to look at within a minute.
Then another is trained from one sparse reward, on a task that is learned in minutes, and exported.
The summary says what each reached, and what to type next.
"""

from __future__ import annotations

import json
import shlex
import subprocess
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from skewmi import policies
from skewmi.child import child_command
from skewmi.cli import numbers
from skewmi.cli.task_flags import TaskName
from skewmi.errors import ConfigurationError
from skewmi.outputs import check_output
from skewmi.sim import tasks


def quickest() -> str:
    """The first task that is learned in minutes; if there is none, the first one."""
    known = [name for name in tasks.names() if tasks.find(name).demo]
    return (known or [tasks.default()])[0]


@dataclass(frozen=True)
class DemoCommand:
    """Options of `skewmi demo`."""

    out: Path = Path("demo")
    """Directory for everything the demo writes."""
    overwrite: bool = False
    """Replace the files of an earlier demo in that directory; its runs are kept."""
    policy: str = field(default_factory=lambda: next(iter(policies.bundled())))
    """Policy to deploy: an ONNX file, or the name of one that comes with the package."""
    task: TaskName = field(default_factory=quickest)
    """Task to train."""
    minutes: float = 4.0
    """Wall-clock time for training at most, minutes; it ends when the task is learned."""
    episodes: int = 3
    """Deployed episodes."""
    seed: int = 0
    """Seed of training, evaluation and deployment."""
    limits: str = "lab"
    """Limit profile of the deployment."""
    json: bool = False
    """Print one JSON document instead of the summary."""


@dataclass
class Steps:
    """Runs `skewmi` commands, shows them, and keeps what each printed."""

    console: Console
    results: dict[str, dict[str, Any]] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)

    def run(self, name: str, arguments: list[str], allowed: tuple[int, ...] = (0,)) -> None:
        """Run one command with --json; its progress goes to our standard error.

        Raises:
            ConfigurationError: It ended with an exit code that is not `allowed`.
        """
        self.console.print(f"\n[bold]$ skewmi {shlex.join(arguments)}[/bold]", highlight=False)
        start = time.monotonic()
        process = subprocess.run(
            child_command("-m", "skewmi.cli.main", *arguments, "--json"),
            stdout=subprocess.PIPE,
            text=True,
            check=False,
        )
        self.seconds[name] = time.monotonic() - start
        if process.returncode not in allowed:
            raise ConfigurationError(
                f"the step `skewmi {shlex.join(arguments)}` ended with exit code "
                f"{process.returncode}; its message is above"
            )
        self.results[name] = json.loads(process.stdout)
        self.console.print(f"  done in {self.seconds[name]:.0f} s", highlight=False)


def run_demo(options: DemoCommand) -> int:
    """Run the chain. Returns 0 if every step ran, whatever the policy achieved."""
    numbers.require_positive("--minutes", options.minutes)
    numbers.require("--episodes", options.episodes, 1, numbers.MAX_EPISODES)
    numbers.require_seed(options.seed)
    learned = tasks.find(options.task).demo
    out = options.out
    run_dir = out / "runs" / time.strftime("%Y%m%d-%H%M%S")
    onnx, mcap, rrd = out / "policy.onnx", out / "episodes.mcap", out / "episodes.rrd"
    film, strip = out / "episode.gif", out / "episode.png"
    for path in (onnx, mcap, rrd, film, strip):
        check_output(path, overwrite=options.overwrite)
    seed, replace = str(options.seed), ["--overwrite"] if options.overwrite else []
    steps = Steps(Console(stderr=True))
    deploy = ["--episodes", str(options.episodes), "--seed", seed, "--limits", options.limits]
    record = ["--record", str(mcap), *replace]
    steps.run("deploy", ["deploy", options.policy, "--robot", "sim", *deploy, *record])
    pictures = ["--out", str(film), "--strip", str(strip), *replace]
    steps.run("film", ["film", str(mcap), *pictures])
    steps.run("replay", ["replay", str(mcap), "--out", str(rrd), *replace])
    train = ["--task", options.task, *learned, "--stop-on-convergence"]
    train += ["--minutes", str(options.minutes), "--seed", seed]
    steps.run("train", ["train", "--run-dir", str(run_dir), *train])
    steps.run("export", ["export-onnx", str(run_dir), "--out", str(onnx), *replace, "--seed", seed])
    steps.run("figures", ["figures", str(run_dir), *replace])
    files = {"film": film, "picture": strip, "replay": rrd, "recording": mcap}
    files |= {"run": run_dir, "policy": onnx}
    document = {
        "task": options.task,
        "steps": steps.results,
        "seconds": steps.seconds,
        "files": {name: str(path) for name, path in files.items()},
        "next": next_commands(options, run_dir, rrd),
    }
    if options.json:
        print(json.dumps(document, indent=2))
    else:
        Console().print(summary(document))
        print("\nNext:\n" + "\n".join(f"  {line}" for line in document["next"]))
    return 0


def next_commands(options: DemoCommand, run_dir: Path, replay: Path) -> list[str]:
    """What to type after the demo."""
    longer = shlex.quote(str(run_dir.parent / "long"))
    return [
        f"rerun {shlex.quote(str(replay))}",
        f"skewmi deploy {shlex.quote(options.policy)} --live",
        f"skewmi train --task {tasks.default()} --run-dir {longer} --stop-on-convergence",
    ]


def summary(document: dict[str, Any]) -> Table:
    """What a person wants to know after the demo; every number from the steps' own reports."""
    train, export, deploy = (document["steps"][name] for name in ("train", "export", "deploy"))
    table = Table(title="skewmi demo", show_header=False, title_justify="left")
    ends = ", ".join(f"{e['outcome']} after {e['steps']} steps" for e in deploy["per_episode"])
    table.add_row(
        "deployed on the simulated YuMi",
        f"success {deploy['successes']} of {deploy['episodes']} episodes ({ends})",
    )
    for reason in deploy["stops"]:
        table.add_row("stopped", reason)
    uses = {"position": "|q|", "velocity": "|v|", "acceleration": "|a|", "jerk": "|jerk|"}
    shares = [f"{symbol} {deploy['limit_fractions'][k]:.0%}" for k, symbol in uses.items()]
    table.add_row("largest use of limits", f"{', '.join(shares)} ({deploy['limit_profile']})")
    cycle = deploy["cycle_ms"]
    table.add_row(
        "planner cycle of 20 ms",
        f"p50 {cycle['p50']:.1f} ms, p99 {cycle['p99']:.1f} ms; "
        f"{deploy['missed_cycles']} of {deploy['cycles']} missed",
    )
    table.add_row(f"trained on {document['task']}", training_line(train))
    table.add_row(
        "its policy, batched simulation",
        f"success {export['onnx']['successes']} of {export['onnx']['episodes']} episodes; "
        f"onnxruntime and torch differ by at most {export['max_difference']:.1g}",
    )
    for name, path in document["files"].items():
        table.add_row(name, path)
    table.add_row("time", f"{sum(document['seconds'].values()) / 60:.1f} min")
    return table


def training_line(train: dict[str, Any]) -> str:
    """How far training came, in one line."""
    metrics = train["metrics"]
    found = ", ".join(
        f"{name} (trajectory {where['trajectory']})" for name, where in train["discoveries"].items()
    )
    converged = train["converged_at"]
    how = (
        f"learned after {converged} trajectories"
        if converged is not None
        else "did not converge in this time; --resume goes on"
    )
    return (
        f"{metrics['trajectories']:.0f} trajectories in {train['seconds'] / 60:.1f} min; "
        f"discovered: {found or 'nothing yet'}; {how}"
    )
