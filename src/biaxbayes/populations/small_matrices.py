"""Matrices of a few rows, compiled: factors, inverses, correlations by canonical partial ones."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

__all__ = ["cholesky", "correlation_factor", "inverse_from", "log_lkj", "precision"]


@njit(cache=True)
def cholesky(a, n):
    """Lower Cholesky factor in place; log determinant, NaN where not positive definite."""
    total = 0.0
    for i in range(n):
        for j in range(i + 1):
            s = a[i, j]
            for k in range(j):
                s -= a[i, k] * a[j, k]
            if i == j:
                if not s > 0.0:
                    return np.nan
                a[i, i] = math.sqrt(s)
                total += math.log(s)
            else:
                a[i, j] = s / a[j, j]
    return total


@njit(cache=True)
def inverse_from(c, n, out):
    """Inverse of C C' from the lower factor C."""
    # column by column: solve C y = e, then C' x = y
    for k in range(n):
        for i in range(n):
            s = 1.0 if i == k else 0.0
            for j in range(i):
                s -= c[i, j] * out[j, k]
            out[i, k] = s / c[i, i]
        for i in range(n - 1, -1, -1):
            s = out[i, k]
            for j in range(i + 1, n):
                s -= c[j, i] * out[j, k]
            out[i, k] = s / c[i, i]


@njit(cache=True)
def correlation_factor(partial, b, out):
    """Lower factor of a correlation matrix from its canonical partial correlations."""
    k = 0
    for i in range(b):
        rest = 1.0
        for j in range(i):
            out[i, j] = partial[k] * math.sqrt(rest)
            rest *= 1.0 - partial[k] * partial[k]
            k += 1
        out[i, i] = math.sqrt(max(rest, 1e-12))
        for j in range(i + 1, b):
            out[i, j] = 0.0


@njit(cache=True)
def log_lkj(partial, b, eta):
    """Log density of an LKJ(eta) correlation matrix in its partial correlations."""
    # p(c_ij) ~ (1 - c^2)^(eta + (b - 2 - j) / 2 - 1)
    total, k = 0.0, 0
    for i in range(b):
        for j in range(i):
            total += (eta + 0.5 * (b - 2 - j) - 1.0) * math.log1p(-partial[k] * partial[k])
            k += 1
    return total


@njit(cache=True)
def precision(sd, factor, b, work, out):
    """Inverse of diag(sd) F F' diag(sd) into ``out``; returns the log determinant of the matrix."""
    total = 0.0
    for i in range(b):
        for j in range(i + 1):
            work[i, j] = sd[i] * factor[i, j]
        total += 2.0 * math.log(work[i, i])
    inverse_from(work, b, out)
    return total
