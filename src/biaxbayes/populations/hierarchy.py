r"""Group means, donor effects and covariances of a population, given its specimens.

Specimen i of group g and donor d has values theta_i (p of them) from a truncated normal:

    theta_i | m_i, Sigma_g  ~  N(m_i, Sigma_g) inside the box,     m_i = mu_g + b_d
    b_d ~ N(0, Omega)        mu_g ~ N(0, diag(s0^2))
    Sigma = diag(sd) R diag(sd)      sd_k ~ half-normal(a_k)      R ~ LKJ(eta)

and likewise Omega. The truncation gives the density the normaliser 1 / P(box | m_i, Sigma). It is
never computed: rejection sampling draws a truncated normal as the first draw inside the box, so the
rejected draws before it are auxiliary variables, simulated again in every sweep (Rao, Lin and
Dunson, Biometrika 103 (2016) 319). With them as further specimens, everything is normal.

The values are centred on the prior means of the groups. Arrays have the chain as first axis, then
the block of values: K blocks of b = 1 independent value, or K = 1 of all b = p correlated ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtr

MIN_INSIDE_PROBABILITY = 0.01
"""Least P(low_k <= N(m_ik, sd_k^2) <= high_k) of a location m_i, for each of its values k."""
SD_RANGE = np.log([1e-4, 20.0])
"""Range of ln sd, relative to the scale of its prior, which has 1e-4 of its mass outside."""
SLICE_WIDTH = 4.0
"""Width w of the initial interval (Neal 2003) for the log of an sd."""


@dataclass(frozen=True, eq=False)
class Layout:
    """Group and donor of each specimen, and priors."""

    group: np.ndarray  # (n,): index of the group of each specimen
    donor: np.ndarray  # (n,): index of its donor
    covariance_index: np.ndarray  # (groups,): index of the covariance Sigma of each group
    donors: int
    sets: int  # number of covariances Sigma
    low: np.ndarray  # (p,): the box, centred as the values; infinite where unbounded
    high: np.ndarray
    mean_sd: np.ndarray  # (p,): prior sd of the groups' means
    scale: np.ndarray  # (2, p), of the half-normal priors of the sds: of donors, of specimens
    eta: np.ndarray  # (2,), of the LKJ priors of both; zero without correlations

    @property
    def set_of(self) -> np.ndarray:
        """Index of the covariance Sigma of each specimen, (n,)."""
        return np.asarray(self.covariance_index[self.group])


class Sums(NamedTuple):
    """Specimens with the draws rejected before them, block by block."""

    N: np.ndarray  # (C, K, n): number
    S: np.ndarray  # (C, K, n, b): sum
    Q: np.ndarray  # (C, K, sets, b, b): sum of squares of a set's specimens


def correlation_factors(partial: np.ndarray, b: int) -> np.ndarray:
    """Cholesky factors (M, b, b) of correlations from canonical partial ones (M, pairs or 0)."""
    if not partial.size:
        return np.tile(np.eye(b), (len(partial), 1, 1))
    out = np.zeros((len(partial), b, b))
    k = 0
    for i in range(b):
        rest = np.ones(len(partial))
        for j in range(i):
            out[:, i, j] = partial[:, k] * np.sqrt(rest)
            rest = rest * (1.0 - partial[:, k] ** 2)
            k += 1
        out[:, i, i] = np.sqrt(np.maximum(rest, 1e-12))
    return out


def inside_probability(location: Any, sd: Any, low: Any, high: Any) -> np.ndarray:
    """Probability of a range under a normal."""
    return np.asarray(ndtr((high - location) / sd) - ndtr((low - location) / sd))


class Common:
    """What the specimens have in common, of C chains, and its moves."""

    STATE = ("mu", "effect", "sd", "partial")

    def __init__(self, layout: Layout, theta: np.ndarray, rng: np.random.Generator) -> None:
        """Means start at those of ``theta`` (C, n, p), sds over-dispersed around their scale."""
        self.layout, self.rng = layout, rng
        self.C, _, self.p = theta.shape
        self.b = self.p if layout.eta.any() else 1
        self.K = self.p // self.b
        means = [theta[:, layout.group == g].mean(1) for g in range(len(layout.covariance_index))]
        self.mu = np.stack(means, axis=1).clip(layout.low, layout.high)
        self.effect = np.zeros((self.C, layout.donors, self.p))
        spread = rng.uniform(-1.5, 0.5, (self.C, 1 + layout.sets, self.p))
        self.sd = np.exp(spread) * np.repeat(layout.scale, [1, layout.sets], axis=0)
        self.partial = np.zeros((self.C, 2, self.b * (self.b - 1) // 2))

    def _blocks(self, values: np.ndarray) -> np.ndarray:
        """Values (C, m, p) by block, (C, K, m, b)."""
        return values.reshape(len(values), -1, self.K, self.b).swapaxes(1, 2)

    def m(self) -> np.ndarray:
        """Locations of the specimens, (C, n, p)."""
        return self.mu[:, self.layout.group] + self.effect[:, self.layout.donor]

    def factors(self, side: int) -> np.ndarray:
        """Cholesky factors (C, b, b) of the correlations of donors (0) or specimens (1)."""
        return correlation_factors(self.partial[:, side], self.b)

    def inverse_covariances(self) -> tuple[np.ndarray, np.ndarray]:
        """Inverses (C, K, 1 + sets, b, b) of Omega and every Sigma, and their log determinants."""
        sd = self._blocks(self.sd)
        F = np.stack([self.factors(0)] + [self.factors(1)] * self.layout.sets, axis=1)[:, None]
        log_det = 2.0 * (np.log(sd) + np.log(np.diagonal(F, axis1=-2, axis2=-1))).sum(axis=-1)
        root = np.linalg.inv(F) / sd[..., None, :]
        return root.swapaxes(-1, -2) @ root, log_det

    def precisions(self) -> np.ndarray:
        """Inverse covariance of every specimen with all of its values, (C, n, p, p)."""
        P = self.inverse_covariances()[0][:, :, 1 + self.layout.set_of]
        out = np.zeros((self.C, P.shape[2], self.p, self.p))
        for k in range(self.K):
            at = slice(k * self.b, (k + 1) * self.b)
            out[:, :, at, at] = P[:, k]
        return out

    def update(self, theta: np.ndarray) -> None:
        """Move sds, correlations, means and donor effects once, given the specimens' values."""
        sums = self.with_rejected(theta)
        for s in range(1 + self.layout.sets):
            for j in range(self.b):
                self._move_sd(sums, s, j)
        for side in (0, 1):
            if self.layout.eta[side] > 0.0:
                self._move_correlations(side, *self._scatter(side, sums))

    def with_rejected(self, theta: np.ndarray) -> Sums:
        """Sums of the specimens and of the draws outside the box that came before each."""
        layout, set_of = self.layout, self.layout.set_of
        x, m = self._blocks(theta), self._blocks(self.m())
        sd, F = self._blocks(self.sd[:, 1 + set_of]), self.factors(1)
        low, high = (e.reshape(self.K, self.b) for e in (layout.low, layout.high))
        sums = Sums(
            np.ones(x.shape[:3]),
            x.copy(),
            np.einsum("ckni,cknj,ns->cksij", x, x, np.eye(layout.sets)[set_of]),
        )
        bounded = (np.isfinite(low) | np.isfinite(high)).any(axis=1)
        at = np.nonzero(np.broadcast_to(bounded[:, None], x.shape[:3]))
        while len(at[0]):
            z = self.rng.standard_normal((len(at[0]), self.b))
            y = m[at] + sd[at] * (F[at[0]] @ z[..., None])[..., 0]
            outside = ((y < low[at[1]]) | (y > high[at[1]])).any(axis=1)
            at, y = tuple(a[outside] for a in at), y[outside]
            sums.N[at] += 1.0
            sums.S[at] += y
            np.add.at(sums.Q, (at[0], at[1], set_of[at[2]]), y[:, :, None] * y[:, None, :])
        return sums

    def log_marginal(self, sums: Sums) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Log density (C, K) of the specimens, x = (mu, b) integrated out, and what draws x.

            x | theta ~ N(M^-1 r, M^-1)    M = M_0 + sum_i N_i X_i X_i' (x) P_i
            r = sum_i X_i (x) P_i S_i      M_0 = diag(s0^-2, ..., Omega^-1, ...)
            ln p = 1/2 sum_i N_i ln |P_i| - 1/2 tr P Q + 1/2 ln |M_0| - 1/2 ln |M| + 1/2 r' M^-1 r

        The second and third results are the Cholesky factor L of M, and L^-1 r.
        """
        layout, C, K, b = self.layout, self.C, self.K, self.b
        G = len(layout.covariance_index)
        q = G + layout.donors
        # m = X (mu, b)
        X = np.hstack([np.eye(G)[layout.group], np.eye(layout.donors)[layout.donor]])
        P, log_det = self.inverse_covariances()
        own = P[:, :, 1 + layout.set_of]
        pairs = (X[:, :, None] * X[:, None, :]).reshape(len(X), q * q)
        NP = np.moveaxis(sums.N[..., None, None] * own, 2, -1)
        M = (NP @ pairs).reshape(C, K, b, b, q, q).transpose(0, 1, 4, 2, 5, 3)
        for g in range(G):
            M[:, :, g, range(b), g, range(b)] += 1.0 / layout.mean_sd.reshape(K, b) ** 2
        for d in range(G, q):
            M[:, :, d, :, d, :] += P[:, :, 0]
        PS = (own @ sums.S[..., None])[..., 0]
        r = (X.T @ PS).reshape(C, K, q * b, 1)
        L = np.linalg.cholesky(M.reshape(C, K, q * b, q * b))
        y = np.linalg.solve(L, r)[..., 0]
        value = -0.5 * (sums.N * log_det[:, :, 1 + layout.set_of]).sum(axis=-1)
        value -= 0.5 * (P[:, :, 1:] * sums.Q).sum(axis=(-3, -2, -1))
        value -= 0.5 * layout.donors * log_det[:, :, 0]
        value -= np.log(np.diagonal(L, axis1=-2, axis2=-1)).sum(axis=-1)
        return value + 0.5 * (y * y).sum(axis=-1), L, y

    def _move_sd(self, sums: Sums, s: int, j: int) -> None:
        """Move one sd of every block by a slice (Neal 2003), x = (mu, b) integrated out; draw x."""
        before, scale = self.sd.copy(), self.layout.scale[min(s, 1)].reshape(self.K, -1)[:, j]
        sd = self._blocks(self.sd)[:, :, s, j]  # a view

        def log_density(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            sd[:] = np.exp(x)
            value, L, y = self.log_marginal(sums)
            # half-normal, as a density of x = ln sd: -sd^2 / (2 a^2) + x
            return value - 0.5 * (sd / scale) ** 2 + x, L, y

        ends = np.log(scale) + SD_RANGE[:, None]
        _, (_, L, y) = slice_sample(self.rng, log_density, np.log(sd), SLICE_WIDTH, *ends)
        # x = M^-1 r + L'^-1 z = L'^-1 (L^-1 r + z)
        z = y + self.rng.standard_normal(y.shape)
        x = np.linalg.solve(L.swapaxes(-1, -2), z[..., None])
        x = x.reshape(self.C, self.K, -1, self.b).swapaxes(1, 2).reshape(self.C, -1, self.p)
        mu, effect = np.split(x, [self.mu.shape[1]], axis=1)
        m = mu[:, self.layout.group] + effect[:, self.layout.donor]
        own = self.sd[:, 1 + self.layout.set_of]
        inside = inside_probability(m, own, self.layout.low, self.layout.high)
        # a location that is not allowed takes the whole move of its block back
        allowed = self._blocks(inside >= MIN_INSIDE_PROBABILITY).all(axis=(2, 3))
        allowed = allowed.repeat(self.b, axis=1)[:, None]
        self.mu = np.where(allowed, mu, self.mu)
        self.effect = np.where(allowed, effect, self.effect)
        self.sd = np.where(allowed, self.sd, before)

    def _scatter(self, side: int, sums: Sums) -> tuple[np.ndarray, np.ndarray]:
        """Scatter V (C, b, b) of donor effects or specimens in units of their sds; their number.

        V = sum over specimens of (Q - S m' - m S' + N m m') / (sd sd')
        """
        if side == 0:
            z = self.effect / self.sd[:, :1]
            return z.swapaxes(1, 2) @ z, np.full(self.C, float(self.layout.donors))
        V, m = np.zeros((self.C, self.b, self.b)), self.m()
        for s in range(self.layout.sets):
            of = self.layout.set_of == s
            Sm = sums.S[:, 0, of].swapaxes(1, 2) @ m[:, of]
            mm = (sums.N[:, 0, of, None] * m[:, of]).swapaxes(1, 2) @ m[:, of]
            sd = self.sd[:, 1 + s]
            V += (sums.Q[:, 0, s] - Sm - Sm.swapaxes(1, 2) + mm) / (sd[:, :, None] * sd[:, None])
        return V, sums.N[:, 0].sum(axis=1)

    def _move_correlations(self, side: int, V: np.ndarray, count: np.ndarray) -> None:
        """Move all partial correlations c by slices, given ``count`` vectors with a scatter V.

        With the Cholesky factor F of the correlation matrix R = F F'

            p(c_ij) ~ (1 - c_ij^2)^(eta + (b - 2 - j) / 2 - 1)
            ln L = -count ln |F| - 1/2 tr(R^-1 V)
        """
        partial = self.partial[:, side]
        j = np.tril_indices(self.b, -1)[1]
        power = self.layout.eta[side] + 0.5 * (self.b - 2 - j) - 1.0

        for k in range(partial.shape[1]):

            def log_density(x: np.ndarray, k: int = k) -> tuple[np.ndarray]:
                partial[:, k] = x
                F = correlation_factors(partial, self.b)
                value = np.log1p(-(partial**2)) @ power
                value -= count * np.log(np.diagonal(F, axis1=1, axis2=2)).sum(axis=1)
                inverse = np.linalg.inv(F)
                return (value - 0.5 * (inverse.swapaxes(1, 2) @ inverse * V).sum(axis=(1, 2)),)

            slice_sample(self.rng, log_density, partial[:, k].copy(), 2.0, -1 + 1e-9, 1 - 1e-9)


def slice_sample(
    rng: np.random.Generator, log_density: Any, x0: np.ndarray, width: float, low: Any, high: Any
) -> tuple[np.ndarray, Any]:
    """Slice sampling of many numbers in a range; the last evaluation is at the result."""
    level = log_density(x0)[0] + np.log1p(-rng.random(x0.shape))
    left = x0 - width * rng.random(x0.shape)
    left, right = np.maximum(left, low), np.minimum(left + width, high)
    x, searching = x0, np.ones(x0.shape, dtype=bool)
    while True:
        drawn = left + rng.random(x0.shape) * (right - left)
        x = np.where(searching, drawn, x)
        found = log_density(x)
        searching &= found[0] < level
        if not searching.any():
            return x, found
        left = np.where(searching & (x < x0), x, left)
        right = np.where(searching & (x > x0), x, right)
