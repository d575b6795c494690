"""Random materials that are ranked before a fit starts, each with its best amplitudes."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls

from biaxbayes.laws.law import Law
from biaxbayes.laws.materials import cauchy_stress, squared_stretches

MIN_MATRIX_FRACTION = 0.01
"""Smallest stiffness of the matrix to start from, over the peak stress, if prestretch is inferred.
Without a matrix the mounting stretch is almost unbounded, and a descent does not return."""
POISSON_RATIO = (0.2, 0.9)
"""Range of Poisson's ratio of a strip, -ln(width stretch) / ln(length stretch); isotropic: 0.5."""


class Screening(NamedTuple):
    """Readings on which starting points are ranked, and the random materials."""

    stretch: np.ndarray  # (n, 2), measured
    stress: np.ndarray  # (n, 2), kPa, of the section that the dimensions refer to
    free_side: np.ndarray  # (n,), the direction that carries no load and may be unmeasured, or -1
    with_mounting: bool  # draw mounting stretches; else they are one
    point: np.ndarray  # (p,), fit coordinates, used where they are not free
    free: np.ndarray  # indices of the free fit coordinates
    size: int  # number of materials
    # that stress per Cauchy stress, at total stretches (S, n, 2)
    factor: Callable[[np.ndarray], np.ndarray]


def screen(law: Law, data: Screening, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Many random materials with their best amplitudes, by nonnegative least squares.

    Returns fit coordinates (S, p), mounting stretches (S, 2), sums of squares (S,; infinite where
    a material cannot be evaluated), and features (S, k) in which chosen points have to differ.
    """
    mounting = np.ones((data.size, 2))
    if data.with_mounting:
        moved = rng.random((data.size, 1)) > 0.2
        mounting += np.abs(rng.normal(0.0, 0.03, mounting.shape)) * moved
    total = data.stretch * mounting[:, None]  # (S, n, 2)
    for side in np.unique(data.free_side[data.free_side >= 0]):
        # a guess of how a strip narrows, which its stress across it has to confirm
        own = data.free_side == side
        ratio = rng.uniform(*POISSON_RATIO, (data.size, 1))
        guess = total[:, own, 1 - side] ** -ratio
        total[:, own, side] = np.where(np.isnan(total[:, own, side]), guess, total[:, own, side])
    points, features = law.random_materials(data.size, total.max(axis=1), rng)
    others = np.setdiff1d(np.arange(points.shape[1]), data.free)
    points[:, others] = data.point[others]
    factor = data.factor(total)

    def load_at(points: np.ndarray) -> np.ndarray:
        constants = law.constants_from_fit(*points.T[:, :, None])
        stress = cauchy_stress(constants, *squared_stretches(total[..., 0], total[..., 1]))
        stress = np.stack(np.broadcast_arrays(*stress), axis=-1)  # (S, n, 2)
        return (stress * factor).reshape(data.size, -1)

    linear = [law.names.index(name) for name in law.amplitudes]
    free_amplitudes = [i for i in linear if i in data.free]
    base = points.copy()
    base[:, free_amplitudes] = 0.0
    # loads are linear in the amplitudes k: load = base + sum_i k_i load(k_i = 1, others 0)
    target = np.broadcast_to(data.stress, total.shape).reshape(data.size, -1) - load_at(base)
    columns = np.empty((*target.shape, len(free_amplitudes)))
    for k, i in enumerate(free_amplitudes):
        alone = points.copy()
        alone[:, linear] = 0.0
        alone[:, i] = 1.0
        columns[:, :, k] = load_at(alone)
    finite = np.isfinite(columns).all(axis=(1, 2)) & np.isfinite(target).all(axis=1)
    cost = np.full(data.size, np.inf)
    if free_amplitudes:
        size = np.maximum(np.sqrt((columns**2).sum(axis=1)), 1e-300)
        for s in np.flatnonzero(finite):
            best, residual_norm = nnls(columns[s] / size[s], target[s])
            points[s, free_amplitudes] = np.minimum(best / size[s], law.upper[free_amplitudes])
            cost[s] = residual_norm**2
    else:  # nnls refuses a matrix without columns
        cost[finite] = (target[finite] ** 2).sum(axis=1)
    if data.with_mounting and linear[0] in data.free:
        peak = float(np.abs(data.stress).max())
        points[:, linear[0]] = np.maximum(points[:, linear[0]], MIN_MATRIX_FRACTION * peak)
    return points, mounting, np.where(np.isfinite(points).all(axis=1), cost, np.inf), features
