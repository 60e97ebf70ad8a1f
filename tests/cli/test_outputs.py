"""Every command that writes files treats what exists alike, and ends in one line."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from tiny_disk import tiny_disk

from skewmi.cli.main import main

# {i}: the input, {o}: the output, {r}: a run.
COMMANDS: dict[str, list[str]] = {
    "replay": ["replay", "{i}", "--out", "{o}"],
    "film": ["film", "{i}", "--out", "{o}"],
    "film --strip": ["film", "{i}", "--out", "{i}.gif", "--strip", "{o}"],
    "deploy --record": ["deploy", "open_press_close", "--zenoh-config", "{i}", "--record", "{o}"],
    "deploy --live-out": [
        *("deploy", "open_press_close", "--zenoh-config", "{i}"),
        *("--live-out", "{o}"),
    ],
}


def arguments(command: str, given: Path, output: Path) -> list[str]:
    return [word.format(i=given, o=output) for word in COMMANDS[command]]


def one_line(capsys: pytest.CaptureFixture[str]) -> str:
    captured = capsys.readouterr()
    lines = [line for line in captured.err.splitlines() if line.startswith("skewmi ")]
    assert len(lines) == 1, captured.err
    assert "Traceback" not in captured.err
    return lines[0]


@pytest.mark.parametrize("command", COMMANDS)
def test_input_is_never_the_output(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = tmp_path / "given"
    given.write_bytes(b"precious")
    link = tmp_path / "link"
    link.symlink_to(given)
    for output in (given, tmp_path / "." / "given", link):
        assert main([*arguments(command, given, output), "--overwrite"]) == 2
        assert "this command needs" in one_line(capsys)
    assert given.read_bytes() == b"precious"


@pytest.mark.parametrize("command", COMMANDS)
def test_existing_file_is_not_replaced_unasked(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given, there = tmp_path / "given", tmp_path / "there"
    given.write_bytes(b"input")
    there.write_bytes(b"precious")
    assert main(arguments(command, given, there)) == 2
    assert "--overwrite" in one_line(capsys)
    assert there.read_bytes() == b"precious"


@pytest.mark.parametrize("command", COMMANDS)
def test_place_that_cannot_be_is_one_line(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = tmp_path / "given"
    given.write_bytes(b"input")
    for output in (Path("/proc/none/a"), given / "below", tmp_path, Path("/dev/full")):
        assert main([*arguments(command, given, output), "--overwrite"]) == 2
        assert "cannot write" in one_line(capsys)


def test_demo_keeps_an_earlier_demos_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "policy.onnx").write_bytes(b"precious")
    assert main(["demo", "--out", str(tmp_path)]) == 2
    assert "--overwrite" in one_line(capsys)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["policy.onnx"]


def test_figures_and_export_keep_what_is_there(
    maze_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    shutil.copytree(maze_run, run)
    (run / "coverage.png").write_bytes(b"precious")
    assert main(["figures", str(run)]) == 2
    assert "--overwrite" in one_line(capsys)
    assert (run / "coverage.png").read_bytes() == b"precious"
    before = (run / "config.json").read_bytes()
    for own in (
        run / "config.json",
        run / "metrics.csv",
        tmp_path / "run" / ".." / "run" / "metrics.csv",
    ):
        assert main(["export-onnx", str(run), "--out", str(own), "--overwrite"]) == 2
        assert "this command needs" in one_line(capsys)
    assert (run / "config.json").read_bytes() == before
    (tmp_path / "p.onnx").write_bytes(b"precious")
    assert main(["export-onnx", str(run), "--out", str(tmp_path / "p.onnx")]) == 2
    assert "--overwrite" in one_line(capsys)


def test_full_disk_leaves_no_half_picture(
    maze_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with tiny_disk(tmp_path / "disk") as disk:
        (disk / "filler").write_bytes(bytes(40_000))
        assert main(["figures", str(maze_run), "--out", str(disk)]) == 2
        assert "No space left" in one_line(capsys)
        assert all(path.name == "filler" or path.stat().st_size for path in disk.iterdir())
        assert not list(disk.glob(".*"))


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full here")
def test_full_standard_output_is_one_line() -> None:
    with open("/dev/full", "w") as full:
        result = subprocess.run(
            [sys.executable, "-m", "skewmi.cli.main", "doctor", "--quick"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert result.returncode == 2
    assert "No space left" in result.stderr
    assert "Traceback" not in result.stderr
    assert "Exception ignored" not in result.stderr
