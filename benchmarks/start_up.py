"""Processor and wall time from a command to first motion, a ready robot or a help text.

Each figure is of a fresh process and all its children, in several rounds; the median counts. Rounds
of all commands are taken in turn, so that a slow minute of the machine meets all of them.

`deploy` ends with the first chunk of motion on the wire: a listener connects to the robot server
that the command has started, and waits for it. `robot` ends with the line that says it is ready.
The helps end with their process. With `--against` another checkout takes turns with this one, and
`ratio` is this one's processor time by the other's, of the medians.
"""

from __future__ import annotations

import argparse
import os
import re
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from common import REPOSITORY, argument_parser, print_result, progress, write_result

from skewmi.deploy.robot.process import free_port
from skewmi.deploy.wire.topics import YUMI_TRAJECTORY
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.errors import SkewmiError, TransportError

BAR_S = 5.0
"""Most processor time from `skewmi deploy` to first motion that the project asks of itself, s."""

TIMEOUT_S = 180.0
_POLL_S = 0.02
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")

Times = dict[str, float]


class _Tree:
    """The processes of a command: it and its children, by what the kernel tells of them.

    Args:
        pid: Of the command's own.
    """

    def __init__(self, pid: int) -> None:
        self.pid = pid

    def members(self) -> list[int]:
        """The command and whatever descends from it, now."""
        parents: dict[int, int] = {}
        for entry in Path("/proc").iterdir():
            if entry.name.isdigit() and (fields := _stat(int(entry.name))) is not None:
                parents[int(entry.name)] = int(fields[1])
        found = [self.pid]
        for pid in found:
            found += [child for child, parent in parents.items() if parent == pid]
        return found

    def processor_s(self) -> float:
        """What they have used, those that have ended and were waited for included."""
        ticks = 0
        for pid in self.members():
            fields = _stat(pid)
            ticks += sum(map(int, fields[11:15])) if fields is not None else 0
        return ticks / _TICKS_PER_S

    def listens_at(self) -> str | None:
        """Locator of a robot server among them."""
        for pid in self.members():
            try:
                words = Path(f"/proc/{pid}/cmdline").read_bytes().decode()
            except OSError:
                continue
            if pid != self.pid and (found := re.search(r"tcp/127\.0\.0\.1:\d+", words)):
                return found[0]
        return None


def _stat(pid: int) -> list[str] | None:
    """Fields of /proc/PID/stat from the third, the state, on; None if the process is gone."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8")
    except OSError:
        return None
    return text.rpartition(")")[2].split()


@contextmanager
def _command(root: Path, arguments: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    """`skewmi ARGUMENTS` of a checkout, ended with the block."""
    environment = {**os.environ, "PYTHONPATH": str(root)}
    code = "import sys; from skewmi.cli.main import main; sys.exit(main())"
    child = subprocess.Popen(
        [sys.executable, "-P", "-c", code, *arguments],
        cwd=root,
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        yield child
    finally:
        child.terminate()
        try:
            child.wait(30.0)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
        assert child.stdin is not None
        assert child.stdout is not None
        child.stdin.close()
        child.stdout.close()


def measure_deploy(root: Path, options: list[str]) -> Times:
    """To the first chunk of motion.

    Raises:
        TransportError: Nothing moved in time.
    """
    begun = time.monotonic()
    with _command(root, ["deploy", "open_press_close", *options]) as child:
        tree = _Tree(child.pid)
        locator = _await(tree.listens_at, child, begun)
        with Link.open(_await(lambda: _reachable(locator), child, begun), "start_up") as link:
            reader = link.subscribe(YUMI_TRAJECTORY)
            _await(reader.take, child, begun)
            return {"processor_s": tree.processor_s(), "wall_s": time.monotonic() - begun}


def _reachable(locator: str) -> TransportConfig | None:
    """How to connect, once somebody listens there."""
    import socket

    host, port = locator.removeprefix("tcp/").rsplit(":", 1)
    try:
        socket.create_connection((host, int(port)), 0.2).close()
    except OSError:
        return None
    return TransportConfig.for_client(locator)


def _await(ask: Any, child: subprocess.Popen[bytes], begun: float) -> Any:
    """What `ask` returns once that is not None."""
    while time.monotonic() - begun < TIMEOUT_S and child.poll() is None:
        answer = ask()
        if answer is not None:
            return answer
        time.sleep(_POLL_S)
    raise TransportError(f"nothing happened within {time.monotonic() - begun:.0f} s")


def measure_robot(root: Path, options: list[str]) -> Times:
    """To the line that says that the robot server is ready."""
    begun = time.monotonic()
    arguments = ["robot", "--json", "--listen", f"tcp/127.0.0.1:{free_port()}", *options]
    with _command(root, arguments) as child:
        assert child.stdout is not None
        while line := child.stdout.readline():
            if b'"backend"' in line:
                used = _Tree(child.pid).processor_s()
                return {"processor_s": used, "wall_s": time.monotonic() - begun}
    raise TransportError("the robot server ended before it was ready")


def measure_whole(root: Path, options: list[str]) -> Times:
    """To the end of a command."""
    begun, before = time.monotonic(), os.times()
    with _command(root, options) as child:
        child.communicate(timeout=TIMEOUT_S)
    after = os.times()
    used = after.children_user + after.children_system
    used -= before.children_user + before.children_system
    return {"processor_s": used, "wall_s": time.monotonic() - begun}


MEASURES: dict[str, tuple[Any, list[str]]] = {
    "deploy": (measure_deploy, []),
    "robot": (measure_robot, []),
    "help": (measure_whole, ["--help"]),
    "deploy_help": (measure_whole, ["deploy", "--help"]),
}
"""Name -> how it is measured, and the options of its command."""


def run(options: argparse.Namespace) -> dict[str, Any]:
    """All figures."""
    roots = {"this": REPOSITORY}
    if options.against is not None:
        roots["other"] = options.against.resolve()
    rounds: dict[tuple[str, str], list[Times]] = {}
    for index in range(options.rounds):
        for name in options.commands:
            measure, arguments = MEASURES[name]
            # Who comes first changes, so that neither profits from files that were just read.
            order = list(roots) if index % 2 == 0 else list(roots)[::-1]
            for whose in order:
                times = measure(roots[whose], arguments)
                rounds.setdefault((name, whose), []).append(times)
                told = ", ".join(f"{key} {value:.2f}" for key, value in times.items())
                progress(f"round {index + 1}, {name}, {whose}: {told}")
    figures: dict[str, Any] = {}
    for (name, whose), times in rounds.items():
        figures.setdefault(name, {})[whose] = _summary(times)
    for entry in figures.values():
        if "other" in entry:
            entry["ratio"] = entry["this"]["processor_s"] / entry["other"]["processor_s"]
    if "deploy" in figures:
        figures["processor_bar_s"] = BAR_S
        figures["meets_bar"] = figures["deploy"]["this"]["processor_s"] <= BAR_S
    return figures


def _summary(rounds: list[Times]) -> dict[str, Any]:
    """Medians, and the least and most of each."""
    summary: dict[str, Any] = {}
    for key in rounds[0]:
        values = [times[key] for times in rounds]
        summary[key] = statistics.median(values)
        summary[f"{key}_range"] = [min(values), max(values)]
    return {**summary, "rounds": len(rounds)}


def main() -> int:
    """Entry point."""
    parser = argument_parser(__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--rounds", type=int, default=5, help="fresh processes per command")
    parser.add_argument("--commands", nargs="+", default=list(MEASURES), choices=list(MEASURES))
    parser.add_argument("--against", type=Path, default=None, help="another checkout, in turns")
    options = parser.parse_args()
    try:
        figures = run(options)
    except SkewmiError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    config = {"rounds": options.rounds, "commands": options.commands}
    document = write_result("start_up", figures, options.out, seed=None, config=config)
    print_result(document, as_json=options.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
