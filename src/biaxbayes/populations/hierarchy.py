r"""Means, donors and spreads given the specimens: the part of a population with closed forms.

Specimen i of group g and donor d has values theta_i (p of them), cut at a box:

    theta_i | m_i, Sigma_g  ~  N(m_i, Sigma_g) inside the box,     m_i = mu_g + b_d
    b_d ~ N(0, Omega)        mu_g ~ N(m0, diag(s0^2))
    Sigma = diag(sd) R diag(sd)      sd_k ~ half-normal(a_k)      R ~ LKJ(eta)

and likewise Omega. Where the box cuts, the density has the normaliser P(box | m_i, Sigma). It is
never computed: a cut normal is a normal whose draws outside of the box were thrown away, so these
draws are simulated again in every sweep (Rao, Lin and Dunson, Biometrika 103 (2016) 319) and count
as further specimens, after which everything is normal. Group means and donor effects are then
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

from biaxbayes.compilation import compiled
from biaxbayes.populations.integrated import (
    accumulate,
    draw_means,
    integrate,
    inverse_from,
    invert,
    workspace,
)

LEAST_INSIDE = 0.01
WIDE = 0.1
"""Width of a range in sds; a normal about its edge has 0.04 of its mass inside."""
LEAST_PARTIAL = -1.0 + 1e-9
SLICE_WIDTH = 4.0
"""Width of the first interval of a slice of the log of an sd."""
MOST_TRIES = 60
"""Tries of a slice: then the interval is down to rounding, and the value stays."""


class Layout(NamedTuple):
    """Who belongs to whom, and the priors of one block of values that may correlate."""

    group: np.ndarray  # (n,)
    donor: np.ndarray  # (n,)
    set_of: np.ndarray  # (groups,): set of spreads of each group
    donors: int
    sets: int
    low: np.ndarray  # (b,): the box, centred as the values; infinite where there is no edge
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
    """Draws outside of the box that preceded those inside."""

    number: np.ndarray  # (chains, n)
    total: np.ndarray  # (chains, n, b), their sums
    square: np.ndarray  # (chains, sets, b, b), sums of their squares


@compiled(nogil=True)
def augment(rng, layout, block):
    """Draw the values outside of the box that preceded each specimen's, of all chains."""
    C, n, b = block.theta.shape
    number, total = np.zeros((C, n)), np.zeros((C, n, b))
    square = np.zeros((C, layout.sets, b, b))
    z, y = np.empty(b), np.empty(b)
    for c in range(C):
        for i in range(n):
            g, d = layout.group[i], layout.donor[i]
            s = layout.set_of[g]
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
                number[c, i] += 1.0
                for k in range(b):
                    total[c, i, k] += y[k]
                    for j in range(b):
                        square[c, s, k, j] += y[k] * y[j]
    return Augmented(number, total, square)


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
            s = sd[1 + layout.set_of[g], k]
            if low <= m <= high and high - low > WIDE * s:
                continue
            root = 1.0 / (s * math.sqrt(2.0))
            inside = 0.5 * (math.erf((high - m) * root) - math.erf((low - m) * root))
            if not inside >= LEAST_INSIDE:
                return False
    return True


@compiled()
def _prepare(layout, block, c, augmented, work):
    """Sums and inverse covariances of chain c."""
    number, total, square = augmented
    accumulate(layout, block.theta[c], number[c], total[c], square[c], work)
    for s in range(1 + layout.sets):
        invert(block.sd[c], block.factor[c], s, work)


@compiled(nogil=True)
def log_marginal(layout, block, augmented):
    """Log density (chains,) of the specimens' values, means and effects integrated out."""
    C = block.theta.shape[0]
    out = np.empty(C)
    work = workspace(layout)
    for c in range(C):
        _prepare(layout, block, c, augmented, work)
        out[c] = integrate(layout, work)
    return out


@compiled()
def _log_density_of_sd(x, layout, work, sd, factor, s, k):
    """Log density of the log of an sd, which is set to it."""
    sd[s, k] = math.exp(x)
    invert(sd, factor, s, work)
    # half-normal, as a density of the log
    prior = -0.5 * (sd[s, k] / layout.scale[min(s, 1), k]) ** 2 + x
    return prior + integrate(layout, work)


@compiled()
def _slice_of_sd(rng, layout, work, sd, factor, s, k):
    """Slice sampling (Neal 2003) of one sd with the means integrated out."""
    x0 = math.log(sd[s, k])
    args = (layout, work, sd, factor, s, k)
    level = _log_density_of_sd(x0, *args) + math.log(1.0 - rng.random())
    low = x0 - SLICE_WIDTH * rng.random()
    high = low + SLICE_WIDTH
    for _ in range(MOST_TRIES):
        x = low + rng.random() * (high - low)
        if _log_density_of_sd(x, *args) >= level:
            return
        if x < x0:
            low = x
        else:
            high = x
    _log_density_of_sd(x0, *args)


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
def _log_density_of_correlations(partial, factor, eta, scatter, count):
    """Log density of partial correlations given ``count`` vectors of unit sds and this scatter.

    Fills the Cholesky factor of their matrix; p(c_ij) ~ (1 - c^2)^(eta + (b - 2 - j) / 2 - 1).
    """
    b = scatter.shape[0]
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
    return value - 0.5 * (inverse * scatter).sum()


@compiled()
def _correlations(rng, partial, factor, eta, scatter, count):
    """Slices of all partial correlations, given what they are the correlations of."""
    args = (partial, factor, eta, scatter, count)
    for k in range(partial.size):
        x0 = partial[k]
        level = _log_density_of_correlations(*args) + math.log(1.0 - rng.random())
        low, high = LEAST_PARTIAL, -LEAST_PARTIAL
        for tried in range(MOST_TRIES):
            partial[k] = low + rng.random() * (high - low)
            if tried == MOST_TRIES - 1:
                partial[k] = x0
            if _log_density_of_correlations(*args) >= level:
                break
            if partial[k] < x0:
                low = partial[k]
            else:
                high = partial[k]


@compiled()
def _scatter_of_specimens(layout, work, mu, effect, sd):
    """Squares about the locations in units of the sds (1 + sets, b), shape (b, b)."""
    D, G = work.N.shape
    b = layout.low.size
    out, m = np.zeros((b, b)), np.empty(b)
    for s in range(layout.sets):
        for k in range(b):
            for j in range(b):
                out[k, j] += work.Q[s, k, j] / (sd[1 + s, k] * sd[1 + s, j])
    for d in range(D):
        for g in range(G):
            N, S, s = work.N[d, g], work.S[d, g], 1 + layout.set_of[g]
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
        _prepare(layout, block, c, augmented, work)
        for s in range(sd.shape[0]):
            for k in range(sd.shape[1]):
                before = sd[s, k]
                _slice_of_sd(rng, layout, work, sd, factor, s, k)
                if not _draw_locations(rng, layout, block, c, work):
                    # the whole move is refused: spread, means and effects stay together
                    sd[s, k] = before
                    invert(sd, factor, s, work)
        if layout.eta[0] > 0.0:
            z = block.effect[c] / sd[0]
            count = float(layout.donors)
            _correlations(rng, partial[0], factor[0], layout.eta[0], z.T @ z, count)
        if layout.eta[1] > 0.0:
            scatter = _scatter_of_specimens(layout, work, block.mu[c], block.effect[c], sd)
            _correlations(rng, partial[1], factor[1], layout.eta[1], scatter, work.N.sum())


@compiled(nogil=True)
def draw_locations(rng, layout, block, augmented):
    """Draw means and donor effects of all chains, in place; where they are allowed, (chains,)."""
    C = block.theta.shape[0]
    allowed = np.empty(C, dtype=np.bool_)
    work = workspace(layout)
    for c in range(C):
        _prepare(layout, block, c, augmented, work)
        integrate(layout, work)
        allowed[c] = _draw_locations(rng, layout, block, c, work)
    return allowed
