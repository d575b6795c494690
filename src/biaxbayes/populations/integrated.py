"""Marginal likelihood over group means and donor effects, and their conditional draws.

Specimens theta_i ~ N(mu_g + b_d, Sigma_g), donor effects b_d ~ N(0, Omega), group means
mu_g ~ N(0, S0) with S0 = diag(s0^2). With P_g = Sigma_g^-1, counts N_dg, sums S_dg and squares Q of
the specimens, the donor effects are integrated out first, then the means:

    A_d^-1 = Omega^-1 + sum_g N_dg P_g
    h_d    = sum_g P_g S_dg
    M_gh   = [g = h] (S0^-1 + sum_d N_dg P_g) - sum_d N_dg P_g A_d P_h N_dh
    r_g    = sum_d (P_g S_dg - N_dg P_g A_d h_d)

    ln p = - 1/2 sum_i ln |2 pi Sigma_g(i)| - 1/2 tr P Q
           - 1/2 sum_d (ln |A_d^-1| + ln |Omega|) + 1/2 sum_d h_d' A_d h_d
           - 1/2 (ln |S0| + ln |M|) + 1/2 r' M^-1 r

Donors with the same numbers of specimens per group (a pattern) share A_d, and only the sums of
their products are needed: the work of an evaluation does not grow with the donors.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from biaxbayes.compilation import compiled

# --- matrices of a few rows: factors, inverses, correlations by canonical partial ones -----------


@compiled()
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


@compiled()
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


@compiled()
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


@compiled()
def log_lkj(partial, b, eta):
    """Log density of an LKJ(eta) correlation matrix in its partial correlations."""
    # p(c_ij) ~ (1 - c^2)^(eta + (b - 2 - j) / 2 - 1)
    total, k = 0.0, 0
    for i in range(b):
        for j in range(i):
            total += (eta + 0.5 * (b - 2 - j) - 1.0) * math.log1p(-partial[k] * partial[k])
            k += 1
    return total


@compiled()
def precision(sd, factor, b, work, out):
    """Inverse of diag(sd) F F' diag(sd) into ``out``; returns the log determinant of the matrix."""
    total = 0.0
    for i in range(b):
        for j in range(i + 1):
            work[i, j] = sd[i] * factor[i, j]
        total += 2.0 * math.log(work[i, i])
    inverse_from(work, b, out)
    return total


# --- the integrals -------------------------------------------------------------------------------

LOG_2PI = math.log(2.0 * math.pi)


class Sums(NamedTuple):
    """Sums over the specimens of a chain and the augmented draws."""

    N: np.ndarray  # (donors, groups), counts
    S: np.ndarray  # (donors, groups, b)
    Q: np.ndarray  # (sets, b, b), sums of squares
    ns: np.ndarray  # (sets,), counts
    pattern: np.ndarray  # (donors,): index of the pattern of counts of each donor
    n_patterns: np.ndarray  # (1,)
    counts: np.ndarray  # (patterns, groups)
    multiplicity: np.ndarray  # (patterns,): how many donors have these counts
    first: np.ndarray  # (patterns, groups, b): sum of S_g over their donors
    second: np.ndarray  # (patterns, groups, groups, b, b): sum of S_g S_h'
    total: np.ndarray  # (groups, b): sum over all donors


class Precisions(NamedTuple):
    """Inverse covariances of specimens and donors, and log determinants of the covariances."""

    P: np.ndarray  # (sets, b, b)
    logdet: np.ndarray  # (sets,)
    omega: np.ndarray  # (b, b)
    logdet_donors: np.ndarray  # (1,)
    work: np.ndarray


class Solved(NamedTuple):
    """Matrices that means and effects are drawn with, and two work arrays (b, b)."""

    A: np.ndarray  # (patterns, b, b): covariance of a donor's effect given the means
    M: np.ndarray  # (groups b, groups b): Cholesky factor of the precision of the means
    r: np.ndarray  # (groups b,): its inverse times the linear term of the means
    left: np.ndarray
    middle: np.ndarray


class Workspace(NamedTuple):
    """Everything that the integrals of a chain are computed from and leave behind."""

    sums: Sums
    precisions: Precisions
    solved: Solved


@compiled()
def workspace(layout):
    """An empty :class:`Workspace` of a layout."""
    D, G, sets, b = layout.donors, layout.set_of.size, layout.sets, layout.low.size
    sums = Sums(
        np.empty((D, G)),
        np.empty((D, G, b)),
        np.empty((sets, b, b)),
        np.empty(sets),
        np.empty(D, dtype=np.int64),
        np.zeros(1, dtype=np.int64),
        np.empty((D, G)),
        np.empty(D),
        np.empty((D, G, b)),
        np.empty((D, G, G, b, b)),
        np.empty((G, b)),
    )
    precisions = Precisions(
        np.empty((sets, b, b)), np.empty(sets), np.empty((b, b)), np.empty(1), np.empty((b, b))
    )
    solved = Solved(
        np.empty((D, b, b)),
        np.empty((G * b, G * b)),
        np.empty(G * b),
        np.empty((b, b)),
        np.empty((b, b)),
    )
    return Workspace(sums, precisions, solved)


@compiled()
def accumulate(layout, theta, count, total, square, sums):
    """Sums of a chain: theta (n, b), and count, total and square of the augmented draws."""
    n, b = theta.shape
    D, G = sums.N.shape
    sums.N[:] = 0.0
    sums.S[:] = 0.0
    sums.Q[:] = square
    sums.ns[:] = 0.0
    sums.total[:] = 0.0
    for i in range(n):
        g, d = layout.group[i], layout.donor[i]
        s = layout.set_of[g]
        sums.N[d, g] += 1.0 + count[i]
        sums.ns[s] += 1.0 + count[i]
        for k in range(b):
            x = theta[i, k] + total[i, k]
            sums.S[d, g, k] += x
            sums.total[g, k] += x
            for j in range(b):
                sums.Q[s, k, j] += theta[i, k] * theta[i, j]
    patterns = 0
    for d in range(D):
        pattern = 0
        while pattern < patterns:
            same = True
            for g in range(G):
                same = same and sums.counts[pattern, g] == sums.N[d, g]
            if same:
                break
            pattern += 1
        if pattern == patterns:
            patterns += 1
            sums.multiplicity[pattern] = 0.0
            sums.first[pattern] = 0.0
            sums.second[pattern] = 0.0
            for g in range(G):
                sums.counts[pattern, g] = sums.N[d, g]
        sums.pattern[d] = pattern
        sums.multiplicity[pattern] += 1.0
        for g in range(G):
            for k in range(b):
                x = sums.S[d, g, k]
                sums.first[pattern, g, k] += x
                for h in range(G):
                    for j in range(b):
                        sums.second[pattern, g, h, k, j] += x * sums.S[d, h, j]
    sums.n_patterns[0] = patterns


@compiled()
def invert(sd, factor, b, precisions):
    """Precisions of specimens from sds (sets, b) and the factor of their correlations."""
    for s in range(sd.shape[0]):
        precisions.logdet[s] = precision(sd[s], factor, b, precisions.work, precisions.P[s])


@compiled()
def invert_donors(sd, factor, b, precisions):
    """Precision of donors from sds (b,) and the factor of their correlations."""
    precisions.logdet_donors[0] = precision(sd, factor, b, precisions.work, precisions.omega)


@compiled()
def integrate(layout, work):
    """Log density of the sums with means and donor effects integrated out; fills ``solved``."""
    sums, precisions, solved = work
    G = sums.N.shape[1]
    b = layout.low.size
    P, A, M, r = precisions.P, solved.A, solved.M, solved.r
    left, middle = solved.left, solved.middle
    value = 0.0
    for s in range(layout.sets):
        value -= 0.5 * sums.ns[s] * (precisions.logdet[s] + b * LOG_2PI)
        for k in range(b):
            for j in range(b):
                value -= 0.5 * P[s, k, j] * sums.Q[s, k, j]
    M[:] = 0.0
    for g in range(G):
        s = layout.set_of[g]
        for k in range(b):
            M[g * b + k, g * b + k] = 1.0 / layout.mean_sd[k] ** 2
            value -= math.log(layout.mean_sd[k])
            x = 0.0
            for j in range(b):
                x += P[s, k, j] * sums.total[g, j]
            r[g * b + k] = x
    for pattern in range(sums.n_patterns[0]):
        multiplicity = sums.multiplicity[pattern]
        # A^-1 = Omega^-1 + sum_g N_g P_g
        for k in range(b):
            for j in range(b):
                middle[k, j] = precisions.omega[k, j]
        for g in range(G):
            if sums.counts[pattern, g] > 0.0:
                s = layout.set_of[g]
                for k in range(b):
                    for j in range(b):
                        own = sums.counts[pattern, g] * P[s, k, j]
                        middle[k, j] += own
                        M[g * b + k, g * b + j] += multiplicity * own
        log = cholesky(middle, b)
        if not np.isfinite(log):
            return -np.inf
        inverse_from(middle, b, A[pattern])
        value -= 0.5 * multiplicity * (log + precisions.logdet_donors[0])
        for s in range(layout.sets):
            for k in range(b):
                for j in range(b):
                    x = 0.0
                    for q in range(b):
                        x += P[s, k, q] * A[pattern, q, j]
                    left[k, j] = x
            for u in range(layout.sets):
                for k in range(b):
                    for j in range(b):
                        x = 0.0
                        for q in range(b):
                            x += left[k, q] * P[u, q, j]
                        middle[k, j] = x
                for g in range(G):
                    if layout.set_of[g] != s or sums.counts[pattern, g] == 0.0:
                        continue
                    for h in range(G):
                        if layout.set_of[h] != u or sums.counts[pattern, h] == 0.0:
                            continue
                        own = sums.counts[pattern, g]
                        both = multiplicity * own * sums.counts[pattern, h]
                        for k in range(b):
                            for j in range(b):
                                x = middle[k, j]
                                value += 0.5 * x * sums.second[pattern, g, h, k, j]
                                M[g * b + k, h * b + j] -= both * x
                                r[g * b + k] -= own * x * sums.first[pattern, h, j]
    size = G * b
    log = cholesky(M, size)
    if not np.isfinite(log):
        return -np.inf
    value -= 0.5 * log
    # 1/2 r' (C C')^-1 r = 1/2 |C^-1 r|^2
    for i in range(size):
        x = r[i]
        for j in range(i):
            x -= M[i, j] * r[j]
        r[i] = x / M[i, i]
        value += 0.5 * r[i] * r[i]
    return value


@compiled()
def draw_means(rng, layout, work, mu, effect):
    """Draw means (groups, b) and donor effects (donors, b) in place; factorises `solved.A`."""
    sums, precisions, solved = work
    D, G = sums.N.shape
    b = layout.low.size
    P, A, M, r = precisions.P, solved.A, solved.M, solved.r
    size = G * b
    for i in range(size):
        r[i] += rng.standard_normal()
    for i in range(size - 1, -1, -1):
        x = r[i]
        for j in range(i + 1, size):
            x -= M[j, i] * r[j]
        r[i] = x / M[i, i]
    for g in range(G):
        for k in range(b):
            mu[g, k] = r[g * b + k]
    for pattern in range(sums.n_patterns[0]):
        cholesky(A[pattern], b)
    h, z = np.empty(b), np.empty(b)
    for d in range(D):
        pattern = sums.pattern[d]
        h[:] = 0.0
        for g in range(G):
            if sums.N[d, g] > 0.0:
                s = layout.set_of[g]
                for k in range(b):
                    for j in range(b):
                        h[k] += P[s, k, j] * (sums.S[d, g, j] - sums.N[d, g] * mu[g, j])
        # A h + C z = C (C' h + z) with A = C C'
        for k in range(b):
            z[k] = rng.standard_normal()
            for j in range(k, b):
                z[k] += A[pattern, j, k] * h[j]
        for k in range(b):
            effect[d, k] = 0.0
            for j in range(k + 1):
                effect[d, k] += A[pattern, k, j] * z[j]
