"""The log posterior density of many walkers in one compiled call.

A walker's coordinates are spread over the slots of a :class:`~.problem.Problem`, turned into
material, mounted state and noise, and its curves are compared with the readings. The stress
itself is that of :mod:`biaxbayes.mechanics.goh`; the mounted state that of
:mod:`biaxbayes.mechanics.mounting`.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numba.extending import register_jitable

from biaxbayes.inference.coordinates import SHEAR, angles_from_shear, reference_state
from biaxbayes.inference.problem import (
    ALPHA,
    C1,
    EDGE_X,
    EDGE_Y,
    FIXED,
    FORCE,
    GROWTH,
    INSIDE,
    K1,
    K2,
    KAPPA,
    MOUNTING,
    NO_ROOT,
    NOISE,
    NORMAL,
    NORMAL_NATURAL,
    OFFSET_X,
    OFFSET_Y,
    OUT_OF_RANGE,
    OVERFLOW,
    REFERENCE,
    THICKNESS,
    UNIFORM,
)
from biaxbayes.mechanics.goh import fibre_factor, fibre_strain, stress_component, structure_tensor
from biaxbayes.mechanics.growth import exponential
from biaxbayes.mechanics.mounting import (
    LOG_HIGH,
    LOG_LOW,
    balance,
    log_change_of_variables,
    solve_balance,
)

__all__ = ["evaluate", "log_density"]

HALF_LOG_2PI = 0.9189385332046727


@register_jitable
def _log_prior(kind, row, x):
    """Log prior density of one slot at x, or -inf outside its range."""
    if kind == FIXED:
        return 0.0
    if not (row[2] <= x <= row[3]):
        return -np.inf
    if kind == NORMAL:
        z = (x - row[0]) / row[1]
        return row[4] - 0.5 * z * z
    if kind == UNIFORM:
        return row[4]
    if kind == NORMAL_NATURAL:
        z = (np.exp(x) - row[0]) / row[1]
        return row[4] - 0.5 * z * z + x  # d exp(x) / dx = exp(x)
    return row[4] + x


@register_jitable
def _material(problem, value):
    """Turn the first five slots into C1, k1, k2, alpha, kappa in place; their log Jacobian."""
    log_jacobian = 0.0
    if problem.chart == SHEAR:
        if not 0.0 <= value[KAPPA] <= 1.0:
            return -np.inf
        alpha, kappa, log_jacobian = angles_from_shear(
            value[ALPHA], value[KAPPA], problem.softening
        )
        value[ALPHA], value[KAPPA] = alpha, kappa
    alpha, kappa = value[ALPHA], value[KAPPA]
    if not (0.0 <= kappa <= 1.0 / 3.0 and 0.0 <= alpha <= 0.5 * np.pi):
        return -np.inf
    if problem.structural:
        Hx, Hy, Hz = structure_tensor(alpha, kappa)
        log_E2, log_EG = reference_state(
            Hx, Hy, Hz, problem.reference[0], problem.reference[1], problem.reference[2]
        )
        if problem.slot[K2] >= 0:
            value[K2] -= log_E2  # ln k2 = ln q - ln E*^2
        if problem.slot[K1] >= 0:
            # ln k1 = ln S - q - ln(E* sqrt(gx gy))
            value[K1] -= np.exp(value[K2] + log_E2) + log_EG
    for i in (C1, K1, K2):
        if problem.tie[i] >= 0:
            value[i] = value[problem.tie[i]] + problem.tie_log_factor[i]
    return log_jacobian


@register_jitable
def _mounted_state(problem, value, H, m, sx, sy):
    """(ln lm_x, ln lm_y, log density, reason) of mounted state m; sx, sy its sections."""
    if problem.mounting_mode == REFERENCE:
        return 0.0, 0.0, 0.0, INSIDE
    Hx, Hy, Hz = H
    i = MOUNTING + 2 * m
    c1, k1, k2 = value[C1], value[K1], value[K2]
    if problem.mounting_mode == FORCE:
        px, py = value[i], value[i + 1]
        if problem.slot[i] < 0:  # exact: the reading, less the cell's own zero
            px, py = px - value[OFFSET_X], py - value[OFFSET_Y]
        ok, x, y, jxx, jxy, jyy = solve_balance(
            c1, k1, k2, Hx, Hy, Hz, problem.fibre_switch, px / sx, py / sy, problem.mounted
        )
        if not ok:
            return x, y, -np.inf, NO_ROOT
        logp = 0.0
        if problem.determinant:
            # ln |det d p0 / d lm|, p0 in the unit of the file
            change = log_change_of_variables(x, y, jxx, jxy, jyy, problem.mounted)
            logp -= change + np.log(sx * sy)
    else:
        if not (value[i] > 0.0 and value[i + 1] > 0.0):
            return 0.0, 0.0, -np.inf, OUT_OF_RANGE
        x, y = np.log(value[i]), np.log(value[i + 1])
        if not (LOG_LOW < x < LOG_HIGH and LOG_LOW < y < LOG_HIGH):
            return x, y, -np.inf, NO_ROOT
        rx, ry, jxx, jxy, jyy = balance(
            c1, k1, k2, Hx, Hy, Hz, problem.fibre_switch, 0.0, 0.0, problem.mounted, x, y
        )
        if problem.mounted:
            px, py = rx * sx, ry * sy
        else:
            px, py = rx * np.exp(-x) * sx, ry * np.exp(-y) * sy
            jxx, jyy = jxx - rx, jyy - ry  # the work of the dead load p0 = s / lm
        if not (jxx > 0.0 and jxx * jyy - jxy * jxy > 0.0):
            return x, y, -np.inf, NO_ROOT
        logp = 0.0
    lx, ly = np.exp(x), np.exp(y)
    logp += _log_prior(problem.prior_kind[i], problem.prior[i], lx)
    logp += _log_prior(problem.prior_kind[i + 1], problem.prior[i + 1], ly)
    for k in range(2):
        sd = problem.reading_sd[m, k]
        if sd > 0.0:
            p, offset = (px, value[OFFSET_X]) if k == 0 else (py, value[OFFSET_Y])
            z = (problem.reading[m, k] - p - offset) / sd
            logp -= 0.5 * z * z + np.log(sd) + HALF_LOG_2PI
    value[i], value[i + 1] = lx, ly
    return x, y, logp, INSIDE


@njit(cache=True, error_model="numpy", nogil=True, fastmath={"reassoc", "contract", "arcp", "nsz"})
def _curves(problem, value, H, p, x, y, sx, sy, strain, scratch, growth):
    """Log likelihood of protocol p, tempered, given its mounted state."""
    Hx, Hy, Hz = H
    first, last = problem.start[p], problem.start[p + 1]
    n = last - first
    mx, my = np.exp(2.0 * x), np.exp(2.0 * y)
    mz = 1.0 / (mx * my)
    ax, ay, az = problem.ax[first:last], problem.ay[first:last], problem.az[first:last]
    ilx, ily = problem.ilx[first:last], problem.ily[first:last]
    fx, fy = problem.fx[first:last], problem.fy[first:last]
    ux, uy = problem.vx[first:last], problem.vy[first:last]
    k1, k2, c1 = value[K1], value[K2], value[C1]
    E, exponent, g = strain[:n], scratch[:n], growth[:n]
    hx, hy, hz = Hx * mx, Hy * my, Hz * mz
    for j in range(n):
        E[j] = fibre_strain(hx, hy, hz, ax[j], ay[j], az[j])
        exponent[j] = k2 * E[j] * E[j]
    exponential(exponent, g)
    # f_k = A P_k = A s_k / (l_k lm_k); mounted dimensions: times lm_k
    cx = sx if problem.mounted else sx * np.exp(-x)
    cy = sy if problem.mounted else sy * np.exp(-y)
    ox, oy = value[OFFSET_X], value[OFFSET_Y]
    switch = problem.fibre_switch
    w2 = value[NOISE] * value[NOISE]
    bx, by = problem.beta[p, 0], problem.beta[p, 1]
    if not problem.has_growth:
        ssx = ssy = 0.0
        for j in range(n):
            e = fibre_factor(k1, E[j], g[j], switch)
            rx = fx[j] - ox - cx * ilx[j] * stress_component(c1, Hx, Hz, e, mx * ax[j], mz * az[j])
            ry = fy[j] - oy - cy * ily[j] * stress_component(c1, Hy, Hz, e, my * ay[j], mz * az[j])
            ssx += rx * rx + ux[j]
            ssy += ry * ry + uy[j]
        log_w = 0.5 * np.log(w2) + HALF_LOG_2PI
        return -0.5 * (bx * ssx + by * ssy) / w2 - n * (bx + by) * log_w
    b2 = value[GROWTH] * value[GROWTH]
    total = 0.0
    for j in range(n):
        e = fibre_factor(k1, E[j], g[j], switch)
        qx = cx * ilx[j] * stress_component(c1, Hx, Hz, e, mx * ax[j], mz * az[j])
        qy = cy * ily[j] * stress_component(c1, Hy, Hz, e, my * ay[j], mz * az[j])
        vx, vy = w2 + b2 * qx * qx, w2 + b2 * qy * qy
        rx, ry = fx[j] - ox - qx, fy[j] - oy - qy
        sqx, sqy = rx * rx + ux[j], ry * ry + uy[j]
        total -= 0.5 * bx * (sqx / vx + np.log(vx)) + 0.5 * by * (sqy / vy + np.log(vy))
    return total - n * (bx + by) * HALF_LOG_2PI


@njit(cache=True, error_model="numpy", nogil=True)
def _density(problem, u, value, strain, scratch, growth):
    """(log density, log likelihood of the curves, reason); natural values into ``value``."""
    for i in range(problem.slot.size):
        value[i] = u[problem.slot[i]] if problem.slot[i] >= 0 else problem.fixed[i]
    total = _material(problem, value)
    if not np.isfinite(total):
        return -np.inf, -np.inf, OUT_OF_RANGE
    for i in range(MOUNTING):
        x = np.degrees(value[i]) if i == ALPHA else value[i]
        total += _log_prior(problem.prior_kind[i], problem.prior[i], x)
    if not np.isfinite(total):
        return -np.inf, -np.inf, OUT_OF_RANGE
    for i in (C1, K1, K2, NOISE, GROWTH):
        value[i] = np.exp(value[i])
    if not (np.isfinite(value[C1]) and np.isfinite(value[K1]) and np.isfinite(value[K2])):
        return -np.inf, -np.inf, OVERFLOW
    H = structure_tensor(value[ALPHA], value[KAPPA])
    # the section in x is edge_y * thickness
    sx = problem.area[0] * value[EDGE_Y] * value[THICKNESS]
    sy = problem.area[1] * value[EDGE_X] * value[THICKNESS]
    if not (sx > 0.0 and sy > 0.0):
        return -np.inf, -np.inf, OUT_OF_RANGE
    likelihood = 0.0
    done = -1
    x = y = 0.0
    for p in range(problem.mount.size):
        if problem.mount[p] != done:
            done = problem.mount[p]
            x, y, logp, reason = _mounted_state(problem, value, H, done, sx, sy)
            total += logp
            if not np.isfinite(total):
                return -np.inf, -np.inf, reason if reason != INSIDE else OUT_OF_RANGE
        likelihood += _curves(problem, value, H, p, x, y, sx, sy, strain, scratch, growth)
    total += likelihood
    if not np.isfinite(total):
        return -np.inf, -np.inf, OVERFLOW
    return total, likelihood, INSIDE


@njit(cache=True, error_model="numpy", nogil=True)
def log_density(problem, u, rejected):
    """Log density of each walker in the sampling coordinates.

    Parameters
    ----------
    problem : Problem
    u : ndarray, shape (walkers, d)
    rejected : int64 ndarray, shape (4,)
        Counters, added to: walkers inside, out of range, without a root, overflowed.

    Returns
    -------
    ndarray, shape (walkers,)
        Finite or -inf, never NaN.
    """
    n = u.shape[0]
    out = np.empty(n)
    value = np.empty(problem.slot.size)
    longest = np.max(np.diff(problem.start))
    strain, scratch, growth = np.empty(longest), np.empty(longest), np.empty(longest)
    for i in range(n):
        out[i], _, reason = _density(problem, u[i], value, strain, scratch, growth)
        rejected[reason] += 1
    return out


@njit(cache=True, error_model="numpy", nogil=True)
def evaluate(problem, u):
    """Log density, tempered log likelihood and natural values of each walker.

    Returns
    -------
    log_density, log_likelihood : ndarray, shape (walkers,)
    natural : ndarray, shape (walkers, s)
        C1, k1 (kPa), k2, alpha (radians), kappa, noise sd, growth, edge, thickness and offset
        factors, then the mounting *stretches*.
    """
    n = u.shape[0]
    total, likelihood = np.empty(n), np.empty(n)
    natural = np.empty((n, problem.slot.size))
    longest = np.max(np.diff(problem.start))
    strain, scratch, growth = np.empty(longest), np.empty(longest), np.empty(longest)
    for i in range(n):
        total[i], likelihood[i], _ = _density(problem, u[i], natural[i], strain, scratch, growth)
    return total, likelihood, natural
