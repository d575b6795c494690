r"""Amplitudes, which stresses are linear in: their best values, their end at zero, coordinates.

The terms of a law stand in for one another: their stresses S add up to that of the data, which is
straight in S and bent in ln S, while priors are wide in ln S down to S = 0. Roots lie between,
and what is uneven in S or in ln S is even in u:

    S = s L(u)^2,    L(u) = ln(1 + exp(u))

u is sqrt(S / s) for large S, and ln(S / s) / 2 near S = 0: no edge, and a tail that proposals
follow. Exponents q = k E*^2 at the reference state are held alike, as q = r L(v)^2.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from biaxbayes.compilation import inlined
from biaxbayes.laws.response import Material, MaterialResponse

if TYPE_CHECKING:
    from biaxbayes.laws.law import Law

__all__ = [
    "LOAD_NEARNESS",
    "LOAD_SHARE",
    "LOG_EXPONENT",
    "MATRIX_SHARE",
    "ROOT_WIDTH",
    "Screening",
    "amplitude_distances",
    "best_pair",
    "largest_at",
    "log_square",
    "log_stress_scale",
    "mounting_candidates",
    "root",
    "screened",
]


# --- random materials that are ranked before a fit starts: what all laws share of it -------------

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
    mounted : bool
        Whether the dimensions refer to the mounted state.
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
    mounted: bool
    with_mounting: bool
    point: np.ndarray
    free: np.ndarray
    size: int
    load_factor: Callable[[np.ndarray], np.ndarray]


def mounting_candidates(
    share: np.ndarray, rng: np.random.Generator, with_mounting: bool
) -> np.ndarray:
    """Mounting stretches, shape (S, 2): slightly above one, and one for a fifth of ``share``."""
    lm = np.ones((share.size, 2))
    if with_mounting:
        lm += np.abs(rng.normal(0.0, 0.03, lm.shape)) * (share[:, None] > 0.2)
    return lm


def best_pair(
    a: np.ndarray, b: np.ndarray, y: np.ndarray, known: list[Any]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nonnegative least squares y = u a + v b for many (a, b); a known u or v is kept.

    Parameters
    ----------
    a, b, y : ndarray, shape (S, n)
    known : list
        u and v, None where unknown.

    Returns
    -------
    u, v, cost : ndarray, shape (S,)
        Amplitudes and sums of squares.
    """
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


def screened(law: Law, data: Screening, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Random shapes of a law, each with its best amplitudes.

    The stress is linear in the amplitudes, so that nonnegative least squares gives the best ones.

    Parameters
    ----------
    law : Law
        With ``amplitudes``, the first of which is the stiffness of the matrix, and ``shapes``.
    data : Screening
    rng : numpy.random.Generator

    Returns
    -------
    points, mounting, cost, marks
        As :meth:`biaxbayes.laws.law.Law.screen` returns them.
    """
    from scipy.optimize import nnls

    lm = mounting_candidates(rng.random(data.size), rng, data.with_mounting)
    total = data.stretch * lm[:, :, None]  # (S, 2, n)
    points, marks = law.shapes(data.size, total.max(axis=2), rng)
    held = np.setdiff1d(np.arange(points.shape[1]), data.free)
    points[:, held] = data.point[held]
    factor = data.load_factor(total)
    linear = [law.names.index(name) for name in law.amplitudes]

    def load_of(given: np.ndarray) -> np.ndarray:
        constants = law.constants_at_point(*given.T[:, :, None])
        return (law.cauchy_of(constants, total[:, 0], total[:, 1]) * factor).reshape(data.size, -1)

    base = points.copy()
    base[:, [i for i in linear if i in data.free]] = 0.0
    wanted = np.broadcast_to(data.load, total.shape).reshape(data.size, -1) - load_of(base)
    sought = [i for i in linear if i in data.free]
    unit = []
    for i in sought:
        one = points.copy()
        one[:, linear] = 0.0
        one[:, i] = 1.0
        unit.append(load_of(one))
    columns = np.stack(unit, axis=-1) if unit else np.empty((*wanted.shape, 0))
    size = np.maximum(np.sqrt((columns**2).sum(axis=1)), 1e-300)
    cost = np.full(data.size, np.inf)
    fine = np.isfinite(columns).all(axis=(1, 2)) & np.isfinite(wanted).all(axis=1)
    if sought:
        scaled, best, miss = columns / size[:, None, :], np.zeros(size.shape), np.empty(data.size)
        for s in np.flatnonzero(fine):
            best[s], miss[s] = nnls(scaled[s], wanted[s])
        points[np.ix_(fine, sought)] = np.minimum(best / size, law.upper[sought])[fine]
        cost[fine] = miss[fine] * miss[fine]
    else:  # SciPy's solver takes no matrix without columns
        cost[fine] = (wanted[fine] ** 2).sum(axis=1)
    if data.with_mounting and linear[0] in data.free:
        peak = float(np.abs(data.load / data.area[:, None]).max())
        points[:, linear[0]] = np.maximum(points[:, linear[0]], MATRIX_SHARE * peak)
    return points, lm, np.where(np.isfinite(points).all(axis=1), cost, np.inf), marks


# --- how near to a physical edge counts as near: what laws share of it ---------------------------

LOAD_SHARE = 0.05
"""Of the stress at the largest stretch: what carries less is near to absent."""
LOAD_NEARNESS = f"where they carry less than {LOAD_SHARE:g} of the stress at the largest stretch"
"""The same in words, behind the names of amplitudes."""
LOWEST = 0.05
"""Draws from which a distance is taken: an amplitude trades with its exponent, so that a small one
may carry as much as a large one does."""


def largest_at(quantity: Callable[[Any, Any, Any], Any], tops: Sequence[np.ndarray]) -> np.ndarray:
    """Largest value of each draw at some total stretches, shape (n,).

    Parameters
    ----------
    quantity : callable
        Of squared stretches X, Y, Z of shape (n, 1); not negative.
    tops : sequence of ndarray, shape (n, 2)
    """
    largest = np.zeros(1)
    for top in tops:
        X, Y = top[:, :1] ** 2, top[:, 1:] ** 2
        largest = np.maximum(largest, np.asarray(quantity(X, Y, 1.0 / (X * Y)))[:, 0])
    return largest


def amplitude_distances(material: MaterialResponse, tops: Sequence[np.ndarray]) -> dict[str, float]:
    """Amplitudes that carry :data:`LOAD_SHARE` of the stress at the largest stretches.

    Medians over the draws in which the amplitude is smallest.

    Parameters
    ----------
    material : Material
        Of n draws; stresses are linear in the amplitudes of its law.
    tops : sequence of ndarray, shape (n, 2)
        Largest total stretches of each protocol.
    """
    law = material.law
    places = [law.names.index(name) for name in law.amplitudes]
    out = {}
    for i in places:
        alone = list(material.theta)
        for j in places:
            alone[j] = np.full_like(alone[j], float(i == j))
        # the amplitude that would carry all, in the protocol in which it carries most
        all_of_it = np.min(
            [_stress(material, top) / _stress(Material(law, tuple(alone)), top) for top in tops],
            axis=0,
        )
        size = np.broadcast_to(np.ravel(material.theta[i]), all_of_it.shape)
        smallest = np.argsort(size, kind="stable")[: max(1, round(LOWEST * size.size))]
        out[law.names[i]] = LOAD_SHARE * float(np.median(all_of_it[smallest]))
    return out


def _stress(material: MaterialResponse, top: np.ndarray) -> np.ndarray:
    """Sum of both Cauchy stresses of each draw, kPa, never zero."""
    x, y = material.cauchy(top[:, :1], top[:, 1:])
    return np.maximum((x + y)[:, 0], 1e-12)


# --- sampling coordinates of stiffnesses and exponents that may vanish: roots with a log tail ----

_STRESS_SHARE, _EXPONENT = 0.01, 0.1
"""s over the largest stress of a specimen, and r; tuned on an aorta under five protocols."""
LOG_EXPONENT = math.log(_EXPONENT)
ROOT_WIDTH = 1.0
"""Of dispersed starts, in u and v."""
_LOG_2 = math.log(2.0)


def log_stress_scale(peak_kPa: float) -> float:
    """Log of s (kPa) of a specimen, by its largest stress."""
    return math.log(_STRESS_SHARE * peak_kPa)


@inlined
def log_square(u):
    """(ln L^2, ln of its derivative by u)."""
    tail = np.log1p(np.exp(-abs(u)))
    log_L = u if u < -30.0 else np.log(max(u, 0.0) + tail)
    # d ln L^2 / du = 2 e^u / (1 + e^u) / L
    return 2.0 * log_L, _LOG_2 + min(u, 0.0) - tail - log_L


def root(log_squared: np.ndarray) -> np.ndarray:
    """The u of ln L^2; inverse of :func:`log_square`."""
    L = np.exp(0.5 * log_squared)
    # e^u = e^L - 1
    return L + np.log(-np.expm1(-L))
