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
    correlation_factor,
    draw_means,
    integrate,
    inverse_from,
    invert,
    invert_donors,
    log_lkj,
    workspace,
)

LEAST_INSIDE = 0.01
WIDE = 0.1
"""Width of a range in sds; a normal about its edge has 0.04 of its mass inside."""
LEAST_PARTIAL = -1.0 + 1e-9
DONORS, SPECIMENS = 0, 1


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
    donor_scale: np.ndarray  # (b,): scales of the half-normal priors of the sds
    specimen_scale: np.ndarray
    eta_donors: float  # of the LKJ priors; zero or less without correlations
    eta_specimens: float


class Block(NamedTuple):
    """Values that may correlate, of all chains, and everything they have in common."""

    theta: np.ndarray  # (chains, n, b)
    mu: np.ndarray  # (chains, groups, b)
    effect: np.ndarray  # (chains, donors, b)
    sd_donors: np.ndarray  # (chains, b)
    partial_donors: np.ndarray  # (chains, b (b - 1) / 2): canonical partial correlations
    factor_donors: np.ndarray  # (chains, b, b): Cholesky factor of the correlation matrix
    sd: np.ndarray  # (chains, sets, b), of the specimens as the next two
    partial: np.ndarray
    factor: np.ndarray


class Augmented(NamedTuple):
    """Draws outside of the box that preceded those inside."""

    number: np.ndarray  # (chains, n)
    total: np.ndarray  # (chains, n, b), their sums
    square: np.ndarray  # (chains, sets, b, b), sums of their squares


@compiled()
def _inside(m, sd, low, high):
    """Share of a normal that lies in a range."""
    root = 1.0 / (sd * math.sqrt(2.0))
    return 0.5 * (math.erf((high - m) * root) - math.erf((low - m) * root))


@compiled()
def _augment(rng, layout, block, c, augmented):
    """The draws outside of the box that preceded each specimen's values, of chain c."""
    mu, effect, sd, factor = block.mu[c], block.effect[c], block.sd[c], block.factor[c]
    count, total, square = augmented.number[c], augmented.total[c], augmented.square[c]
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


@compiled()
def is_allowed(layout, mu, effect, sd):
    """Test that every location has enough of its normal inside the box."""
    for k in range(layout.low.size):
        if math.isinf(layout.low[k]) and math.isinf(layout.high[k]):
            continue
        for i in range(layout.group.size):
            g = layout.group[i]
            m = mu[g, k] + effect[layout.donor[i], k]
            s = sd[layout.set_of[g], k]
            if layout.low[k] <= m <= layout.high[k] and layout.high[k] - layout.low[k] > WIDE * s:
                continue
            if not _inside(m, s, layout.low[k], layout.high[k]) >= LEAST_INSIDE:
                return False
    return True


@compiled()
def _log_sd_prior(sd, scale):
    """Half-normal, as a density of the log."""
    return -0.5 * (sd / scale) ** 2 + math.log(sd)


@compiled(nogil=True)
def augment(rng, layout, block, augmented):
    """Draw the values outside of the box for all chains, into ``augmented``."""
    for c in range(block.mu.shape[0]):
        _augment(rng, layout, block, c, augmented)


@compiled()
def _prepare(layout, block, c, augmented, work):
    """Sums and precisions of chain c."""
    b = layout.low.size
    accumulate(
        layout,
        block.theta[c],
        augmented.number[c],
        augmented.total[c],
        augmented.square[c],
        work.sums,
    )
    invert(block.sd[c], block.factor[c], b, work.precisions)
    invert_donors(block.sd_donors[c], block.factor_donors[c], b, work.precisions)


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


SLICE_WIDTH = 1.0
MOST_STEPS = 8
MOST_TRIES = 60
"""Tries of a slice: then the interval is down to rounding, and the value stays."""


@compiled()
def _log_density_of_sd(x, layout, work, own, side, s, k, factor):
    """Log density of the log of one sd of `own` (sets, b), which is set to it."""
    b = layout.low.size
    own[s, k] = math.exp(x)
    if side == DONORS:
        invert_donors(own[0], factor, b, work.precisions)
        prior = _log_sd_prior(own[s, k], layout.donor_scale[k])
    else:
        invert(own, factor, b, work.precisions)
        prior = _log_sd_prior(own[s, k], layout.specimen_scale[k])
    return prior + integrate(layout, work)


@compiled()
def _slice_of_sd(rng, layout, work, own, side, s, k, factor):
    """Slice sampling (Neal 2003) of one sd with the means integrated out."""
    args = (layout, work, own, side, s, k, factor)
    x0 = math.log(own[s, k])
    level = _log_density_of_sd(x0, *args) + math.log(1.0 - rng.random())
    low = x0 - SLICE_WIDTH * rng.random()
    high = low + SLICE_WIDTH
    left = int(MOST_STEPS * rng.random())
    right = MOST_STEPS - 1 - left
    while left > 0 and _log_density_of_sd(low, *args) > level:
        low -= SLICE_WIDTH
        left -= 1
    while right > 0 and _log_density_of_sd(high, *args) > level:
        high += SLICE_WIDTH
        right -= 1
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
def _log_density_of_correlations(partial, factor, b, eta, scatter, count, work, inverse):
    """Log density of partial correlations given ``count`` vectors of unit sds and this scatter."""
    correlation_factor(partial, b, factor)
    value = log_lkj(partial, b, eta)
    for i in range(b):
        value -= count * math.log(factor[i, i])
        for j in range(i + 1):
            work[i, j] = factor[i, j]
    inverse_from(work, b, inverse)
    for i in range(b):
        for j in range(b):
            value -= 0.5 * inverse[i, j] * scatter[i, j]
    return value


@compiled()
def _correlations(rng, partial, factor, b, eta, scatter, count):
    """Slices of all partial correlations, given what they are the correlations of."""
    work, inverse = np.empty((b, b)), np.empty((b, b))
    args = (partial, factor, b, eta, scatter, count, work, inverse)
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
def _scatter_of_specimens(layout, sums, mu, effect, sd, out):
    """Squares about the locations in units of the sds; the number of vectors."""
    D, G = sums.N.shape
    b = layout.low.size
    out[:] = 0.0
    for s in range(layout.sets):
        for k in range(b):
            for j in range(b):
                out[k, j] += sums.Q[s, k, j] / (sd[s, k] * sd[s, j])
    m = np.empty(b)
    for d in range(D):
        for g in range(G):
            N = sums.N[d, g]
            if N == 0.0:
                continue
            s = layout.set_of[g]
            for k in range(b):
                m[k] = mu[g, k] + effect[d, k]
            for k in range(b):
                for j in range(b):
                    x = N * m[k] * m[j] - sums.S[d, g, k] * m[j] - m[k] * sums.S[d, g, j]
                    out[k, j] += x / (sd[s, k] * sd[s, j])
    return sums.ns.sum()


@compiled()
def _scatter_of_donors(effect, sd, out):
    """Squares of the effects in units of the sds; the number of vectors."""
    D, b = effect.shape
    for k in range(b):
        for j in range(b):
            x = 0.0
            for d in range(D):
                x += effect[d, k] * effect[d, j]
            out[k, j] = x / (sd[k] * sd[j])
    return float(D)


@compiled(nogil=True)
def update(rng, layout, block, augmented, cycles):
    """Move spreads, correlations, means and donor effects of all chains, in place.

    Sds move with means and donor effects integrated out and take these along; correlations move
    given them. The specimens' values stay. Without a cycle only means and effects are drawn;
    ``augmented`` is drawn again in every cycle but the first.
    """
    C, _, b = block.theta.shape
    work = workspace(layout)
    old_mu, old_effect = np.empty((layout.set_of.size, b)), np.empty((layout.donors, b))
    scatter = np.empty((b, b))
    cut = False
    for k in range(b):
        cut = cut or not (math.isinf(layout.low[k]) and math.isinf(layout.high[k]))
    moves = b + layout.sets * b if cycles > 0 else 1
    for c in range(C):
        mu, effect, sd_donors, sd = (block.mu[c], block.effect[c], block.sd_donors[c], block.sd[c])
        for cycle in range(max(cycles, 1)):
            if cycle > 0 and cut:
                _augment(rng, layout, block, c, augmented)
            _prepare(layout, block, c, augmented, work)
            for move in range(moves):
                side, s, k = DONORS, 0, move
                own, factor = block.sd_donors[c : c + 1], block.factor_donors[c]
                if move >= b:
                    side, s, k = SPECIMENS, (move - b) // b, (move - b) % b
                    own, factor = sd, block.factor[c]
                before = own[s, k]
                if cycles > 0:
                    _slice_of_sd(rng, layout, work, own, side, s, k, factor)
                else:
                    integrate(layout, work)
                if not cut and move < moves - 1:
                    continue  # means are drawn once, at the end
                old_mu[:] = mu
                old_effect[:] = effect
                draw_means(rng, layout, work, mu, effect)
                if cut and not is_allowed(layout, mu, effect, sd):
                    # the whole move is refused: spread, means and effects stay together
                    mu[:] = old_mu
                    effect[:] = old_effect
                    own[s, k] = before
                    if side == DONORS:
                        invert_donors(sd_donors, factor, b, work.precisions)
                    else:
                        invert(sd, factor, b, work.precisions)
            if cycles > 0 and layout.eta_donors > 0.0:
                vectors = _scatter_of_donors(effect, sd_donors, scatter)
                own_partial, own_factor = (block.partial_donors[c], block.factor_donors[c])
                _correlations(rng, own_partial, own_factor, b, layout.eta_donors, scatter, vectors)
            if cycles > 0 and layout.eta_specimens > 0.0:
                vectors = _scatter_of_specimens(layout, work.sums, mu, effect, sd, scatter)
                own_partial, own_factor = block.partial[c], block.factor[c]
                _correlations(
                    rng, own_partial, own_factor, b, layout.eta_specimens, scatter, vectors
                )
