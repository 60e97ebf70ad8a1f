"""`skewmi doctor` reports what is, and survives what is not."""

from __future__ import annotations

import importlib.metadata
import json
import socket
from typing import Any

import pytest

from skewmi.cli import doctor, doctor_probes
from skewmi.cli.main import main


def checks_of(arguments: list[str], capfd: pytest.CaptureFixture[str]) -> dict[str, Any]:
    code = main(["doctor", "--json", *arguments])
    stdout, stderr = capfd.readouterr()
    assert stderr == ""
    document = json.loads(stdout)
    errors = [check for check in document["checks"] if check["status"] == "error"]
    assert document["ok"] == (not errors) == (code == 0)
    return {check["name"]: check for check in document["checks"]}


def test_quick_look_names_versions_cores_and_timer(capfd: pytest.CaptureFixture[str]) -> None:
    checks = checks_of(["--quick"], capfd)
    for package in ("numpy", "mujoco", "torch", "onnxruntime"):
        assert checks[package]["status"] == "ok"
        assert checks[package]["found"] == importlib.metadata.version(package)
    assert {"python", "cores", "memory", "timer", "port"} <= set(checks)


def test_busy_port_is_a_warning_with_advice(capfd: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen()
        port = server.getsockname()[1]
        check = checks_of(["--quick", "--port", str(port)], capfd)["port"]
        assert check["status"] == "warning"
        assert check["advice"]
    assert checks_of(["--quick", "--port", str(port)], capfd)["port"]["status"] == "ok"


def test_impossible_port_is_bad_input(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--port", "70000"]) == 2
    assert "1..65535" in capfd.readouterr().err


@pytest.mark.parametrize("task", ["point_maze", "open_press_close"])
def test_tasks_are_really_stepped(task: str) -> None:
    check = doctor._probe("task", doctor_probes.SIMULATE, task)
    assert check.status == "ok", check.found
    assert "steps/s" in check.found


@pytest.mark.parametrize(
    ("script", "found"),
    [
        ("import skewmi.nothing", "No module named 'skewmi.nothing'"),
        ("import os; os.abort()", "ended with code -6"),
        ("import sys; sys.exit('the picture is empty')", "the picture is empty"),
    ],
)
def test_probe_that_fails_or_crashes_is_reported(script: str, found: str) -> None:
    check = doctor._probe("broken", script, bad="error", advice="mend it")
    assert check.status == "error"
    assert found in check.found
    assert check.advice == "mend it"


def test_probe_that_hangs_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "_TIMEOUT_S", 0.2)
    check = doctor._probe("slow", "import time; time.sleep(60)")
    assert check.status == "warning"
    assert "no answer" in check.found


def test_error_makes_the_exit_code_1(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(importlib.metadata, "version", lambda name: "0.0.1")
    checks = checks_of(["--quick"], capfd)
    assert checks["numpy"]["status"] == "error"
    assert "0.0.1, needed is >=2.0" in checks["numpy"]["found"]
    assert checks["torch"]["status"] == "warning"
    assert main(["doctor", "--quick"]) == 1
    assert "pip install" in capfd.readouterr().out
