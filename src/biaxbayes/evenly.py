"""Some of many rows or draws, spread over all of them."""

from __future__ import annotations

import numpy as np


def evenly_chosen(count: int, limit: int | None) -> np.ndarray:
    """Indices of at most ``limit`` of ``count`` items, spread over all, both ends included."""
    if limit is None or count <= limit:
        return np.arange(count)
    return np.unique(np.linspace(0, count - 1, limit).round().astype(int))


def evenly_spaced(count: int, limit: int | None) -> np.ndarray:
    """Every n-th of ``count`` indices and the last one, at most ``limit``."""
    if limit is None or count <= limit:
        return np.arange(count)
    step = -(-(count - 1) // (limit - 1))
    return np.union1d(np.arange(0, count - 1, step), [count - 1])
