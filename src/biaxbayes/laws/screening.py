"""Random materials that are ranked before a fit starts, each with its best amplitudes."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls

from biaxbayes.laws.law import Law

MATRIX_SHARE = 0.01
"""Of the peak stress: least stiffness of the matrix to start from where prestretch is inferred.
Without a matrix the mounted state is next to unbounded: a descent gets lost there."""


class Screening(NamedTuple):
    """Readings on which starting points are ranked, and what is drawn.

    Attributes
    ----------
    stretch, load : ndarray, shape (2, n)
        Measured stretches and loads.
    area : ndarray, shape (2,)
        Load per kPa.
    with_mounting : bool
        Draw mounting stretches; else they are one.
    point : ndarray, shape (p,)
        Values of the fixed coordinates of the fit.
    free : ndarray of int
        Indices of the others.
    size : int
        Number of materials.
    load_factor : callable
        Load per Cauchy stress at total stretches of shape (S, 2, n).
    """

    stretch: np.ndarray
    load: np.ndarray
    area: np.ndarray
    with_mounting: bool
    point: np.ndarray
    free: np.ndarray
    size: int
    load_factor: Callable[[np.ndarray], np.ndarray]


def screen(law: Law, data: Screening, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Many random materials with their best amplitudes.

    The stress is linear in the amplitudes, so that nonnegative least squares gives the best ones.

    Returns
    -------
    points : ndarray, shape (S, p)
        Coordinates of fits.
    mounting : ndarray, shape (S, 2)
        Mounting stretches of each: slightly above one, and one for a fifth of them.
    cost : ndarray, shape (S,)
        Sum of squares; infinite where a material cannot be evaluated.
    features : ndarray, shape (S, k)
        Coordinates in which chosen points have to differ.
    """
    mounting = np.ones((data.size, 2))
    if data.with_mounting:
        moved = rng.random((data.size, 1)) > 0.2
        mounting += np.abs(rng.normal(0.0, 0.03, mounting.shape)) * moved
    total = data.stretch * mounting[:, :, None]  # (S, 2, n)
    points, features = law.random_materials(data.size, total.max(axis=2), rng)
    fixed = np.setdiff1d(np.arange(points.shape[1]), data.free)
    points[:, fixed] = data.point[fixed]
    factor = data.load_factor(total)

    def load_at(given: np.ndarray) -> np.ndarray:
        constants = law.constants_at_point(*given.T[:, :, None])
        return (law.cauchy_of(constants, total[:, 0], total[:, 1]) * factor).reshape(data.size, -1)

    linear = [law.names.index(name) for name in law.amplitudes]
    unknown = [i for i in linear if i in data.free]
    base = points.copy()
    base[:, unknown] = 0.0
    target = np.broadcast_to(data.load, total.shape).reshape(data.size, -1) - load_at(base)
    columns = np.empty((*target.shape, len(unknown)))
    for k, i in enumerate(unknown):
        unit = points.copy()
        unit[:, linear] = 0.0
        unit[:, i] = 1.0
        columns[:, :, k] = load_at(unit)
    finite = np.isfinite(columns).all(axis=(1, 2)) & np.isfinite(target).all(axis=1)
    cost = np.full(data.size, np.inf)
    if unknown:
        size = np.maximum(np.sqrt((columns**2).sum(axis=1)), 1e-300)
        for s in np.flatnonzero(finite):
            best, misfit = nnls(columns[s] / size[s], target[s])
            points[s, unknown] = np.minimum(best / size[s], law.upper[unknown])
            cost[s] = misfit**2
    else:  # SciPy's solver takes no matrix without columns
        cost[finite] = (target[finite] ** 2).sum(axis=1)
    if data.with_mounting and linear[0] in data.free:
        peak = float(np.abs(data.load / data.area[:, None]).max())
        points[:, linear[0]] = np.maximum(points[:, linear[0]], MATRIX_SHARE * peak)
    return points, mounting, np.where(np.isfinite(points).all(axis=1), cost, np.inf), features
