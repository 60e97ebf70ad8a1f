"""Statistics of columns, as a LeRobotDataset keeps them for normalisation."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

QUANTILES = (0.01, 0.10, 0.50, 0.90, 0.99)

Statistics = dict[str, list[Any]]


def statistics(rows: NDArray[Any]) -> Statistics:
    """Of each column: min, max, mean, std and quantiles as q01 to q99; and the count of rows.

    Args:
        rows: At least one. Shape (n, size).

    Returns:
        Lists of `size` numbers; `count` has one.
    """
    values = np.asarray(rows, dtype=np.float64)
    found: Statistics = {
        "min": values.min(axis=0).tolist(),
        "max": values.max(axis=0).tolist(),
        "mean": values.mean(axis=0).tolist(),
        "std": values.std(axis=0).tolist(),
        "count": [len(values)],
    }
    for share, quantile in zip(QUANTILES, np.quantile(values, QUANTILES, axis=0), strict=True):
        found[f"q{round(100 * share):02d}"] = quantile.tolist()
    return found
