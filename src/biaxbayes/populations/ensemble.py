"""One ensemble of chains over specimens and their common distribution, and its moves.

A chain holds the coordinates of every specimen and the means, donor effects and sds. In a sweep

1. each specimen moves by its own density: differential evolution on an archive of the warm-up, and
   draws of a mixture fitted to it;
2. all specimens move together along leading principal components of the stacked warm-up draws, or
   scale their deviations along them (:func:`scale_deviations`), group means and donor effects
   integrated out;
3. some rounds without a likelihood: each specimen is offered draws of its own run, accepted on the
   ratio of the population's density to the run's prior (Lunn, Barrett, Sweeting and Thompson,
   JRSS C 62 (2013) 551); sds, means and donor effects move as in :mod:`.hierarchy`. Where
   single posteriors are wide, sds and specimens mix slowly: hence several rounds.

The sampler is independent of tissue: an :class:`Individual` is a density, a pool and bounds.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from biaxbayes.compilation import compiled
from biaxbayes.populations.hierarchy import (
    Augmented,
    Block,
    Layout,
    augment,
    draw_locations,
    log_marginal,
    update,
)
from biaxbayes.sampling.proposal import TransportedMixture

POOL_VISITS, FRESH_VISITS, JOINT_MOVES = 1, 2, 3
"""Draws of the run offered to a specimen in a round, draws of the mixture and joint moves in a
sweep. With more draws of the run, its finite number has more influence."""
POOL_ROUNDS = 4
"""Rounds in a sweep of draws of the run, sds and means: they need no likelihood."""
JOINT_MOVE_NAMES = ("together", "apart", "apart in donors")
"""Joint moves: all specimens in one direction, or scaled deviations from a group or donor mean."""
DEVIATION_MOVE_PROBABILITY = 0.5
"""Probability that a joint move scales deviations from the mean of a group or donor."""
MIN_WEIGHT = 1e-9
"""Specimens with a smaller weight in a direction, relative to the largest, do not take part."""


@dataclass(frozen=True, eq=False)
class Individual:
    """A specimen of the sampler: its density, prior, bounds and pool of draws."""

    name: str
    # coordinates (n, d) to the log density without the prior of the pooled values, (n,), and those
    # values, (n, p)
    density: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    # pooled values (n, p) to the log prior (n,) that the draws of the pool were under
    log_prior: Callable[[np.ndarray], np.ndarray]
    bounds: np.ndarray  # (d, 2)
    # (ensembles, N, d), draws of the specimen's own posterior: one pool per ensemble, so that the
    # error of a finite pool shows as a difference of ensembles
    pool: np.ndarray

    @property
    def dimension(self) -> int:
        """Number of coordinates."""
        return int(self.pool.shape[2])


@dataclass(frozen=True, eq=False)
class Design:
    """Specimens, groups and priors."""

    individuals: tuple[Individual, ...]
    # columns of the pooled values with their layout: all of them if they may correlate, else each
    blocks: tuple[tuple[slice, Layout], ...]
    centre: np.ndarray  # (p,), prior means of the groups

    @property
    def layout(self) -> Layout:
        """Layout of the first block: groups and donors are the same in all."""
        return self.blocks[0][1]

    def density(self, i: int, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Log density and centred values of specimen i."""
        log, values = self.individuals[i].density(np.ascontiguousarray(u))
        return log, values - self.centre


@dataclass(frozen=True, eq=False)
class Tuning:
    """Results of the warm-up that the moves use; frozen afterwards."""

    # (A, d) each: coordinates of each specimen, for differential evolution
    archives: tuple[np.ndarray, ...]
    proposals: tuple[TransportedMixture, ...]  # empty before the first fit
    directions: np.ndarray  # (L, n, dmax): principal components times their sd
    # (kinds, L): lengths of joint moves, and sds of the log factors of scaled deviations
    steps: np.ndarray
    centre: np.ndarray  # (n, dmax), mean of each specimen's coordinates
    sd: np.ndarray


def scale_deviations(
    u: np.ndarray, tuning: Tuning, direction: np.ndarray, label: np.ndarray, log_factor: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates (C, n, dmax) with scaled deviations, and the log of the Jacobian (C,).

    Does what an sd is slow to do one specimen at a time: where single posteriors are long ridges,
    an sd between specimens and the positions of all specimens on their ridges constrain each
    other. Along a ``direction`` (n, dmax) of all specimens together specimen i is at s_i; the
    deviations of the s_i from their mean over specimens of the same ``label`` (n,) are multiplied
    by the exponential of ``log_factor`` (C,), and the specimens move along the direction.
    """
    along = direction / np.where(tuning.sd > 0.0, tuning.sd, 1.0) ** 2
    share = (direction * along).sum(axis=1)
    taking = share > MIN_WEIGHT * share.max()
    share = np.where(taking, share, 0.0)
    names, label = np.unique(label, return_inverse=True)
    cells = (label == np.arange(len(names))[:, None]).astype(float)
    weight = cells @ share
    projected = ((u - tuning.centre) * along).sum(axis=2) * taking
    mean = (projected @ cells.T) / np.where(weight > 0.0, weight, 1.0)
    s = projected / np.where(taking, share, 1.0)
    deviation = np.where(taking, s - mean[:, label], 0.0)
    new = u + (np.expm1(log_factor)[:, None] * deviation)[..., None] * direction
    # deviations from a mean have one dimension less than there are specimens that take part
    dimensions = taking.sum() - np.count_nonzero(weight)
    return new, log_factor * float(dimensions)


class Values(NamedTuple):
    """Coordinates and densities of specimens: those of the chains, or a pool of proposals."""

    u: np.ndarray  # (chains, n, dmax) or (n, N, dmax)
    theta: np.ndarray  # (..., p)
    log: np.ndarray  # (...): the specimens' own log densities
    weight: np.ndarray  # (...): log of target over proposal, without the population's density


@compiled()
def _distance2(theta, m, precision):
    """(theta - m)' precision (theta - m)."""
    total = 0.0
    for k in range(m.size):
        for j in range(m.size):
            total += (theta[k] - m[k]) * precision[k, j] * (theta[j] - m[j])
    return total


@compiled(nogil=True)
def _visit(rng, current, pool, rows, m, precision):
    """Offer each specimen rows (chains, n, R) of a pool, as an independence sampler.

    Returns the acceptance rates (n,). ``m`` (chains, n, p) are the locations, ``precision``
    (chains, n, p, p) the inverse covariances.
    """
    C, n, offered = rows.shape
    accepted = np.zeros(n)
    for c in range(C):
        for i in range(n):
            own = current.weight[c, i]
            own -= 0.5 * _distance2(current.theta[c, i], m[c, i], precision[c, i])
            for k in range(offered):
                j = rows[c, i, k]
                new = pool.weight[i, j]
                new -= 0.5 * _distance2(pool.theta[i, j], m[c, i], precision[c, i])
                if math.log(1.0 - rng.random()) < new - own:
                    own = new
                    accepted[i] += 1.0
                    current.weight[c, i] = pool.weight[i, j]
                    current.log[c, i] = pool.log[i, j]
                    for q in range(m.shape[2]):
                        current.theta[c, i, q] = pool.theta[i, j, q]
                    for q in range(current.u.shape[2]):
                        current.u[c, i, q] = pool.u[i, j, q]
    return accepted / (C * offered)


class Ensemble:
    """Chains that share only the tuning; `number` selects the pool."""

    def __init__(
        self, design: Design, number: int, chains: int, seed: np.random.SeedSequence
    ) -> None:
        self.design = design
        self.rng = rng = np.random.default_rng(seed)
        self.moves: dict[str, np.ndarray] = {}  # accepted and tried, (2, specimens or directions)
        self.sizes = [member.dimension for member in design.individuals]
        layout, C, n = design.layout, chains, len(design.individuals)
        self.group, self.donor = layout.group, layout.donor
        # deviations are scaled about the means of groups, and of donors with several specimens
        self.labels = [v for v in (self.group, self.donor) if len(np.unique(v)) < len(v)]
        draws = [member.pool[number] for member in design.individuals]
        least = min(map(len, draws))
        self.pool = self._evaluate([d[:least] for d in draws], self._prior_weight)
        at = np.arange(n), rng.integers(least, size=(C, n))
        self.u, self.theta, self.log = (values[at] for values in self.pool[:3])
        # means start where the model allows them, sds over-dispersed around their prior's scale
        self.blocks = []
        for columns, own in design.blocks:
            b, theta = own.low.size, np.ascontiguousarray(self.theta[..., columns])
            mu = [theta[:, self.group == g].mean(axis=1) for g in range(own.covariance_index.size)]
            scale = np.vstack([own.scale[:1], np.repeat(own.scale[1:], own.sets, axis=0)])
            self.blocks.append(
                Block(
                    theta,
                    np.stack(mu, axis=1).clip(own.low, own.high),
                    np.zeros((C, own.donors, b)),
                    np.exp(rng.uniform(-1.5, 0.5, (C, 1 + own.sets, b))) * scale,
                    np.zeros((C, 2, b * (b - 1) // 2)),
                    np.tile(np.eye(b), (C, 2, 1, 1)),
                )
            )

    def _prior_weight(self, i: int, u: np.ndarray, log: np.ndarray, theta: np.ndarray) -> Any:
        """Weights of draws of a specimen's run: the likelihood cancels."""
        return -self.design.individuals[i].log_prior(theta + self.design.centre)

    def _evaluate(self, u: Sequence[np.ndarray], weight: Callable[..., Any]) -> Values:
        """Values at coordinates of each specimen, with weights from a function of these."""
        padded = np.zeros((len(u), len(u[0]), max(self.sizes)))
        logs, thetas, weights = [], [], []
        for i, own in enumerate(u):
            padded[i, :, : self.sizes[i]] = own
            log, theta = self.design.density(i, own)
            with np.errstate(invalid="ignore"):
                weights.append(np.where(np.isfinite(log), weight(i, own, log, theta), -np.inf))
            logs.append(log)
            thetas.append(np.where(np.isfinite(theta), theta, 0.0))
        return Values(padded, np.array(thetas), np.array(logs), np.array(weights))

    def snapshot(self) -> dict[str, Any]:
        """Copy of all that later sweeps depend on, and of the counts."""
        plain = {name: getattr(self, name) for name in ("u", "theta", "log", "moves")}
        plain["blocks"] = [block._asdict() for block in self.blocks]
        return copy.deepcopy(plain | {"rng": self.rng.bit_generator.state})

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Continue from a snapshot."""
        stored = copy.deepcopy(snapshot)
        self.u, self.theta, self.log = stored["u"], stored["theta"], stored["log"]
        self.blocks = [Block(**block) for block in stored["blocks"]]
        self.moves, self.rng.bit_generator.state = stored["moves"], stored["rng"]

    @property
    def mu(self) -> np.ndarray:
        """Means of the groups, shape (chains, groups, p)."""
        return np.concatenate([block.mu for block in self.blocks], axis=-1)

    @property
    def effect(self) -> np.ndarray:
        """Donor effects, shape (chains, donors, p)."""
        return np.concatenate([block.effect for block in self.blocks], axis=-1)

    @property
    def sd(self) -> np.ndarray:
        """Sds of donors and of each set of specimens, shape (chains, 1 + sets, p)."""
        return np.concatenate([block.sd for block in self.blocks], axis=-1)

    @property
    def locations(self) -> np.ndarray:
        """m_i of every chain and specimen, shape (chains, n, p)."""
        return self.mu[:, self.group] + self.effect[:, self.donor]

    @property
    def precision(self) -> np.ndarray:
        """Inverse covariance of every chain and specimen, shape (chains, n, p, p)."""
        C, n, p = self.theta.shape
        out = np.zeros((C, n, p, p))
        sd_row = 1 + self.design.layout.covariance_index[self.group]  # row 0 is that of donors
        for (columns, _), block in zip(self.design.blocks, self.blocks, strict=True):
            root = np.linalg.inv(block.factor[:, 1])[:, None] / block.sd[:, sd_row, None, :]
            out[:, :, columns, columns] = root.swapaxes(-1, -2) @ root
        return out

    def _with_values(self, theta: np.ndarray) -> list[tuple[Layout, Block]]:
        """Layouts and blocks, with values (chains, n, p) of the specimens."""
        return [
            (layout, block._replace(theta=np.ascontiguousarray(theta[..., columns])))
            for (columns, layout), block in zip(self.design.blocks, self.blocks, strict=True)
        ]

    def draw_rejected(self) -> list[Augmented]:
        """Rejected draws outside the box, by block."""
        return [augment(self.rng, *pair) for pair in self._with_values(self.theta)]

    def log_marginal(self, theta: np.ndarray, augmented: list[Augmented]) -> np.ndarray:
        """Log density of values with means and donor effects integrated out, (chains,)."""
        pairs = zip(self._with_values(theta), augmented, strict=True)
        return np.sum([log_marginal(*pair, extra) for pair, extra in pairs], axis=0)

    def _densities(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Finite or not, log density and values of every chain and specimen at u (C, n, dmax)."""
        log, theta = np.empty_like(self.log), np.empty_like(self.theta)
        for i, d in enumerate(self.sizes):
            log[:, i], theta[:, i] = self.design.density(i, u[:, i, :d])
        known = np.isfinite(log)
        theta[~known] = self.theta[~known]
        return known, log, theta

    def _count(self, name: str, accepted: np.ndarray, tried: np.ndarray | float = 1.0) -> None:
        both = np.array([accepted, np.broadcast_to(tried, accepted.shape)])
        self.moves[name] = self.moves.get(name, 0.0) + both

    # --- moves ---

    def sweep(self, tuning: Tuning) -> None:
        """All moves once."""
        C, n = self.log.shape
        self._evolve(tuning)
        if tuning.proposals:
            size = C * FRESH_VISITS
            drawn = [q.sample(self.rng, size) for q in tuning.proposals]
            rows = np.repeat(np.arange(size).reshape(C, 1, FRESH_VISITS), n, axis=1)

            def mixture_weight(i: int, u: np.ndarray, log: np.ndarray, _: np.ndarray) -> Any:
                return log - tuning.proposals[i].log_density(u)

            fresh = self._evaluate(drawn, mixture_weight)
            self._offer("fresh", fresh, rows, mixture_weight)
        if len(tuning.directions):
            augmented = self.draw_rejected()
            marginal = self.log_marginal(self.theta, augmented)
            for _ in range(JOINT_MOVES):
                self.move_together(tuning, augmented, marginal)
        for _ in range(POOL_ROUNDS):
            rows = self.rng.integers(self.pool.log.shape[1], size=(C, n, POOL_VISITS))
            self._offer("pool", self.pool, rows, self._prior_weight)
            for layout, block in self._with_values(self.theta):
                update(self.rng, layout, block, augment(self.rng, layout, block))

    def _offer(self, name: str, pool: Values, rows: np.ndarray, weight: Callable[..., Any]) -> None:
        """Offer rows (chains, n, R) of a pool, whose weights are those of a function."""
        own = np.empty_like(self.log)
        for i, d in enumerate(self.sizes):
            own[:, i] = weight(i, self.u[:, i, :d], self.log[:, i], self.theta[:, i])
        current = Values(self.u, self.theta, self.log, own)
        accepted = _visit(self.rng, current, pool, rows, self.locations, self.precision)
        self._count(name, accepted)

    def _evolve(self, tuning: Tuning) -> None:
        """Move each specimen by differences of its archive (ter Braak and Vrugt 2008)."""
        (C, n), rng = self.log.shape, self.rng
        lengths = np.array([len(a) for a in tuning.archives])
        first, second = (rng.random((2, C, n)) * lengths).astype(np.int64)
        gamma = rng.choice([1.0, 0.4, 0.15], size=(C, n))
        new = self.u.copy()
        for i, (d, archive) in enumerate(zip(self.sizes, tuning.archives, strict=True)):
            step = archive[first[:, i]] - archive[second[:, i]]
            new[:, i, :d] += 2.38 / math.sqrt(2 * d) * gamma[:, i, None] * step
        known, log, theta = self._densities(new)
        gain = np.where(known, log - self.log, -np.inf)
        precision, m = self.precision, self.locations
        for values, sign in ((theta, -0.5), (self.theta, 0.5)):
            off = values - m
            gain += sign * ((precision @ off[..., None])[..., 0] * off).sum(axis=2)
        yes = np.log(1.0 - rng.random((C, n))) < gain
        self._accept(yes, new, log, theta)
        self._count("own", yes.mean(axis=0))

    def _accept(self, yes: np.ndarray, u: np.ndarray, log: np.ndarray, theta: np.ndarray) -> None:
        for own, other in ((self.u, u), (self.log, log), (self.theta, theta)):
            own[yes] = other[yes]

    def move_together(
        self, tuning: Tuning, augmented: list[Augmented], marginal: np.ndarray
    ) -> None:
        """One joint move; ``marginal``, that of the current values, follows in place."""
        rng, C = self.rng, len(self.u)
        chosen, kind = int(rng.integers(len(tuning.directions))), 0
        if self.labels and rng.random() < DEVIATION_MOVE_PROBABILITY:
            kind = 1 + int(rng.integers(len(self.labels)))
        direction = tuning.directions[chosen]
        step = tuning.steps[kind, chosen] * rng.standard_normal(C)
        if kind:
            label = self.labels[kind - 1]
            new, log_jacobian = scale_deviations(self.u, tuning, direction, label, step)
        else:
            new, log_jacobian = self.u + step[:, None, None] * direction, np.zeros(C)
        known, log, theta = self._densities(new)
        there = self.log_marginal(theta, augmented)
        with np.errstate(invalid="ignore"):
            gain = (log - self.log).sum(axis=1) + log_jacobian + there - marginal
        gain = np.where(known.all(axis=1), gain, -np.inf)
        yes = np.log(1.0 - rng.random(C)) < gain
        before = [self.u.copy(), self.log.copy(), self.theta.copy()]
        self._accept(yes, new, log, theta)
        # the means follow; a mean that is not allowed takes the whole move back
        common = [(block.mu.copy(), block.effect.copy()) for block in self.blocks]
        pairs = zip(self._with_values(self.theta), augmented, strict=True)
        allowed = np.all([draw_locations(rng, *pair, extra) for pair, extra in pairs], axis=0)
        self._accept(~allowed, *before)
        for block, (mu, effect) in zip(self.blocks, common, strict=True):
            block.mu[~allowed], block.effect[~allowed] = mu[~allowed], effect[~allowed]
        moved = yes & allowed
        marginal[moved] = there[moved]
        tried = np.eye(len(tuning.directions))[chosen]
        self._count(JOINT_MOVE_NAMES[kind], moved.mean() * tried, tried)
