"""What all figures of sweeps share: what the sweep file asks for, and the files of a figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skewmi.errors import ConfigurationError
from skewmi.outputs import written_aside
from skewmi.sweep.tables import as_columns, write_csv

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = ("#2f6f9f", "#d9752b", "#5a9a4a", "#9a5aa8", "#b8453a", "#7a6a4a", "#5b6770", "#c2a02c")
"""Of configurations, in the order of the sweep file."""
SUFFIXES = (".png", ".svg", ".csv")
_KEYS = ("draw", "title", "groups", "paper", "x")
"""Of every kind of figure."""


@dataclass(frozen=True)
class Request:
    """A figure as the sweep file asks for it.

    Attributes:
        name: Of its files.
        draw: Which kind it is.
        title: Above it.
        groups: Of the sweep that it shows.
        x: Column along the abscissa, where there is one.
        paper: Published values; the kind says how they are nested.
        more: Keys of its kind alone.
    """

    name: str
    draw: str
    title: str
    groups: tuple[str, ...]
    x: str
    paper: Mapping[str, Any]
    more: Mapping[str, Any]


@dataclass(frozen=True)
class Drawn:
    """What became of a figure.

    Attributes:
        files: Written; none if there was nothing to draw.
        missing: What it lacks, a line each.
    """

    files: tuple[Path, ...]
    missing: tuple[str, ...]


def read_request(name: str, content: object, kinds: Mapping[str, Sequence[str]]) -> Request:
    """What a sweep file says of a figure.

    Args:
        name: In the file.
        content: Under it.
        kinds: Kind -> its own keys.

    Raises:
        ConfigurationError: It is not a figure.
    """
    where = f"figure {name}"
    if not isinstance(content, dict):
        raise ConfigurationError(f"{where} is {content!r}; a mapping is needed")
    draw = content.get("draw")
    if not isinstance(draw, str) or draw not in kinds:
        raise ConfigurationError(f"{where}: draw is {draw!r}; allowed: {', '.join(kinds)}")
    allowed = (*_KEYS, *kinds[draw])
    unknown = [str(key) for key in content if key not in allowed]
    if unknown:
        raise ConfigurationError(
            f"{where}: unknown {', '.join(unknown)}; a figure {draw} has {', '.join(allowed)}"
        )
    groups = content.get("groups")
    if not isinstance(groups, list) or not groups or not all(isinstance(g, str) for g in groups):
        raise ConfigurationError(f"{where}: groups is {groups!r}; a list of names is needed")
    paper = content.get("paper", {})
    if not isinstance(paper, dict):
        raise ConfigurationError(f"{where}: paper is {paper!r}; a mapping is needed")
    return Request(
        name=name,
        draw=draw,
        title=str(content.get("title", name)),
        groups=tuple(groups),
        x=str(content.get("x", "trajectories")),
        paper=paper,
        more={key: content[key] for key in kinds[draw] if key in content},
    )


def write_figure(
    figure: Figure, rows: Sequence[Mapping[str, Any]], stem: Path, dpi: int
) -> tuple[Path, ...]:
    """Write a figure as PNG and SVG and what it shows as CSV, and give its memory back.

    Raises:
        OutputError: One cannot be written.
    """
    from matplotlib import pyplot

    paths = tuple(stem.with_name(stem.name + suffix) for suffix in SUFFIXES)
    with ExitStack() as stack:
        stack.callback(pyplot.close, figure)
        for path in paths[:2]:
            with written_aside(path) as draft:
                # Without the time of drawing in it, so that the same results give the same file.
                metadata = {"Date": None} if path.suffix == ".svg" else {}
                figure.savefig(draft, dpi=dpi, metadata=metadata)
        write_csv(as_columns(rows), paths[2])
    return paths
