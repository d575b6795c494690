"""Collapsed Gibbs: the marginal likelihood without group means and donor effects, and their draws.

Specimens theta_i ~ N(mu_g + b_d, Sigma_g), donor effects b_d ~ N(0, Omega), group means
mu_g ~ N(0, S0) with S0 = diag(s0^2). With P_g = Sigma_g^-1, counts N_dg, sums S_dg and squares Q of
the specimens, the donor effects are integrated out first, then the means:

    A_d^-1 = Omega^-1 + sum_g N_dg P_g
    h_d    = sum_g P_g S_dg
    M_gh   = [g = h] (S0^-1 + sum_d N_dg P_g) - sum_d N_dg P_g A_d P_h N_dh
    r_g    = sum_d P_g (S_dg - N_dg A_d h_d)

    ln p = - 1/2 sum_i ln |2 pi Sigma_g(i)| - 1/2 tr P Q
           - 1/2 sum_d (ln |A_d^-1| + ln |Omega|) + 1/2 sum_d h_d' A_d h_d
           - 1/2 (ln |S0| + ln |M|) + 1/2 r' M^-1 r
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from biaxbayes.compilation import compiled

LOG_2PI = math.log(2.0 * math.pi)


class Workspace(NamedTuple):
    """Sufficient statistics of one chain, and the factors that :func:`draw_means` needs."""

    N: np.ndarray  # (donors, groups), counts of specimens
    S: np.ndarray  # (donors, groups, b), their sums
    Q: np.ndarray  # (sets, b, b), sums of squares
    P: np.ndarray  # (1 + sets, b, b), inverse covariances of donors and of specimens
    log_det: np.ndarray  # (1 + sets,), of the covariances
    A: np.ndarray  # (donors, b, b): covariance of a donor's effect given the means
    M: np.ndarray  # (groups b, groups b): Cholesky factor C of the precision M of the means
    r: np.ndarray  # (groups b,): C^-1 r, the linear term of the means times C^-1


@compiled()
def workspace(layout):
    """An empty :class:`Workspace` of a layout."""
    D, G, sets, b = layout.donors, layout.covariance_index.size, layout.sets, layout.low.size
    return Workspace(
        np.empty((D, G)),
        np.empty((D, G, b)),
        np.empty((sets, b, b)),
        np.empty((1 + sets, b, b)),
        np.empty(1 + sets),
        np.empty((D, b, b)),
        np.empty((G * b, G * b)),
        np.empty(G * b),
    )


@compiled()
def cholesky(a, n):
    """Lower Cholesky factor in place; log determinant, NaN where not positive definite.

    Not ``np.linalg.cholesky``, which raises on a matrix that is not positive definite.
    """
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
def invert(sd, factor, s, work):
    """Inverse and log determinant of diag(sd) F F' diag(sd), of donors (s = 0) or a set."""
    b = sd.shape[1]
    root = np.empty((b, b))
    work.log_det[s] = 0.0
    for i in range(b):
        for j in range(i + 1):
            root[i, j] = sd[s, i] * factor[min(s, 1), i, j]
        work.log_det[s] += 2.0 * math.log(root[i, i])
    inverse_from(root, b, work.P[s])


@compiled()
def accumulate(layout, theta, rejected, total, square, work):
    """Sums of a chain: theta (n, b), and number, total and square of the rejected draws."""
    work.N[:] = 0.0
    work.S[:] = 0.0
    work.Q[:] = square
    for i in range(theta.shape[0]):
        g, d = layout.group[i], layout.donor[i]
        s = layout.covariance_index[g]
        work.N[d, g] += 1.0 + rejected[i]
        for k in range(theta.shape[1]):
            work.S[d, g, k] += theta[i, k] + total[i, k]
            for j in range(theta.shape[1]):
                work.Q[s, k, j] += theta[i, k] * theta[i, j]


@compiled()
def integrate(layout, work):
    """Log density of the sums with means and donor effects integrated out; fills A, M and r."""
    N, S, Q, P, log_det, A, M, r = work
    (D, G), b = N.shape, layout.low.size
    inverse, PA, h, Ah = np.empty((b, b)), np.empty((b, b)), np.empty(b), np.empty(b)
    value = 0.0
    M[:] = 0.0
    r[:] = 0.0
    for s in range(layout.sets):
        for k in range(b):
            for j in range(b):
                value -= 0.5 * P[1 + s, k, j] * Q[s, k, j]
    for g in range(G):
        value -= 0.5 * N[:, g].sum() * (log_det[1 + layout.covariance_index[g]] + b * LOG_2PI)
        for k in range(b):
            M[g * b + k, g * b + k] = 1.0 / layout.mean_sd[k] ** 2
            value -= math.log(layout.mean_sd[k])
    for d in range(D):
        # A^-1 = Omega^-1 + sum_g N_g P_g,  h = sum_g P_g S_g
        for k in range(b):
            h[k] = 0.0
            for j in range(b):
                inverse[k, j] = P[0, k, j]
        for g in range(G):
            Pg = P[1 + layout.covariance_index[g]]
            for k in range(b):
                for j in range(b):
                    inverse[k, j] += N[d, g] * Pg[k, j]
                    M[g * b + k, g * b + j] += N[d, g] * Pg[k, j]
                    h[k] += Pg[k, j] * S[d, g, j]
        log = cholesky(inverse, b)
        if not np.isfinite(log):
            return -np.inf
        inverse_from(inverse, b, A[d])
        value -= 0.5 * (log + log_det[0])
        for k in range(b):
            Ah[k] = 0.0
            for j in range(b):
                Ah[k] += A[d, k, j] * h[j]
            value += 0.5 * h[k] * Ah[k]
        for g in range(G):
            if N[d, g] == 0.0:
                continue
            Pg = P[1 + layout.covariance_index[g]]
            for k in range(b):
                for j in range(b):
                    r[g * b + k] += Pg[k, j] * (S[d, g, j] - N[d, g] * Ah[j])
                    PA[k, j] = 0.0
                    for q in range(b):
                        PA[k, j] += Pg[k, q] * A[d, q, j]
            for other in range(G):
                both = N[d, g] * N[d, other]
                Ph = P[1 + layout.covariance_index[other]]
                for k in range(b):
                    for j in range(b):
                        for q in range(b):
                            M[g * b + k, other * b + j] -= both * PA[k, q] * Ph[q, j]
    log = cholesky(M, G * b)
    if not np.isfinite(log):
        return -np.inf
    value -= 0.5 * log
    # 1/2 r' (C C')^-1 r = 1/2 |C^-1 r|^2
    for i in range(G * b):
        for j in range(i):
            r[i] -= M[i, j] * r[j]
        r[i] /= M[i, i]
        value += 0.5 * r[i] * r[i]
    return value


@compiled()
def draw_means(rng, layout, work, mu, effect):
    """Draw means (groups, b) and donor effects (donors, b) in place, after :func:`integrate`."""
    N, S, _, P, _, A, M, r = work
    (D, G), b = N.shape, layout.low.size
    # mu = M^-1 r + C'^-1 z = C'^-1 (C^-1 r + z)
    for i in range(G * b - 1, -1, -1):
        x = r[i] + rng.standard_normal()
        for j in range(i + 1, G * b):
            x -= M[j, i] * mu[j // b, j % b]
        mu[i // b, i % b] = x / M[i, i]
    h, z = np.empty(b), np.empty(b)
    for d in range(D):
        h[:] = 0.0
        for g in range(G):
            Pg = P[1 + layout.covariance_index[g]]
            for k in range(b):
                for j in range(b):
                    h[k] += Pg[k, j] * (S[d, g, j] - N[d, g] * mu[g, j])
        # A h + C z = C (C' h + z) with A = C C'
        cholesky(A[d], b)
        for k in range(b):
            z[k] = rng.standard_normal()
            for j in range(k, b):
                z[k] += A[d, j, k] * h[j]
        for k in range(b):
            effect[d, k] = 0.0
            for j in range(k + 1):
                effect[d, k] += A[d, k, j] * z[j]
