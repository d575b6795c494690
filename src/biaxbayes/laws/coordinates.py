r"""Sampling coordinates that laws share: exponents and stresses at a reference state.

Data determine the exponent q = k2 F and the stress S = k1 G exp(q) of a term at the largest stretch
far better than k1 and k2. F and G are what the law makes of one fixed reference stretch.

Most laws sample ln S and ln q. Where several terms of a law can stand in for one another, their
stresses add up to that of the data, which is straight in S and bent in ln S, while priors are wide
in ln S down to S = 0. Roots lie between the two, and what is uneven in S or in ln S is even in u:

    S = s L(u)^2,    L(u) = ln(1 + exp(u))

u is sqrt(S / s) for large S, and ln(S / s) / 2 near S = 0: no edge, and a tail that proposals
follow. Exponents are sampled in the same way, as q = r L(v)^2.
"""

from __future__ import annotations

import math

import numpy as np

from biaxbayes.compilation import inlined

_STRESS_SHARE, _EXPONENT = 0.01, 0.1
"""s over the largest stress of a specimen, and r; tuned on an aorta under five protocols."""
LOG_EXPONENT = math.log(_EXPONENT)
ROOT_WIDTH = 1.0
"""Width of dispersed starts, in u and v."""
_LOG_2 = math.log(2.0)


@inlined
def log_fibre_strain(alpha, X, Y):
    """Ln E of fibres at +-alpha (radians) at squared stretches, E = X cos^2 + Y sin^2 - 1."""
    cos2 = np.cos(alpha) ** 2
    return np.log(cos2 * X + (1.0 - cos2) * Y - 1.0)


# --- logs ----------------------------------------------------------------------------------------


@inlined
def from_log_stress(value, k1, k2, k1_sampled, k2_sampled, log_F, log_G):
    """Replace ln S and ln q in ``value``, at the places k1 and k2, by ln k1 and ln k2."""
    if k2_sampled > 0.0:
        value[k2] -= log_F  # ln k2 = ln q - ln F
    if k1_sampled > 0.0:
        value[k1] -= np.exp(value[k2] + log_F) + log_G  # ln k1 = ln S - q - ln G


def to_log_stress(out, k1, k2, k1_sampled, k2_sampled, log_F, log_G):
    """Replace ln k1 and ln k2 in ``out``, by the names k1 and k2, by ln S and ln q."""
    log_q = out[k2] + log_F
    if k1_sampled > 0.0:
        out[k1] = out[k1] + np.exp(log_q) + log_G
    if k2_sampled > 0.0:
        out[k2] = log_q


# --- roots with a logarithmic tail ---------------------------------------------------------------


def log_stress_scale(peak_kPa: float) -> float:
    """Log of s (kPa) of a specimen, by its largest stress."""
    return math.log(_STRESS_SHARE * peak_kPa)


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


@inlined
def from_root_exponent(value, k, sampled, log_F):
    """Replace the root of q = k F in ``value`` by ln k; the log Jacobian."""
    if not sampled > 0.0:
        return 0.0
    log_q, log_slope = log_square(value[k])
    value[k] = LOG_EXPONENT + log_q - log_F  # ln k = ln q - ln F
    return log_slope


def to_root_exponent(out, k, sampled, log_F):
    """Replace ln k in ``out`` by the root of q = k F."""
    if sampled > 0.0:
        out[k] = root(out[k] + log_F - LOG_EXPONENT)


@inlined
def from_root_stress(value, k, sampled, log_scale, q, log_G):
    """Replace the root of S = k G exp(q) in ``value`` by ln k; the log Jacobian."""
    if not sampled > 0.0:
        return 0.0
    log_S, log_slope = log_square(value[k])
    value[k] = log_scale + log_S - q - log_G  # ln k = ln S - q - ln G
    return log_slope


def to_root_stress(out, k, sampled, log_scale, q, log_G):
    """Replace ln k in ``out`` by the root of S = k G exp(q)."""
    if sampled > 0.0:
        out[k] = root(out[k] + q + log_G - log_scale)
