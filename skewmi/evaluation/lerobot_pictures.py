"""Pictures of a LeRobotDataset: PNG in the frames' rows, and their statistics."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from skewmi.evaluation.lerobot_statistics import Statistics, statistics

if TYPE_CHECKING:
    import pyarrow as pa

Picture = NDArray[np.uint8]

_EVERY = 8
"""Pixels between two that count for statistics, each way."""


@dataclass(frozen=True)
class Pictures:
    """What they are called, and their size.

    Attributes:
        camera: Whose they are.
        width, height: Pixels.
    """

    camera: str
    width: int
    height: int

    @property
    def name(self) -> str:
        """Of the feature."""
        return f"observation.images.{self.camera}"

    def as_mapping(self) -> dict[str, Any]:
        """As `info.json` has it."""
        names = ["height", "width", "channels"]
        return {"dtype": "image", "shape": [self.height, self.width, 3], "names": names}

    def array(self, pictures: Sequence[Picture]) -> pa.Array:
        """The column: files in memory, with no path."""
        import pyarrow as pa
        from PIL import Image

        rows = []
        for picture in pictures:
            file = io.BytesIO()
            Image.fromarray(picture).save(file, format="png")
            rows.append({"bytes": file.getvalue(), "path": None})
        return pa.array(rows, type=pa.struct([("bytes", pa.binary()), ("path", pa.string())]))

    def sampled(self, pictures: Sequence[Picture]) -> Picture:
        """Every eighth pixel of every eighth row. Shape (n, rows, columns, 3)."""
        return np.stack([picture[::_EVERY, ::_EVERY] for picture in pictures])

    def statistics(self, samples: Picture) -> Statistics:
        """Per colour, of values in [0, 1]; each number alone in two lists, as channels are first.

        Args:
            samples: Shape (n, rows, columns, 3).
        """
        found = statistics(samples.reshape(-1, 3) / 255.0)
        count = found.pop("count")
        shaped: Statistics = {k: [[[v]] for v in values] for k, values in found.items()}
        return {**shaped, "count": [len(samples)] if count else [0]}
