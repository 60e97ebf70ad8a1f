"""What a file is: a policy, a recording, a calibration, or the folder of a run.

Exit code 0 if it could be read whole, 1 for a recording that ends early, 2 if it is none of these.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.markup import escape

from skewmi import extras, policies
from skewmi.errors import ConfigurationError, NotFoundError, did_you_mean

_MCAP = b"\x89MCAP0\r\n"


@dataclass(frozen=True)
class InfoCommand:
    """Options of `skewmi info`."""

    file: Annotated[Path, tyro.conf.Positional]
    """Policy file (or bundled name), recording, calibration, or folder of a run."""
    json: bool = False
    """Print one JSON document."""


def run_info(options: InfoCommand) -> int:
    """Tell what it is. Returns the exit code."""
    document = info(options.file)
    if options.json:
        print(json.dumps(document))
    else:
        console = Console()
        for name, value in _lines(document):
            console.print(f"[bold]{escape(name)}[/bold]: {escape(value)}", highlight=False)
    return 1 if document.get("complete") is False else 0


def info(path: Path) -> dict[str, Any]:
    """What is known of a file, by name, beginning with its kind.

    Raises:
        NotFoundError: There is nothing of that name.
        ConfigurationError: It is of no kind that is known.
        SkewmiError: It is of one, but damaged.
    """
    found = policies.locate(path)
    if found.is_dir():
        return {"kind": "run", "path": str(found), **_run(found)}
    if not found.is_file():
        names = policies.bundled()
        raise NotFoundError(
            f"{path} does not exist; give a policy, a recording, a calibration, the folder of a "
            f"run, or a bundled policy ({', '.join(names)}){did_you_mean(str(path), names)}"
        )
    kind, read = _kind(found)
    return {"kind": kind, "path": str(found), "bytes": found.stat().st_size, **read(found)}


def _kind(path: Path) -> tuple[str, Callable[[Path], dict[str, Any]]]:
    with path.open("rb") as file:
        begin = file.read(16)
    if begin.startswith(_MCAP):
        return "recording", _recording
    if path.suffix.lower() in (".yaml", ".yml", ".json"):
        return "calibration", _calibration
    if path.suffix.lower() == ".onnx":
        return "policy", _policy
    raise ConfigurationError(
        f"{path} is neither a policy (.onnx), nor a recording (MCAP), nor a calibration (.yaml); "
        "give one of these, or the folder of a run"
    )


def _policy(path: Path) -> dict[str, Any]:
    from skewmi.deploy.policy import OnnxPolicy

    policy = OnnxPolicy.load(path)
    layout = policy.layout
    told = {key: value for key, value in policy.metadata.items() if key != "layout"}
    return {
        "task": layout.task,
        "observation": [f"{field.name} [{field.unit}]" for field in layout.observation],
        "action": [f"{field.name} [{field.unit}]" for field in layout.action],
        "control_hz": 1.0 / layout.control_dt,
        "metadata": told,
    }


def _recording(path: Path) -> dict[str, Any]:
    from skewmi.deploy.recording.reader import read_recording

    recording = read_recording(path)
    times = [m.log_time_ns for every in recording.messages.values() for m in every]
    told = {
        name: value
        for name, value in recording.metadata.items()
        if name not in ("layout", "limits", "scene", "believed", "excitation")
    }
    return {
        "complete": recording.complete,
        "seconds": (max(times) - min(times)) / 1e9,
        "messages": {name: len(every) for name, every in recording.messages.items()},
        "types": dict(recording.types),
        "metadata": told,
    }


def _calibration(path: Path) -> dict[str, Any]:
    from skewmi.calibration.calibration_file import read_calibration

    known = read_calibration(path)
    sections = {"servo": known.servo, "egm": known.egm, "scene": known.scene}
    told: dict[str, Any] = {
        "created": known.created,
        "version": known.version,
        "sections": [name for name, section in sections.items() if section is not None],
        "recordings": [recording.as_mapping() for recording in known.recordings],
        "checks": dict(known.checks),
        "warnings": list(known.warnings),
    }
    for name, section in sections.items():
        if section is not None:
            told[name] = section.as_mapping()
    return told


def _run(path: Path) -> dict[str, Any]:
    try:
        from skewmi.train.checkpoint import read_run_header
    except ModuleNotFoundError as error:
        raise extras.missing("reading a run directory", error) from error
    config, layout = read_run_header(path)
    checkpoints = sorted(p.name for p in (path / "checkpoints").glob("*") if p.is_dir())
    return {
        "task": config.task,
        "preset": config.preset,
        "seed": config.seed,
        "learner": type(config.learner).__name__.removesuffix("Config"),
        "exploration": type(config.exploration).__name__.removesuffix("Config"),
        "task_options": dict(config.task_options),
        "started_from": config.started_from,
        "layout_hash": layout.hash(),
        "checkpoints": checkpoints,
        "measured": _last_row(path / "metrics.csv"),
    }


def _last_row(path: Path) -> dict[str, str]:
    """The newest line of a run's metrics; empty if there is none yet."""
    if not path.is_file():
        return {}
    header, *rows = path.read_text(encoding="utf-8").splitlines() or [""]
    return dict(zip(header.split(","), rows[-1].split(","), strict=False)) if rows else {}


def _lines(document: dict[str, Any], before: str = "") -> Iterator[tuple[str, str]]:
    """Names, with those of what they are in, and values as text."""
    for name, value in document.items():
        if isinstance(value, dict) and value:
            yield from _lines(value, f"{before}{name}.")
        elif isinstance(value, list):
            yield f"{before}{name}", ", ".join(map(str, value)) or "none"
        else:
            yield f"{before}{name}", "none" if value in ("", None, {}) else str(value)
