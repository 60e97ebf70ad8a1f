"""Data sets for imitation learners: what was written is what readers find, ours and LeRobot's."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from skewmi.evaluation import lerobot_dataset
from skewmi.evaluation.lerobot_dataset import DatasetWriter, Feature
from skewmi.evaluation.lerobot_pictures import Pictures
from skewmi.evaluation.lerobot_statistics import QUANTILES, statistics

FEATURES = {
    "observation.state": Feature("float32", ("x", "y", "z")),
    "action": Feature("float32", ("dx", "dy")),
    "next.done": Feature("bool"),
}
FPS = 10
TASK = "open the box"
PICTURES = Pictures("close", 24, 16)


def episode(length: int, seed: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {
        "observation.state": rng.standard_normal((length, 3)),
        "action": rng.uniform(-1.0, 1.0, (length, 2)),
        "next.done": np.arange(length) == length - 1,
    }


def picture(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (16, 24, 3), dtype=np.uint8)


def write(
    folder: Path, episodes: list[dict[str, np.ndarray]], pictures: Pictures | None = None
) -> None:
    folder.mkdir(parents=True)
    writer = DatasetWriter(folder, FEATURES, FPS, TASK, pictures)
    for index, values in enumerate(episodes):
        frames = range(len(values["action"]) if pictures else 0)
        writer.add(values, [picture(1000 * index + frame) for frame in frames])
    writer.finish({"from": "a test"})


def rows_of(folder: Path, row: dict[str, Any]) -> Any:
    """An episode's frames, found as the format says: by file, and by index in all of them."""
    info = json.loads((folder / "meta" / "info.json").read_text())
    path = info["data_path"].format(
        chunk_index=row["data/chunk_index"], file_index=row["data/file_index"]
    )
    table = pyarrow.parquet.read_table(folder / path)
    index = np.array(table["index"])
    chosen = (row["dataset_from_index"] <= index) & (index < row["dataset_to_index"])
    return table.filter(chosen)


@settings(max_examples=15, deadline=None)
@given(st.lists(st.integers(1, 30), min_size=1, max_size=6), st.sampled_from([1, 10**9]))
def test_an_independent_reader_finds_every_episode(
    tmp_path_factory: pytest.TempPathFactory, lengths: list[int], most: int
) -> None:
    folder = tmp_path_factory.mktemp("data") / "set"
    episodes = [episode(length, seed) for seed, length in enumerate(lengths)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lerobot_dataset, "MOST_FILE_BYTES", most)
        patch.setattr(lerobot_dataset, "MOST_FILES", 2)
        write(folder, episodes)
    info = json.loads((folder / "meta" / "info.json").read_text())
    told = pyarrow.parquet.read_table(folder / "meta/episodes/chunk-000/file-000.parquet")
    assert (info["total_episodes"], info["total_frames"]) == (len(lengths), sum(lengths))
    assert told["length"].to_pylist() == lengths
    paths = sorted(folder.glob("data/*/*.parquet"))
    assert len(paths) == (len(lengths) if most == 1 else 1)
    groups = sum(pyarrow.parquet.ParquetFile(path).num_row_groups for path in paths)
    assert groups == len(lengths), "an episode is a row group"
    for number, (row, values) in enumerate(zip(told.to_pylist(), episodes, strict=True)):
        rows = rows_of(folder, row)
        assert set(rows.column_names) == set(info["features"])
        for name in ("observation.state", "action"):
            np.testing.assert_array_equal(
                np.array(rows[name].to_pylist(), dtype=np.float32), values[name].astype(np.float32)
            )
        assert rows["next.done"].to_pylist() == values["next.done"].tolist()
        assert rows["episode_index"].to_pylist() == [number] * len(rows)
        assert rows["frame_index"].to_pylist() == list(range(len(rows)))
        np.testing.assert_allclose(np.array(rows["timestamp"]), np.arange(len(rows)) / FPS, 1e-6)
        mean = values["action"].astype(np.float32).mean(axis=0)
        np.testing.assert_allclose(row["stats/action/mean"], mean, atol=1e-6)
    whole = json.loads((folder / "meta" / "stats.json").read_text())
    every = np.concatenate([values["observation.state"] for values in episodes])
    np.testing.assert_allclose(whole["observation.state"]["max"], every.max(axis=0), 1e-6)
    assert whole["observation.state"]["count"] == [sum(lengths)]
    assert set(whole) == set(info["features"])


def test_statistics_are_numpys() -> None:
    rows = np.random.default_rng(0).standard_normal((101, 4))
    found = statistics(rows)
    np.testing.assert_allclose(found["std"], rows.std(axis=0))
    for share in QUANTILES:
        np.testing.assert_allclose(
            found[f"q{round(100 * share):02d}"], np.quantile(rows, share, axis=0)
        )


def test_pictures_are_kept_to_the_bit(tmp_path: Path) -> None:
    write(tmp_path / "set", [episode(3, 0), episode(2, 1)], PICTURES)
    (path,) = (tmp_path / "set").glob("data/*/*.parquet")
    column = pyarrow.parquet.read_table(path)[PICTURES.name].to_pylist()
    seeds = (0, 1, 2, 1000, 1001)
    for cell, seed in zip(column, seeds, strict=True):
        with Image.open(io.BytesIO(cell["bytes"])) as image:
            np.testing.assert_array_equal(np.asarray(image), picture(seed))
    info = json.loads((tmp_path / "set" / "meta" / "info.json").read_text())
    assert info["features"][PICTURES.name] == {
        "dtype": "image",
        "shape": [16, 24, 3],
        "names": ["height", "width", "channels"],
    }
    stats = json.loads((tmp_path / "set" / "meta" / "stats.json").read_text())
    assert np.shape(stats[PICTURES.name]["mean"]) == (3, 1, 1)


def test_the_tasks_are_pandas_index(tmp_path: Path) -> None:
    write(tmp_path / "set", [episode(3, 0)])
    table = pyarrow.parquet.read_table(tmp_path / "set" / "meta" / "tasks.parquet")
    assert json.loads(table.schema.metadata[b"pandas"])["index_columns"] == ["task"]
    assert table.to_pylist() == [{"task_index": 0, "task": TASK}]


@pytest.mark.parametrize("pictures", [None, PICTURES])
def test_lerobots_own_loader_opens_it(
    tmp_path: Path, pictures: Pictures | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    reason = "LeRobot is not installed; it needs a Rerun of its own, so an environment of its own"
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    monkeypatch.setenv("HF_HOME", str(tmp_path / "home"))
    loader = pytest.importorskip("lerobot.datasets.lerobot_dataset", reason=reason)
    episodes = [episode(5, 0), episode(3, 1)]
    write(tmp_path / "set", episodes, pictures)
    data = loader.LeRobotDataset("local/set", root=tmp_path / "set")
    assert (data.num_episodes, data.num_frames, data.fps) == (2, 8, FPS)
    states = np.concatenate([values["observation.state"] for values in episodes])
    for index in range(8):
        item = data[index]
        np.testing.assert_allclose(item["observation.state"], states[index], 1e-6)
        assert int(item["episode_index"]) == (index >= 5)
        assert item["task"] == TASK
        if pictures is not None:
            expected = picture(index if index < 5 else 1000 + index - 5)
            seen = np.asarray(item[pictures.name]).transpose(1, 2, 0)
            np.testing.assert_allclose(seen, expected / 255.0, atol=1e-6)
    # Steps around a frame, as learners ask for them; they end with the episode.
    deltas = {"action": [0.0, 1 / FPS]}
    data = loader.LeRobotDataset("local/set", root=tmp_path / "set", delta_timestamps=deltas)
    assert data[4]["action"].shape == (2, 2)
    assert data[4]["action_is_pad"].tolist() == [False, True]
