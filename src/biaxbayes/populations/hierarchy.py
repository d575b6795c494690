r"""Means, donors and spreads given the specimens: the part of a population with closed forms.

Specimen i of group g and donor d has values theta_i (p of them), cut at a box:

    theta_i | m_i, Sigma_g  ~  N(m_i, Sigma_g) inside the box,     m_i = mu_g + b_d
    b_d ~ N(0, Omega)        mu_g ~ N(m0, diag(s0^2))
    Sigma = diag(sd) R diag(sd)      sd_k ~ half-normal(a_k)      R ~ LKJ(eta)

and Omega alike. Where the box cuts, the normaliser P(box | m_i, Sigma) stands in the density. It is
never computed: a cut normal is a normal whose draws outside of the box were thrown away, so these
draws are made up again in every sweep (Rao, Lin and Dunson, Biometrika 103 (2016) 319) and count as
further specimens, after which everything is normal. Group means and donor effects are then
integrated out while a spread is moved, and drawn exactly from their normal.

A location m_i with less than 1 % of its normal inside the range of one of its values is excluded
from the model.

Nothing here knows what the values are of. Arrays have the chain as first axis; values are centred
on the prior means of the groups.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

__all__ = ["Layout", "augment", "log_marginal", "update"]

LEAST_INSIDE = 0.01
LOG_2PI = math.log(2.0 * math.pi)


class Layout(NamedTuple):
    """Who belongs to whom, and the priors of one block of values that may correlate.

    Attributes
    ----------
    group, donor : int64 ndarray, shape (n,)
        Of each specimen.
    set_of : int64 ndarray, shape (groups,)
        Which set of spreads a group has.
    donors, sets : int
    low, high : ndarray, shape (b,)
        The box, centred as the values are; infinite where there is no edge.
    mean_sd : ndarray, shape (b,)
        Prior sd of the groups' means.
    donor_scale, specimen_scale : ndarray, shape (b,)
        Scales of the half-normal priors of the sds.
    eta_donors, eta_specimens : float
        Of the LKJ priors; zero or less where there are no correlations.
    """

    group: np.ndarray
    donor: np.ndarray
    set_of: np.ndarray
    donors: int
    sets: int
    low: np.ndarray
    high: np.ndarray
    mean_sd: np.ndarray
    donor_scale: np.ndarray
    specimen_scale: np.ndarray
    eta_donors: float
    eta_specimens: float


@njit(cache=True)
def _cholesky(a, n):
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
def _inverse_from(c, n, out):
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
def _correlation_factor(partial, b, out):
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
def _log_lkj(partial, b, eta):
    """Log density of an LKJ(eta) correlation matrix in its partial correlations."""
    # p(c_ij) ~ (1 - c^2)^(eta + (b - 2 - j) / 2 - 1)
    total, k = 0.0, 0
    for i in range(b):
        for j in range(i):
            total += (eta + 0.5 * (b - 2 - j) - 1.0) * math.log1p(-partial[k] * partial[k])
            k += 1
    return total


@njit(cache=True)
def _precision(sd, factor, b, work, out):
    """Inverse of diag(sd) F F' diag(sd) into ``out``; returns the log determinant of the matrix."""
    total = 0.0
    for i in range(b):
        for j in range(i + 1):
            work[i, j] = sd[i] * factor[i, j]
        total += 2.0 * math.log(work[i, i])
    _inverse_from(work, b, out)
    return total


@njit(cache=True)
def _inside(m, sd, low, high):
    """Share of a normal that lies in a range."""
    root = 1.0 / (sd * math.sqrt(2.0))
    return 0.5 * (math.erf((high - m) * root) - math.erf((low - m) * root))


@njit(cache=True)
def _augment(rng, layout, mu, effect, sd, factor, count, total, square):
    """The draws outside of the box that a specimen's value was preceded by, of one chain."""
    n, b = layout.group.size, layout.low.size
    z, y = np.empty(b), np.empty(b)
    count[:] = 0.0
    total[:] = 0.0
    square[:] = 0.0
    for i in range(n):
        g, d = layout.group[i], layout.donor[i]
        s = layout.set_of[g]
        while True:
            outside = False
            for k in range(b):
                z[k] = rng.standard_normal()
            for k in range(b):
                y[k] = mu[g, k] + effect[d, k]
                for j in range(k + 1):
                    y[k] += sd[s, k] * factor[k, j] * z[j]
                if y[k] < layout.low[k] or y[k] > layout.high[k]:
                    outside = True
            if not outside:
                break
            count[i] += 1.0
            for k in range(b):
                total[i, k] += y[k]
                for j in range(b):
                    square[s, k, j] += y[k] * y[j]


@njit(cache=True)
def _gather(layout, theta, count, total, square, N, S, Q, ns):
    """Sums over the specimens of a chain, by donor and group."""
    n, b = theta.shape
    N[:] = 0.0
    S[:] = 0.0
    Q[:] = square
    ns[:] = 0.0
    for i in range(n):
        g, d = layout.group[i], layout.donor[i]
        s = layout.set_of[g]
        N[d, g] += 1.0 + count[i]
        ns[s] += 1.0 + count[i]
        for k in range(b):
            S[d, g, k] += theta[i, k] + total[i, k]
            for j in range(b):
                Q[s, k, j] += theta[i, k] * theta[i, j]


@njit(cache=True)
def _collapse(layout, N, S, Q, ns, P, logdet, Om, logdet_d, A, M, r):
    """Log density of the sums with means and donor effects integrated out.

    P, Om are precisions of specimens (by set) and donors. Fills A (inverse precision of each
    donor's effect given the means), M (Cholesky factor of the precision of the means) and r (its
    linear term).
    """
    D, G = N.shape
    b = layout.low.size
    value = 0.0
    for s in range(layout.sets):
        value -= 0.5 * ns[s] * (logdet[s] + b * LOG_2PI)
        for k in range(b):
            for j in range(b):
                value -= 0.5 * P[s, k, j] * Q[s, k, j]
    M[:] = 0.0
    r[:] = 0.0
    work = np.empty((b, b))
    t, v = np.empty(b), np.empty(b)
    left = np.empty((b, b))
    for g in range(G):
        for k in range(b):
            M[g * b + k, g * b + k] = 1.0 / layout.mean_sd[k] ** 2
            value -= math.log(layout.mean_sd[k])
    # donors with as many specimens in every group have one A: it is worked out once for them
    first, alike = np.empty(D, dtype=np.int64), np.zeros(D)
    logs = np.empty(D)
    kinds = 0
    for d in range(D):
        kind = 0
        while kind < kinds and np.any(N[first[kind]] != N[d]):
            kind += 1
        if kind == kinds:
            # A^-1 = Omega^-1 + sum_g N_dg P_g
            for k in range(b):
                for j in range(b):
                    work[k, j] = Om[k, j]
            for g in range(G):
                if N[d, g] > 0.0:
                    s = layout.set_of[g]
                    for k in range(b):
                        for j in range(b):
                            work[k, j] += N[d, g] * P[s, k, j]
            logs[kind] = _cholesky(work, b)
            if not np.isfinite(logs[kind]):
                return -np.inf
            _inverse_from(work, b, A[d])
            first[kind] = d
            kinds += 1
        else:
            for k in range(b):
                for j in range(b):
                    A[d, k, j] = A[first[kind], k, j]
        alike[kind] += 1.0
        value -= 0.5 * (logs[kind] + logdet_d)
        for k in range(b):
            t[k] = 0.0
        for g in range(G):
            if N[d, g] > 0.0:
                s = layout.set_of[g]
                for k in range(b):
                    for j in range(b):
                        t[k] += P[s, k, j] * S[d, g, j]
        for k in range(b):
            v[k] = 0.0
            for j in range(b):
                v[k] += A[d, k, j] * t[j]
        for k in range(b):
            value += 0.5 * t[k] * v[k]
        for g in range(G):
            if N[d, g] == 0.0:
                continue
            s = layout.set_of[g]
            for k in range(b):
                for j in range(b):
                    r[g * b + k] += P[s, k, j] * (S[d, g, j] - N[d, g] * v[j])
    for kind in range(kinds):
        d = first[kind]
        for g in range(G):
            if N[d, g] == 0.0:
                continue
            s = layout.set_of[g]
            times = alike[kind] * N[d, g]
            for k in range(b):
                for j in range(b):
                    M[g * b + k, g * b + j] += times * P[s, k, j]
                    left[k, j] = 0.0
                    for q in range(b):
                        left[k, j] += P[s, k, q] * A[d, q, j]
            for h in range(G):
                if N[d, h] == 0.0:
                    continue
                u = layout.set_of[h]
                for k in range(b):
                    for j in range(b):
                        x = 0.0
                        for q in range(b):
                            x += left[k, q] * P[u, q, j]
                        M[g * b + k, h * b + j] -= times * N[d, h] * x
    size = G * b
    found = _cholesky(M, size)
    if not np.isfinite(found):
        return -np.inf
    value -= 0.5 * found
    # 1/2 r' (C C')^-1 r = 1/2 |C^-1 r|^2
    for i in range(size):
        x = r[i]
        for j in range(i):
            x -= M[i, j] * r[j]
        r[i] = x / M[i, i]
        value += 0.5 * r[i] * r[i]
    return value


@njit(cache=True)
def _draw(rng, layout, N, S, P, A, M, r, mu, effect):
    """Means and donor effects from their normal; r is C^-1 times the linear term."""
    D, G = N.shape
    b = layout.low.size
    size = G * b
    x = np.empty(size)
    for i in range(size):
        x[i] = r[i] + rng.standard_normal()
    for i in range(size - 1, -1, -1):
        for j in range(i + 1, size):
            x[i] -= M[j, i] * x[j]
        x[i] /= M[i, i]
    for g in range(G):
        for k in range(b):
            mu[g, k] = x[g * b + k]
    work, h = np.empty((b, b)), np.empty(b)
    z = np.empty(b)
    for d in range(D):
        h[:] = 0.0
        for g in range(G):
            s = layout.set_of[g]
            for k in range(b):
                for j in range(b):
                    h[k] += P[s, k, j] * (S[d, g, j] - N[d, g] * mu[g, j])
        for k in range(b):
            for j in range(b):
                work[k, j] = A[d, k, j]
            z[k] = rng.standard_normal()
        _cholesky(work, b)
        for k in range(b):
            effect[d, k] = 0.0
            for j in range(b):
                effect[d, k] += A[d, k, j] * h[j]
            for j in range(k + 1):
                effect[d, k] += work[k, j] * z[j]


@njit(cache=True)
def _allowed(layout, mu, effect, sd):
    """Whether every location has enough of its normal inside the box."""
    for k in range(layout.low.size):
        if math.isinf(layout.low[k]) and math.isinf(layout.high[k]):
            continue
        for i in range(layout.group.size):
            g = layout.group[i]
            m = mu[g, k] + effect[layout.donor[i], k]
            s = sd[layout.set_of[g], k]
            if not _inside(m, s, layout.low[k], layout.high[k]) >= LEAST_INSIDE:
                return False
    return True


@njit(cache=True)
def _log_sd_prior(sd, scale):
    """Half-normal, as a density of the log."""
    return -0.5 * (sd / scale) ** 2 + math.log(sd)


@njit(cache=True, nogil=True)
def augment(rng, layout, mu, effect, sd, factor, count, total, square):
    """Make up the draws outside of the box, for all chains.

    Parameters
    ----------
    rng : numpy.random.Generator
    layout : Layout
    mu : ndarray, shape (chains, groups, b); effect : ndarray, shape (chains, donors, b)
    sd : ndarray, shape (chains, sets, b); factor : ndarray, shape (chains, b, b)
        Sds of specimens, and the Cholesky factor of their correlations.
    count : ndarray, shape (chains, n)
        Filled with their number,
    total : ndarray, shape (chains, n, b); square : ndarray, shape (chains, sets, b, b)
        their sums, and the sums of their squares.
    """
    for c in range(mu.shape[0]):
        _augment(rng, layout, mu[c], effect[c], sd[c], factor[c], count[c], total[c], square[c])


@njit(cache=True, nogil=True)
def log_marginal(layout, theta, count, total, square, sd_donors, factor_donors, sd, factor):
    """Log density of the specimens' values with means and donor effects integrated out.

    Up to a constant, shape (chains,). Arguments as in :func:`augment` and :func:`update`.
    """
    C, _, b = theta.shape
    G, D = layout.set_of.size, layout.donors
    out = np.empty(C)
    N, S = np.empty((D, G)), np.empty((D, G, b))
    Q, ns = np.empty((layout.sets, b, b)), np.empty(layout.sets)
    P, logdet = np.empty((layout.sets, b, b)), np.empty(layout.sets)
    Om, work = np.empty((b, b)), np.empty((b, b))
    A, M, r = np.empty((D, b, b)), np.empty((G * b, G * b)), np.empty(G * b)
    for c in range(C):
        _gather(layout, theta[c], count[c], total[c], square[c], N, S, Q, ns)
        for s in range(layout.sets):
            logdet[s] = _precision(sd[c, s], factor[c], b, work, P[s])
        logdet_d = _precision(sd_donors[c], factor_donors[c], b, work, Om)
        out[c] = _collapse(layout, N, S, Q, ns, P, logdet, Om, logdet_d, A, M, r)
    return out


DONORS, SPECIMENS = 0, 1
SLICE_WIDTH = 1.0
MOST_STEPS = 8


@njit(cache=True, nogil=True)
def update(
    rng,
    layout,
    theta,
    count,
    total,
    square,
    mu,
    effect,
    sd_donors,
    partial_donors,
    factor_donors,
    sd,
    partial,
    factor,
    cycles,
):
    """Move spreads, correlations, means and donor effects of all chains, in place.

    Parameters
    ----------
    rng : numpy.random.Generator
    layout : Layout
    theta : ndarray, shape (chains, n, b)
        Values of the specimens, which stay.
    count, total, square
        As in :func:`augment`; made anew in every cycle.
    mu : ndarray, shape (chains, groups, b); effect : ndarray, shape (chains, donors, b)
    sd_donors : ndarray, shape (chains, b); sd : ndarray, shape (chains, sets, b)
    partial_donors, partial : ndarray, shape (chains, b (b - 1) / 2)
        Canonical partial correlations,
    factor_donors, factor : ndarray, shape (chains, b, b)
        and the Cholesky factors that they make.
    cycles : int
        With no cycle, means and donor effects alone are drawn.
    """
    C, _, b = theta.shape
    G, D = layout.set_of.size, layout.donors
    N, S = np.empty((D, G)), np.empty((D, G, b))
    Q, ns = np.empty((layout.sets, b, b)), np.empty(layout.sets)
    P, logdet = np.empty((layout.sets, b, b)), np.empty(layout.sets)
    Om, work = np.empty((b, b)), np.empty((b, b))
    A, M, r = np.empty((D, b, b)), np.empty((G * b, G * b)), np.empty(G * b)
    old_mu, old_effect = np.empty((G, b)), np.empty((D, b))
    cut = False
    for k in range(b):
        cut = cut or not (math.isinf(layout.low[k]) and math.isinf(layout.high[k]))
    pairs = b * (b - 1) // 2
    moves = b + layout.sets * b
    if layout.eta_donors > 0.0:
        moves += pairs
    if layout.eta_specimens > 0.0:
        moves += pairs
    for c in range(C):
        for cycle in range(max(cycles, 1)):
            if cycle > 0 and cut:
                _augment(
                    rng, layout, mu[c], effect[c], sd[c], factor[c], count[c], total[c], square[c]
                )
            _gather(layout, theta[c], count[c], total[c], square[c], N, S, Q, ns)
            for s in range(layout.sets):
                logdet[s] = _precision(sd[c, s], factor[c], b, work, P[s])
            logdet_d = _precision(sd_donors[c], factor_donors[c], b, work, Om)
            for move in range(moves if cycles > 0 else 1):
                kind, s, k = DONORS, 0, move
                correlation = False
                if move >= b:
                    kind, s, k = SPECIMENS, (move - b) // b, (move - b) % b
                if move >= b + layout.sets * b:
                    correlation = True
                    k = move - b - layout.sets * b
                    kind = DONORS
                    if layout.eta_donors <= 0.0 or k >= pairs:
                        kind = SPECIMENS
                        if layout.eta_donors > 0.0:
                            k -= pairs
                if cycles > 0:
                    # slice sampling (Neal 2003) of one coordinate with the means integrated out
                    if correlation:
                        x0 = math.atanh(partial_donors[c, k] if kind == DONORS else partial[c, k])
                    elif kind == DONORS:
                        x0 = math.log(sd_donors[c, k])
                    else:
                        x0 = math.log(sd[c, s, k])
                    low_x = x0 - SLICE_WIDTH * rng.random()
                    high_x = low_x + SLICE_WIDTH
                    level = 0.0
                    stage, steps, x = 0, 0, x0
                    left = int(MOST_STEPS * rng.random())
                    right = MOST_STEPS - 1 - left
                    while True:
                        # stages: 0 the level, 1 step out to the left, 2 to the right, 3 shrink
                        if stage == 1:
                            x = low_x
                        elif stage == 2:
                            x = high_x
                        elif stage == 3:
                            x = low_x + rng.random() * (high_x - low_x)
                        prior = 0.0
                        if correlation:
                            value = math.tanh(x)
                            value = min(max(value, -1.0 + 1e-9), 1.0 - 1e-9)
                            if kind == DONORS:
                                partial_donors[c, k] = value
                                _correlation_factor(partial_donors[c], b, factor_donors[c])
                                prior = _log_lkj(partial_donors[c], b, layout.eta_donors)
                            else:
                                partial[c, k] = value
                                _correlation_factor(partial[c], b, factor[c])
                                prior = _log_lkj(partial[c], b, layout.eta_specimens)
                            prior += math.log1p(-value * value)  # d tanh(x) / dx
                        elif kind == DONORS:
                            sd_donors[c, k] = math.exp(x)
                            prior = _log_sd_prior(sd_donors[c, k], layout.donor_scale[k])
                        else:
                            sd[c, s, k] = math.exp(x)
                            prior = _log_sd_prior(sd[c, s, k], layout.specimen_scale[k])
                        if kind == DONORS:
                            logdet_d = _precision(sd_donors[c], factor_donors[c], b, work, Om)
                        else:
                            for q in range(layout.sets):
                                logdet[q] = _precision(sd[c, q], factor[c], b, work, P[q])
                        height = prior + _collapse(
                            layout, N, S, Q, ns, P, logdet, Om, logdet_d, A, M, r
                        )
                        if stage == 0:
                            level = height + math.log(1.0 - rng.random())
                            stage = 1
                        elif stage == 1:
                            if height > level and steps < left:
                                low_x -= SLICE_WIDTH
                                steps += 1
                            else:
                                stage, steps = 2, 0
                        elif stage == 2:
                            if height > level and steps < right:
                                high_x += SLICE_WIDTH
                                steps += 1
                            else:
                                stage, steps = 3, 0
                        elif height >= level or steps > 60:
                            break
                        else:
                            if x < x0:
                                low_x = x
                            else:
                                high_x = x
                            steps += 1
                            if steps == 60:  # numbers end: where it came from
                                low_x = high_x = x0
                else:
                    x0 = 0.0
                    correlation = False
                    _collapse(layout, N, S, Q, ns, P, logdet, Om, logdet_d, A, M, r)
                if not cut and move < moves - 1 and cycles > 0:
                    continue  # means are drawn once, at the end
                old_mu[:] = mu[c]
                old_effect[:] = effect[c]
                _draw(rng, layout, N, S, P, A, M, r, mu[c], effect[c])
                if cut and not _allowed(layout, mu[c], effect[c], sd[c]):
                    # the whole move is refused: spread, means and effects stay together
                    mu[c] = old_mu
                    effect[c] = old_effect
                    if cycles > 0:
                        if correlation:
                            if kind == DONORS:
                                partial_donors[c, k] = math.tanh(x0)
                                _correlation_factor(partial_donors[c], b, factor_donors[c])
                            else:
                                partial[c, k] = math.tanh(x0)
                                _correlation_factor(partial[c], b, factor[c])
                        elif kind == DONORS:
                            sd_donors[c, k] = math.exp(x0)
                        else:
                            sd[c, s, k] = math.exp(x0)
                        for q in range(layout.sets):
                            logdet[q] = _precision(sd[c, q], factor[c], b, work, P[q])
                        logdet_d = _precision(sd_donors[c], factor_donors[c], b, work, Om)
