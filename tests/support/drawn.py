"""What a Rerun file has drawn."""

from __future__ import annotations

from pathlib import Path

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
