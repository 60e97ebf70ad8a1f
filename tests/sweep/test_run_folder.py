"""What a sweep keeps in a run's folder."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from skewmi.errors import CheckpointError
from skewmi.sweep.run_folder import (
    Progress,
    note_part,
    read_parts,
    read_progress,
    read_result,
    read_run,
    source_version,
    write_run,
)
from skewmi.train.presets import default_preset


def test_a_run_is_what_it_was_begun_as(tmp_path: Path) -> None:
    config = replace(default_preset("t"), seed=4)
    write_run(tmp_path / "run", config)
    write_run(tmp_path / "run", replace(config, seed=5))
    assert read_run(tmp_path / "run") == config
    (tmp_path / "run" / "run.json").write_text("{")
    with pytest.raises(CheckpointError, match="damaged"):
        read_run(tmp_path / "run")


@pytest.mark.parametrize(
    ("table", "expected"),
    [
        (None, Progress()),
        ("", Progress()),
        ("step,a,seconds\n", Progress()),
        ("step,a,seconds\n200,1,1.5\n400,,3.5\n", Progress(400, 3.5)),
        ("step,a,seconds\n200,1,1.5\n400,1,3.", Progress(200, 1.5)),  # half a row, as after a kill
        ("step,a,seconds\n200,1,1.5\n4", Progress(200, 1.5)),
        ("other,table\n1,2\n", Progress()),
    ],
)
def test_progress_is_that_of_the_last_whole_row(
    tmp_path: Path, table: str | None, expected: Progress
) -> None:
    if table is not None:
        (tmp_path / "metrics.csv").write_text(table)
    assert read_progress(tmp_path) == expected


def test_progress_of_a_long_table_is_read_from_its_end(tmp_path: Path) -> None:
    rows = "".join(f"{k},{'1' * 40},{k}.5\n" for k in range(1, 20_000))
    (tmp_path / "metrics.csv").write_text("step,a,seconds\n" + rows)
    assert read_progress(tmp_path) == Progress(19_999, 19_999.5)


def test_parts_are_kept_in_order_and_half_a_line_is_left_out(tmp_path: Path) -> None:
    assert read_parts(tmp_path) == []
    note_part(tmp_path, "one", "default")
    (tmp_path / "metrics.csv").write_text("step,seconds\n200,1.0\n")
    note_part(tmp_path, "two", "avx")
    with (tmp_path / "parts.jsonl").open("a") as file:
        file.write('{"version": "thr')
    parts = read_parts(tmp_path)
    assert [part["version"] for part in parts] == ["one", "two"]
    assert [part["kernels"] for part in parts] == ["default", "avx"]
    assert [part["step"] for part in parts] == [0, 200]


def test_a_run_without_a_result_is_not_done(tmp_path: Path) -> None:
    assert read_result(tmp_path) is None


def test_the_version_is_a_commit_or_a_release() -> None:
    assert re.fullmatch(r"[0-9a-f]{40}\+?|version .+", source_version())
