"""One ensemble of chains over specimens and what they have in common, and how it moves.

A chain holds the coordinates of every specimen and the means, donor effects and spreads. In a sweep

1. each specimen moves by its own density: differential evolution on an archive of the warm-up, and
   draws of a mixture fitted to it, whose likelihoods are computed a block ahead;
2. all specimens move together along leading principal components of the stacked warm-up draws, or
   apart along them (:class:`Spreading`), group means and donor effects integrated out;
3. some rounds without a likelihood: each specimen is offered draws of its own run, accepted on the
   ratio of the population's density to the run's prior (Lunn, Barrett, Sweeting and Thompson,
   JRSS C 62 (2013) 551); spreads, means and donor effects move as in :mod:`.hierarchy`. Where
   single posteriors are wide, spreads and specimens wait for one another: that takes rounds.

Nothing here knows what a specimen is: an :class:`Individual` is a density, a pool and bounds.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from biaxbayes.compilation import compiled
from biaxbayes.populations.hierarchy import Augmented, Block, Layout, augment, log_marginal, update
from biaxbayes.sampling.proposal import TransportedMixture

POOL_VISITS, FRESH_VISITS, JOINT_MOVES = 1, 2, 3
"""Draws of the run offered to a specimen in a round, draws of the mixture and joint moves in a
sweep. With more draws of the run, its finite number has more influence."""
ROUNDS = 4
"""Rounds in a sweep of draws of the run, spreads and means: they cost no likelihood."""
JOINT = ("together", "apart", "apart in donors")
"""Kinds of joint moves: all in one direction, or apart from the mean of a group or donor."""
SPREAD = 0.5
"""Share of these moves that draw specimens apart or together."""


@dataclass(frozen=True, eq=False)
class Individual:
    """A specimen as the sampler knows it."""

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
    blocks: tuple[tuple[tuple[int, ...], Layout], ...]  # pooled values that may correlate, by index
    centre: np.ndarray  # (p,), prior means of the groups

    @property
    def layout(self) -> Layout:
        """Layout of the first block: groups and donors are the same in all."""
        return self.blocks[0][1]

    @property
    def groups(self) -> int:
        """Number of groups."""
        return int(self.layout.set_of.size)

    def density(self, i: int, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Log density and centred values of specimen i."""
        log, values = self.individuals[i].density(u)
        return log, values - self.centre


MIN_SHARE = 1e-9
"""Specimens with a smaller share in a direction, relative to the largest, are left out of it."""


def memberships(group: np.ndarray, donor: np.ndarray) -> list[np.ndarray]:
    """Groupings (n,) whose means specimens deviate from: groups, and donors with several."""
    return [of for of in (group, donor) if len(np.unique(of)) < len(of)]


@dataclass(frozen=True, eq=False)
class Spreading:
    """Tuning, by the warm-up, of moves that draw specimens apart or together.

    They do what an sd is slow to do one specimen at a time: where single posteriors are long
    ridges, an sd between specimens and the positions of all specimens on their ridges constrain
    each other. Along a direction g of all specimens together (a principal component of the
    warm-up) specimen i is at s_i; the deviations of the s_i from their mean over a group, or over
    a donor, are multiplied by one factor, and the specimens move along g.
    """

    centre: np.ndarray  # (n, dmax), of each specimen's coordinates
    sd: np.ndarray
    steps: np.ndarray  # (memberships, L): sds of the logs of the factors, by direction

    def moved(
        self, u: np.ndarray, direction: np.ndarray, of: np.ndarray, log_factor: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates (C, n, dmax) drawn apart, and the log of the Jacobian (C,).

        ``direction`` (n, dmax), ``of`` (n,) whose mean each deviates from, ``log_factor`` (C,).
        """
        along = direction / np.where(self.sd > 0.0, self.sd, 1.0) ** 2
        share = (direction * along).sum(axis=1)
        taking = share > MIN_SHARE * share.max()
        share = np.where(taking, share, 0.0)
        of = np.unique(of, return_inverse=True)[1]
        cells = (of == np.arange(of.max() + 1)[:, None]).astype(float)
        weight = cells @ share
        projected = ((u - self.centre) * along).sum(axis=2) * taking
        mean = (projected @ cells.T) / np.where(weight > 0.0, weight, 1.0)
        s = projected / np.where(taking, share, 1.0)
        off = np.where(taking, s - mean[:, of], 0.0)
        by = np.expm1(log_factor)
        new = u + (by[:, None] * off)[..., None] * direction
        # deviations from a mean have one dimension less than there are specimens that take part
        dimensions = taking.sum() - np.count_nonzero(weight)
        return new, log_factor * float(dimensions)


@dataclass(frozen=True, eq=False)
class Tuning:
    """Results of the warm-up that the moves use; frozen afterwards."""

    # (A, d) each: coordinates of each specimen, for differential evolution
    archives: tuple[np.ndarray, ...]
    proposals: tuple[TransportedMixture, ...]  # empty before the first fit
    directions: np.ndarray  # (L, n, dmax): principal components times their sd
    steps: np.ndarray  # (L,): lengths of joint moves
    spreading: Spreading | None = None


@compiled()
def _distance2(theta, m, precision, p):
    """(theta - m)' precision (theta - m)."""
    total = 0.0
    for k in range(p):
        for j in range(p):
            total += (theta[k] - m[k]) * precision[k, j] * (theta[j] - m[j])
    return total


class Values(NamedTuple):
    """Coordinates and densities of specimens: those of the chains, or a pool of proposals."""

    u: np.ndarray  # (chains, n, dmax) or (n, N, dmax)
    theta: np.ndarray  # (..., p)
    log: np.ndarray  # (...): the specimens' own log densities
    weight: np.ndarray  # (...): log of target over proposal, without the population's density


@compiled(nogil=True)
def _visit(rng, current, pool, m, precision, offered, first):
    """Offer each specimen proposals of a pool, as an independence sampler; accepted shares (n,).

    ``m`` (chains, n, p) are the locations, ``precision`` (chains, n, p, p) the inverse covariances.
    ``first`` is the first row to offer to the first chain, each row once; or negative to offer
    ``offered`` random rows.
    """
    C, n, p = current.theta.shape
    N = pool.log.shape[1]
    accepted = np.zeros(n)
    for c in range(C):
        for i in range(n):
            inverse = precision[c, i]
            own = current.weight[c, i] - 0.5 * _distance2(current.theta[c, i], m[c, i], inverse, p)
            for k in range(offered):
                j = first + c * offered + k if first >= 0 else int(rng.random() * N)
                new = pool.weight[i, j] - 0.5 * _distance2(pool.theta[i, j], m[c, i], inverse, p)
                if math.log(1.0 - rng.random()) < new - own:
                    own = new
                    accepted[i] += 1.0
                    current.weight[c, i] = pool.weight[i, j]
                    current.log[c, i] = pool.log[i, j]
                    for q in range(p):
                        current.theta[c, i, q] = pool.theta[i, j, q]
                    for q in range(current.u.shape[2]):
                        current.u[c, i, q] = pool.u[i, j, q]
    return accepted / (C * max(offered, 1))


class Ensemble:
    """Chains that share only what was tuned; `number` selects the pool."""

    def __init__(
        self, design: Design, number: int, chains: int, seed: np.random.SeedSequence
    ) -> None:
        self.design = design
        self.rng = np.random.default_rng(seed)
        n, p = len(design.individuals), design.centre.size
        self.sizes = np.array([member.dimension for member in design.individuals])
        self.group, self.donor = design.layout.group, design.layout.donor
        self.memberships = memberships(self.group, self.donor)
        self.pool = self._pool(number)
        C = chains
        self.u = np.zeros((C, n, int(self.sizes.max())))
        self.theta, self.log = np.empty((C, n, p)), np.empty((C, n))
        sets, groups, donors = design.layout.sets, design.groups, design.layout.donors
        self.mu, self.effect = np.zeros((C, groups, p)), np.zeros((C, donors, p))
        self.sd_donors, self.sd = np.empty((C, p)), np.empty((C, sets, p))
        self.partial = []
        self.factor = []
        for columns, layout in design.blocks:
            b = len(columns)
            self.partial.append(np.zeros((2, C, b * (b - 1) // 2)))
            self.factor.append(np.tile(np.eye(b), (2, C, 1, 1)))
            # over-dispersed: spreads from a wide range around the scale of their prior
            wide = np.exp(self.rng.uniform(-1.5, 0.5, (C, 1 + sets, b)))
            self.sd_donors[:, columns] = wide[:, 0] * layout.donor_scale
            self.sd[:, :, columns] = wide[:, 1:] * layout.specimen_scale
        chosen = self.rng.integers(self.pool.log.shape[1], size=(C, n))
        for i in range(n):
            self.u[:, i] = self.pool.u[i, chosen[:, i]]
            self.theta[:, i] = self.pool.theta[i, chosen[:, i]]
            self.log[:, i] = self.pool.log[i, chosen[:, i]]
        self.accepted: dict[str, np.ndarray] = {}
        for g in range(groups):
            self.mu[:, g] = self.theta[:, self.group == g].mean(axis=1)
        for columns, layout in design.blocks:  # means start where the model allows them
            for k, column in enumerate(columns):
                self.mu[:, :, column] = self.mu[:, :, column].clip(layout.low[k], layout.high[k])

    def _pool(self, number: int) -> Values:
        members = self.design.individuals
        draws = [member.pool[number] for member in members]
        N = min(len(d) for d in draws)
        evaluated = [self.design.density(i, d[:N]) for i, d in enumerate(draws)]
        weights = [
            -member.log_prior(values + self.design.centre)
            for member, (_, values) in zip(members, evaluated, strict=True)
        ]
        return self._stacked([d[:N] for d in draws], evaluated, weights)

    def _stacked(
        self,
        u: list[np.ndarray],
        evaluated: list[tuple[np.ndarray, np.ndarray]],
        weights: list[np.ndarray],
    ) -> Values:
        size = int(self.sizes.max())
        padded = np.zeros((len(u), len(u[0]), size))
        for i, own in enumerate(u):
            padded[i, :, : own.shape[1]] = own
        log = np.array([f[0] for f in evaluated])
        theta = np.array([f[1] for f in evaluated])
        weight = np.where(np.isfinite(log), np.array(weights), -np.inf)
        return Values(padded, np.where(np.isfinite(theta), theta, 0.0), log, weight)

    # --- what the moves need ---

    @property
    def locations(self) -> np.ndarray:
        """m_i of every chain and specimen, shape (chains, n, p)."""
        return self.mu[:, self.group] + self.effect[:, self.donor]

    @property
    def precision(self) -> np.ndarray:
        """Inverse covariance of specimens, shape (chains, sets, p, p)."""
        C, sets, p = self.sd.shape
        out = np.zeros((C, sets, p, p))
        for (columns, _), factor in zip(self.design.blocks, self.factor, strict=True):
            at = np.ix_(range(C), range(sets), columns, columns)
            if len(columns) == 1:
                out[at] = (self.sd[:, :, columns] ** -2.0)[..., None]
                continue
            inverse = np.linalg.inv(factor[1] @ factor[1].transpose(0, 2, 1))
            scale = 1.0 / self.sd[:, :, columns]
            out[at] = scale[..., :, None] * inverse[:, None] * scale[..., None, :]
        return out

    def _quadratic(self, theta: np.ndarray, precision: np.ndarray) -> np.ndarray:
        """(theta - m)' precision (theta - m) of every chain and specimen."""
        off = theta - self.locations
        own = precision[:, self.design.layout.set_of[self.group]]
        return np.asarray((own @ off[..., None])[..., 0] * off).sum(axis=2)

    def _densities(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Finite or not, log density and values of every chain and specimen at u (C, n, dmax)."""
        log, theta = np.empty_like(self.log), np.empty_like(self.theta)
        for i, d in enumerate(self.sizes):
            log[:, i], theta[:, i] = self.design.density(i, np.ascontiguousarray(u[:, i, :d]))
        known = np.isfinite(log)
        theta[~known] = self.theta[~known]
        return known, log, theta

    def _count(self, what: str, accepted: np.ndarray) -> None:
        self.accepted[what] = self.accepted.get(what, 0.0) + accepted

    # --- moves ---

    def fresh_pool(self, tuning: Tuning, size: int) -> Values | None:
        """Draws of the mixtures, as many as a block of sweeps needs."""
        if not tuning.proposals:
            return None
        drawn = [q.sample(self.rng, size) for q in tuning.proposals]
        evaluated = [self.design.density(i, d) for i, d in enumerate(drawn)]
        with np.errstate(invalid="ignore"):
            weights = [
                f[0] - q.log_density(d)
                for q, d, f in zip(tuning.proposals, drawn, evaluated, strict=True)
            ]
        return self._stacked(drawn, evaluated, weights)

    def sweep(self, tuning: Tuning, fresh: Values | None, row: int) -> None:
        """All moves once; ``row`` is the first row of ``fresh`` that was not offered yet."""
        self._evolve(tuning)
        if fresh is not None:
            weight = np.empty_like(self.log)
            for i, q in enumerate(tuning.proposals):
                own = np.ascontiguousarray(self.u[:, i, : self.sizes[i]])
                weight[:, i] = self.log[:, i] - q.log_density(own)
            self._count("fresh", self._offer(weight, fresh, FRESH_VISITS, row))
        if len(tuning.directions):
            augmented = self._augmented()
            marginal = self._marginal(self.theta, augmented)
            for _ in range(JOINT_MOVES):
                self._move_together(tuning, augmented, marginal)
        weight = np.empty_like(self.log)
        for i, member in enumerate(self.design.individuals):
            weight[:, i] = -member.log_prior(self.theta[:, i] + self.design.centre)
        for _ in range(ROUNDS):
            self._count("pool", self._offer(weight, self.pool, POOL_VISITS, -1) / ROUNDS)
            self._update(self._augmented(), 1)

    def _offer(self, weight: np.ndarray, pool: Values, offered: int, row: int) -> np.ndarray:
        """Offer draws of a pool to all; ``weight``, that of the current values, follows."""
        current = Values(self.u, self.theta, self.log, weight)
        precision = self.precision[:, self.design.layout.set_of[self.group]]
        accepted = _visit(self.rng, current, pool, self.locations, precision, offered, row)
        return np.asarray(accepted)

    def _evolve(self, tuning: Tuning) -> None:
        """Each specimen by differences of its past, of several lengths (ter Braak, Vrugt 2008)."""
        C, n, rng = len(self.u), len(self.sizes), self.rng
        lengths = np.array([len(a) for a in tuning.archives])
        first, second = (rng.random((2, C, n)) * lengths).astype(np.int64)
        gamma = rng.choice([1.0, 0.4, 0.15], size=(C, n))
        new = self.u.copy()
        for i, (d, archive) in enumerate(zip(self.sizes, tuning.archives, strict=True)):
            step = archive[first[:, i]] - archive[second[:, i]]
            new[:, i, :d] += 2.38 / math.sqrt(2 * d) * gamma[:, i, None] * step
        known, log, theta = self._densities(new)
        gain = np.where(known, log - self.log, -np.inf)
        precision = self.precision
        gain -= 0.5 * self._quadratic(theta, precision)
        gain += 0.5 * self._quadratic(self.theta, precision)
        yes = np.log(1.0 - rng.random((C, n))) < gain
        for own, other in ((self.u, new), (self.theta, theta), (self.log, log)):
            own[yes] = other[yes]
        self._count("own", yes.mean(axis=0))

    def _augmented(self) -> list[Augmented]:
        """Draws outside of the box, by block."""
        out = []
        C, n, _ = self.theta.shape
        for number, (columns, layout) in enumerate(self.design.blocks):
            b = len(columns)
            augmented = Augmented(
                np.zeros((C, n)), np.zeros((C, n, b)), np.zeros((C, layout.sets, b, b))
            )
            if np.isfinite([layout.low, layout.high]).any():
                augment(self.rng, layout, self._block(number, self.theta), augmented)
            out.append(augmented)
        return out

    def _block(self, number: int, theta: np.ndarray) -> Block:
        """Values of a block from `theta` (chains, n, p), and the chains' common quantities."""
        at = list(self.design.blocks[number][0])
        partial_donors, partial = self.partial[number]
        factor_donors, factor = self.factor[number]
        return Block(
            np.ascontiguousarray(theta[..., at]),
            np.ascontiguousarray(self.mu[..., at]),
            np.ascontiguousarray(self.effect[..., at]),
            np.ascontiguousarray(self.sd_donors[..., at]),
            partial_donors,
            factor_donors,
            np.ascontiguousarray(self.sd[..., at]),
            partial,
            factor,
        )

    def _marginal(self, theta: np.ndarray, augmented: list[Augmented]) -> np.ndarray:
        """Log density of values with means and donor effects integrated out, (chains,)."""
        total = np.zeros(len(theta))
        for number, (_, layout) in enumerate(self.design.blocks):
            total += log_marginal(layout, self._block(number, theta), augmented[number])
        return total

    def _move_together(
        self, tuning: Tuning, augmented: list[Augmented], marginal: np.ndarray
    ) -> None:
        """One joint move; ``marginal``, that of the current values, follows in place."""
        rng, C = self.rng, len(self.u)
        chosen = int(rng.integers(len(tuning.directions)))
        direction, spreading, kind = tuning.directions[chosen], tuning.spreading, 0
        if spreading is not None and rng.random() < SPREAD:
            kind = 1 + int(rng.integers(len(self.memberships)))
        if kind and spreading is not None:
            factor = spreading.steps[kind - 1, chosen] * rng.standard_normal(C)
            of = self.memberships[kind - 1]
            new, jacobian = spreading.moved(self.u, direction, of, factor)
        else:
            along = tuning.steps[chosen] * rng.standard_normal(C)
            new, jacobian = self.u + along[:, None, None] * direction, np.zeros(C)
        each, log, theta = self._densities(new)
        known = each.all(axis=1)
        gain = np.where(known, (log - self.log).sum(axis=1) + jacobian, -np.inf)
        there = self._marginal(theta, augmented)
        gain[known] += (there - marginal)[known]
        yes = np.log(1.0 - rng.random(C)) < gain
        previous = [a.copy() for a in (self.u, self.theta, self.log, self.mu, self.effect)]
        for own, other in ((self.u, new), (self.theta, theta), (self.log, log)):
            own[yes] = other[yes]
        # the means follow; a mean that is not allowed takes the whole move back
        back = ~self._update(augmented, 0)
        carried = (self.u, self.theta, self.log, self.mu, self.effect)
        for values, before in zip(carried, previous, strict=True):
            values[back] = before[back]
        moved = yes & ~back
        marginal[moved] = there[moved]
        tried = np.zeros(len(tuning.directions))
        hits = tried.copy()
        tried[chosen], hits[chosen] = 1.0, moved.mean()
        name = JOINT[kind]
        self._count(name, hits)
        self._count(f"{name} tried", tried)

    def _update(self, augmented: list[Augmented], cycles: int) -> np.ndarray:
        """Move what the specimens have in common; whether new means were allowed, (chains,)."""
        allowed = np.ones(len(self.theta), dtype=bool)
        for number, (columns, layout) in enumerate(self.design.blocks):
            at = list(columns)
            block = self._block(number, self.theta)
            update(self.rng, layout, block, augmented[number], cycles)
            allowed &= (block.mu != self.mu[..., at]).any(axis=(1, 2))
            self.mu[..., at], self.effect[..., at] = block.mu, block.effect
            self.sd_donors[..., at], self.sd[..., at] = block.sd_donors, block.sd
        return allowed
