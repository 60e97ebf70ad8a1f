"""Tables of results: written whole, read back as they were."""

from __future__ import annotations

from pathlib import Path

import pytest

from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.sweep.tables import Tables, as_columns, is_sweep, read_tables, write_tables

RESULTS = as_columns(
    [
        {"run": "a", "group": "g", "configuration": "c", "task": "t", "seed": 0, "entropy": 1},
        {"run": "b", "group": "g", "configuration": "c", "task": "t", "seed": 1, "entropy": 2.5},
        {"run": "d", "group": "g", "configuration": "c", "task": "t", "seed": 2, "target": "far"},
    ]
)
CURVES = {"run": ["a", "a"], "step": [1.0, 2.0], "entropy": [None, 0.5]}
STATES = {"run": ["a"], "trajectory": [1], "x": [0.5]}


def test_they_are_read_as_they_were_written(tmp_path: Path) -> None:
    figures = {"f": {"draw": "ablation", "paper": {"a": 1.5}}}
    files = write_tables(Tables(RESULTS, CURVES, STATES, figures), tmp_path)
    assert [path.name for path in files] == [
        "results.parquet", "results.csv", "curves.parquet", "curves.csv", "states.parquet",
    ]  # fmt: skip
    for path in (tmp_path, tmp_path / "results.parquet"):
        assert is_sweep(path)
        read = read_tables(path)
        assert read.results == {**RESULTS, "entropy": [1.0, 2.5, None]}
        assert (read.curves, read.states, read.figures) == (CURVES, STATES, figures)
        assert read.folder == tmp_path
    assert (tmp_path / "results.csv").read_text().startswith('"run","group"')


def test_what_is_no_sweep_is_refused(tmp_path: Path) -> None:
    assert not is_sweep(tmp_path)
    (tmp_path / "sweep.yaml").touch()  # killed before it could write any
    assert is_sweep(tmp_path)
    with pytest.raises(NotFoundError, match="--collect"):
        read_tables(tmp_path)
    write_tables(Tables({"a": [1]}, {}), tmp_path)
    with pytest.raises(ConfigurationError, match="no column 'run'"):
        read_tables(tmp_path)
    (tmp_path / "results.parquet").write_bytes(b"PAR1")
    with pytest.raises(ConfigurationError, match="cannot be read"):
        read_tables(tmp_path)
