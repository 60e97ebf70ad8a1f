"""Trained policies that come with the package, as files of `skewmi export-onnx`."""

from __future__ import annotations

from pathlib import Path


def bundled() -> dict[str, Path]:
    """The bundled policy files by name."""
    return {path.stem: path for path in sorted(Path(__file__).parent.glob("*.onnx"))}


def locate(path: Path | str) -> Path:
    """A policy file: an existing path as it is, or else the bundled policy of that name."""
    path = Path(path)
    return path if path.exists() else bundled().get(str(path), path)
