"""One result document that says how it came about, for benchmarks and long checks.

The document is the figures plus seed, configuration, commit, versions and machine.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

REPOSITORY = Path(__file__).resolve().parents[2]

PACKAGES = (
    "mujoco",
    "numpy",
    "torch",
    "gymnasium",
    "stable-baselines3",
    "pin",
    "mink",
    "ruckig",
    "onnxruntime",
    "eclipse-zenoh",
)
"""Distributions whose versions can change a figure."""


def argument_parser(description: str | None, *, seed: int = 0) -> argparse.ArgumentParser:
    """Parser with the options that all of them have: `--json`, `--out` and `--seed`."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--json", action="store_true", help="print one JSON document on stdout")
    parser.add_argument("--out", type=Path, default=None, help="also write the document here")
    parser.add_argument("--seed", type=int, default=seed, help="seed of everything random")
    return parser


def machine_info() -> dict[str, Any]:
    """Kind of machine, without its name: processor, usable cores, memory, system, load.

    `cores` is what this process may use; `load_1min` above it means that others were running
    and absolute speeds are too low.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    info: dict[str, Any] = {
        "processor": _processor(),
        "cores": cores,
        "system": platform.system(),
        "machine": platform.machine(),
    }
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
        info["memory_gib"] = round(memory / 2**30, 1)
    if hasattr(os, "getloadavg"):
        info["load_1min"] = round(os.getloadavg()[0], 2)
    return info


def versions() -> dict[str, str]:
    """Version of Python and of each of `PACKAGES` that is installed."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def commit() -> str | None:
    """Commit of this checkout, with `-dirty` if tracked files differ; None outside of git."""
    try:
        head = _git("rev-parse", "HEAD")
        changed = _git("status", "--porcelain", "--untracked-files=no")
    except (OSError, subprocess.CalledProcessError):
        return None
    return f"{head}-dirty" if changed else head


def write_result(
    name: str,
    data: Mapping[str, Any],
    path: str | Path | None = None,
    *,
    seed: int | None = None,
    config: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Put the figures of a run into a document and, with a path, into a file.

    Args:
        name: Of the benchmark or check.
        data: Its figures; they become top-level entries of the document.
        path: File to write (replaced in one step), or None to write none.
        seed: Seed of the run.
        config: What the figures depend on.

    Returns:
        The document: benchmark, `data`, seed, config, commit, versions, machine, created_utc.
    """
    document: dict[str, Any] = {
        "benchmark": name,
        **data,
        "seed": seed,
        "config": dict(config or {}),
        "commit": commit(),
        "versions": versions(),
        "machine": machine_info(),
        "created_utc": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }
    if path is not None:
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(path.name + ".partial")
        partial.write_text(_dump(document) + "\n", encoding="utf-8")
        partial.replace(path)
    return document


def print_result(document: Mapping[str, Any], *, as_json: bool) -> None:
    """Print the whole document as JSON, or its figures as indented lines for people."""
    if as_json:
        print(_dump(document))
        return
    about = ("seed", "config", "commit", "versions", "machine", "created_utc")
    print(_dump({key: value for key, value in document.items() if key not in about}))


def progress(message: str) -> None:
    """One line on standard error."""
    print(message, file=sys.stderr, flush=True)


def _dump(document: Mapping[str, Any]) -> str:
    # numpy scalars and arrays turn up in figures; NaN is not JSON and must not pass silently.
    return json.dumps(
        document,
        indent=2,
        allow_nan=False,
        default=lambda value: value.tolist() if hasattr(value, "tolist") else str(value),
    )


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or "unknown"


def _git(*arguments: str) -> str:
    command = ["git", "-C", str(REPOSITORY), *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
