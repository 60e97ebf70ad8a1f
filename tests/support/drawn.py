"""What a Rerun file has drawn."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rerun.chunk import RrdReader


def rows(path: Path) -> dict[str, int]:
    """Number of samples by entity, static ones left out."""
    counts: dict[str, int] = {}
    for chunk in RrdReader(path).stream().to_chunks():
        if not chunk.is_static:
            entity = str(chunk.entity_path)
            counts[entity] = counts.get(entity, 0) + chunk.num_rows
    return counts


def drawn(path: Path, entity: str) -> np.ndarray:
    """The numbers of an entity's curves, in the order of time. Shape (n, curves)."""
    found = []
    for chunk in RrdReader(path).stream().to_chunks():
        if str(chunk.entity_path) == entity and not chunk.is_static:
            batch = chunk.to_record_batch()
            (name,) = [name for name in batch.schema.names if name.endswith("scalars")]
            found += batch.column(name).to_pylist()
    return np.array(found, dtype=np.float64)


def drawn_times(path: Path, entity: str, timeline: str = "robot_time") -> np.ndarray:
    """When an entity was drawn, s. Shape (n,)."""
    found = []
    for chunk in RrdReader(path).stream().to_chunks():
        if str(chunk.entity_path) == entity and not chunk.is_static:
            column = chunk.to_record_batch().column(timeline).to_pylist()
            found += [time.total_seconds() for time in column]
    return np.array(found, dtype=np.float64)


def static(path: Path, entity: str, ending: str) -> list[Any]:
    """A component, by the end of its name, that an entity has for good; the newest one."""
    found: list[Any] = []
    for chunk in RrdReader(path).stream().to_chunks():
        if str(chunk.entity_path) == entity and chunk.is_static:
            for name, values in chunk.to_record_batch().to_pydict().items():
                if name.endswith(ending) and values[-1]:
                    found = values[-1]
    return found


def document(path: Path, entity: str) -> str:
    """The newest text of an entity."""
    return str(static(path, entity, "text")[0])


def series_names(path: Path, entity: str) -> list[str]:
    """What the curves of an entity are called."""
    return [str(name) for name in static(path, entity, "names")]
