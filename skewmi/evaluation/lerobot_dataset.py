"""Episodes as a LeRobotDataset, version 3.0 of its format: what imitation learners read.

    meta/info.json                            what there is: features, frames per second, counts
    meta/stats.json                           of each feature over all frames, to normalise with
    meta/tasks.parquet                        what was to be done, in words
    meta/episodes/chunk-000/file-000.parquet  per episode: length, where its frames are, statistics
    meta/skewmi.json                          where it comes from: recordings, layout of the policy
    data/chunk-000/file-000.parquet           the frames, a row each, an episode a row group

A frame is a control step. Its time is its number by the frames per second, as the format has it.
Pictures, if there are any, are PNG in the frames' rows: the format's `image`, which needs no video
codec where they are written and none where they are read.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from skewmi.evaluation.lerobot_pictures import Pictures
from skewmi.evaluation.lerobot_statistics import statistics

if TYPE_CHECKING:
    import pyarrow as pa

VERSION = "v3.0"
ROBOT = "abb_yumi"
MOST_FILE_BYTES = 100 * 2**20
"""A file of frames is ended by the episode that brings it here; the format's default."""
MOST_FILES = 1000
"""In a folder (chunk)."""

_FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_DTYPES = {"float32": np.float32, "int64": np.int64, "bool": np.bool_}


@dataclass(frozen=True)
class Feature:
    """A column of numbers.

    Attributes:
        dtype: `float32`, `int64` or `bool`.
        names: Of its numbers; None if it is one number without a name.
    """

    dtype: str
    names: tuple[str, ...] | None = None

    @property
    def size(self) -> int:
        return 1 if self.names is None else len(self.names)

    def as_mapping(self) -> dict[str, Any]:
        """As `info.json` has it."""
        names = None if self.names is None else list(self.names)
        return {"dtype": self.dtype, "shape": [self.size], "names": names}


_COMMON = {
    "timestamp": Feature("float32"),
    "frame_index": Feature("int64"),
    "episode_index": Feature("int64"),
    "index": Feature("int64"),
    "task_index": Feature("int64"),
}
"""What every data set has."""


class DatasetWriter:
    """Writes a data set into an empty folder: `add` each episode, then `finish`.

    Args:
        folder: Exists.
        features: Of the frames, by name; those that every data set has come on top.
        fps: Frames per second.
        task: What was to be done, in words.
        pictures: Name and shape of the frames' pictures; None if there are none.
    """

    def __init__(
        self,
        folder: Path,
        features: Mapping[str, Feature],
        fps: float,
        task: str,
        pictures: Pictures | None = None,
    ) -> None:
        self._folder = folder
        self._features = {**features, **_COMMON}
        self._fps = round(fps) if abs(fps - round(fps)) < 1e-6 * fps else fps
        self._task = task
        self._pictures = pictures
        self._frames = 0
        self._file = 0
        self._file_bytes = 0
        self._writer: Any = None
        self._columns: dict[str, list[NDArray[Any]]] = {name: [] for name in self._features}
        self._picture_samples: list[NDArray[np.uint8]] = []
        self._episodes: list[dict[str, Any]] = []

    def add(
        self, values: Mapping[str, NDArray[Any]], pictures: Sequence[NDArray[np.uint8]] = ()
    ) -> None:
        """Append an episode.

        Args:
            values: Per feature, shape (n, size), or (n,) for one number.
            pictures: One a frame, shape (height, width, 3), if the data set has them.
        """
        import pyarrow as pa

        count = len(next(iter(values.values())))
        index = len(self._episodes)
        frame = np.arange(count)
        columns: dict[str, NDArray[Any]] = {
            **values,
            "timestamp": frame / self._fps,
            "frame_index": frame,
            "episode_index": np.full(count, index),
            "index": self._frames + frame,
            "task_index": np.zeros(count),
        }
        arrays, stats = {}, {}
        for name, feature in self._features.items():
            values_of: NDArray[Any] = np.asarray(columns[name], dtype=_DTYPES[feature.dtype])
            column = values_of.reshape(count, -1)
            assert column.shape[1] == feature.size, name
            self._columns[name].append(column)
            stats[name] = statistics(column)
            flat = pa.array(column.ravel())
            arrays[name] = (
                pa.FixedSizeListArray.from_arrays(flat, feature.size) if feature.size > 1 else flat
            )
        if self._pictures is not None:
            samples = self._pictures.sampled(pictures)
            self._picture_samples.append(samples)
            stats[self._pictures.name] = self._pictures.statistics(samples)
            arrays[self._pictures.name] = self._pictures.array(pictures)
        chunk, file = divmod(self._file, MOST_FILES)
        self._write(pa.table(arrays), chunk, file)
        self._episodes.append(
            {
                "episode_index": index,
                "tasks": [self._task],
                "length": count,
                "data/chunk_index": chunk,
                "data/file_index": file,
                "dataset_from_index": self._frames,
                "dataset_to_index": self._frames + count,
                "meta/episodes/chunk_index": 0,
                "meta/episodes/file_index": 0,
                **{f"stats/{name}/{key}": v for name, s in stats.items() for key, v in s.items()},
            }
        )
        self._frames += count

    def finish(self, about: Mapping[str, Any]) -> None:
        """Write what tells of the frames.

        Args:
            about: Where the data comes from; anything that JSON can hold.
        """
        import pyarrow as pa
        import pyarrow.parquet

        self._end_file()
        meta = self._folder / "meta"
        episodes = meta / "episodes" / _FILE.format(chunk_index=0, file_index=0)
        episodes.parent.mkdir(parents=True)
        pyarrow.parquet.write_table(pa.Table.from_pylist(self._episodes), episodes)
        pyarrow.parquet.write_table(_task_table([self._task]), meta / "tasks.parquet")
        whole = {
            name: statistics(np.concatenate(columns)) for name, columns in self._columns.items()
        }
        if self._pictures is not None:
            samples = np.concatenate(self._picture_samples)
            whole[self._pictures.name] = self._pictures.statistics(samples)
        for name, content in (("info", self._info()), ("stats", whole), ("skewmi", dict(about))):
            text = json.dumps(content, indent=4, ensure_ascii=False)
            (meta / f"{name}.json").write_text(text + "\n", encoding="utf-8")

    def _write(self, table: pa.Table, chunk: int, file: int) -> None:
        """An episode as a row group of its own, so that it can be read alone."""
        import pyarrow.parquet

        if self._writer is None:
            path = self._folder / "data" / _FILE.format(chunk_index=chunk, file_index=file)
            path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = pyarrow.parquet.ParquetWriter(path, table.schema)
        self._writer.write_table(table, row_group_size=max(1, len(table)))
        self._file_bytes += table.nbytes
        if self._file_bytes >= MOST_FILE_BYTES:
            self._end_file()

    def _end_file(self) -> None:
        if self._writer is not None:
            self._writer.close()
            self._writer = None
            self._file, self._file_bytes = self._file + 1, 0

    def _info(self) -> dict[str, Any]:
        features = {name: feature.as_mapping() for name, feature in self._features.items()}
        if self._pictures is not None:
            features[self._pictures.name] = self._pictures.as_mapping()
        return {
            "codebase_version": VERSION,
            "robot_type": ROBOT,
            "total_episodes": len(self._episodes),
            "total_frames": self._frames,
            "total_tasks": 1,
            "chunks_size": MOST_FILES,
            "data_files_size_in_mb": MOST_FILE_BYTES // 2**20,
            "video_files_size_in_mb": 200,
            "fps": self._fps,
            "splits": {"train": f"0:{len(self._episodes)}"},
            "data_path": f"data/{_FILE}",
            "video_path": None,
            "features": features,
        }


def _task_table(tasks: Sequence[str]) -> pa.Table:
    """Tasks and their numbers, as pandas writes a table whose index is the task."""
    import pyarrow as pa

    def column(name: str, kind: str, numpy_type: str) -> dict[str, Any]:
        about = {"name": name, "field_name": name, "pandas_type": kind}
        return {**about, "numpy_type": numpy_type, "metadata": None}

    pandas = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [column("task_index", "int64", "int64"), column("task", "unicode", "object")],
        "creator": {"library": "pyarrow", "version": pa.__version__},
        "pandas_version": "2.0.0",
    }
    table = pa.table({"task_index": list(range(len(tasks))), "task": list(tasks)})
    return table.replace_schema_metadata({"pandas": json.dumps(pandas)})
