"""Densities with exact draws, and what every move must do to them.

A move is right if it leaves the target as it is and looks the same run backwards. Both are tested
from walkers that are exact draws of the target, after a single step:

    stationary    E f(x') = E f(x) = known
    reversible    E [f(x) g(x') - g(x) f(x')] = 0

for many functions f, g at once (Bonferroni).
"""

from dataclasses import dataclass, field
from functools import cache

import emcee
import numpy as np
from scipy.stats import norm

from biaxbayes.sampling.target import bounds_array


@dataclass(frozen=True, eq=False)
class Target:
    """A normalised density, with exact independent draws."""

    name: str
    dimension: int
    log_density: object
    sample: object
    limits: dict = field(default_factory=dict)

    @property
    def bounds(self):
        """Bounds of the coordinates, shape (d, 2)."""
        return bounds_array(self.limits, self.dimension)


def gaussian(d):
    """Correlated, with sds over two decades."""
    rng = np.random.default_rng(d)
    factor = np.linalg.qr(rng.standard_normal((d, d)))[0] * np.geomspace(0.1, 10, d)
    inverse = np.linalg.inv(factor)
    constant = -np.log(np.abs(np.linalg.det(factor))) - 0.5 * d * np.log(2 * np.pi)
    mean = np.arange(d) - 2.0
    return Target(
        f"gaussian-{d}",
        d,
        lambda x: constant - 0.5 * (((x - mean) @ inverse.T) ** 2).sum(axis=1),
        lambda rng, n: mean + rng.standard_normal((n, d)) @ factor.T,
    )


def banana(d):
    """Two bent pairs, the rest Gaussian: x_2 = z_2 + b (z_1^2 - 1)."""

    def straight(x):
        z = x.copy()
        z[:, 1] -= 0.8 * (x[:, 0] ** 2 - 1)
        z[:, 3] -= 1.2 * (x[:, 2] ** 2 - 1) + x[:, 0]
        return z

    def sample(rng, n):
        z = rng.standard_normal((n, d))
        z[:, 1] += 0.8 * (z[:, 0] ** 2 - 1)
        z[:, 3] += 1.2 * (z[:, 2] ** 2 - 1) + z[:, 0]
        return z

    return Target(f"banana-{d}", d, lambda x: norm.logpdf(straight(x)).sum(axis=1), sample)


def half_bounded(d, *, with_bounds):
    """x_0 > 0 half-normal, x_1 between 0 and 1 with most mass at 0; the others follow them."""

    def log_density(x):
        inside = (x[:, 0] >= 0) & (x[:, 1] >= 0) & (x[:, 1] <= 1)
        z = x[:, 2:] - x[:, :1] + 0.5 * x[:, 1:2]
        logs = np.log(2) + norm.logpdf(x[:, 0])
        logs = logs + np.log(4 / (1 - np.exp(-4))) - 4 * x[:, 1] + norm.logpdf(z).sum(axis=1)
        return np.where(inside, logs, -np.inf)

    def sample(rng, n):
        x = rng.standard_normal((n, d))
        x[:, 0] = np.abs(x[:, 0])
        x[:, 1] = -np.log1p(-rng.random(n) * (1 - np.exp(-4))) / 4
        x[:, 2:] += x[:, :1] - 0.5 * x[:, 1:2]
        return x

    limits = {0: (0.0, np.inf), 1: (0.0, 1.0)} if with_bounds else {}
    return Target(
        f"bounded-{d}-{'folded' if with_bounds else 'plain'}", d, log_density, sample, limits
    )


def two_modes(d):
    """Weights 0.3 and 0.7, ten sds apart in one direction."""
    centres = np.zeros((2, d))
    centres[0, 0], centres[1, 0], centres[1, 1] = -5.0, 5.0, 2.0
    sds = np.array([1.0, 0.6])
    weights = np.array([0.3, 0.7])

    def log_density(x):
        logs = [
            np.log(w) + norm.logpdf(x, c, s).sum(axis=1)
            for w, c, s in zip(weights, centres, sds, strict=True)
        ]
        return np.logaddexp(*logs)

    def sample(rng, n):
        which = (rng.random(n) < weights[1]).astype(int)
        return centres[which] + sds[which, None] * rng.standard_normal((n, d))

    return Target(f"two-modes-{d}", d, log_density, sample)


def two_ridges(d, *, share, bend=0.0):
    """Two Gaussian ridges of other directions, the second of weight ``share``; they may bend."""
    sds = np.geomspace(0.05, 3.0, d)
    turns = [
        np.linalg.qr(np.random.default_rng(10 + k).standard_normal((d, d)))[0] for k in range(2)
    ]
    centres = 8.0 * np.eye(d)[:2]
    weights = np.array([1.0 - share, share])

    def straight(x, k):
        z = (x - centres[k]) @ turns[k] / sds
        z[:, -2] -= bend * (z[:, -1] ** 2 - 1)
        return z

    def log_density(x):
        logs = [
            np.log(weights[k]) + norm.logpdf(straight(x, k)).sum(axis=1) - np.log(sds).sum()
            for k in range(2)
        ]
        return np.logaddexp(*logs)

    def sample(rng, n):
        which = (rng.random(n) < share).astype(int)
        z = rng.standard_normal((n, d))
        z[:, -2] += bend * (z[:, -1] ** 2 - 1)
        both = np.array(
            [z * sds @ turn.T + centre for turn, centre in zip(turns, centres, strict=True)]
        )
        return both[which, np.arange(n)]

    return Target(f"two-ridges-{d}-{share}-{bend}", d, log_density, sample)


def on_second_ridge(x):
    """Whether points of :func:`two_ridges` lie nearer the centre of the second."""
    return x[..., 1] - x[..., 0] > 0.0


TARGETS = [
    make
    for d in (6, 20)
    for make in (
        gaussian(d),
        banana(d),
        half_bounded(d, with_bounds=False),
        half_bounded(d, with_bounds=True),
        two_modes(d),
    )
]


def functions_of(target, draws):
    """Columns of functions of the coordinates, scaled by constants of the target; its density."""
    level = target.log_density(draws).mean()

    def apply(x):
        centre, scale = np.median(draws, axis=0), draws.std(axis=0)
        z = np.clip((x - centre) / scale, -6, 6)
        d = min(z.shape[1], 6)
        low, high = np.quantile(draws, [0.05, 0.95], axis=0)
        columns = [z[:, :d], z[:, :d] ** 2, x[:, :d] < low[:d], x[:, :d] > high[:d]]
        columns += [z[:, :1] * z[:, 1:d], z[:, :1] ** 2 * z[:, 1:d]]
        columns.append(np.maximum(target.log_density(x) - level, -20)[:, None])
        return np.hstack([np.asarray(c, dtype=float) for c in columns])

    return apply


def one_step(move, target, start, seed=5, group=400):
    """One step of a move, as emcee itself would make it, in ensembles of ``group`` walkers."""
    if isinstance(move, emcee.moves.RedBlueMove) and len(start) > group:
        parts = np.array_split(start, len(start) // group)
        return np.concatenate([one_step(move, target, p, seed + i) for i, p in enumerate(parts)])
    n, d = start.shape
    sampler = emcee.EnsembleSampler(n, d, target.log_density, moves=move, vectorize=True)
    sampler._random = np.random.RandomState(seed)
    state = emcee.State(start, log_prob=target.log_density(start), copy=True)
    for state in sampler.sample(state, iterations=1, skip_initial_state_check=True):
        pass
    return state.coords


@cache
def _reference(target):
    """Test functions of a target, their means and variances, and the draws behind these."""
    apply = functions_of(target, target.sample(np.random.default_rng(99), 20_000))
    values = apply(target.sample(np.random.default_rng(98), 100_000))
    return apply, values.mean(axis=0), values.var(axis=0), len(values)


def largest_departures(move, target, *, walkers=12_000, seed=3):
    """Largest z-scores of stationarity and of reversibility, and the number of tests in each."""
    apply, mean, variance, count = _reference(target)
    before = target.sample(np.random.default_rng(seed), walkers)
    after = one_step(move, target, before)
    f, g = apply(before), apply(after)
    gap = g.mean(axis=0) - mean
    stationary = np.abs(gap) / np.sqrt(variance * (1 / walkers + 1 / count))
    # sum over walkers of f_i g_j - g_i f_j, and of its square
    swap = f.T @ g - g.T @ f
    f2, g2 = f * f, g * g
    square = f2.T @ g2 + g2.T @ f2 - 2 * (f * g).T @ (f * g)
    i, j = np.triu_indices(f.shape[1], 1)
    swap, square = swap[i, j], square[i, j]
    reversible = np.abs(swap[square > 0]) / np.sqrt(square[square > 0])
    return (stationary.max(), stationary.size), (reversible.max(), reversible.size)


def limit(tests, level=1e-4):
    """Largest |z| that so many tests exceed with probability ``level`` in all."""
    return norm.isf(0.5 * level / tests)
