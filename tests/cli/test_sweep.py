"""`skewmi sweep` and `skewmi figures` of a sweep, as a user runs them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from tiny_sweeps import write_sweep

from skewmi.cli.main import main
from skewmi.sweep.engine import LocalEngine
from skewmi.sweep.places import RESULT
from skewmi.sweep.tables import read_tables

SWEEPS = Path(__file__).parents[2] / "sweeps"


def test_a_dry_run_lists_the_runs_and_leaves_nothing(tmp_path: Path, capsys: Any) -> None:
    file, out = write_sweep(tmp_path, 400), tmp_path / "out"
    assert main(["sweep", str(file), "--out", str(out), "--dry-run"]) == 0
    text = capsys.readouterr().out
    assert text.count("waiting") == 2
    assert "maze/improved" in text
    assert main(["sweep", str(file), "--out", str(out), "--dry-run", "--json"]) == 0
    runs = json.loads(capsys.readouterr().out)["runs"]
    assert [(run["seed"], run["state"], run["total_steps"]) for run in runs] == [
        (0, "waiting", 400), (1, "waiting", 400),
    ]  # fmt: skip
    assert not out.exists()


@pytest.mark.parametrize(
    ("file", "runs"),
    [("smoke.yaml", 2), ("paper-reduced.yaml", 333), ("paper.yaml", 792)],
)
def test_the_publications_sweeps_are_whole(
    tmp_path: Path, capsys: Any, file: str, runs: int
) -> None:
    """Fig. 5 and the ablation share their runs of sigma 2 and of Skew-Fit."""
    out = ["--out", str(tmp_path / "out"), "--dry-run", "--json"]
    assert main(["sweep", str(SWEEPS / file), *out]) == 0
    found = json.loads(capsys.readouterr().out)["runs"]
    assert len(found) == runs
    shared = [run["of"] for run in found if len(run["of"]) > 1]
    assert len(shared) == (0 if file == "smoke.yaml" else runs // 33)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("learner.hidden", "learner.hiden"), "there is no number 'learner.hiden'"),
        (("point_maze", "maze"), "point_maze"),
        (("[improved]", "[best]"), "point_maze/improved"),
        (("seeds: 2", "seeds: two"), "seeds 'two'"),
        (("seeds: 2", "threads: 0"), "threads is 0"),
        (("seeds: 2", "seeds: [99999999999999999999]"), "--seed is"),
        (("tasks: [point_maze]", "tasks: [point_maze], targets: [t9]"), "group maze"),
        (("tasks: [point_maze]", "tasks: [point_maze], options: {no_such: 1}"), "no_such"),
    ],
)
def test_mistakes_are_one_line_and_leave_nothing(
    tmp_path: Path, capsys: Any, change: tuple[str, str], says: str
) -> None:
    file, out = write_sweep(tmp_path, 400), tmp_path / "out"
    file.write_text(file.read_text().replace(*change))
    assert main(["sweep", str(file), "--out", str(out)]) == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count("\n") == 1
    assert not out.exists()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--processes", "0"], "--processes is 0"),
        (["--address", "10.0.0.1:6379"], "--engine ray"),
        (["--seeds", "0"], "--seeds is 0"),
        (["--steps", "0"], "--steps is 0"),
        (["--groups", "maze", "door"], "no group door; groups are maze"),
        (["--tasks", "door_open"], "no task door_open; tasks are point_maze"),
        (["--configurations", "fast"], "no configuration fast; configurations are "),
    ],
)
def test_options_that_mean_nothing_are_refused(
    tmp_path: Path, capsys: Any, options: list[str], says: str
) -> None:
    assert main(["sweep", str(write_sweep(tmp_path, 400)), *options]) == 2
    assert says in capsys.readouterr().err


class InThisProcess:
    """A worker that has trained when it is started."""

    def __init__(self, run_dir: Path) -> None:
        from skewmi.cli.sweep_run import work

        self.code = work(run_dir)

    def poll(self) -> int:
        return self.code

    def end(self) -> None:
        raise AssertionError("it has ended")


def test_a_sweep_from_its_file_to_its_figures(
    tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    started = []

    def start(self: LocalEngine, run_dir: Path, threads: int) -> InThisProcess:
        started.append(run_dir.name)
        return InThisProcess(run_dir)

    monkeypatch.setattr(LocalEngine, "start", start)
    file, out = write_sweep(tmp_path, 800), tmp_path / "out"
    figures = "figures: {f: {draw: exploration, groups: [maze], metrics: [covered_cells]}}"
    file.write_text(f"{file.read_text()}\n{figures}\n")
    line = ["sweep", str(file), "--out", str(out), "--json"]
    assert main(line) == 0
    document, progress = capsys.readouterr()
    assert [run["state"] for run in json.loads(document)["runs"]] == ["done", "done"]
    assert progress.count("done") >= 2
    results = read_tables(out).results
    assert results["steps"] == [800, 800]
    assert results["state"] == ["done", "done"]
    assert results["kernels"] == ["default", "default"]  # tests leave MKL alone
    assert json.loads(results["config"][0])["seed"] == 0
    assert json.loads(results["changes"][0])["learner.batch_size"] == 16
    # Again: nothing is left to do. A run whose result is lost has only that to do.
    assert main(line) == 0
    assert len(started) == 2
    (out / "runs" / started[0] / RESULT).unlink()
    assert main(line) == 0
    assert started == [started[0], started[1], started[0]]
    assert read_tables(out).results["steps"] == [800, 800]
    # Nor is there in another folder that knows of these results.
    elsewhere = [*line[:3], str(tmp_path / "other"), "--json", "--with-results", str(out)]
    for option in ([], ["--collect"], ["--dry-run"]):
        capsys.readouterr()
        assert main([*elsewhere, *option]) == 0
        runs = json.loads(capsys.readouterr().out)["runs"]
        assert [(run["state"], run["steps"]) for run in runs] == [("done", 800)] * 2
    assert len(started) == 3
    assert read_tables(tmp_path / "other").results == read_tables(out).results
    capsys.readouterr()
    assert main(["figures", str(out), "--dpi", "30"]) == 0
    assert [Path(path).name for path in capsys.readouterr().out.split()] == [
        "f.png", "f.svg", "f.csv",
    ]  # fmt: skip
    assert main(["figures", str(out / "results.parquet"), "--dpi", "30"]) == 2
    assert "--overwrite" in capsys.readouterr().err


def test_a_part_of_a_sweep_shares_its_runs_with_the_whole(tmp_path: Path, capsys: Any) -> None:
    line = ["sweep", str(SWEEPS / "paper-reduced.yaml"), "--out", str(tmp_path), "--dry-run"]

    def listed(*more: str) -> set[str]:
        assert main([*line, *more, "--json"]) == 0
        return {run["run"] for run in json.loads(capsys.readouterr().out)["runs"]}

    part, whole = listed("--groups", "ablation", "--seeds", "1"), listed()
    assert len(part) == 6
    assert part < whole
    assert not listed("--groups", "ablation", "--seeds", "1", "--steps", "2000") & whole


def test_figures_of_a_sweep_that_asks_for_none(tmp_path: Path, capsys: Any) -> None:
    file = write_sweep(tmp_path, 400)
    assert main(["sweep", str(file), "--out", str(tmp_path / "out"), "--collect"]) == 0
    capsys.readouterr()
    assert main(["figures", str(tmp_path / "out")]) == 2
    assert "asks for no figures; give one that does with --spec" in capsys.readouterr().err


@pytest.mark.slow
def test_the_smallest_sweep_with_every_kind_of_figure(tmp_path: Path, capsys: Any) -> None:
    """Processes of its own, one that renders an arm among the figures."""
    line = ["--out", str(tmp_path), "--json", "--quiet", "--processes", "1"]
    assert main(["sweep", str(SWEEPS / "smoke.yaml"), *line]) == 0
    capsys.readouterr()
    assert main(["figures", str(tmp_path), "--dpi", "40", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    names = {Path(path).stem for path in document["files"]}
    assert names == {"fig5", "fig6", "ablation", "table1", "fig7a", "fig7b", "fig10"}
    assert len(document["files"]) == 3 * len(names)
    # What a policy of a few updates cannot do is said, and nothing else is missing.
    assert set(document["missing"]) <= {"fig7b"}
