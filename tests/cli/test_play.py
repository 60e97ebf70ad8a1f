"""`skewmi play`: what it draws, in a file and for a browser."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest
from drawn import rows
from small_files import files_at_most

from skewmi.cli.main import main


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ([], "--agent zero|random with --task"),
        (["--agent", "zero"], "needs --task"),
        (["open_press_close", "--copies", "65"], "--copies"),
        (["open_press_close", "--episodes", "0"], "--episodes"),
        (["open_press_close", "--web", "--out", "a.rrd"], "give --web or --out"),
        (["open_press_close", "--task", "point_maze"], "was trained on task"),
        (["open_pres_close"], "did you mean 'open_press_close'"),
    ],
)
def test_bad_options_are_told(
    flags: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["play", *flags]) == 2
    assert message in capsys.readouterr().err


def test_copies_of_a_variation_are_drawn(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new" / "play.rrd"
    flags = ["play", "open_press_close", "--copies", "2", "--variation", "randomised"]
    assert main([*flags, "--out", str(out), "--json"]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert told["episodes"] == 2
    assert told["succeeded"] == sum(step > 0 for step in told["first_success_step"])
    paths = set(rows(out))
    for copy in ("1", "2"):
        assert {f"/copies/{copy}/box", f"/copies/{copy}/yumi_link_7_r/cylinders"} <= paths
    assert "/state/lid_angle" in paths
    assert main([*flags, "--out", str(out)]) == 2
    assert "--overwrite" in capsys.readouterr().err


def test_a_file_that_cannot_be_finished_leaves_the_old_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "play.rrd"
    out.write_bytes(b"precious")
    flags = ["play", "--agent", "zero", "--task", "open_press_close", "--out", str(out)]
    with files_at_most(10_000):
        assert main([*flags, "--overwrite"]) == 2
    told = capsys.readouterr()
    assert f"skewmi play: cannot write {out}: File too large" in told.err
    assert "wrote" not in told.out
    assert out.read_bytes() == b"precious"


@pytest.mark.slow
def test_a_task_without_a_robot_is_shown_by_its_camera(tmp_path: Path) -> None:
    out = tmp_path / "play.rrd"
    flags = ["play", "--agent", "random", "--task", "point_maze", "--copies", "2"]
    assert main([*flags, "--out", str(out)]) == 0
    assert {"/copies/1", "/copies/2"} <= set(rows(out))


def without_screen() -> dict[str, str]:
    return {k: v for k, v in os.environ.items() if "DISPLAY" not in k}


def page(address: str, patience_s: float = 60.0) -> bytes:
    deadline = time.monotonic() + patience_s
    while True:
        try:
            return bytes(urllib.request.urlopen(address, timeout=30.0).read())
        except OSError:
            assert time.monotonic() < deadline
            time.sleep(0.2)


def test_the_browser_gets_a_page_until_the_end_is_asked_for() -> None:
    command = [sys.executable, "-m", "skewmi.cli.main", "play", "open_press_close", "--json"]
    child = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=without_screen()
    )
    try:
        assert child.stderr is not None
        line = next(line for line in child.stderr if line.startswith("open http"))
        address = line.split()[1]
        assert b"rerun" in page(address).lower()
        assert any("Ctrl-C" in line for line in child.stderr)
    finally:
        child.send_signal(signal.SIGINT)
        out, _ = child.communicate(timeout=60.0)
    assert json.loads(out.splitlines()[-1])["address"] == address


@pytest.mark.slow
def test_a_deployment_without_a_screen_is_shown_in_the_browser() -> None:
    flags = ["deploy", "open_press_close", "--lock-step", "--live", "--json"]
    child = subprocess.Popen(
        [sys.executable, "-m", "skewmi.cli.main", *flags],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=without_screen(),
    )
    try:
        assert child.stderr is not None
        line = next(line for line in child.stderr if line.startswith("no screen here: open http"))
        assert b"rerun" in page(line.split()[4]).lower()
        told = json.loads(child.communicate(timeout=200.0)[0].splitlines()[-1])
    finally:
        child.kill()
        child.wait()
    assert told["stops"] == []
    assert not [note for note in told["notes"] if "live view" in note]
