"""Where deterministic fits start: many random materials, screened in one vectorised sweep.

For a given (k2, t, kappa) and mounting stretch the stress is linear in C1 and k1, so the best
pair follows from a nonnegative least-squares problem of two unknowns, in closed form. The
exponent is drawn through q = k2 E*^2 at the largest stretch, which is what makes a curve more
or less bent whatever the strain range.
"""

from __future__ import annotations

import numpy as np

from biaxbayes.inference.readings import Readings

__all__ = ["LOWER", "UPPER", "screened_points"]

LOWER = np.zeros(5)
UPPER = np.array([1e5, 1e6, 1e4, 1.0, 1.0 / 3.0])
"""Bounds of (C1 kPa, k1 kPa, k2, cos^2 alpha, kappa)."""

ROWS = 24  # of each protocol, enough to rank starting points
CANDIDATES = 512
MATRIX_SHARE = 0.01  # of the peak stress: least C1 to start from where prestretch is inferred


def screened_points(
    data: Readings,
    count: int,
    rng: np.random.Generator,
    *,
    point: np.ndarray,
    free: np.ndarray,
    with_mounting: bool,
) -> tuple[np.ndarray, np.ndarray]:
    """The most promising of many random materials, kept apart from one another.

    Parameters
    ----------
    data : Readings
    count : int
    rng : numpy.random.Generator
    point : ndarray, shape (5,)
        Values of the fixed ones among (C1, k1, k2, t, kappa).
    free : ndarray of int
        Indices of the others.
    with_mounting : bool
        Draw mounting stretches and let the mounting reading count; else they are one.

    Returns
    -------
    points : ndarray, shape (count, 5)
    mounting : ndarray, shape (count, 2)
        One pair of mounting stretches each, for all groups.
    """
    few = data.thinned(ROWS)
    draws = _candidates(rng, with_mounting)
    k2, t, kappa, lm = draws
    stretch, load = few.stretch, few.load
    if with_mounting:
        stretch = np.hstack([np.ones_like(data.mounting_load), stretch])
        load = np.hstack([data.mounting_load, load])
    total = stretch * lm[:, :, None]  # (S, 2, n)
    t = np.where(3 in free, t, point[3])[:, None]
    kappa = np.where(4 in free, kappa, point[4])[:, None]
    with np.errstate(all="ignore"):
        matrix, fibre, E = _bases(t, kappa, total)
        top = np.maximum((E * E).max(axis=1), 1e-12)
        k2 = np.where(2 in free, np.minimum(k2 / top, UPPER[2]), point[2])
        # exp(k2 (E^2 - E*^2)): normalised at the top, so that nothing overflows
        growth = np.exp(k2[:, None] * (E * E - top[:, None]))
        fibre = fibre * (4.0 * E * growth)[:, None, :]
        log_peak = np.minimum(k2 * top, 600.0)
        # loads: A0 s / (l lm) (unloaded) or Am s / l (mounted)
        factor = data.area[:, None] / (stretch if data.mounted else total)
        known = [
            None if i in free else v for i, v in ((0, point[0]), (1, point[1] * np.exp(log_peak)))
        ]
        C1, K, cost = _two_unknowns(
            (matrix * factor).reshape(len(t), -1),
            (fibre * factor).reshape(len(t), -1),
            np.broadcast_to(load, total.shape).reshape(len(t), -1),
            known,
        )
        k1 = (
            np.clip(K * np.exp(-log_peak), 0.0, UPPER[1])
            if 1 in free
            else np.full(k2.shape, point[1])
        )
    if with_mounting and 0 in free:
        # Without a matrix the mounted state is next to unbounded, and a descent gets lost there.
        C1 = np.maximum(C1, MATRIX_SHARE * float(np.abs(load / data.area[:, None]).max()))
    points = np.column_stack([np.clip(C1, 0.0, UPPER[0]), k1, k2, t[:, 0], kappa[:, 0]])
    cost = np.where(np.isfinite(cost) & np.isfinite(points).all(axis=1), cost, np.inf)
    marks = np.column_stack([0.3 * log_peak, t[:, 0], 3.0 * kappa[:, 0]])
    chosen = _spread_out(cost, marks, count)
    return points[chosen], lm[chosen]


def _candidates(rng: np.random.Generator, with_mounting: bool):
    """Random q, t, kappa and mounting stretches, with the corners of the box among them."""
    u = rng.random((CANDIDATES, 4))
    q = 10.0 ** (-2.0 + 3.5 * u[:, 0])
    t = np.cos(0.5 * np.pi * u[:, 1]) ** 2
    kappa = u[:, 2] / 3.0
    q[::9] = 0.0
    t[1::7], t[2::7] = 0.0, 1.0
    kappa[3::5] = 0.0
    lm = np.ones((CANDIDATES, 2))
    if with_mounting:
        lm += np.abs(rng.normal(0.0, 0.03, (CANDIDATES, 2))) * (u[:, 3:] > 0.2)
    return q, t, kappa, lm


def _bases(t, kappa, total):
    """Stress of unit C1 (S, 2, n), the geometric factor gk of the fibres and their strain E."""
    ax, ay = total[:, 0] ** 2, total[:, 1] ** 2
    az = 1.0 / (ax * ay)
    spread = 1.0 - 3.0 * kappa
    Hx, Hy, Hz = kappa + spread * t, kappa + spread * (1.0 - t), kappa
    E = Hx * ax + Hy * ay + Hz * az - 1.0
    matrix = 2.0 * np.stack([ax - az, ay - az], axis=1)
    fibre = np.stack([Hx * ax - Hz * az, Hy * ay - Hz * az], axis=1)
    return matrix, fibre, E


def _two_unknowns(a, b, y, known):
    """Nonnegative least squares y = u a + v b for many (a, b); a known u or v is kept."""
    u_known, v_known = known
    aa, bb, ab = (a * a).sum(1), (b * b).sum(1), (a * b).sum(1)
    ya, yb, yy = (y * a).sum(1), (y * b).sum(1), (y * y).sum(1)

    def cost(u, v):
        return yy - 2.0 * (u * ya + v * yb) + u * u * aa + 2.0 * u * v * ab + v * v * bb

    zero = np.zeros_like(aa)
    if u_known is not None and v_known is not None:
        u, v = zero + u_known, zero + v_known
        return u, v, cost(u, v)
    if u_known is not None:
        v = np.maximum((yb - u_known * ab) / bb, 0.0)
        return zero + u_known, v, cost(u_known, v)
    if v_known is not None:
        u = np.maximum((ya - v_known * ab) / aa, 0.0)
        return u, zero + v_known, cost(u, v_known)
    determinant = aa * bb - ab * ab
    u, v = (ya * bb - yb * ab) / determinant, (yb * aa - ya * ab) / determinant
    u_alone, v_alone = np.maximum(ya / aa, 0.0), np.maximum(yb / bb, 0.0)
    matrix_alone = cost(u_alone, zero) <= cost(zero, v_alone)
    inside = (u >= 0.0) & (v >= 0.0) & (determinant > 1e-14 * aa * bb)
    u = np.where(inside, u, np.where(matrix_alone, u_alone, 0.0))
    v = np.where(inside, v, np.where(matrix_alone, 0.0, v_alone))
    return u, v, cost(u, v)


def _spread_out(cost, marks, count) -> np.ndarray:
    """Indices of low costs, no two close to each other while there is a choice."""
    order = np.argsort(cost, kind="stable")
    chosen: list[int] = []
    for distance in (0.25, 0.1, 0.0):
        for i in order:
            if len(chosen) == count:
                return np.array(chosen, dtype=int)
            near = [j for j in chosen if np.abs(marks[i] - marks[j]).max() < distance]
            if i not in chosen and not near:
                chosen.append(int(i))
    return np.array(chosen, dtype=int)
