"""The results of a sweep as tables: Parquet and CSV, and what figures are to be made of them.

results.parquet, results.csv   a row per run in its place in a group
curves.parquet, curves.csv     a row per run and measurement: the columns of metrics.csv
states.parquet                 visited states of some runs, thinned: run, trajectory, fields
                               of the state by name

Whoever reads them needs neither torch nor the runs. What the sweep file says of figures travels in
the metadata of results.parquet.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.outputs import written_aside

if TYPE_CHECKING:
    import pyarrow as pa

RESULTS, CURVES, STATES = "results", "curves", "states"
SWEEP = "sweep.yaml"
"""In a sweep's folder: the file that it was run with."""
RUN = "run"
"""Column of every table: name of the run."""
_FIGURES = b"skewmi.figures"
_WORDS = (
    RUN, "group", "configuration", "task", "target", "preset", "learner", "exploration", "commit",
    "kernels", "state", "stopped_by", "discoveries", "changes", "config",
)  # fmt: skip
"""Columns whose values are words, also where they look like numbers."""

Columns = dict[str, list[Any]]


@dataclass(frozen=True)
class Tables:
    """What a sweep came to.

    Attributes:
        results, curves, states: Columns by name, all of a table equally long; see the module.
        figures: Of the sweep file.
        folder: Where they were read.
    """

    results: Columns
    curves: Columns
    states: Columns = field(default_factory=dict)
    figures: Mapping[str, Any] = field(default_factory=dict)
    folder: Path = field(default_factory=Path)


def as_columns(rows: Sequence[Mapping[str, Any]]) -> Columns:
    """Rows as columns; what a row lacks is None."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    return {name: [row.get(name) for row in rows] for name in names}


def rows_of(columns: Columns) -> list[dict[str, Any]]:
    """Inverse of `as_columns`."""
    return [
        dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)
    ]


def joined(parts: Sequence[Columns]) -> Columns:
    """Rows of several tables, one after the other; what a table lacks is None."""
    names = list(dict.fromkeys(name for part in parts for name in part))
    found: Columns = {name: [] for name in names}
    for part in parts:
        count = max((len(values) for values in part.values()), default=0)
        for name in names:
            found[name].extend(part.get(name, [None] * count))
    return found


def write_tables(tables: Tables, folder: Path) -> list[Path]:
    """Write all of them, each whole or not at all, and return the files.

    Raises:
        OutputError: One cannot be written.
    """
    files = []
    for name, columns in (
        (RESULTS, tables.results),
        (CURVES, tables.curves),
        (STATES, tables.states),
    ):
        if not columns:
            continue
        table = _table(columns)
        if name == RESULTS:
            figures = json.dumps(tables.figures).encode()
            table = table.replace_schema_metadata({_FIGURES: figures})
        files += _write(table, folder / name, csv=name != STATES)
    return files


def _table(columns: Columns) -> pa.Table:
    import pyarrow as pa

    return pa.table({name: _array(values) for name, values in columns.items()})


def _array(values: list[Any]) -> pa.Array:
    import pyarrow as pa

    known = [value for value in values if value is not None]
    # Whole numbers of one run may be fractions of another.
    if any(isinstance(v, float) for v in known) and all(
        isinstance(v, int | float) and not isinstance(v, bool) for v in known
    ):
        values = [None if value is None else float(value) for value in values]
    return pa.array(values)


def _write(table: pa.Table, stem: Path, *, csv: bool) -> list[Path]:
    import pyarrow.parquet

    path = stem.with_suffix(".parquet")
    with written_aside(path) as draft:
        pyarrow.parquet.write_table(table, draft, compression="zstd")
    return [path, _write_csv(table, stem.with_suffix(".csv"))] if csv else [path]


def _write_csv(table: pa.Table, path: Path) -> Path:
    import pyarrow.csv

    with written_aside(path) as draft:
        pyarrow.csv.write_csv(table, draft)
    return path


def write_csv(columns: Columns, path: Path) -> Path:
    """Write columns as CSV.

    Raises:
        OutputError: It cannot be written.
    """
    return _write_csv(_table(columns), path)


def read_tables(path: Path) -> Tables:
    """Read what a sweep came to.

    Args:
        path: Its folder, or results.parquet or results.csv in it. Where a table is not there as
            Parquet its CSV file is read, which does not say which figures are to be made.

    Raises:
        NotFoundError: There are no results.
        ConfigurationError: A table is damaged, or none of ours.
    """
    folder = path.parent if path.suffix in (".parquet", ".csv") else path
    if not any((folder / f"{RESULTS}{suffix}").exists() for suffix in (".parquet", ".csv")):
        raise NotFoundError(
            f"{path} has no {RESULTS}.parquet or .csv: give the folder of a sweep that has been "
            "run, or write its results as they are with skewmi sweep FILE --collect"
        )
    results, metadata = _read(folder / RESULTS)
    for needed in (RUN, "group", "configuration", "task", "seed"):
        if needed not in results:
            raise ConfigurationError(f"{path} has no column {needed!r}: it is no sweep's")
    curves, _ = _read(folder / CURVES)
    states, _ = _read(folder / STATES)
    try:
        figures = json.loads(metadata.get(_FIGURES, b"{}"))
    except ValueError as error:
        raise ConfigurationError(f"{path} is damaged: {error}") from error
    return Tables(results, curves, states, figures, folder)


def is_sweep(path: Path) -> bool:
    """Whether a path is a sweep's and not a run's, with results or without."""
    return path.suffix in (".parquet", ".csv") or any(
        (path / name).exists() for name in (f"{RESULTS}.parquet", f"{RESULTS}.csv", SWEEP)
    )


def _read(stem: Path) -> tuple[Columns, Mapping[bytes, bytes]]:
    """A table that is there as Parquet or CSV; none where it is not."""
    import pyarrow as pa
    import pyarrow.csv
    import pyarrow.parquet

    parquet, csv = (stem.with_suffix(suffix) for suffix in (".parquet", ".csv"))
    try:
        if parquet.exists():
            table = pyarrow.parquet.read_table(parquet)
        elif csv.exists():
            words = dict.fromkeys(_WORDS, pa.string())
            table = pyarrow.csv.read_csv(
                csv,
                convert_options=pyarrow.csv.ConvertOptions(
                    column_types=words, strings_can_be_null=True, quoted_strings_can_be_null=False
                ),
            )
        else:
            return {}, {}
    except (OSError, pa.ArrowException) as error:
        raise ConfigurationError(f"{stem} cannot be read: {error}") from error
    return table.to_pydict(), table.schema.metadata or {}
