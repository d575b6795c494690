"""Prior, mounted state and model loads of many walkers in one compiled call.

A walker's coordinates are spread over *slots*, one entry per parameter, whether sampled, fixed or
tied to another: the parameters of the law first, then the noise sd and measured dimensions, then
two per mounted state. They are turned into material and mounted state, and the readings less the
model's loads are the residuals that a likelihood takes (:mod:`biaxbayes.model.misfit`,
:mod:`biaxbayes.model.readings`). The stress is that of the law (:mod:`biaxbayes.laws.materials`),
the mounted state and the load law those of :mod:`biaxbayes.mechanics.mounting`; one kernel is
compiled for each law. In NumPy :mod:`biaxbayes.forward` does the same.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from biaxbayes.compilation import WITHIN, compiled, inlined
from biaxbayes.laws.coordinates import constants_from_theta, to_slots
from biaxbayes.laws.materials import cauchy_stress
from biaxbayes.mechanics.mounting import (
    LOG_HIGH,
    LOG_LOW,
    balance,
    load_per_stress,
    log_change_of_variables,
    sections,
    solve_balance,
)
from biaxbayes.model.priors import FIXED, NORMAL, NORMAL_NATURAL, UNIFORM
from biaxbayes.parameters import DIMENSION_PARAMETERS

# Slots after those of the law: noise sd and dimensions, then two per mounted state.
NOISE_SLOTS = 1
DIMENSION_SLOTS = len(DIMENSION_PARAMETERS)
EDGE_X, EDGE_Y, THICKNESS, OFFSET_X, OFFSET_Y = range(DIMENSION_SLOTS)

# What the slots of a mounted state hold: nothing (lm = 1), forces p0 (lm is their root), or lm.
MODE_UNSTRETCHED, MODE_FORCE, MODE_STRETCH = 0, 1, 2

# Why a density is zero; counted for the diagnostics.
INSIDE, OUT_OF_RANGE, NO_ROOT, OVERFLOW = range(4)
REASONS = ("out_of_range", "no_mounting_root", "overflow")
"""Names of the reasons, in the order of the counters, which begin with the points inside."""


class Problem(NamedTuple):
    """Everything the compiled density needs; arrays are float64 unless stated.

    Attributes
    ----------
    slot : int64 ndarray, shape (s,)
        Index of each slot in a walker's coordinates, or -1 where the slot is fixed.
    fixed : ndarray, shape (s,)
        Value of a fixed slot, on the scale of the slot (logs for positive quantities).
    tie : int64 ndarray, shape (s,); tie_log_factor : ndarray, shape (s,)
        A tied slot takes the value of another plus a log factor; -1 where free.
    transform : NamedTuple
        Constants of the transform between slots and sampling coordinates; its type picks the law.
    size : int
        Number of the law's slots.
    logarithmic : bool ndarray, shape (s,)
        Slots that hold logs.
    per_unit : ndarray, shape (s,)
        Natural units in one unit of the slot: degrees per radian, else 1.
    prior_kind : int64 ndarray, shape (s,); prior : ndarray, shape (s, 5)
        Kind, and location, scale, lower, upper, log normaliser of each slot's prior. For
        mounting slots the prior is on the mounting stretch.
    determinant : bool
        Whether the change of variables from mounting force to mounting stretch is included
        (always, except in tests).
    mounting : ndarray, shape (m, 2)
        Mounting loads that were read.
    reads : bool
        Whether they are readings with an error, the first of the vector of readings.
    area : ndarray, shape (2,)
    start : int64 ndarray, shape (p + 1,); mount : int64 ndarray, shape (p,)
        First row of each protocol; the mounted state it belongs to.
    ilx, ily, X, Y, Z : ndarray, shape (n,)
        Reciprocals of the measured stretches, and their squares.
    fx, fy : ndarray, shape (n,)
        Loads after the mounted state, in the unit of the file.
    reading_of : int64 ndarray, shape (n, 2); share : ndarray, shape (n,)
        The reading that a row belongs to, in x and y, and its weight in the mean.
    readings : int
        Length of the vector of readings.
    """

    slot: np.ndarray
    fixed: np.ndarray
    tie: np.ndarray
    tie_log_factor: np.ndarray
    transform: Any
    size: int
    logarithmic: np.ndarray
    per_unit: np.ndarray
    prior_kind: np.ndarray
    prior: np.ndarray
    mounting_mode: int
    mounted: bool
    determinant: bool
    mounting: np.ndarray
    reads: bool
    area: np.ndarray
    start: np.ndarray
    mount: np.ndarray
    ilx: np.ndarray
    ily: np.ndarray
    X: np.ndarray
    Y: np.ndarray
    Z: np.ndarray
    fx: np.ndarray
    fy: np.ndarray
    reading_of: np.ndarray
    share: np.ndarray
    readings: int


# In the decorators below ``error_model`` is numba's: x / 0 is infinite, as in NumPy.


@inlined
def log_prior(kind, row, x):
    """Log prior density of one slot at x, or -inf outside its range."""
    location, scale, low, high, log_norm = row[0], row[1], row[2], row[3], row[4]
    if kind == FIXED:
        return 0.0
    if not (low <= x <= high):
        return -np.inf
    if kind == NORMAL:
        # ln N(x | location, scale)
        z = (x - location) / scale
        return log_norm - 0.5 * z * z
    if kind == UNIFORM:
        return log_norm
    if kind == NORMAL_NATURAL:
        # ln N(exp(x) | location, scale) + x,  as d exp(x) / dx = exp(x)
        z = (np.exp(x) - location) / scale
        return log_norm - 0.5 * z * z + x
    # UNIFORM_NATURAL: exp(x) is uniform
    return log_norm + x


@inlined
def _mounted_state(problem, value, constants, m, area_x, area_y, residual):
    """(ln lm_x, ln lm_y, log density, reason) of mounted state m; area_x, area_y its sections.

    The two slots of a mounted state hold its forces in mode ``MODE_FORCE`` and its stretches in
    mode ``MODE_STRETCH``; their prior is that of the stretches in both, and they end as stretches.
    Residuals of the mounting readings are written.
    """
    if problem.mounting_mode == MODE_UNSTRETCHED:
        return 0.0, 0.0, 0.0, INSIDE
    o = problem.size + NOISE_SLOTS
    i = o + DIMENSION_SLOTS + 2 * m
    if problem.mounting_mode == MODE_FORCE:
        px, py = value[i], value[i + 1]
        if problem.slot[i] < 0:  # exact: the reading less the offset of the cell
            px, py = px - value[o + OFFSET_X], py - value[o + OFFSET_Y]
        ok, x, y, jxx, jxy, jyy = solve_balance(
            constants, px / area_x, py / area_y, problem.mounted
        )
        if not ok:
            return x, y, -np.inf, NO_ROOT
        logp = 0.0
        if problem.determinant:
            # ln |det d p0 / d lm|, p0 in the unit of the file
            change = log_change_of_variables(x, y, jxx, jxy, jyy, problem.mounted)
            logp -= change + np.log(area_x * area_y)
    else:
        if not (value[i] > 0.0 and value[i + 1] > 0.0):
            return 0.0, 0.0, -np.inf, OUT_OF_RANGE
        x, y = np.log(value[i]), np.log(value[i + 1])
        if not (LOG_LOW < x < LOG_HIGH and LOG_LOW < y < LOG_HIGH):
            return x, y, -np.inf, NO_ROOT
        rx, ry, jxx, jxy, jyy = balance(constants, 0.0, 0.0, problem.mounted, x, y)
        px = rx * load_per_stress(area_x, 1.0, np.exp(x), problem.mounted)
        py = ry * load_per_stress(area_y, 1.0, np.exp(y), problem.mounted)
        if not problem.mounted:
            # d(s - p0 lm) / d ln lm at fixed p0 = s / lm: the dead load takes s off the diagonal
            jxx, jyy = jxx - rx, jyy - ry
        if not (jxx > 0.0 and jxx * jyy - jxy * jxy > 0.0):
            return x, y, -np.inf, NO_ROOT
        logp = 0.0
    lx, ly = np.exp(x), np.exp(y)
    logp += log_prior(problem.prior_kind[i], problem.prior[i], lx)
    logp += log_prior(problem.prior_kind[i + 1], problem.prior[i + 1], ly)
    if problem.reads:
        residual[2 * m] = problem.mounting[m, 0] - px - value[o + OFFSET_X]
        residual[2 * m + 1] = problem.mounting[m, 1] - py - value[o + OFFSET_Y]
    value[i], value[i + 1] = lx, ly
    return x, y, logp, INSIDE


@njit(
    error_model="numpy",
    nogil=True,
    fastmath={"reassoc", "contract", "arcp", "nsz"},
    **WITHIN,
)
def _curves(problem, value, constants, p, x, y, area_x, area_y, residual):
    """Add the residuals of protocol p, given its mounted state; their sum, to see an overflow."""
    first, last = problem.start[p], problem.start[p + 1]
    o = problem.size + NOISE_SLOTS
    mx, my = np.exp(2.0 * x), np.exp(2.0 * y)
    mz = 1.0 / (mx * my)
    per_stress_x = load_per_stress(area_x, 1.0, np.exp(x), problem.mounted)
    per_stress_y = load_per_stress(area_y, 1.0, np.exp(y), problem.mounted)
    ox, oy = value[o + OFFSET_X], value[o + OFFSET_Y]
    total = 0.0
    # q = A s / (l lm) or A s / l, as in biaxbayes.forward; l lm squared is m X
    for j in range(first, last):
        stress_x, stress_y = cauchy_stress(
            constants, mx * problem.X[j], my * problem.Y[j], mz * problem.Z[j]
        )
        rx = problem.fx[j] - ox - per_stress_x * problem.ilx[j] * stress_x
        ry = problem.fy[j] - oy - per_stress_y * problem.ily[j] * stress_y
        residual[problem.reading_of[j, 0]] += problem.share[j] * rx
        residual[problem.reading_of[j, 1]] += problem.share[j] * ry
        total += rx * rx + ry * ry
    return total


@njit(error_model="numpy", nogil=True, **WITHIN)
def _walker(problem, u, value, residual):
    """(log prior with the changes of variables, log Jacobian of the coordinates, reason).

    The values and residuals of :class:`Evaluation` are written into ``value`` and ``residual``.
    """
    size = problem.size
    o = size + NOISE_SLOTS
    for i in range(problem.slot.size):
        value[i] = u[problem.slot[i]] if problem.slot[i] >= 0 else problem.fixed[i]
    total = jacobian = to_slots(problem.transform, value)
    for i in range(size):
        if problem.tie[i] >= 0:
            value[i] = value[problem.tie[i]] + problem.tie_log_factor[i]
    if not np.isfinite(total):
        return -np.inf, jacobian, OUT_OF_RANGE
    for i in range(o + DIMENSION_SLOTS):
        x = value[i] * problem.per_unit[i]
        total += log_prior(problem.prior_kind[i], problem.prior[i], x)
    if not np.isfinite(total):
        return -np.inf, jacobian, OUT_OF_RANGE
    for i in range(o + DIMENSION_SLOTS):
        if problem.logarithmic[i]:
            value[i] = np.exp(value[i])
    for i in range(size):
        if not np.isfinite(value[i]):
            return -np.inf, jacobian, OVERFLOW
    constants = constants_from_theta(problem.transform, value)
    area_x, area_y = sections(
        problem.area, value[o + EDGE_X], value[o + EDGE_Y], value[o + THICKNESS]
    )
    if not (area_x > 0.0 and area_y > 0.0):
        return -np.inf, jacobian, OUT_OF_RANGE
    residual[:] = 0.0
    done = -1
    x = y = 0.0
    for p in range(problem.mount.size):
        if problem.mount[p] != done:
            done = problem.mount[p]
            x, y, logp, reason = _mounted_state(
                problem, value, constants, done, area_x, area_y, residual
            )
            total += logp
            if not np.isfinite(total):
                return -np.inf, jacobian, reason if reason != INSIDE else OUT_OF_RANGE
        squares = _curves(problem, value, constants, p, x, y, area_x, area_y, residual)
        if not np.isfinite(squares):
            return -np.inf, jacobian, OVERFLOW
    return total, jacobian, INSIDE


@compiled(error_model="numpy", nogil=True)
def _walkers(problem, u, counts):
    """The arrays of :class:`Evaluation` for each walker; counts the reasons."""
    n = u.shape[0]
    total, jacobian = np.empty(n), np.empty(n)
    values = np.empty((n, problem.slot.size))
    residual = np.zeros((n, problem.readings))
    for i in range(n):
        total[i], jacobian[i], reason = _walker(problem, u[i], values[i], residual[i])
        counts[reason] += 1
    return total, residual, jacobian, values


class Evaluation(NamedTuple):
    """What a density is made of, at the coordinates of each walker.

    Attributes
    ----------
    log_prior : ndarray, shape (walkers,)
        Log prior density in the sampling coordinates, changes of variables included; finite, or
        -inf where the density is zero.
    residual : ndarray, shape (walkers, n)
        Readings less the model's loads; without meaning where the density is zero.
    log_jacobian : ndarray, shape (walkers,)
        ln |d slots / d sampling coordinates|: the log density less it is that in slots.
    values : ndarray, shape (walkers, s)
        Parameters of the law (angles in radians), noise sd, factors of edges and thickness,
        offsets, then the mounting *stretches*.
    """

    log_prior: np.ndarray
    residual: np.ndarray
    log_jacobian: np.ndarray
    values: np.ndarray


def evaluate(problem: Problem, u: np.ndarray, counts: np.ndarray | None = None) -> Evaluation:
    """Evaluate walkers (n, d); ``counts`` of shape (4,) is added to.

    It counts walkers inside, out of range, without a root, and overflowed.
    """
    if counts is None:
        counts = np.zeros(1 + len(REASONS), dtype=np.int64)
    return Evaluation(*_walkers(problem, u, counts))
