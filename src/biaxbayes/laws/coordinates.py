r"""Sampling coordinates: exponents and stresses at a reference state.

Data determine the exponent q of an exponential and the stress S of a term at the largest stretch
far better than their parameters. Both follow from the law, for each of its ``exponents`` k and
``amplitudes`` c, at one fixed reference stretch l* per specimen:

    q_k = k q*(k = 1, other exponents 0)
    S_c = c (s_x* + s_y*)(c = 1, other amplitudes 0) / 2

Most laws sample ln q and ln S. Of two parameters of one exponential (k, then k'), ln(q_k + q_k')
and ln(q_k' / q_k) are sampled. A parameter b that others bound, b^2 < b_x b_y, is sampled as
rho = b / sqrt(b_x b_y); the angle and the dispersion of fibres are in :mod:`biaxbayes.laws.chart`.
All others, and those that are fixed, are coordinates themselves.

Where several terms of a law can stand in for one another, their stresses add up to that of the
data, which is straight in S and bent in ln S, while priors are wide in ln S down to S = 0. Roots
lie between the two, and what is uneven in S or in ln S is even in u:

    S = s L(u)^2,    L(u) = ln(1 + exp(u))

u is sqrt(S / s) for large S, and ln(S / s) / 2 near S = 0: no bound, and a tail that proposals
follow. Exponents are sampled in the same way, as q = r L(v)^2.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from biaxbayes.compilation import inlined
from biaxbayes.laws.chart import angles_from_chart, chart_from_angles
from biaxbayes.laws.materials import cauchy_stress, constants_at, exponents

STRESS_SHARE, _EXPONENT = 0.01, 0.1
"""s over the largest stress of a specimen, and r; tuned on an aorta under five protocols."""
LOG_EXPONENT = math.log(_EXPONENT)
ROOT_WIDTH = 1.0
"""Width of dispersed starts, in u and v."""
_LOG_2 = math.log(2.0)


class Transform(NamedTuple):
    """What the sampling coordinates of a run depend on; arrays have one entry per parameter."""

    constants: Any  # of the law; only their type matters, which picks its energy
    low: np.ndarray  # bounds of the coordinates
    high: np.ndarray
    logarithmic: np.ndarray  # parameters whose slots are logs
    exponential: np.ndarray  # which exponential of the law it is an exponent of, or -1
    in_exponents: np.ndarray  # the same, or bound by such
    first: np.ndarray  # the exponent that it shares one with, where both are sampled, or -1
    amplitude: np.ndarray
    sampled: np.ndarray  # whether q or S is sampled in its place
    bound: np.ndarray  # (3,), the parameter that two others bound, and these; -1 without one
    as_share: bool  # whether rho is sampled in its place
    alpha: int  # the angle and the dispersion that are sampled in their chart; -1 without
    kappa: int
    isotropy_scale: float  # of the chart
    roots: bool  # sampled in place of logs
    log_scale: float  # ln s, s in kPa
    X: float  # squares of the reference stretch
    Y: float
    Z: float


# --- the reference state: slots are (p,) in compiled code, (p, n) in NumPy -----------------------


@inlined
def _alone(transform, slots, k, others):
    """Constants of the law where a parameter is 1 and others of its kind are 0."""
    theta = np.empty_like(slots)
    for i in range(transform.low.size):
        theta[i] = np.exp(slots[i]) if transform.logarithmic[i] else slots[i]
        if others[i]:
            theta[i] = 0.0
    theta[k] = 1.0
    return constants_at(transform.constants, theta)


@inlined
def log_exponent(transform, slots, k):
    """Ln of q* at k = 1, with no other exponent."""
    constants = _alone(transform, slots, k, transform.in_exponents)
    q = exponents(constants, transform.X, transform.Y, transform.Z)
    return np.log(q[transform.exponential[k]])


@inlined
def log_stress(transform, slots, c):
    """Ln of (s_x* + s_y*) / 2 at c = 1, with no other amplitude."""
    constants = _alone(transform, slots, c, transform.amplitude)
    sx, sy = cauchy_stress(constants, transform.X, transform.Y, transform.Z)
    return np.log(0.5 * (sx + sy))


# --- roots with a logarithmic tail ---------------------------------------------------------------


@inlined
def log_square(u):
    """(ln L^2, ln(d ln L^2 / du))."""
    tail = np.log1p(np.exp(-abs(u)))
    log_L = u if u < -30.0 else np.log(max(u, 0.0) + tail)
    # d ln L^2 / du = 2 e^u / (1 + e^u) / L
    return 2.0 * log_L, _LOG_2 + min(u, 0.0) - tail - log_L


def root(log_squared: np.ndarray) -> np.ndarray:
    """The u of ln L^2; inverse of :func:`log_square`."""
    L = np.exp(0.5 * log_squared)
    # e^u = e^L - 1
    return L + np.log(-np.expm1(-L))


# --- both directions -----------------------------------------------------------------------------


@inlined
def to_slots(transform, value):
    """Turn sampling coordinates, the first entries of ``value``, into slots in place.

    Returns ln |d slots / d sampling coordinates|, -inf outside the law's range.
    """
    t, size = transform, transform.low.size
    for i in range(size):
        if not t.low[i] <= value[i] <= t.high[i]:
            return -np.inf
    log_jacobian = 0.0
    if t.alpha >= 0:
        alpha, kappa, log_jacobian = angles_from_chart(
            value[t.alpha], value[t.kappa], t.isotropy_scale
        )
        value[t.alpha], value[t.kappa] = alpha, kappa
    for k in range(size):  # ln q in place of exponents
        if t.exponential[k] >= 0 and t.sampled[k]:
            if t.roots:
                log_q, log_slope = log_square(value[k])
                value[k], log_jacobian = LOG_EXPONENT + log_q, log_jacobian + log_slope
            if t.first[k] >= 0:
                # ln q = ln(q + q') - ln(1 + q' / q)
                value[t.first[k]] -= np.log1p(np.exp(value[k]))
                value[k] += value[t.first[k]]
    for k in range(size):
        if t.exponential[k] >= 0 and t.sampled[k]:
            value[k] -= log_exponent(t, value, k)
    b, first, second = t.bound
    if b >= 0:
        # b = rho sqrt(b_x b_y);  |d b / d rho| = sqrt(b_x b_y)
        log_most = 0.5 * (value[first] + value[second])
        if t.as_share:
            value[b] *= np.exp(log_most)
            log_jacobian += log_most
        elif not abs(value[b]) < np.exp(log_most):
            return -np.inf
    for c in range(size):
        if t.amplitude[c] and t.sampled[c]:
            if t.roots:
                log_S, log_slope = log_square(value[c])
                value[c], log_jacobian = t.log_scale + log_S, log_jacobian + log_slope
            value[c] -= log_stress(t, value, c)
    return log_jacobian


def from_slots(transform: Transform, slots: np.ndarray) -> np.ndarray:
    """Sampling coordinates at slots, both (p, n); inverse of :func:`to_slots`."""
    t, out = transform, slots.copy()
    for k in np.flatnonzero((t.exponential >= 0) & t.sampled):
        log_q = slots[k] + log_exponent(t, slots, k)
        out[k] = root(log_q - LOG_EXPONENT) if t.roots else log_q
    for k in np.flatnonzero(t.first >= 0):
        log_q, log_other = out[t.first[k]], out[k]
        out[t.first[k]], out[k] = np.logaddexp(log_q, log_other), log_other - log_q
    if t.as_share:
        b, first, second = t.bound
        out[b] = slots[b] * np.exp(-0.5 * (slots[first] + slots[second]))
    for c in np.flatnonzero(t.amplitude & t.sampled):
        log_S = slots[c] + log_stress(t, slots, c)
        out[c] = root(log_S - t.log_scale) if t.roots else log_S
    if t.alpha >= 0:
        alpha, kappa = slots[t.alpha], slots[t.kappa]
        out[t.alpha], out[t.kappa] = chart_from_angles(alpha, kappa, t.isotropy_scale)
    return out
