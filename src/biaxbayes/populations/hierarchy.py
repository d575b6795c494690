r"""Group means, donor effects and covariances of a population, given its specimens.

Specimen i of group g and donor d has values theta_i (p of them) from a truncated normal:

    theta_i | m_i, Sigma_g  ~  N(m_i, Sigma_g) inside the box,     m_i = mu_g + b_d
    b_d ~ N(0, Omega)        mu_g ~ N(m0, diag(s0^2))
    Sigma = diag(sd) R diag(sd)      sd_k ~ half-normal(a_k)      R ~ LKJ(eta)

and likewise Omega. The truncation gives the density the normaliser 1 / P(box | m_i, Sigma). It is
never computed: rejection sampling draws a truncated normal as the first draw inside the box, so the
rejected draws before it are auxiliary variables, simulated again in every sweep (Rao, Lin and
Dunson, Biometrika 103 (2016) 319). With them as further specimens, everything is normal. Group
means and donor effects are integrated out while an sd is moved, and drawn exactly from their
normal (:mod:`.collapsed`).

The model excludes a location m_i if P(low_k <= N(m_ik, sd_k^2) <= high_k) < 0.01 for one of its
values k.

The values may be any quantities. Arrays have the chain as first axis; values are centred on the
prior means of the groups.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from biaxbayes.compilation import compiled
from biaxbayes.populations.collapsed import (
    accumulate,
    draw_means,
    integrate,
    inverse_from,
    invert,
    workspace,
)

MIN_INSIDE_PROBABILITY = 0.01
MIN_WIDTH_IN_SDS = 0.1
"""A wider range needs no check: a normal centred on its bound has 0.04 of its mass inside."""
MIN_PARTIAL = -1.0 + 1e-9
SLICE_WIDTH = 4.0
"""Width w of the initial interval (Neal 2003) for the log of an sd."""
MAX_SHRINKAGES = 60
"""Shrinkages of a slice: then the interval is down to rounding, and the value stays."""


class Layout(NamedTuple):
    """Group and donor of each specimen, and priors of one block of values that may correlate."""

    group: np.ndarray  # (n,): index of the group of each specimen
    donor: np.ndarray  # (n,): index of its donor
    covariance_index: np.ndarray  # (groups,): index of the covariance Sigma of each group
    donors: int
    sets: int  # number of covariances Sigma
    low: np.ndarray  # (b,): the box, centred as the values; infinite where unbounded
    high: np.ndarray
    mean_sd: np.ndarray  # (b,): prior sd of the groups' means
    scale: np.ndarray  # (2, b), of the half-normal priors of the sds: of donors, of specimens
    eta: np.ndarray  # (2,), of the LKJ priors of both; zero without correlations


class Block(NamedTuple):
    """Values that may correlate, of all chains, and everything they have in common."""

    theta: np.ndarray  # (chains, n, b)
    mu: np.ndarray  # (chains, groups, b)
    effect: np.ndarray  # (chains, donors, b)
    sd: np.ndarray  # (chains, 1 + sets, b): of donors, then of specimens
    partial: np.ndarray  # (chains, 2, b (b - 1) / 2): canonical partial correlations of both
    factor: np.ndarray  # (chains, 2, b, b): Cholesky factors of the correlation matrices


class Augmented(NamedTuple):
    """Rejected draws, outside the box, before each specimen's value inside."""

    rejected: np.ndarray  # (chains, n), their number
    total: np.ndarray  # (chains, n, b), their sums
    square: np.ndarray  # (chains, sets, b, b), sums of their squares


@compiled(nogil=True)
def augment(rng, layout, block):
    """Draw the rejected values, outside the box, before each specimen's, of all chains."""
    C, n, b = block.theta.shape
    rejected, total = np.zeros((C, n)), np.zeros((C, n, b))
    square = np.zeros((C, layout.sets, b, b))
    z, y = np.empty(b), np.empty(b)
    for c in range(C):
        for i in range(n):
            g, d = layout.group[i], layout.donor[i]
            s = layout.covariance_index[g]
            while True:
                outside = False
                for k in range(b):
                    z[k] = rng.standard_normal()
                for k in range(b):
                    y[k] = block.mu[c, g, k] + block.effect[c, d, k]
                    for j in range(k + 1):
                        y[k] += block.sd[c, 1 + s, k] * block.factor[c, 1, k, j] * z[j]
                    outside = outside or y[k] < layout.low[k] or y[k] > layout.high[k]
                if not outside:
                    break
                rejected[c, i] += 1.0
                for k in range(b):
                    total[c, i, k] += y[k]
                    for j in range(b):
                        square[c, s, k, j] += y[k] * y[j]
    return Augmented(rejected, total, square)


@compiled()
def is_allowed(layout, mu, effect, sd):
    """Test that every location has enough of its normal inside the box; sd (1 + sets, b)."""
    for k in range(layout.low.size):
        low, high = layout.low[k], layout.high[k]
        if math.isinf(low) and math.isinf(high):
            continue
        for i in range(layout.group.size):
            g = layout.group[i]
            m = mu[g, k] + effect[layout.donor[i], k]
            s = sd[1 + layout.covariance_index[g], k]
            if low <= m <= high and high - low > MIN_WIDTH_IN_SDS * s:
                continue
            root = 1.0 / (s * math.sqrt(2.0))
            inside = 0.5 * (math.erf((high - m) * root) - math.erf((low - m) * root))
            if not inside >= MIN_INSIDE_PROBABILITY:
                return False
    return True


@compiled()
def _fill_statistics(layout, block, c, augmented, work):
    """Fill sums and inverse covariances of chain c into the workspace."""
    rejected, total, square = augmented
    accumulate(layout, block.theta[c], rejected[c], total[c], square[c], work)
    for s in range(1 + layout.sets):
        invert(block.sd[c], block.factor[c], s, work)


@compiled(nogil=True)
def log_marginal(layout, block, augmented):
    """Log density (chains,) of the specimens' values, means and effects integrated out."""
    C = block.theta.shape[0]
    out = np.empty(C)
    work = workspace(layout)
    for c in range(C):
        _fill_statistics(layout, block, c, augmented, work)
        out[c] = integrate(layout, work)
    return out


@compiled()
def _set_log_sd(x, layout, work, sd, factor, s, k):
    """Set sd[s, k] = exp(x) and its inverse covariance; return the log density of x."""
    sd[s, k] = math.exp(x)
    invert(sd, factor, s, work)
    # half-normal, as a density of x = ln sd: -sd^2 / (2 a^2) + x
    prior = -0.5 * (sd[s, k] / layout.scale[min(s, 1), k]) ** 2 + x
    return prior + integrate(layout, work)


@compiled()
def _slice_sample_sd(rng, layout, work, sd, factor, s, k):
    """Move one sd in place by slice sampling (Neal 2003), means and effects integrated out.

    The last evaluation leaves sd and inverse covariance at the accepted value.
    """
    x0 = math.log(sd[s, k])
    args = (layout, work, sd, factor, s, k)
    level = _set_log_sd(x0, *args) + math.log(1.0 - rng.random())
    low = x0 - SLICE_WIDTH * rng.random()
    high = low + SLICE_WIDTH
    for _ in range(MAX_SHRINKAGES):
        x = low + rng.random() * (high - low)
        if _set_log_sd(x, *args) >= level:
            return
        if x < x0:
            low = x
        else:
            high = x
    _set_log_sd(x0, *args)


@compiled()
def _draw_locations(rng, layout, block, c, work):
    """Draw means and donor effects; False, and they stay, if a location is not allowed."""
    mu, effect = block.mu[c], block.effect[c]
    old_mu, old_effect = mu.copy(), effect.copy()
    draw_means(rng, layout, work, mu, effect)
    if is_allowed(layout, mu, effect, block.sd[c]):
        return True
    mu[:] = old_mu
    effect[:] = old_effect
    return False


@compiled()
def _set_correlations(partial, factor, eta, scatter_matrix, count):
    """Log density of partial correlations c given ``count`` standardised vectors with a scatter V.

    Fills the Cholesky factor F of their correlation matrix R = F F'. Prior and likelihood are

        p(c_ij) ~ (1 - c_ij^2)^(eta + (b - 2 - j) / 2 - 1)
        ln L = -count ln |F| - 1/2 tr(R^-1 V),   V = sum_i z_i z_i',   z_i = (theta_i - m_i) / sd
    """
    b = scatter_matrix.shape[0]
    value, p = 0.0, 0
    for i in range(b):
        rest = 1.0
        for j in range(i):
            square = partial[p] * partial[p]
            factor[i, j] = partial[p] * math.sqrt(rest)
            rest *= 1.0 - square
            value += (eta + 0.5 * (b - 2 - j) - 1.0) * math.log1p(-square)
            p += 1
        factor[i, i] = math.sqrt(max(rest, 1e-12))
        value -= count * math.log(factor[i, i])
    inverse = np.empty((b, b))
    inverse_from(factor, b, inverse)
    return value - 0.5 * (inverse * scatter_matrix).sum()


@compiled()
def _slice_sample_correlations(rng, partial, factor, eta, scatter_matrix, count):
    """Move all partial correlations in place by slice sampling, given standardised vectors."""
    args = (partial, factor, eta, scatter_matrix, count)
    for k in range(partial.size):
        x0 = partial[k]
        level = _set_correlations(*args) + math.log(1.0 - rng.random())
        low, high = MIN_PARTIAL, -MIN_PARTIAL
        for tried in range(MAX_SHRINKAGES):
            partial[k] = low + rng.random() * (high - low)
            if tried == MAX_SHRINKAGES - 1:
                partial[k] = x0
            if _set_correlations(*args) >= level:
                break
            if partial[k] < x0:
                low = partial[k]
            else:
                high = partial[k]


@compiled()
def _scatter_matrix(layout, work, mu, effect, sd):
    """Scatter about the locations m in units of the sds (1 + sets, b), shape (b, b).

    V_kj = sum over sets, donors and groups of (Q - S m' - m S' + N m m')_kj / (sd_k sd_j)
    """
    D, G = work.N.shape
    b = layout.low.size
    out, m = np.zeros((b, b)), np.empty(b)
    for s in range(layout.sets):
        for k in range(b):
            for j in range(b):
                out[k, j] += work.Q[s, k, j] / (sd[1 + s, k] * sd[1 + s, j])
    for d in range(D):
        for g in range(G):
            N, S, s = work.N[d, g], work.S[d, g], 1 + layout.covariance_index[g]
            for k in range(b):
                m[k] = mu[g, k] + effect[d, k]
            for k in range(b):
                for j in range(b):
                    x = N * m[k] * m[j] - S[k] * m[j] - m[k] * S[j]
                    out[k, j] += x / (sd[s, k] * sd[s, j])
    return out


@compiled(nogil=True)
def update(rng, layout, block, augmented):
    """Move sds, correlations, means and donor effects of all chains, in place.

    Sds move with means and donor effects integrated out and take these along; correlations move
    given them. The specimens' values stay.
    """
    work = workspace(layout)
    for c in range(block.theta.shape[0]):
        sd, partial, factor = block.sd[c], block.partial[c], block.factor[c]
        _fill_statistics(layout, block, c, augmented, work)
        for s in range(sd.shape[0]):
            for k in range(sd.shape[1]):
                before = sd[s, k]
                _slice_sample_sd(rng, layout, work, sd, factor, s, k)
                if not _draw_locations(rng, layout, block, c, work):
                    # the whole move is rejected: sd, means and effects stay together
                    sd[s, k] = before
                    invert(sd, factor, s, work)
        if layout.eta[0] > 0.0:
            z = block.effect[c] / sd[0]
            count = float(layout.donors)
            _slice_sample_correlations(rng, partial[0], factor[0], layout.eta[0], z.T @ z, count)
        if layout.eta[1] > 0.0:
            scatter_matrix = _scatter_matrix(layout, work, block.mu[c], block.effect[c], sd)
            _slice_sample_correlations(
                rng, partial[1], factor[1], layout.eta[1], scatter_matrix, work.N.sum()
            )


@compiled(nogil=True)
def draw_locations(rng, layout, block, augmented):
    """Draw means and donor effects of all chains, in place; where they are allowed, (chains,)."""
    C = block.theta.shape[0]
    allowed = np.empty(C, dtype=np.bool_)
    work = workspace(layout)
    for c in range(C):
        _fill_statistics(layout, block, c, augmented, work)
        integrate(layout, work)
        allowed[c] = _draw_locations(rng, layout, block, c, work)
    return allowed
