"""Zenoh's threads: asked for once, in every process of ours, unless the user says otherwise."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

import skewmi
from skewmi.deploy.wire import runtime

THREADS = """
import os
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.deploy.robot.process import free_port
with Link.open(TransportConfig.for_robot(f"tcp/127.0.0.1:{free_port()}"), "test"):
    names = [open(f"/proc/self/task/{task}/comm").read().strip() for task in
             os.listdir("/proc/self/task")]
    print(sum(name.startswith("acc-") for name in names), os.environ["ZENOH_RUNTIME"])
"""


def accepting_threads(setting: str | None) -> tuple[int, str]:
    """Zenoh's accepting threads in a process that has opened a link, and its variable."""
    environment = {k: v for k, v in os.environ.items() if k != runtime.VARIABLE}
    if setting is not None:
        environment[runtime.VARIABLE] = setting
    output = subprocess.run(
        [sys.executable, "-c", THREADS], env=environment, capture_output=True, text=True, check=True
    ).stdout
    count, _, said = output.strip().partition(" ")
    return int(count), said


@pytest.mark.skipif(sys.platform != "linux", reason="threads are counted in /proc")
def test_zenoh_has_the_threads_that_are_asked_for() -> None:
    assert accepting_threads(None) == (runtime.THREADS["acc"], runtime.setting())


@pytest.mark.skipif(sys.platform != "linux", reason="threads are counted in /proc")
def test_a_users_own_setting_wins() -> None:
    own = "(acc: (worker_threads: 3))"
    assert accepting_threads(own) == (3, own)


@pytest.mark.skipif(sys.platform != "linux", reason="threads are counted in /proc")
def test_nonsense_in_the_variable_is_named() -> None:
    environment = {**os.environ, runtime.VARIABLE: "many"}
    output = subprocess.run(
        [sys.executable, "-c", THREADS], env=environment, capture_output=True, text=True
    )
    assert output.stderr.splitlines()[-1].endswith("unset it, or write " + runtime.setting())
    assert "ZENOH_RUNTIME" in output.stderr.splitlines()[-1]


def test_only_the_wire_imports_zenoh() -> None:
    """Its package asks for the threads, so that they are there before Zenoh is."""
    package = Path(skewmi.__file__).parent
    elsewhere = [
        path
        for path in package.rglob("*.py")
        if path.parent != package / "deploy" / "wire"
        for node in ast.walk(ast.parse(path.read_text()))
        if (
            isinstance(node, ast.Import)
            and any(a.name.split(".")[0] == "zenoh" for a in node.names)
        )
        or (isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "zenoh")
    ]
    assert elsewhere == []
