r"""The misfit of a law, as a smooth random function inside the likelihood.

No law is the tissue. With the model loads f of a material from its root-found mounted state, all
readings of a specimen, the mounting readings among them, are

    y = f(theta, lm) + delta + toe + eps
    eps   ~ N(0, (c s0)^2)        noise of the load cell
    delta ~ N(0, a^2 D K_h D)     smooth misfit, D = diag sqrt(q^2 + (0.05 peak of the curve)^2)
    toe   ~ N(0, t^2 V G V)       V = diag q exp(-s / r): the toe is stiffer or softer

with the smooth loads q of the least-squares fit, which stay what they are, and the position s on
the path of the test, from 0 at the mounted state to 1 at its end. The structure h of the misfit,
its amplitude a and the factor c of the noise are unknown and averaged out:

    L(theta) = sum_h sum_a sum_c  w_h w_a w_c  N(y - f | 0, a^2 D K_h D + t^2 V G V + c^2 s0^2)

- h: each curve its own function along the path, squared-exponential of five lengths or Matern 3/2
  of two, x and y of a protocol independent or correlated (0.9); of several protocols also a
  function over the plane of stretches, of five lengths
- a: ten values from 0.002 to 0.4 under a half-normal prior of sd 0.05
- c: 1, or 2, 4 or 8 where readings scatter more than the load cell's noise says (a coarse
  resolution, curves read off a figure): else only a large misfit could explain them

The toe has t = 0.2 and r = 0.4. All protocols begin at one state, so it is a function of the
stretches: G is squared exponential over the plane of log stretches over their ranges, of length 1,
and x and y are independent. Drawn anew for each curve, it would leave a path between the tested
ones thirty times less known. With t = 0.4 intervals are 1.2 to 1.5 times as wide and held the truth
as often, on virtual tissue of six kinds with one and three protocols.

Everything but the residual is known before sampling. With S = t^2 V G V + c^2 s0^2 = L L' and the
eigenvectors U of L^-1 D K_h D L^-1' with eigenvalues e,

    -2 ln N = ln |S| + sum_j ln(1 + a^2 e_j)
              + |L^-1 r|^2 - sum_j (U' L^-1 r)_j^2 a^2 e_j / (1 + a^2 e_j).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.special import logsumexp

from biaxbayes.normal_errors import HALF_LOG_2PI, squared_exponential

AMPLITUDES = np.geomspace(0.002, 0.4, 10)
AMPLITUDE_SD = 0.05
FLOOR = 0.05
"""Least load that a misfit is relative to, as a fraction of the peak of its curve."""
TOE, TOE_LENGTH = 0.2, 0.4
"""Default sd of the relative error of the loads at the mounted state; length of the toe along the
path."""
NOISE_FACTORS = (1.0, 2.0, 4.0, 8.0)
NOISE_WEIGHTS = (0.85, 0.1, 0.04, 0.01)
"""Factors of the load cell's noise, and their prior weights."""
CORRELATION = 0.9
"""Of the misfits in x and y, in the structures where they are correlated."""
BLOCK = 1024
"""Draws that are evaluated together."""
LEAST_EIGENVALUE = 0.1
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

    def take(self, index: np.ndarray) -> CurvePoints:
        """Some of the points."""
        return CurvePoints(*(values[index] for values in vars(self).values()))

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


def log_amplitude_weights() -> np.ndarray:
    """Log prior weights of the amplitudes: a half-normal density over logarithmic steps."""
    # p(a) da = p(a) a d ln a
    log = np.log(AMPLITUDES) - 0.5 * (AMPLITUDES / AMPLITUDE_SD) ** 2
    return np.asarray(log - logsumexp(log))


# --- the likelihood ------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Component:
    """A structure with a factor of the noise: all amplitudes at once."""

    structure: Structure
    noise: int  # index of the factor
    columns: np.ndarray  # L^-1' U, (n, k)
    shrinkage: np.ndarray  # a^2 e / (1 + a^2 e), (k, amplitudes)
    constant: np.ndarray  # log density at zero residual with the log prior weight, (amplitudes,)


@dataclass(frozen=True, eq=False)
class SmoothMisfit:
    """Likelihood of readings under a smooth misfit of unknown structure and amplitude.

    Attributes
    ----------
    points : CurvePoints
        Of every curve: its mounted state, and the readings that follow.
    reading : ndarray, shape (n, points)
        Each reading as a mean of points: that of a mounted state, which several curves share, is
        the mean over them.
    noise_sd : ndarray, shape (n,)
        Of each reading.
    toe : float
        Amplitude t of the toe.
    protocols : int
        Number of protocols.
    """

    points: CurvePoints
    reading: np.ndarray
    noise_sd: np.ndarray
    toe: float = TOE
    protocols: int = 1

    def toe_covariance(self, a: CurvePoints, b: CurvePoints) -> np.ndarray:
        """t^2 V G V between the points a and b."""
        return self.toe**2 * a.toe_scale[:, None] * TOE_SHAPE.matrix(a, b) * b.toe_scale

    @cached_property
    def toe_and_noise(self) -> list[np.ndarray]:
        """S = t^2 V G V + c^2 s0^2 of the readings, for each factor of the noise."""
        toe = self.reading @ self.toe_covariance(self.points, self.points) @ self.reading.T
        return [toe + np.diag((c * self.noise_sd) ** 2) for c in NOISE_FACTORS]

    @cached_property
    def inverse_roots(self) -> list[np.ndarray]:
        """L^-1' for each factor of the noise, S = L L'."""
        identity = np.eye(len(self.noise_sd))
        return [
            solve_triangular(np.linalg.cholesky(s), identity, lower=True).T
            for s in self.toe_and_noise
        ]

    @cached_property
    def components(self) -> list[Component]:
        """All structures with all factors of the noise."""
        return list(self._components())

    def _components(self) -> Iterator[Component]:
        known = structures(self.protocols)
        weight = log_amplitude_weights() - np.log(len(known))
        for structure in known:
            between = structure.covariance(self.points, self.points)
            misfit = self.reading @ between @ self.reading.T
            for noise, root in enumerate(self.inverse_roots):
                values, vectors = np.linalg.eigh(root.T @ misfit @ root)
                used = values * AMPLITUDES[-1] ** 2 > LEAST_EIGENVALUE
                size = AMPLITUDES**2 * values[used, None]
                # ln |S| = -2 sum ln diag(L^-1)
                log_det = np.log1p(size).sum(axis=0) - 2.0 * np.log(np.diag(root)).sum()
                yield Component(
                    structure,
                    noise,
                    root @ vectors[:, used],
                    size / (1.0 + size),
                    weight
                    + np.log(NOISE_WEIGHTS[noise])
                    - 0.5 * log_det
                    - len(root) * HALF_LOG_2PI,
                )

    def log_weights(self, residual: np.ndarray) -> np.ndarray:
        """Log density of residuals (draws, n) under each component, prior weight included.

        Shape (draws, components, amplitudes).
        """
        whitened = [((residual @ root) ** 2).sum(axis=1) for root in self.inverse_roots]
        out = []
        for c in self.components:
            explained = (residual @ c.columns) ** 2 @ c.shrinkage
            out.append(c.constant - 0.5 * (whitened[c.noise][:, None] - explained))
        return np.stack(out, axis=1)

    def log_likelihood(self, residual: np.ndarray) -> np.ndarray:
        """Log likelihood of residuals, readings less model loads, (draws, n)."""
        out = np.empty(len(residual))
        for first in range(0, len(residual), BLOCK):
            part = slice(first, first + BLOCK)
            # ln sum exp, which takes scipy.special.logsumexp four times as long
            logs = self.log_weights(residual[part])
            top = logs.max(axis=(1, 2))
            out[part] = top + np.log(np.exp(logs - top[:, None, None]).sum(axis=(1, 2)))
        return out

    # --- the misfit given the readings -----------------------------------------------------------

    def choose(self, residual: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Structure, noise and amplitude of each draw, drawn given its residuals (n, readings).

        As an index (n,): component times the number of amplitudes, plus the amplitude.
        """
        logs = self.log_weights(residual).reshape(len(residual), -1)
        cumulative = np.cumsum(np.exp(logs - logsumexp(logs, axis=1, keepdims=True)), axis=1)
        chosen = (cumulative < rng.random((len(residual), 1))).sum(axis=1)
        return np.asarray(np.minimum(chosen, logs.shape[1] - 1))

    def given(
        self, residual: np.ndarray, chosen: np.ndarray, at: CurvePoints
    ) -> tuple[np.ndarray, np.ndarray]:
        """Mean and sd of the misfit at points, (draws, points), given the residuals of draws.

        ``chosen`` are structure, noise and amplitude of each draw, from :meth:`choose`: the misfit
        is then normal.
        """
        mean, sd = (np.empty((len(residual), len(at.path))) for _ in range(2))
        for index in np.unique(chosen):
            number, k = divmod(int(index), len(AMPLITUDES))
            rows = chosen == index
            gain, sd[rows] = self._conditional(self.components[number], float(AMPLITUDES[k]), at)
            mean[rows] = residual[rows] @ gain
        return mean, sd

    def _conditional(
        self, c: Component, amplitude: float, at: CurvePoints
    ) -> tuple[np.ndarray, np.ndarray]:
        """Matrix (n, points) from residuals to the mean at points, and the sd there."""

        def covariance(a: CurvePoints, b: CurvePoints) -> np.ndarray:
            return amplitude**2 * c.structure.covariance(a, b) + self.toe_covariance(a, b)

        noise = np.diag((NOISE_FACTORS[c.noise] * self.noise_sd) ** 2)
        of_readings = self.reading @ covariance(self.points, self.points) @ self.reading.T + noise
        cross = self.reading @ covariance(self.points, at)
        gain = cho_solve(cho_factor(of_readings, lower=True), cross)
        prior = (amplitude * at.scale) ** 2 + (self.toe * at.toe_scale) ** 2
        return gain, np.sqrt(np.maximum(prior - (gain * cross).sum(axis=0), 0.0))

    def noise_factors(self, chosen: np.ndarray) -> np.ndarray:
        """Factor of the noise of each draw (n,), from :meth:`choose`."""
        of_component = np.array([NOISE_FACTORS[c.noise] for c in self.components])
        return of_component[chosen // len(AMPLITUDES)]

    def amplitude(self, residual: np.ndarray) -> float:
        """Mean relative amplitude a of the smooth misfit over the draws."""
        logs = self.log_weights(residual)
        weight = np.exp(logs - logsumexp(logs, axis=(1, 2), keepdims=True)).sum(axis=1)
        return float((weight @ AMPLITUDES).mean())

    def draw(self, at: CurvePoints, rng: np.random.Generator) -> tuple[np.ndarray, float]:
        """One misfit drawn from its prior, at points, and a factor of the noise."""
        known = structures(self.protocols)
        structure = known[rng.integers(len(known))]
        amplitude = rng.choice(AMPLITUDES, p=np.exp(log_amplitude_weights()))
        between = amplitude**2 * structure.covariance(at, at) + self.toe_covariance(at, at)
        values, vectors = np.linalg.eigh(between)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        factor = float(rng.choice(NOISE_FACTORS, p=NOISE_WEIGHTS))
        return root @ rng.standard_normal(len(values)), factor
