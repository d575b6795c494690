"""Points tracked on the tissue by a camera, and the deformation gradient that they show."""

from __future__ import annotations

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.specimens.protocol import rest_rows
from biaxbayes.specimens.raw_table import RawTable

__all__ = ["deformation_gradient", "tracked_points"]

ENOUGH_TRACKED = 5


def tracked_points(table: RawTable, rows: np.ndarray, *, required: bool) -> np.ndarray | None:
    """Positions of the tracked points, shape (n, points, 2), NaN where one is lost."""
    pairs = []
    for number in range(1, 100):
        x, y = (table.by_stem(f"{axis}{number}") for axis in "xy")
        if x is None or y is None:
            break
        pairs.append((x, y))
    points = None
    if len(pairs) >= 3:
        points = np.stack(
            [
                np.column_stack([table.sparse_numbers(index, rows) for index in pair])
                for pair in pairs
            ],
            axis=1,
        )
        # Trackers write 0, 0 for a point that they lost.
        points[(points == 0.0).all(axis=2)] = np.nan
        if np.isfinite(points).all(axis=(1, 2)).sum() < ENOUGH_TRACKED:
            points = None
    if points is None and required:
        raise InputError(
            "no tracked points X1, Y1, X2, Y2, X3, Y3 ... in these rows",
            file=table.path,
            remedy=f"use --stretch-from rake; {table.found}",
        )
    return points


def deformation_gradient(points: np.ndarray, table: RawTable, rows: np.ndarray) -> np.ndarray:
    """In-plane deformation gradient of tracked points by least squares.

    The reference is the mean position over the rows at rest, which are found from a first
    estimate relative to the first row.

    Parameters
    ----------
    points : ndarray, shape (n, m, 2)
        Positions of m >= 3 points.
    table : RawTable
    rows : ndarray of int, shape (n,)
        For messages.

    Returns
    -------
    ndarray, shape (n, 2, 2)
    """
    reference = points[0]
    for _ in range(2):
        X = reference - reference.mean(axis=0)
        metric = X.T @ X
        if np.linalg.cond(metric) > 1e6:
            raise InputError(
                "the tracked points lie on one line",
                file=table.path,
                row=int(table.lines[rows[0]]),
                remedy="use --stretch-from rake",
            )
        x = points - points.mean(axis=1, keepdims=True)
        # x = F X for every point, in the least-squares sense: F = (sum x X^T) (sum X X^T)^-1
        gradient = np.einsum("nmi,mj->nij", x, X) @ np.linalg.inv(metric)
        resting = rest_rows(gradient[:, 0, 0], gradient[:, 1, 1])
        reference = points[:resting].mean(axis=0)
    return gradient
