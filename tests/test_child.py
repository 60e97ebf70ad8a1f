"""Helper processes import what is installed, and only their own lines count."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import skewmi
from skewmi.child import child_command, told, wait_for_line
from skewmi.deploy.recording.recorder import Recorder
from skewmi.deploy.robot.process import spawn_robot
from skewmi.deploy.wire.transport import Link, TransportConfig

SHADOWS = ("mcap", "zenoh", "queue", "numpy", "onnxruntime", "rerun", "mujoco", "skewmi")


@pytest.fixture
def folder_of_scripts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that one stands in, full of scripts named like modules that we import."""
    for name in SHADOWS:
        (tmp_path / f"{name}.py").write_text(
            'raise SystemExit("a script of the user was imported")'
        )
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    return tmp_path


def test_child_does_not_import_from_the_folder_one_stands_in(folder_of_scripts: Path) -> None:
    code = "import queue, mcap, zenoh, skewmi; print(skewmi.__file__)"
    shadowed = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False)
    assert shadowed.returncode != 0, "the scripts of this test shadow nothing"
    found = subprocess.run(child_command("-c", code), capture_output=True, text=True, check=True)
    assert found.stdout.strip() == skewmi.__file__


def test_child_imports_from_the_users_pythonpath(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "of_the_user.py").write_text("value = 3")
    before = os.environ.get("PYTHONPATH")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, (before, str(tmp_path)))))
    code = "import of_the_user; print(of_the_user.value)"
    found = subprocess.run(child_command("-c", code), capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "3"


def test_robot_and_recorder_start_in_a_folder_of_scripts(folder_of_scripts: Path) -> None:
    with spawn_robot("sim", "open_press_close", "lab", lock_step=True) as locator:
        config = TransportConfig.for_client(locator, lock_step=True)
        with Link.open(config, "watcher") as link:
            link.wait_for_robot(5.0)
            recorder = Recorder.start(folder_of_scripts / "r.mcap", config)
            assert recorder.close().path.stat().st_size > 0


def test_every_process_of_ours_is_started_by_the_one_helper() -> None:
    """A new helper process that forgets `child_command` is found here."""
    root = Path(skewmi.__file__).parent
    own = re.compile(r"sys\.executable")
    users = {str(p.relative_to(root)) for p in root.rglob("*.py") if own.search(p.read_text())}
    assert users == {"child.py"}


NOISY = """
import sys, time
from skewmi.child import tell_parent
print("a library says hello")
sys.stdout.write('{"ready": true} half a line')
sys.stdout.flush()
time.sleep(0.1)
tell_parent(ready=True)
print("more noise")
sys.stdin.read()
sys.stdout.write("unfinished")
tell_parent(messages=3)
print("goodbye")
"""


def test_only_our_own_line_counts() -> None:
    with subprocess.Popen(
        child_command("-c", NOISY), stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        line = wait_for_line(process.stdout, lambda x: told(x) is not None, 30.0)
        assert line is not None
        assert told(line) == {"ready": True}
        out, _ = process.communicate()
    assert [told(x) for x in out.splitlines() if told(x)] == [{"messages": 3}]


def test_noise_alone_is_not_ready() -> None:
    code = "print('ready'); print('{\"ready\": true}'); print('skewmi-child nonsense')"
    with subprocess.Popen(child_command("-c", code), stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert wait_for_line(process.stdout, lambda x: told(x) is not None, 30.0) is None


def test_waiting_ends_in_time() -> None:
    code = "import time; print('noise', flush=True); time.sleep(60)"
    with subprocess.Popen(child_command("-c", code), stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert wait_for_line(process.stdout, lambda x: told(x) is not None, 0.3) is None
        process.kill()
