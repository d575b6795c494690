r"""Sampling coordinates of stiffnesses and exponents that may vanish: square roots with a log tail.

Terms of a law stand in for one another: their stresses S add up to that of the data, which is
straight in S and bent in ln S, while priors are wide in ln S down to S = 0. Roots lie between,
and what is uneven in S or in ln S is even in u:

    S = s L(u)^2,    L(u) = ln(1 + exp(u))

u is sqrt(S / s) for large S, and ln(S / s) / 2 near S = 0: no edge, and a tail that proposals
follow. Exponents q = k E*^2 at the reference state are held alike, as q = r L(v)^2.
"""

from __future__ import annotations

import math

import numpy as np

from biaxbayes.compilation import inlined

__all__ = ["LOG_EXPONENT", "ROOT_WIDTH", "log_square", "log_stress_scale", "root"]

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
