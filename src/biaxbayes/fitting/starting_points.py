"""Starting points of deterministic fits, and their fixed parameters.

Many random materials are ranked, each with its best amplitudes, and the best of them that differ
from one another are chosen.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from scipy.optimize import nnls

from biaxbayes.errors import InputError
from biaxbayes.laws.law import Law
from biaxbayes.laws.materials import cauchy_stress, squared_stretches
from biaxbayes.specimens.rows import MeasuredRows

SCREENING_ROWS = 24  # of each protocol, enough to rank starting points
CANDIDATES = 512
MIN_MATRIX_FRACTION = 0.01
"""Smallest stiffness of the matrix to start from, over the peak stress, if prestretch is inferred.
Without a matrix the mounting stretch is almost unbounded, and a descent does not return."""
POISSON_RATIO = (0.2, 0.9)
"""Range of Poisson's ratio of a strip, -ln(width stretch) / ln(length stretch); isotropic: 0.5."""


@np.errstate(all="ignore")
def screened_points(
    data: MeasuredRows,
    count: int,
    rng: np.random.Generator,
    law: Law,
    point: np.ndarray,
    free: np.ndarray,
    *,
    with_mounting: bool,
) -> tuple[np.ndarray, np.ndarray]:
    """The best random materials (count, p) that differ, with mounting stretches (count, 2)."""
    # mounting readings first
    rows, states = data.chosen(SCREENING_ROWS), len(data.piece_of_state) * with_mounting
    stretch = np.vstack([np.ones((states, 2)), rows.stretch])
    load = np.vstack([data.mounting_load[:states], rows.load])
    piece = np.concatenate([data.piece_of_state[:states], rows.piece])
    for i, of_piece in enumerate(data.pieces):
        own = piece == i
        stresses = of_piece.experiment.stresses(stretch[own], load[own])
        if stresses is None:  # in kPa of the unloaded or mounted section
            load[own] /= of_piece.area
        else:  # P = s / l, none across free sides
            load[own] = np.nan_to_num(stresses / stretch[own])
    mounting = np.ones((CANDIDATES, 2))
    if with_mounting:
        moved = rng.random((CANDIDATES, 1)) > 0.2
        mounting += np.abs(rng.normal(0.0, 0.03, mounting.shape)) * moved
    total = stretch * mounting[:, None]  # (S, n, 2)
    free_side = np.array(
        [-1 if p.experiment.free_side is None else p.experiment.free_side for p in data.pieces]
    )[piece]
    for side in np.unique(free_side[free_side >= 0]):
        # a guess of how a strip narrows, which its stress across it has to confirm
        own = free_side == side
        ratio = rng.uniform(*POISSON_RATIO, (CANDIDATES, 1))
        guess = total[:, own, 1 - side] ** -ratio
        total[:, own, side] = np.where(np.isnan(total[:, own, side]), guess, total[:, own, side])
    points, features = law.random_materials(CANDIDATES, total.max(axis=1), rng)
    others = np.setdiff1d(np.arange(points.shape[1]), free)
    points[:, others] = point[others]
    # per kPa of Cauchy stress, P = s / (l lm) of the unloaded section, s / l of the mounted one
    unloaded = np.array([p.geometry != "mounted" for p in data.pieces])[piece, None]
    factor = 1.0 / np.where(unloaded, total, np.nan_to_num(stretch, nan=1.0))
    cost = _best_amplitudes(law, points, total, factor, load, free)
    matrix = law.names.index(law.amplitudes[0])
    if with_mounting and matrix in free:
        least = MIN_MATRIX_FRACTION * float(np.abs(load).max())
        points[:, matrix] = np.maximum(points[:, matrix], least)
    cost = np.where(np.isfinite(points).all(axis=1), cost, np.inf)
    chosen = _distinct_points(cost, features, count)
    return points[chosen], mounting[chosen]


def _best_amplitudes(
    law: Law,
    points: np.ndarray,
    total: np.ndarray,
    factor: np.ndarray,
    stress: np.ndarray,
    free: np.ndarray,
) -> np.ndarray:
    """Give materials (S, p) their best free amplitudes in place; sums of squares (S,).

    By nonnegative least squares of stresses (n, 2), which are Cauchy stresses at total stretches
    (S, n, 2) times a factor; infinite where a material cannot be evaluated.
    """

    def load_at(points: np.ndarray) -> np.ndarray:
        constants = law.constants_from_fit(*points.T[:, :, None])
        stress = cauchy_stress(constants, *squared_stretches(total[..., 0], total[..., 1]))
        stress = np.stack(np.broadcast_arrays(*stress), axis=-1)  # (S, n, 2)
        return (stress * factor).reshape(len(points), -1)

    linear = [law.names.index(name) for name in law.amplitudes]
    free_amplitudes = [i for i in linear if i in free]
    base = points.copy()
    base[:, free_amplitudes] = 0.0
    # loads are linear in the amplitudes k: load = base + sum_i k_i load(k_i = 1, others 0)
    target = np.broadcast_to(stress, total.shape).reshape(len(points), -1) - load_at(base)
    columns = np.empty((*target.shape, len(free_amplitudes)))
    for k, i in enumerate(free_amplitudes):
        alone = points.copy()
        alone[:, linear] = 0.0
        alone[:, i] = 1.0
        columns[:, :, k] = load_at(alone)
    finite = np.isfinite(columns).all(axis=(1, 2)) & np.isfinite(target).all(axis=1)
    cost = np.full(len(points), np.inf)
    if not free_amplitudes:  # nnls refuses a matrix without columns
        cost[finite] = (target[finite] ** 2).sum(axis=1)
        return cost
    size = np.maximum(np.sqrt((columns**2).sum(axis=1)), 1e-300)
    for s in np.flatnonzero(finite):
        best, residual_norm = nnls(columns[s] / size[s], target[s])
        points[s, free_amplitudes] = np.minimum(best / size[s], law.upper[free_amplitudes])
        cost[s] = residual_norm**2
    return cost


def _distinct_points(cost: np.ndarray, features: np.ndarray, count: int) -> np.ndarray:
    """Indices of low costs, no two close to each other while there is a choice."""
    order = np.argsort(cost, kind="stable")
    chosen: list[int] = []
    for distance in (0.25, 0.1, 0.0):
        for i in order:
            apart = (np.abs(features[i] - features[j]).max(initial=0.0) for j in chosen)
            if len(chosen) < count and i not in chosen and not any(d < distance for d in apart):
                chosen.append(int(i))
    return np.array(chosen, dtype=int)


def fixed_and_free(fixed: Mapping[str, float] | None, law: Law) -> tuple[np.ndarray, np.ndarray]:
    """Fixed values as coordinates of the fit, and the indices of the free ones."""
    values = np.zeros(len(law.names))
    given = {law.known_name(name): value for name, value in dict(fixed or {}).items()}
    for name, value in given.items():
        if name not in law.names:
            raise InputError(
                f"unknown parameter {name!r} of the law {law.name}",
                remedy=f"one of {', '.join(law.names)}",
            )
        p = law.parameter(name)
        low, high = p.low, min(p.high, p.largest)
        if not (math.isfinite(value) and low <= value <= high + 1e-12):
            raise InputError(
                f"{name} = {value:g} is out of range",
                remedy=f"{name} lies between {low:g} and {high:g}{p.unit_words()}",
            )
        values[law.names.index(name)] = min(value, high)
    law.check_condition(given)
    point = np.where([n in given for n in law.names], law.to_fit_coordinates(tuple(values)), 0.0)
    return point, np.array([i for i, name in enumerate(law.names) if name not in given], dtype=int)
