r"""The misfit of a law, as a smooth random function inside the likelihood.

No law is the tissue. With the model loads f of a material from its root-found mounted state, all
readings of a specimen, the mounting readings among them, are

    y = f(theta, lm) + delta + toe + friction + eps
    eps      ~ N(0, c^2 N)        noise of the load cell, N = diag s0^2
    friction ~ N(0, u^2 R R')     R = peak of the curve [e, 1 - e], e = exp(-s / 0.05)
    delta    ~ N(0, a^2 D K_h D)  smooth misfit, D = diag sqrt(q^2 + (0.05 peak of the curve)^2)
    toe      ~ N(0, t^2 V G V)    V = diag q exp(-s / 0.4): the toe is stiffer or softer

with the smooth loads q of the least-squares fit, which stay what they are, and the position s on
the path of the test, from 0 at the mounted state to 1 at its end. The structure h of the misfit,
the amplitudes a, t and u and the factor c of the noise are unknown and averaged out:

    L(theta) = sum_h sum_a sum_c sum_t sum_u  w_h w_a w_c w_t w_u  N(y - f | 0, S)
    S = a^2 D K_h D + t^2 V G V + u^2 R R' + c^2 N

- h: each curve its own function along the path, squared-exponential of five lengths or Matern 3/2
  of two, x and y of a protocol independent or correlated (0.9); of several protocols also a
  function over the plane of stretches, of five lengths
- a: ten values from 0.002 to 0.4 under a half-normal prior of sd 0.05
- t: five values from 0.1 to 2 times the sd of its half-normal prior
- u: none, or 3 % of the peak. Friction of a carriage adds one load at rest and another in motion,
  of each curve its own; so does a first point that was digitised at the origin. No law follows
  the step between them. It is an error of the readings, not of the tissue
- c: 1, or 2, 4 or 8 where readings scatter more than the load cell's noise says (a coarse
  resolution, curves read off a figure): else only a large misfit could explain them

All protocols begin at one state, so the toe is a function of the stretches: G is squared
exponential over the plane of log stretches over their ranges, of length 1, and x and y are
independent. Drawn anew for each curve, it would leave a path between the tested ones thirty times
less known.

Everything but the residual r = y - f is known before sampling. Over their noise, readings r have
a misfit with eigenvectors U and eigenvalues e, N^-1/2 D K_h D N^-1/2 = U e U', and a toe
N^-1/2 V G V N^-1/2 = F F'. With M = a^2 U e U' + c^2,

    r' M^-1 r = (|r|^2 - sum_i (U' r)_i^2 a^2 e_i / (c^2 + a^2 e_i)) / c^2
    ln |M|    = n ln c^2 + sum_i ln(1 + a^2 e_i / c^2)

and friction and the toe are added by Woodbury's identity, one after the other. With
F' M^-1 F = W g W', and P = M^-1 F W,

    (M + t^2 F F')^-1 = M^-1 - P t^2 / (1 + t^2 g) P'
    ln |M + t^2 F F'| = ln |M| + sum_j ln(1 + t^2 g_j)

A sampler sums only the terms with weight: see :meth:`SmoothMisfit.with_weight`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import block_diag, csr_array
from scipy.special import logsumexp

from biaxbayes.normal_errors import HALF_LOG_2PI, squared_exponential

AMPLITUDES = np.geomspace(0.002, 0.4, 10)
AMPLITUDE_SD = 0.05
FLOOR = 0.05
"""Least load that a misfit is relative to, as a fraction of the peak of its curve."""
TOES = np.geomspace(0.1, 2.0, 5)
"""Amplitudes of the toe over the sd of their prior."""
TOE, TOE_LENGTH = 0.2, 0.4
"""Default sd of the relative error of the loads at the mounted state; length of the toe along the
path."""
FRICTIONS = (0.0, 0.03)
FRICTION_WEIGHTS = (0.98, 0.02)
REST_LENGTH = 0.05
"""Friction (sd) over the peak of its curve, prior weights, and the length of the path in which rest
gives way to motion: a reading or two of the 20 to 32 of a curve."""
NOISE_FACTORS = (1.0, 2.0, 4.0, 8.0)
NOISE_WEIGHTS = (0.85, 0.1, 0.04, 0.01)
"""Factors of the load cell's noise, and their prior weights."""
CORRELATION = 0.9
"""Of the misfits in x and y, in the structures where they are correlated."""
LEFT_OUT = 1e-4
"""Fraction of the likelihood that the terms may have that are not summed."""
BLOCK = 2**20
"""Densities, draws times terms, that are evaluated together."""
LEAST_EIGENVALUE = 0.03
"""Eigenvectors are left out where the largest misfit adds less than this fraction of the noise."""


# --- where a misfit is wanted --------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class CurvePoints:
    """Points of load curves, x and y of each state on a path; shapes (n,) unless stated."""

    protocol: np.ndarray  # index of the protocol; another number for a path that was not tested
    axis: np.ndarray  # 0 for x, 1 for y
    path: np.ndarray  # position s on the path: 0 at the mounted state, 1 at the end of a protocol
    plane: np.ndarray  # (n, 2), log stretches over their tested ranges
    load: np.ndarray  # q, of the least-squares fit
    peak: np.ndarray  # largest |q| of the curve

    @property
    def scale(self) -> np.ndarray:
        """The load that a misfit is relative to, D."""
        return np.hypot(self.load, FLOOR * self.peak)

    @property
    def toe_scale(self) -> np.ndarray:
        """The load that the toe is relative to, V."""
        return self.load * np.exp(-self.path / TOE_LENGTH)

    def friction_covariance(self, other: CurvePoints) -> np.ndarray:
        """R R' between points: friction at rest and in motion, of each curve its own."""
        rest, others = (np.exp(-points.path / REST_LENGTH) for points in (self, other))
        shared = np.outer(rest, others) + np.outer(1.0 - rest, 1.0 - others)
        curve, others = (2 * points.protocol + points.axis for points in (self, other))
        return np.where(curve[:, None] == others, np.outer(self.peak, other.peak) * shared, 0.0)

    def take(self, index: np.ndarray) -> CurvePoints:
        """Some of the points."""
        return CurvePoints(*(values[index] for values in vars(self).values()))

    def averaged(self, group: np.ndarray, share: np.ndarray) -> CurvePoints:
        """Points averaged by their shares in groups (n,), each of one curve."""
        of_group = np.unique(group, return_index=True)[1]
        path, plane_x, plane_y, load, peak = (
            np.bincount(group, share * values)
            for values in (self.path, *self.plane.T, self.load, self.peak)
        )
        protocol, axis = self.protocol[of_group], self.axis[of_group]
        return CurvePoints(protocol, axis, path, np.stack([plane_x, plane_y], axis=1), load, peak)

    @classmethod
    def joined(cls, parts: Sequence[CurvePoints]) -> CurvePoints:
        """The points of several curves, one behind the other."""
        return cls(
            *(np.concatenate(v) for v in zip(*(vars(p).values() for p in parts), strict=True))
        )


# --- structures of the misfit --------------------------------------------------------------------


@dataclass(frozen=True)
class Structure:
    """Correlation of the misfit between two points of a specimen's curves."""

    length: float
    matern: bool = False  # Matern 3/2, else squared exponential
    plane: bool = False  # a function of the plane of stretches, else of the path of each protocol
    correlation: float = 0.0  # of x and y

    def matrix(self, a: CurvePoints, b: CurvePoints) -> np.ndarray:
        """K_h between the points a and b, shape (a, b)."""
        same_axis = a.axis[:, None] == b.axis[None, :]
        related = np.where(same_axis, 1.0, self.correlation)
        if self.plane:
            distance = np.linalg.norm(a.plane[:, None, :] - b.plane[None, :, :], axis=2)
        else:
            distance = np.abs(a.path[:, None] - b.path[None, :])
            related = related * (a.protocol[:, None] == b.protocol[None, :])
        d = distance / self.length
        if self.matern:
            # (1 + sqrt(3) d) exp(-sqrt(3) d)
            return related * (1.0 + np.sqrt(3.0) * d) * np.exp(-np.sqrt(3.0) * d)
        return related * squared_exponential(d)

    def covariance(self, a: CurvePoints, b: CurvePoints) -> np.ndarray:
        """D K_h D between the points a and b."""
        return a.scale[:, None] * self.matrix(a, b) * b.scale[None, :]


TOE_SHAPE = Structure(1.0, plane=True)
"""Correlation of the toe."""


def structures(protocols: int) -> tuple[Structure, ...]:
    """The structures that are averaged over, of equal weight."""
    lengths = (0.15, 0.3, 0.6, 1.0, 1.5)
    out = []
    for correlation in (0.0, CORRELATION):
        out += [Structure(length, correlation=correlation) for length in lengths]
        out += [Structure(length, matern=True, correlation=correlation) for length in (0.3, 0.8)]
    if protocols > 1:
        out += [Structure(length, plane=True) for length in lengths]
    return tuple(out)


# --- the terms of the sum ------------------------------------------------------------------------


class Terms(NamedTuple):
    """Normal distributions of the sum, each array of shape (terms,)."""

    structure: np.ndarray  # index
    amplitude: np.ndarray
    noise: np.ndarray  # factor
    toe: np.ndarray
    friction: np.ndarray
    log_weight: np.ndarray  # of the prior; the weights of all terms add up to one

    @classmethod
    def every(cls, protocols: int, toe: float) -> Terms:
        """All terms; ``toe`` is the sd of the prior of the toe's amplitude."""
        count = len(structures(protocols))
        toes = toe * TOES if toe > 0.0 else np.zeros(1)
        axes = (np.arange(count), AMPLITUDES, np.array(NOISE_FACTORS), toes, np.array(FRICTIONS))
        weights = (
            np.full(count, 1.0 / count),
            _half_normal(AMPLITUDES, AMPLITUDE_SD),
            np.array(NOISE_WEIGHTS),
            _half_normal(toes, toe) if toe > 0.0 else np.ones(1),
            np.array(FRICTION_WEIGHTS),
        )
        grid = [values.ravel() for values in np.meshgrid(*axes, indexing="ij")]
        shares = np.meshgrid(*map(np.log, weights), indexing="ij")
        return cls._make([*grid, np.sum(shares, axis=0).ravel()])


def _half_normal(steps: np.ndarray, sd: float) -> np.ndarray:
    """Prior weights of steps that are even in logs, under a half-normal density."""
    # p(a) da = p(a) a d ln a
    weight = steps * np.exp(-0.5 * (steps / sd) ** 2)
    return np.asarray(weight / weight.sum())


class Level(NamedTuple):
    """The terms of one structure, amplitude and noise; vectors are combinations of its basis."""

    noise: float  # c
    shrinkage: np.ndarray  # a^2 e / (c^2 + a^2 e), (k,)
    columns: np.ndarray  # P of friction and toe, (basis, m)
    shrinkage_of_terms: np.ndarray  # t^2 / (1 + t^2 g) of them, (m, terms)
    constant: np.ndarray  # log density at zero residual with the log prior weight, (terms,)


class Quadratics(NamedTuple):
    """The terms as sums of squares of projections of residuals over their noise.

    Terms are in the order of structure, amplitude and noise, as they are given. Residuals are
    projected on the basis of each structure: its vectors U and the F of friction and toe.
    """

    bases: list[np.ndarray]  # of each structure, (n, basis)
    columns: list[np.ndarray]  # P of all its levels, (basis, m)
    shrinkage: csr_array  # of the vectors in each level, (levels, k)
    noise: np.ndarray  # c, (levels,)
    shrinkage_of_terms: csr_array  # of the columns in each term, (terms, m)
    constant: np.ndarray  # (terms,)
    level: np.ndarray  # of each term


def _added(
    of_root: np.ndarray, solved: np.ndarray, variance: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Add variance t^2 (terms,) times F F' to M by Woodbury's identity.

    ``of_root`` are the products F'B with the basis, ``solved`` is M^-1 F in that basis. Returns P,
    g (m, 1), t^2 / (1 + t^2 g) (m, terms), and what is added to ln |M| (terms,).
    """
    g, rotation = np.linalg.eigh(of_root @ solved)
    used = g * variance.max(initial=0.0) > LEAST_EIGENVALUE
    g, size = g[used, None], variance * g[used, None]
    shrinkage = variance / (1.0 + size)
    return solved @ rotation[:, used], g, shrinkage, np.log1p(size).sum(axis=0)


# --- the likelihood ------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class SmoothMisfit:
    """Likelihood of readings under a smooth misfit of unknown structure and amplitude."""

    points: CurvePoints  # of every curve: its mounted state, and the readings that follow
    # (n, points): each reading as a mean of points; of a mounted state that several curves share,
    # over them
    reading: np.ndarray
    noise_sd: np.ndarray  # (n,)
    toe: float = TOE  # sd of the prior of the toe's amplitude
    protocols: int = 1  # their number
    chosen: np.ndarray | None = None  # indices of the terms that are summed; by default all

    @cached_property
    def structures(self) -> tuple[Structure, ...]:
        """The structures of the misfit."""
        return structures(self.protocols)

    @cached_property
    def terms(self) -> Terms:
        """The terms that are summed."""
        every = Terms.every(self.protocols, self.toe)
        return every if self.chosen is None else Terms._make(v[self.chosen] for v in every)

    def covariance(self, a: CurvePoints, b: CurvePoints, share: np.ndarray) -> np.ndarray:
        """a^2 D K_h D + t^2 V G V between the points a and b, averaged by a share of each term."""
        toe = a.toe_scale[:, None] * TOE_SHAPE.matrix(a, b) * b.toe_scale
        out = (share @ self.terms.toe**2) * toe
        squares = np.bincount(self.terms.structure, share * self.terms.amplitude**2)
        for h in np.flatnonzero(squares):
            out += squares[h] * self.structures[h].covariance(a, b)
        return np.asarray(out)

    @property
    def toe_and_noise_sd(self) -> np.ndarray:
        """Prior sd of the readings by the toe and the noise of the load cell, (n,)."""
        scale = self.reading * self.points.toe_scale
        toe = scale @ TOE_SHAPE.matrix(self.points, self.points) @ scale.T
        return np.sqrt(self.toe**2 * np.diag(toe) + self.noise_sd**2)

    @cached_property
    def quadratics(self) -> Quadratics:
        """The terms, ready to be evaluated."""
        over_noise = self.reading / self.noise_sd[:, None]
        toe = TOE_SHAPE.matrix(self.points, self.points)
        toe *= np.outer(self.points.toe_scale, self.points.toe_scale)
        roots = []
        friction = self.points.friction_covariance(self.points)
        for size, covariance in ((self.terms.friction, friction), (self.terms.toe, toe)):
            values, vectors = np.linalg.eigh(over_noise @ covariance @ over_noise.T)
            used = values * size.max() ** 2 > LEAST_EIGENVALUE
            roots.append(vectors[:, used] * np.sqrt(values[used]))
        bases, by_structure = [], []
        for h in np.unique(self.terms.structure):
            own = np.flatnonzero(self.terms.structure == h)
            misfit = self.structures[h].covariance(self.points, self.points)
            values, vectors = np.linalg.eigh(over_noise @ misfit @ over_noise.T)
            used = values * self.terms.amplitude[own].max() ** 2 > LEAST_EIGENVALUE
            bases.append(np.hstack([vectors[:, used], *roots]))
            eigenvalues = np.zeros(bases[-1].shape[1])  # none of friction and toe
            eigenvalues[: used.sum()] = values[used]
            of_friction = slice(used.sum(), used.sum() + roots[0].shape[1])
            by_structure.append(self._levels(own, eigenvalues, bases[-1], of_friction))
        levels = [level for of_structure in by_structure for level in of_structure]
        return Quadratics(
            bases,
            [np.hstack([level.columns for level in part]) for part in by_structure],
            csr_array(block_diag([[level.shrinkage for level in part] for part in by_structure])),
            np.array([level.noise for level in levels]),
            csr_array(block_diag([level.shrinkage_of_terms.T for level in levels])),
            np.concatenate([level.constant for level in levels]),
            np.repeat(np.arange(len(levels)), [len(level.constant) for level in levels]),
        )

    def _levels(
        self, own: np.ndarray, values: np.ndarray, basis: np.ndarray, friction: slice
    ) -> list[Level]:
        """The terms of a structure, whose indices are ``own``, by amplitude and noise.

        ``basis`` are its vectors, of eigenvalues ``values``, the F of friction, that of the toe.
        """
        terms, levels = self.terms, []
        gram, unit, toe = basis.T @ basis, np.eye(len(values)), slice(friction.stop, None)
        for a, c in dict.fromkeys(zip(terms.amplitude[own], terms.noise[own], strict=True)):
            at = own[(terms.amplitude[own] == a) & (terms.noise[own] == c)]
            shrinkage = a**2 * values / (c**2 + a**2 * values)
            # M^-1 F = (F - U s U'F) / c^2
            solved = (unit - shrinkage[:, None] * gram) / c**2
            added = [_added(gram[friction], solved[:, friction], terms.friction[at] ** 2)]
            motion, g, *_ = added[0]
            for u in np.unique(terms.friction[at]):
                taken = motion @ ((motion.T @ gram[:, toe]) * (u**2 / (1.0 + u**2 * g)))
                variance = (terms.friction[at] == u) * terms.toe[at] ** 2
                added.append(_added(gram[toe], solved[:, toe] - taken, variance))
            columns, _, of_terms, log_dets = zip(*added, strict=True)
            log_det = 2.0 * len(basis) * np.log(c) - np.log1p(-shrinkage).sum()
            log_det += 2.0 * np.log(self.noise_sd).sum() + sum(log_dets)
            constant = terms.log_weight[at] - 0.5 * log_det - len(basis) * HALF_LOG_2PI
            levels.append(Level(c, shrinkage, np.hstack(columns), np.vstack(of_terms), constant))
        return levels

    def log_weights(self, residual: np.ndarray) -> np.ndarray:
        """Log density (draws, terms) of residuals (draws, n), prior weights included."""
        q, over_noise = self.quadratics, residual / self.noise_sd
        squares = (over_noise**2).sum(axis=1)
        along = [basis.T @ over_noise.T for basis in q.bases]
        by_vector = q.shrinkage @ np.concatenate([part**2 for part in along])
        projected = [columns.T @ part for columns, part in zip(q.columns, along, strict=True)]
        added = q.shrinkage_of_terms @ np.concatenate(projected) ** 2
        # r' M^-1 r, less what friction and toe explain
        left = (squares - by_vector) / q.noise[:, None] ** 2
        return np.asarray((q.constant[:, None] - 0.5 * (left[q.level] - added)).T)

    def log_likelihood(self, residual: np.ndarray) -> np.ndarray:
        """Log likelihood of residuals, readings less model loads, (draws, n)."""
        out = np.empty(len(residual))
        size = max(BLOCK // len(self.terms.toe), 1)
        for first in range(0, len(residual), size):
            part = slice(first, first + size)
            # ln sum exp, which takes scipy.special.logsumexp four times as long
            logs = self.log_weights(residual[part])
            top = logs.max(axis=1)
            out[part] = top + np.log(np.exp(logs - top[:, None]).sum(axis=1))
        return out

    # --- terms with weight -----------------------------------------------------------------------

    def shares(self, residual: np.ndarray) -> np.ndarray:
        """Share of each term in the likelihood of each draw, (draws, terms)."""
        logs = self.log_weights(residual)
        return np.asarray(np.exp(logs - logsumexp(logs, axis=1, keepdims=True)))

    def with_weight(self, residual: np.ndarray) -> SmoothMisfit:
        """The sum without the terms that together have LEFT_OUT at most at each residual."""
        shares = self.shares(residual)
        order = np.argsort(shares.max(axis=0), kind="stable")
        left_out = np.cumsum(shares[:, order], axis=1).max(axis=0) <= LEFT_OUT
        return replace(self, chosen=np.sort(order[~left_out]))

    @property
    def coarse(self) -> SmoothMisfit:
        """A sum over a part of the steps, with which a search may find where the mass is."""
        steps = [
            np.isin(values, np.unique(values)[::stride])
            for values, stride in zip(self.terms[:5], (4, 3, 2, 2, 1), strict=True)
        ]
        return replace(self, chosen=np.flatnonzero(np.all(steps, axis=0)))

    # --- the misfit given the readings -----------------------------------------------------------

    def choose(self, residual: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """A term for each draw, as an index (n,), drawn given its residuals (n, readings)."""
        cumulative = np.cumsum(self.shares(residual), axis=1)
        chosen = (cumulative < rng.random((len(residual), 1))).sum(axis=1)
        return np.asarray(np.minimum(chosen, cumulative.shape[1] - 1))

    def given(
        self, residual: np.ndarray, chosen: np.ndarray, at: CurvePoints, friction: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """Mean and sd of the misfit at points, (draws, points), given the residuals of draws.

        ``chosen`` is the term of each draw, from :meth:`choose`: the misfit is then normal.
        With ``friction`` of the misfit and friction together, as in a reading.
        """
        mean, sd = (np.empty((len(residual), len(at.path))) for _ in range(2))
        for index in np.unique(chosen):
            share = (np.arange(len(self.terms.toe)) == index).astype(float)
            gain, explained = self.conditional(at, share, friction=friction)
            rows = chosen == index
            mean[rows] = residual[rows] @ gain
            prior = (share @ self.terms.amplitude**2) * at.scale**2
            prior += (share @ self.terms.toe**2) * at.toe_scale**2
            if friction:
                prior += (share @ self.terms.friction**2) * np.diag(at.friction_covariance(at))
            sd[rows] = np.sqrt(np.maximum(prior - (gain * explained).sum(axis=0), 0.0))
        return mean, sd

    def conditional(
        self, at: CurvePoints, share: np.ndarray, *, friction: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """Matrix G (n, points) from residuals to the misfit's mean at points, and C.

        C (n, points) are the covariances of readings and points, averaged by a share of each term;
        the covariance of the points is smaller by G' C given the readings. With ``friction`` of
        the misfit and friction together.
        """
        variance = share @ self.terms.friction**2
        noise = np.diag((share @ self.terms.noise**2) * self.noise_sd**2)
        between = self.covariance(self.points, self.points, share)
        between += variance * self.points.friction_covariance(self.points)
        of_readings = self.reading @ between @ self.reading.T + noise
        cross = self.covariance(self.points, at, share)
        if friction:
            cross += variance * self.points.friction_covariance(at)
        cross = self.reading @ cross
        return cho_solve(cho_factor(of_readings, lower=True), cross), cross

    def draw(
        self, at: CurvePoints, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """A misfit drawn from its prior, at points; friction; a factor of the noise."""
        share = rng.multinomial(1, np.exp(self.terms.log_weight)).astype(float)
        friction = (share @ self.terms.friction**2) * at.friction_covariance(at)
        drawn = []
        for covariance in (self.covariance(at, at, share), friction):
            values, vectors = np.linalg.eigh(covariance)
            root = vectors * np.sqrt(np.maximum(values, 0.0))
            drawn.append(root @ rng.standard_normal(len(values)))
        return drawn[0], drawn[1], float(share @ self.terms.noise)
