"""Prior, mounted state and model loads of many walkers in one compiled call.

A walker's coordinates are spread over *slots*, one entry per parameter, whether sampled, fixed or
tied to another: the parameters of the law; of each piece the noise sd, factors of measured
dimensions, offsets of the load cell and its stiffness relative to the first piece; of each mounted
state two forces or stretches. The readings less the model's loads are the residuals that a
likelihood takes. One kernel is compiled for each law. In NumPy :mod:`biaxbayes.forward` does the
same.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from biaxbayes.compilation import WITHIN, compiled, inlined
from biaxbayes.laws.coordinates import to_slots
from biaxbayes.laws.materials import cauchy_stress, constants_at
from biaxbayes.mechanics.mounting import (
    LOG_HIGH,
    LOG_LOW,
    balance,
    log_change_at_free_side,
    log_change_of_variables,
    mounted_section,
    sections,
    solve_balance,
    solve_free_side,
)
from biaxbayes.model.priors import FIXED, NORMAL, NORMAL_NATURAL, STUDENT, UNIFORM
from biaxbayes.parameters import OF_PIECE

PIECE_SLOTS = len(OF_PIECE)
NOISE, EDGE_X, EDGE_Y, THICKNESS, OFFSET_X, OFFSET_Y, STIFFNESS = range(PIECE_SLOTS)

# What the slots of a mounted state hold: nothing (lm = 1), forces p0 (lm is their root), or lm.
MODE_UNSTRETCHED, MODE_FORCE, MODE_STRETCH = 0, 1, 2

# Why a density is zero; counted for the diagnostics.
INSIDE, OUT_OF_RANGE, NO_ROOT, OVERFLOW = range(4)
REASONS = ("out_of_range", "no_mounting_root", "overflow")
"""Names of the reasons, in the order of the counters, which begin with the points inside."""


class Problem(NamedTuple):
    """Everything the compiled density needs, in s slots; arrays are float64 unless stated."""

    slot: np.ndarray  # int64 (s,): index in a walker's coordinates, or -1 where fixed
    # (s,): value of a fixed slot, on the scale of the slot (logs for positive quantities)
    fixed: np.ndarray
    # int64 (s,): the slot whose value, plus a log factor, a tied one takes; -1 where free
    tie: np.ndarray
    tie_log_factor: np.ndarray  # (s,)
    transform: Any  # constants between slots and sampling coordinates; its type picks the law
    size: int  # number of the law's slots
    logarithmic: np.ndarray  # bool (s,): slots that hold logs
    per_unit: np.ndarray  # (s,): natural units in one unit of the slot: degrees per radian, else 1
    prior_kind: np.ndarray  # int64 (s,)
    # (s, 5): location, scale, lower, upper, log normaliser; for mounting slots of the mounting
    # stretch
    prior: np.ndarray
    # whether the change of variables from mounting force to stretch is included, as in a density
    # of the parameters, not in a likelihood alone
    determinant: bool
    mounting_mode: np.ndarray  # int64 (m,): what the slots of each mounted state hold
    piece: np.ndarray  # int64 (m,): of each mounted state
    free_side: np.ndarray  # int64 (m,): its direction without load (a strip), or -1
    # bool (pieces,): whether the dimensions are those of the mounted state
    mounted_dimensions: np.ndarray
    area: np.ndarray  # (pieces, 2): sections
    mounting_reading: np.ndarray  # int64 (m, 2): the reading of each mounting load, or -1
    start: np.ndarray  # int64 (p + 1,): first point of each protocol
    mount: np.ndarray  # int64 (p,): the mounted state it belongs to
    solved: np.ndarray  # bool (p,): whether the stretch of the free side was not measured
    stretch: np.ndarray  # (n, 2): measured stretches of the points
    weight: np.ndarray  # (n, 2, 2): of stress k in reading i of a point
    reading_of: np.ndarray  # int64 (n, 2): which reading that is, or -1
    measured: np.ndarray  # (r,): all readings, those of the mounted states first in each piece
    offset_of: np.ndarray  # int64 (r,): slot of the offset of each reading


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
    if kind == STUDENT:
        # ln t of three degrees of freedom: (1 + z^2 / 3)^-2
        z = (x - location) / scale
        return log_norm - 2.0 * np.log1p(z * z / 3.0)
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
    A free side carries no force, and its stretch follows. Residuals of the mounting readings are
    written.
    """
    if problem.mounting_mode[m] == MODE_UNSTRETCHED:
        return 0.0, 0.0, 0.0, INSIDE
    piece, side = problem.piece[m], problem.free_side[m]
    o = problem.size + PIECE_SLOTS * piece
    i = problem.size + PIECE_SLOTS * problem.mounted_dimensions.size + 2 * m
    mounted_dimensions, logp = problem.mounted_dimensions[piece], 0.0
    if problem.mounting_mode[m] == MODE_FORCE:
        px, py = value[i], value[i + 1]
        if problem.slot[i + (side == 0)] < 0:  # exact: the reading less the offset of the cell
            px, py = px - value[o + OFFSET_X], py - value[o + OFFSET_Y]
        if side == 0:
            px = 0.0
        elif side == 1:
            py = 0.0
        ok, x, y, jxx, jxy, jyy = solve_balance(
            constants, px / area_x, py / area_y, mounted_dimensions
        )
        if not ok:
            return x, y, -np.inf, NO_ROOT
        if problem.determinant and side < 0:
            # ln |det d p0 / d lm|, p0 in the unit of the file
            change = log_change_of_variables(x, y, jxx, jxy, jyy, mounted_dimensions)
            logp -= change + np.log(area_x * area_y)
        elif problem.determinant:
            # ln |d p0 / d lm| along the strip
            change = log_change_at_free_side(x, y, jxx, jxy, jyy, mounted_dimensions, side)
            logp -= change + np.log(area_x if side == 1 else area_y)
    else:
        x = np.log(value[i]) if value[i] > 0.0 and side != 0 else 0.0
        y = np.log(value[i + 1]) if value[i + 1] > 0.0 and side != 1 else 0.0
        if (side != 0 and not value[i] > 0.0) or (side != 1 and not value[i + 1] > 0.0):
            return 0.0, 0.0, -np.inf, OUT_OF_RANGE
        if side >= 0:
            ok, x, y = solve_free_side(constants, x, y, side)
            if not ok:
                return x, y, -np.inf, NO_ROOT
        if not (LOG_LOW < x < LOG_HIGH and LOG_LOW < y < LOG_HIGH):
            return x, y, -np.inf, NO_ROOT
        rx, ry, jxx, jxy, jyy = balance(constants, 0.0, 0.0, mounted_dimensions, x, y)
        px = rx * mounted_section(area_x, np.exp(x), mounted_dimensions)
        py = ry * mounted_section(area_y, np.exp(y), mounted_dimensions)
        if not mounted_dimensions:
            # d(s - p0 lm) / d ln lm at fixed p0 = s / lm: the dead load takes s off the diagonal
            jxx, jyy = jxx - rx, jyy - ry
        if not (jxx > 0.0 and jxx * jyy - jxy * jxy > 0.0):
            return x, y, -np.inf, NO_ROOT
    lx, ly = np.exp(x), np.exp(y)
    logp += log_prior(problem.prior_kind[i], problem.prior[i], lx)
    logp += log_prior(problem.prior_kind[i + 1], problem.prior[i + 1], ly)
    if problem.mounting_reading[m, 0] >= 0:
        residual[problem.mounting_reading[m, 0]] -= px
    if problem.mounting_reading[m, 1] >= 0:
        residual[problem.mounting_reading[m, 1]] -= py
    value[i], value[i + 1] = lx, ly
    return x, y, logp, INSIDE


@inlined
def _curves(problem, constants, p, x, y, area_x, area_y, residual):
    """Take the model's readings of protocol p from the residuals; False if one is not finite."""
    m = problem.mount[p]
    side, mounted_dimensions = problem.free_side[m], problem.mounted_dimensions[problem.piece[m]]
    lm_x, lm_y = np.exp(x), np.exp(y)
    gx = mounted_section(area_x, lm_x, mounted_dimensions)
    gy = mounted_section(area_y, lm_y, mounted_dimensions)
    total = 0.0
    for j in range(problem.start[p], problem.start[p + 1]):
        lx, ly = problem.stretch[j, 0] * lm_x, problem.stretch[j, 1] * lm_y
        if problem.solved[p]:
            # across the strip s = 0; the root of the row before is near
            if side == 1:
                ok, _, y = solve_free_side(constants, np.log(lx), y, side)
                ly = np.exp(y)
            else:
                ok, x, _ = solve_free_side(constants, x, np.log(ly), side)
                lx = np.exp(x)
            if not ok:
                return False
        X, Y = lx * lx, ly * ly
        sx, sy = cauchy_stress(constants, X, Y, 1.0 / (X * Y))
        sx, sy = gx * sx, gy * sy
        # q_i = sum_p sum_k w_pik g_k s_k
        for i in range(2):
            r = problem.reading_of[j, i]
            if r >= 0:
                q = problem.weight[j, i, 0] * sx + problem.weight[j, i, 1] * sy
                residual[r] -= q
                total += q
    return np.isfinite(total)


@njit(error_model="numpy", nogil=True, **WITHIN)
def _walker(problem, u, value, residual):
    """(log prior, log Jacobian, reason); fills ``value`` and ``residual`` as in `Evaluation`."""
    size, pieces = problem.size, problem.mounted_dimensions.size
    first_state = size + PIECE_SLOTS * pieces
    for i in range(problem.slot.size):
        value[i] = u[problem.slot[i]] if problem.slot[i] >= 0 else problem.fixed[i]
    total = jacobian = to_slots(problem.transform, value)
    for i in range(size):
        if problem.tie[i] >= 0:
            value[i] = value[problem.tie[i]] + problem.tie_log_factor[i]
    if not np.isfinite(total):
        return -np.inf, jacobian, OUT_OF_RANGE
    for i in range(first_state):
        x = value[i] * problem.per_unit[i]
        total += log_prior(problem.prior_kind[i], problem.prior[i], x)
    if not np.isfinite(total):
        return -np.inf, jacobian, OUT_OF_RANGE
    for i in range(first_state):
        if problem.logarithmic[i]:
            value[i] = np.exp(value[i])
    for i in range(size):
        if not np.isfinite(value[i]):
            return -np.inf, jacobian, OVERFLOW
    constants = constants_at(problem.transform.constants, value)
    for r in range(residual.size):
        residual[r] = problem.measured[r] - value[problem.offset_of[r]]
    done = -1
    x = y = area_x = area_y = 0.0
    for p in range(problem.mount.size):
        if problem.mount[p] != done:
            done = problem.mount[p]
            o = size + PIECE_SLOTS * problem.piece[done]
            area_x, area_y = sections(
                problem.area[problem.piece[done]],
                value[o + EDGE_X],
                value[o + EDGE_Y],
                value[o + THICKNESS],
            )
            # all stresses are c times those of the material
            area_x, area_y = area_x * value[o + STIFFNESS], area_y * value[o + STIFFNESS]
            if not (area_x > 0.0 and area_y > 0.0):
                return -np.inf, jacobian, OUT_OF_RANGE
            x, y, logp, reason = _mounted_state(
                problem, value, constants, done, area_x, area_y, residual
            )
            total += logp
            if not np.isfinite(total):
                return -np.inf, jacobian, reason if reason != INSIDE else OUT_OF_RANGE
        if not _curves(problem, constants, p, x, y, area_x, area_y, residual):
            return -np.inf, jacobian, OVERFLOW
    return total, jacobian, INSIDE


@compiled(error_model="numpy", nogil=True)
def _walkers(problem, u):
    """The arrays of :class:`Evaluation` for each walker."""
    n = u.shape[0]
    total, jacobian, outcome = np.empty(n), np.empty(n), np.empty(n, dtype=np.int64)
    values = np.empty((n, problem.slot.size))
    residual = np.zeros((n, problem.measured.size))
    for i in range(n):
        total[i], jacobian[i], outcome[i] = _walker(problem, u[i], values[i], residual[i])
    return total, residual, jacobian, values, outcome


class Evaluation(NamedTuple):
    """What a density is made of, at the coordinates of each walker."""

    # (walkers,): in the sampling coordinates, changes of variables included; -inf where zero
    log_prior: np.ndarray
    # (walkers, n): readings less loads; without meaning where the density is zero
    residual: np.ndarray
    # (walkers,): ln |d slots / d sampling coordinates|; the log density less it is that in slots
    log_jacobian: np.ndarray
    # (walkers, s): slots, positive ones not as logs, and the mounting *stretches*
    values: np.ndarray
    outcome: np.ndarray  # int64 (walkers,): 0 inside, or one more than the index in REASONS


def evaluate(problem: Problem, u: np.ndarray) -> Evaluation:
    """Evaluate walkers (n, d)."""
    return Evaluation(*_walkers(problem, np.ascontiguousarray(u)))
