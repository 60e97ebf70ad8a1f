"""What a sweep keeps in a run's folder, beside what every run has there; `places` has the names."""

from __future__ import annotations

import json
import platform
import subprocess
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import skewmi
from skewmi.errors import CheckpointError
from skewmi.outputs import make_folder, writing
from skewmi.sweep.places import PARTS, RESULT, RUN
from skewmi.train.config import TrainConfig
from skewmi.train.config_json import from_document, to_document
from skewmi.train.files import write_text
from skewmi.train.run import TrainResult


@dataclass(frozen=True)
class Progress:
    """How far a run is.

    Attributes:
        steps: Done, by the last whole row of its table.
        seconds: Wall clock of all its parts until then.
    """

    steps: int = 0
    seconds: float = 0.0


def write_run(run_dir: Path, config: TrainConfig) -> None:
    """Say what a run is, unless that has been said."""
    make_folder(run_dir)
    if not (run_dir / RUN).exists():
        write_text(run_dir / RUN, json.dumps({"config": to_document(config)}, indent=1) + "\n")


def read_run(run_dir: Path) -> TrainConfig:
    """Inverse of `write_run`.

    Raises:
        CheckpointError: It is missing or damaged.
    """
    try:
        return from_document(json.loads((run_dir / RUN).read_text())["config"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CheckpointError(f"{run_dir / RUN} is missing or damaged: {error}") from error


def source_version() -> str:
    """Commit of this package, "+" if its files differ from it; without one, its version."""
    folder = Path(skewmi.__file__).parent

    def git(*arguments: str) -> str:
        command = ["git", "-C", str(folder), *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    try:
        git("ls-files", "--error-unmatch", "__init__.py")  # a package installed inside another
        changed = git("status", "--porcelain", "--untracked-files=no", ".")
        return git("rev-parse", "HEAD") + ("+" if changed else "")
    except (OSError, subprocess.CalledProcessError):
        return f"version {skewmi.__version__}"


def note_part(run_dir: Path, version: str, kernels: str) -> None:
    """Note that a process begins to work on a run, and what its roundings depend on.

    Args:
        run_dir: Of the run.
        version: See `source_version`.
        kernels: See `skewmi.matrix_kernels.name_of_taken`.
    """
    part = {
        "version": version,
        "host": platform.node(),
        "kernels": kernels,
        "step": read_progress(run_dir).steps,
    }
    with writing(run_dir / PARTS), (run_dir / PARTS).open("a") as file:
        file.write(json.dumps(part) + "\n")


def read_parts(run_dir: Path) -> list[dict[str, Any]]:
    """Processes that have worked on a run, oldest first; half a line of a killed one counts not."""
    try:
        lines = (run_dir / PARTS).read_text().splitlines()
    except OSError:
        return []
    parts = []
    for line in lines:
        try:
            parts.append(dict(json.loads(line)))
        except (ValueError, TypeError):
            continue
    return parts


def write_result(run_dir: Path, result: TrainResult) -> None:
    """Say that a run is done, and what it came to."""
    # Where the folder lies and how long the last part took is nobody's result.
    shown = {k: v for k, v in asdict(result).items() if k not in ("run_dir", "seconds", "metrics")}
    write_text(run_dir / RESULT, json.dumps(shown, indent=1) + "\n")


def is_done(run_dir: Path) -> bool:
    """Whether a run is done."""
    return (run_dir / RESULT).exists()


def read_result(run_dir: Path) -> dict[str, Any] | None:
    """What a run came to; None if it is not done.

    Raises:
        CheckpointError: It is damaged.
    """
    if not is_done(run_dir):
        return None
    try:
        return dict(json.loads((run_dir / RESULT).read_text()))
    except (OSError, ValueError, TypeError) as error:
        raise CheckpointError(f"{run_dir / RESULT} is damaged: {error}") from error


def read_progress(run_dir: Path) -> Progress:
    """How far a run is, from the end of its table; nothing yet if there is none."""
    try:
        with (run_dir / "metrics.csv").open("rb") as file:
            names = file.readline().decode().rstrip("\n").split(",")
            begin = file.tell()
            file.seek(0, 2)
            file.seek(max(begin, file.tell() - 65536))
            lines = file.read().decode(errors="replace").split("\n")[:-1]
    except (OSError, UnicodeDecodeError):
        return Progress()
    for line in reversed(lines):
        row = dict(zip(names, line.split(","), strict=False))
        try:
            return Progress(int(row["step"]), float(row["seconds"]))
        except (KeyError, ValueError):
            continue
    return Progress()
