"""What works on this machine, and what to do about what does not.

Every check does the real thing: it imports, renders, steps a simulation, asks for the scheduler.
Checks that may crash or hang run in a process of their own. Exit code 1 if something that
simulation and deployment need is missing; what only some commands need is a warning.
"""

from __future__ import annotations

import importlib.metadata
import json
import os
import platform
import re
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np

from skewmi.child import child_command
from skewmi.cli import doctor_probes, numbers
from skewmi.extras import install_line
from skewmi.trajectory import GRID_S

DEFAULT_PORT = 7447
"""Where the robot server listens by default, and Zenoh's usual port."""

_TIMEOUT_S = 60.0

_BUILT_ON_ARM64 = ("ruckig",)
"""Packages without a ready-made build for ARM64 Linux: pip compiles them."""


@dataclass(frozen=True)
class DoctorCommand:
    """Options of `skewmi doctor`."""

    port: int = DEFAULT_PORT
    """TCP port on the loopback interface that the robot server would use."""
    quick: bool = False
    """Only what takes no time: no imports, pictures or simulations."""
    json: bool = False
    """Print one JSON document instead of a table."""


@dataclass(frozen=True)
class Check:
    """One answer."""

    name: str
    status: Literal["ok", "warning", "error"]
    """"warning": some command does less; "error": simulation or deployment does not work."""
    found: str
    advice: str = ""


def run_doctor(options: DoctorCommand) -> int:
    """Run all checks and print them. Returns 1 if one found an error, else 0."""
    numbers.require("--port", options.port, 1, 65535)
    checks = []
    for check in all_checks(options.port, quick=options.quick):
        if not options.json and sys.stderr.isatty():
            print(f"\r\x1b[K{check.name} ...", end="", file=sys.stderr, flush=True)
        checks.append(check)
    failed = any(check.status == "error" for check in checks)
    if options.json:
        print(json.dumps({"ok": not failed, "checks": [asdict(c) for c in checks]}, indent=2))
    else:
        if sys.stderr.isatty():
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)
        _print_table(checks)
    return 1 if failed else 0


def all_checks(port: int, *, quick: bool) -> Iterator[Check]:
    """The checks one after the other, each run when it is asked for."""
    yield _python()
    yield from _packages()
    yield _cores()
    yield _memory()
    yield _timer()
    yield _port(port)
    if hasattr(os, "SCHED_FIFO"):
        yield _probe(
            "SCHED_FIFO",
            doctor_probes.FIFO,
            advice="for even control cycles: ulimit -r, an rtprio line in limits.conf, or "
            "CAP_SYS_NICE",
        )
        yield _probe(
            "mlockall", doctor_probes.LOCK_MEMORY, advice="ulimit -l unlimited, or CAP_IPC_LOCK"
        )
    if quick:
        return
    yield from _imports()
    yield _rendering()
    yield from _simulations()
    yield _probe(
        "torch", doctor_probes.TORCH, advice=f"to train and export: {install_line('train')}"
    )


def _python() -> Check:
    found = f"{platform.python_version()} on {platform.system()} {platform.machine()}"
    return Check("python", "ok", found)


def _packages() -> Iterator[Check]:
    """Declared dependencies: installed, and in the demanded version."""
    from packaging.requirements import Requirement

    for line in importlib.metadata.requires("skewmi") or []:
        requirement = Requirement(line)
        extra = re.search(r"extra == ['\"](\w+)['\"]", line)
        if (extra and extra[1] not in ("view", "train")) or requirement.name == "skewmi":
            continue
        bad: Literal["warning", "error"] = "warning" if extra else "error"
        install = install_line(extra[1]) if extra else f"pip install '{line.split(';')[0].strip()}'"
        try:
            version = importlib.metadata.version(requirement.name)
        except importlib.metadata.PackageNotFoundError:
            advice = install_advice(requirement.name, install, platform.machine())
            yield Check(requirement.name, bad, "not installed", advice)
            continue
        if requirement.specifier.contains(version, prereleases=True):
            yield Check(requirement.name, "ok", version)
        else:
            found = f"{version}, needed is {requirement.specifier}"
            yield Check(requirement.name, bad, found, install)


def install_advice(package: str, install: str, machine: str) -> str:
    """How to install a package on a kind of processor, such as "aarch64"."""
    if package in _BUILT_ON_ARM64 and machine.lower() in ("aarch64", "arm64"):
        return f"apt-get install g++ cmake python3-dev, then {install}, which compiles it"
    return install


def _cores() -> Check:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    if (cores or 1) < 2:
        return Check(
            "cores", "warning", str(cores), "session, server and recorder share one core: use 2"
        )
    return Check("cores", "ok", f"{cores} usable")


def _memory() -> Check:
    try:
        size = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2**30
    except (ValueError, OSError):
        return Check("memory", "warning", "unknown")
    if size < 2.0:
        return Check("memory", "warning", f"{size:.1f} GiB", "2 GiB are needed for training")
    return Check("memory", "ok", f"{size:.0f} GiB")


def _timer() -> Check:
    """How late a sleeping process wakes up, on the 4 ms grid of the robot."""
    late = []
    due = time.monotonic()
    for _ in range(100):
        due += GRID_S
        time.sleep(max(0.0, due - time.monotonic()))
        late.append(time.monotonic() - due)
    median, worst = np.median(late) * 1e3, np.max(late) * 1e3
    found = f"wakes {median:.2f} ms late in the median, {worst:.2f} ms at worst, 100 cycles of 4 ms"
    if worst > 4.0:
        return Check(
            "timer", "warning", found, "deploy with --lock-step, or on a machine with less load"
        )
    return Check("timer", "ok", found)


def _port(port: int) -> Check:
    with socket.socket() as probe:
        # As servers do: a port that was closed a moment ago counts as free.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            return Check(
                "port", "warning", f"127.0.0.1:{port}: {error}", "a robot server runs? else --port"
            )
    return Check("port", "ok", f"127.0.0.1:{port} is free")


def _imports() -> Iterator[Check]:
    """Compiled packages may be installed and still not load, for want of a system library."""
    for module in ("mujoco", "pinocchio", "mink", "ruckig", "onnxruntime", "zenoh"):
        yield _probe(
            f"import {module}",
            doctor_probes.IMPORT,
            module,
            bad="error",
            advice=f"reinstall {module}",
        )
    advice = f"to show runs: {install_line('view')}"
    yield _probe("import rerun", doctor_probes.IMPORT, "rerun", advice=advice)


def _rendering() -> Check:
    """Pictures without a display, by the first of MuJoCo's back ends that works."""
    reasons = []
    chosen = os.environ.get("MUJOCO_GL")
    for backend in [chosen] if chosen else ["egl", "osmesa", "glfw"]:
        check = _probe("rendering", doctor_probes.RENDER, environment={"MUJOCO_GL": backend})
        if check.status == "ok":
            return Check("rendering", "ok", f"{check.found} with MUJOCO_GL={backend}")
        reasons.append(f"{backend}: {check.found}")
    advice = "install libegl1 and libgl1-mesa-dri (or libosmesa6); only pictures and films need it"
    return Check("rendering", "warning", "; ".join(reasons), advice)


def _simulations() -> Iterator[Check]:
    from skewmi.sim import tasks

    for task in tasks.names():
        yield _probe(f"task {task}", doctor_probes.SIMULATE, task, bad="error")


def _probe(
    name: str,
    script: str,
    *arguments: str,
    bad: Literal["warning", "error"] = "warning",
    advice: str = "",
    environment: dict[str, str] | None = None,
) -> Check:
    """Run a script in a fresh interpreter; its last line of output is what was found."""
    command = child_command("-c", script, *arguments)
    try:
        result = subprocess.run(
            command,
            capture_output=True,
            text=True,
            timeout=_TIMEOUT_S,
            check=False,
            env={**_without_opengl(), **(environment or {})},
        )
    except subprocess.TimeoutExpired:
        return Check(name, bad, f"no answer within {_TIMEOUT_S:.0f} s", advice)
    if result.returncode == 0:
        return Check(name, "ok", _last_line(result.stdout))
    reason = _last_line(result.stderr) or f"ended with code {result.returncode}"
    return Check(name, bad, reason[:160], advice)


def _without_opengl() -> dict[str, str]:
    """Our environment, in which MuJoCo loads no OpenGL that may be missing: as in `cli.main`."""
    return {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}


def _last_line(text: str) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1] if lines else ""


def _print_table(checks: list[Check]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    colours = {"ok": "green", "warning": "yellow", "error": "red"}
    table = Table(box=None, pad_edge=False)
    for title in ("check", "", "found"):
        table.add_column(title, overflow="fold")
    for check in checks:
        found = Text(check.found)
        if check.status != "ok" and check.advice:
            found.append(f"\n-> {check.advice}", style="italic")
        table.add_row(check.name, Text(check.status, style=colours[check.status]), found)
    Console().print(table)
