"""Nothing that we depend on acts outside: traced, because each release may bring something new."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from skewmi import privacy
from skewmi.child import child_command
from skewmi.policies import locate

ACT = """
import sys, time
import numpy as np
from skewmi.deploy.policy import OnnxPolicy
policy = OnnxPolicy.load(sys.argv[1])
policy.act(np.zeros((1, policy.layout.observation_dim)))
time.sleep(1.0)  # whoever uploads does so from a thread of its own
"""

_PASSING = re.compile(r"/(dev|proc|sys)/")
_WRITES = re.compile(r"O_(WRONLY|RDWR|CREAT|TRUNC|APPEND)")
_PATH = re.compile(r'"((?:[^"\\]|\\.)*)"')
_CHANGES = ("mkdir", "mkdirat", "rename", "renameat", "renameat2", "link", "linkat", "symlink")
_CALLS = ("connect", "sendto", "sendmsg", "sendmmsg", "open", "openat", "creat", *_CHANGES)


@dataclass(frozen=True)
class Trace:
    """What a command and all its children did outside of themselves."""

    addresses: frozenset[str]
    """Other machines that were spoken to."""
    files: frozenset[str]
    """Absolute names of files and folders opened for writing, made or renamed."""


def quiet_environment(home: Path) -> dict[str, str]:
    """The environment of a user who has never heard of telemetry, with an empty home."""
    home.mkdir()
    dropped = {*privacy.SWITCHES, *privacy.VIEWER_SWITCHES, "XDG_CACHE_HOME", "XDG_CONFIG_HOME"}
    kept = {name: value for name, value in os.environ.items() if name not in dropped}
    return {**kept, "HOME": str(home), "OMP_NUM_THREADS": "1"}


def traced(command: list[str], folder: Path, home: Path) -> Trace:
    """Run a command under strace in a folder.

    Skips the test where strace is missing or may not trace.
    """
    if shutil.which("strace") is None:
        pytest.skip("strace is not installed")
    log = folder / "trace"
    options = ["-f", "-qq", "-y", "-s", "4096", "-e", "signal=none"]
    options += ["-e", "trace=" + ",".join(f"?{call}" for call in _CALLS), "-o", str(log)]
    result = subprocess.run(
        ["strace", *options, *command],
        cwd=folder,
        env=quiet_environment(home),
        capture_output=True,
        text=True,
        check=False,
    )
    if "ptrace" in result.stderr or "PTRACE" in result.stderr:
        pytest.skip(f"strace may not trace here: {result.stderr.splitlines()[0]}")
    assert result.returncode == 0, result.stderr
    lines = log.read_text(errors="replace").splitlines()
    log.unlink()
    return Trace(frozenset(_addresses(lines)), frozenset(_files(lines, folder)))


def _addresses(lines: list[str]) -> set[str]:
    found = set()
    for line in lines:
        for address in re.findall(r'inet_(?:addr|pton)\((?:AF_INET6, )?"([^"]+)"', line):
            if not address.startswith("127.") and address not in ("::1", "0.0.0.0", "::"):
                found.add(address)
    return found


def _files(lines: list[str], folder: Path) -> set[str]:
    found = set()
    for line in lines:
        call = re.match(r"\d+ +(\w+)\(", line)
        # `<unfinished ...>` lines have the arguments, too.
        if call is None or " = -1 " in line:
            continue
        changes = call[1] in _CHANGES or call[1] == "creat"
        if not changes and not (call[1] in ("open", "openat") and _WRITES.search(line)):
            continue
        paths = _PATH.findall(line)
        found |= {str(folder / path) for path in paths if not _PASSING.match(path)}
    return found


def outside(trace: Trace, allowed: tuple[Path, ...]) -> list[str]:
    """Files of a trace outside of some folders."""
    return sorted(
        name for name in trace.files if not any(Path(name).is_relative_to(a) for a in allowed)
    )


def places(*more: Path) -> tuple[Path, ...]:
    """Where every Python program may write: temporary files, and compiled modules."""
    from tempfile import gettempdir

    installed = {Path(p) for p in (sys.prefix, sys.base_prefix, Path(privacy.__file__).parent)}
    return (Path(gettempdir()), Path("/tmp"), *installed, *more)


def test_switches_are_set_before_anything_can_be_imported() -> None:
    code = "import json, os, sys, skewmi; print(json.dumps([dict(os.environ), list(sys.modules)]))"
    other = dict.fromkeys(privacy.SWITCHES, "wrong")
    found = subprocess.run(
        child_command("-c", code),
        env={**os.environ, **other},
        capture_output=True,
        text=True,
        check=True,
    )
    environment, modules = json.loads(found.stdout)
    assert {name: environment[name] for name in privacy.SWITCHES} == privacy.SWITCHES
    assert not {"onnxruntime", "ray", "rerun"} & set(modules)


def test_policy_acts_without_telling_anybody(tmp_path: Path) -> None:
    home = tmp_path / "home"
    work = tmp_path / "work"
    work.mkdir()
    policy = str(locate(Path("open_press_close")))
    trace = traced(child_command("-c", ACT, policy), work, home)
    assert trace.addresses == set()
    assert list(home.rglob("*")) == []
    assert list(work.rglob("*")) == []


@pytest.mark.parametrize("name", ["ORT_DISABLE_TELEMETRY"])
def test_the_trace_would_notice(tmp_path: Path, name: str) -> None:
    """Without the switch onnxruntime does write into the home folder: the test can see it."""
    home = tmp_path / "home"
    environment = quiet_environment(home)
    code = f"import os, time, onnxruntime; os.environ.pop({name!r}, None); time.sleep(1.0)"
    subprocess.run(child_command("-c", code), env=environment, check=True, cwd=tmp_path)
    if not list(home.rglob("*onnxruntime*")):
        pytest.skip("this release of onnxruntime keeps no telemetry")


@pytest.mark.slow
def test_deployment_speaks_to_nobody_but_the_robot(tmp_path: Path) -> None:
    home = tmp_path / "home"
    work = tmp_path / "work"
    work.mkdir()
    options = ["--lock-step", "--record", "run.mcap", "--live-out", "run.rrd", "--json"]
    command = child_command("-m", "skewmi.cli.main", "deploy", "open_press_close", *options)
    trace = traced(command, work, home)
    assert trace.addresses == set()
    assert [path.name for path in home.rglob("*") if path.is_file()] == []
    assert sorted(path.name for path in work.iterdir()) == ["run.mcap", "run.rrd"]
    assert outside(trace, places()) == []


def test_viewer_of_ours_keeps_no_analytics(tmp_path: Path) -> None:
    """The real program, in the environment that we give it; with no screen it only serves."""
    from skewmi.deploy.replay.viewer import executable
    from skewmi.deploy.robot.process import free_port

    home = tmp_path / "home"
    environment = {**quiet_environment(home), **privacy.VIEWER_SWITCHES}
    process = subprocess.Popen(
        [str(executable()), "--serve-grpc", "--port", str(free_port())],
        env={**environment, "RUST_LOG": "re_analytics=trace"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert process.stdout is not None
    try:
        first = process.stdout.readline()
    finally:
        process.kill()
        process.communicate()
    assert "Analytics disabled" in first
    assert not (home / ".local" / "share" / "rerun" / "analytics").exists()
