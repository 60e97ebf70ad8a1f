"""A Rerun file is whole, or there is an error and the old file stays."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from small_files import files_at_most
from tiny_disk import tiny_disk

from skewmi.cli.main import main
from skewmi.deploy.replay.replay import write_replay
from skewmi.deploy.replay.rerun_file import drawn_into, is_whole, whole_at_end
from skewmi.errors import OutputError


def draw(path: Path, tensors: int = 20) -> None:
    stream = rr.RecordingStream("test")
    with drawn_into(stream, path):
        for seed in range(tensors):
            stream.log(f"noise/{seed}", rr.Tensor(np.random.default_rng(seed).random(1000)))


@pytest.fixture
def drawing(tmp_path: Path) -> Path:
    path = tmp_path / "drawing.rrd"
    draw(path)
    return path


def test_a_file_is_whole_to_its_last_byte(drawing: Path, tmp_path: Path) -> None:
    assert is_whole(drawing)
    content = drawing.read_bytes()
    cut = tmp_path / "cut.rrd"
    for size in (0, 1, 100, len(content) // 2, len(content) - 40, len(content) - 1):
        cut.write_bytes(content[:size])
        assert not is_whole(cut), size
    assert not is_whole(tmp_path / "absent.rrd")


# Of 240 kB, the last 38 are what Rerun writes at the end.
@pytest.mark.parametrize("missing", [100, 1_000, 30_000, 100_000])
def test_an_end_that_cannot_be_written_leaves_the_old_file(drawing: Path, missing: int) -> None:
    before = drawing.read_bytes()
    with files_at_most(len(before) - missing), pytest.raises(OutputError) as caught:
        draw(drawing)
    assert "File too large" in str(caught.value)
    assert str(drawing) in str(caught.value)
    assert drawing.read_bytes() == before
    assert [path.name for path in drawing.parent.iterdir()] == [drawing.name]


def test_what_the_system_does_not_explain_is_told_in_reruns_words(drawing: Path) -> None:
    cut = drawing.read_bytes()[:-1]
    drawing.write_bytes(cut)
    with pytest.raises(OutputError, match="its end is missing"), whole_at_end(drawing, drawing):
        pass
    with pytest.raises(OutputError, match="no more"), whole_at_end(drawing, drawing):
        raise RuntimeError("no more")
    assert drawing.read_bytes() == cut, "looking for the reason has changed it"


@pytest.mark.parametrize("share", [0.01, 0.5, 0.999])
def test_a_replay_that_is_too_large_is_refused_in_one_line(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], share: float
) -> None:
    out = tmp_path / "run.rrd"
    write_replay(recorded, out)
    before = out.read_bytes()
    with files_at_most(int(share * len(before))):
        assert main(["replay", str(recorded), "--out", str(out), "--overwrite"]) == 2
    told = capsys.readouterr()
    assert f"skewmi replay: cannot write {out}: File too large" in told.err
    assert "Traceback" not in told.err
    assert "wrote" not in told.out
    assert out.read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["run.rrd"]


def test_a_full_disk_is_told_as_such(tmp_path: Path) -> None:
    with tiny_disk(tmp_path / "disk") as disk:
        with pytest.raises(OutputError, match=r"No space left.*make room"):
            draw(disk / "drawing.rrd")
        assert list(disk.iterdir()) == []


def test_names_that_cannot_be_are_refused_and_long_ones_are_not(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"cannot write /proc/x\.rrd"):
        draw(Path("/proc/x.rrd"), 1)
    with pytest.raises(OutputError, match="too long"):
        draw(tmp_path / f"{'a' * 252}.rrd", 1)
    longest = tmp_path / f"{'a' * 251}.rrd"
    draw(longest, 1)
    assert is_whole(longest)


def test_a_process_whose_file_cannot_be_written_ends(tmp_path: Path, recorded: Path) -> None:
    """Rerun's own thread, once it has failed, could keep a process from ending for ever."""
    out = tmp_path / "run.rrd"
    write_replay(recorded, out)
    size = out.stat().st_size
    command = [sys.executable, "-m", "skewmi.cli.main", "replay", str(recorded), "--overwrite"]
    for share in (0.001, 0.1, 0.6, 0.9):
        with files_at_most(int(share * size)):  # children inherit it
            done = subprocess.run(
                [*command, "--out", str(out)],
                capture_output=True,
                text=True,
                check=False,
                timeout=120.0,
            )
        assert done.returncode == 2
        assert done.stderr.splitlines() == [
            f"skewmi replay: cannot write {out}: File too large; raise the limit on the size of "
            "files (ulimit -f)"
        ]
    assert is_whole(out)
