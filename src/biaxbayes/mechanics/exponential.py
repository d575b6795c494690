"""exp(x) for a whole curve at once.

A stretch curve costs one exponential per row, and the exponential is most of the cost of the
posterior density. The library function is scalar; written as below the compiler evaluates
several rows at a time. The error is below two units in the last place for the x >= 0 that
occur here (x = k2 E^2), which a test holds.
"""

from __future__ import annotations

import numpy as np
from numba import njit

__all__ = ["exponential"]

LOG2_E = 1.4426950408889634
LN2_HIGH = 6.93145751953125e-1  # ln 2 in two parts, so that x - k ln 2 keeps its digits
LN2_LOW = 1.42860682030941723212e-6
ROUND = 6755399441055744.0  # 1.5 * 2^52: adding it leaves the rounded integer in the low bits
LIMIT = 708.0  # beyond, the stress is far outside the range of a double's usefulness


@njit(cache=True, error_model="numpy", nogil=True, fastmath={"contract", "nsz"}, forceinline=True)
def exponential(x, out):
    """Write exp(x) to ``out``; ``x`` is used up as scratch.

    Parameters
    ----------
    x, out : ndarray, shape (n,), float64, contiguous
        Values are clamped to +-708, where exp is about 1e307.
    """
    bits = out.view(np.int64)
    for j in range(x.size):
        t = min(max(x[j], -LIMIT), LIMIT)
        # x = k ln 2 + r,  |r| <= ln 2 / 2
        shifted = t * LOG2_E + ROUND
        out[j] = shifted
        k = shifted - ROUND
        r = (t - k * LN2_HIGH) - k * LN2_LOW
        # exp(r) by its Taylor polynomial; the remainder r^13/13! is below 2e-16
        p = 1.0 / 39916800.0 + r * (1.0 / 479001600.0)
        p = 1.0 / 3628800.0 + r * p
        p = 1.0 / 362880.0 + r * p
        p = 1.0 / 40320.0 + r * p
        p = 1.0 / 5040.0 + r * p
        p = 1.0 / 720.0 + r * p
        p = 1.0 / 120.0 + r * p
        p = 1.0 / 24.0 + r * p
        p = 1.0 / 6.0 + r * p
        p = 0.5 + r * p
        p = 1.0 + r * p
        x[j] = 1.0 + r * p
    for j in range(x.size):
        bits[j] = (bits[j] + 1023) << 52  # the double 2^k
    for j in range(x.size):
        out[j] *= x[j]
