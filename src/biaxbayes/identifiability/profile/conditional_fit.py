"""The best fit with one parameter fixed: what a profile likelihood is made of.

The deviance is -2 ln L of the posterior's own likelihood, with the error sd profiled out:

    D(theta, lm) = n_eff ln RSS(theta, lm) + sum_k ((f0_k - A0_k P_k(theta, lm)) / s0_k)^2

RSS is the misfit of the loads after the mounted state, n_eff = beta n the effective number of its n
readings (beta = 1 for independent errors), f0 the mounting reading with its own sd s0, never
tempered. No prior enters. The logarithm lies below its tangent, so least squares with the sd of the
last step lowers D at every step until it settles.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from biaxbayes.fitting.least_squares import descend
from biaxbayes.fitting.residuals import BalancedMounting, LoadResiduals, Readings
from biaxbayes.fitting.starting_points import screened_points
from biaxbayes.mechanics.mounting import BRACKET
from biaxbayes.options import Settings
from biaxbayes.specimens.specimen import Specimen

ROUNDS, STEPS = 30, 200
SETTLED = 1e-7
MIN_SD = 1e-9  # of the peak load: the misfit of exact data


@dataclass(frozen=True, eq=False)
class ConditionalFit:
    """A conditional optimum."""

    unknowns: np.ndarray  # (p + 2 m,): fit coordinates, then mounting stretches in x and in y
    deviance: float  # infinite where there is no fit
    error_sd: float  # in the unit of the loads


@dataclass(eq=False)
class ReadMounting(LoadResiduals):
    """Material and mounting stretches unknown, the mounting load has a reading."""

    reading: np.ndarray = field(default_factory=lambda: np.zeros((2, 1)))  # (2, m)
    reading_sd: np.ndarray = field(default_factory=lambda: np.ones((2, 1)))
    # indices into fit coordinates, then lm_x..., lm_y...
    unknown: np.ndarray = field(default_factory=lambda: np.arange(0))

    def all(self, unknowns: np.ndarray) -> np.ndarray:
        """Every parameter, the fixed ones filled in."""
        out = np.concatenate([self.point, self.mounting_stretch.ravel()])
        out[self.unknown] = unknowns
        return out

    def evaluate(self, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual vector and its derivative."""
        full = self.all(unknowns)
        size = self.point.size
        point, lm = full[:size], full[size:].reshape(self.mounting_stretch.shape)
        r, by_point, by_lm, state = self._rows(point, lm)
        by_all = np.hstack([by_point.T, by_lm / lm.ravel()])
        z = (state.load - self.reading) / self.reading_sd
        z_point = state.by_coordinate / self.reading_sd[:, None, :]
        z_point = z_point.transpose(0, 2, 1).reshape(-1, size)
        slope = state.by_log_mounting / self.reading_sd[:, None, :] / lm
        groups = self.reading.shape[1]
        z_lm = np.zeros((2, groups, 2, groups))
        for g in range(groups):
            z_lm[:, g, :, g] = slope[:, :, g]
        z_all = np.hstack([z_point, z_lm.reshape(2 * groups, -1)])
        return (
            np.concatenate([r, z.ravel()]),
            np.vstack([by_all, z_all])[:, self.unknown],
        )


class ConditionalLikelihood:
    """The likelihood as a function of fixed parameters (by index, in fit coordinates)."""

    def __init__(
        self, specimen: Specimen, settings: Settings, beta: float, fixed: dict[int, float]
    ) -> None:
        self.settings = settings
        self.law = settings.material_law
        self.theta = self.law.lower.size  # unknowns before the mounting stretches
        shared = settings.shared
        data = Readings.from_specimen(specimen, shared=shared, zeroed=settings.mounting == "zeroed")
        self.data: Readings = data.stretched()
        self.reading = data.mounting_load
        self.reading_sd = data.mounting_sd
        self.fixed = dict(fixed)
        self.rows = 2 * self.data.group.size
        self.beta = beta
        self.reads = settings.reads_force
        self.groups = self.reading.shape[1]
        self.size = self.theta + 2 * self.groups
        top = np.full(2 * self.groups, BRACKET[1])
        self.lower = np.concatenate([self.law.lower, np.full(2 * self.groups, BRACKET[0])])
        self.upper = np.concatenate([self.law.upper, top])

    @property
    def adjustable(self) -> np.ndarray:
        """Indices of the unknowns that are free when no parameter is fixed."""
        count = self.size if self.reads else self.theta
        return np.array([i for i in range(count) if i not in self.fixed], dtype=int)

    def best(
        self,
        fixed_values: dict[int, float],
        start: np.ndarray,
        error_sd: float,
        *,
        rounds: int = ROUNDS,
        steps: int = STEPS,
    ) -> ConditionalFit:
        """The lowest deviance with some unknowns fixed; `error_sd` is a first value."""
        point = np.array(start, dtype=float)
        for index, value in {**self.fixed, **fixed_values}.items():
            point[index] = value
        free = np.array([i for i in self.adjustable if i not in fixed_values], dtype=int)
        floor = MIN_SD * self.data.peak
        sd, before = max(error_sd, floor), np.inf
        fit = ConditionalFit(point, np.inf, sd)
        for _ in range(rounds):
            fit = self._step(fit.unknowns, free, sd, steps)
            sd = max(fit.error_sd, floor)
            if not (np.isfinite(fit.deviance) and before - fit.deviance > SETTLED):
                break
            before = fit.deviance
        return fit

    def extra_starts(self, fixed_values: dict[int, float], count: int) -> list[np.ndarray]:
        """Promising starting points far from any other fit, the best of many random materials."""
        point = np.zeros(self.theta)
        known = {**self.fixed, **fixed_values}
        for index in known:
            if index < self.theta:
                point[index] = known[index]
        free = np.array([i for i in range(self.theta) if i not in known], dtype=int)
        materials, lm = screened_points(
            self.data,
            count,
            np.random.default_rng(0),
            self.law,
            point=point,
            free=free,
            with_mounting=self.settings.infers_mounting,
        )
        return [
            np.concatenate([material, np.repeat(pair, self.groups)])
            for material, pair in zip(materials, lm, strict=True)
        ]

    def _step(self, point: np.ndarray, free: np.ndarray, sd: float, steps: int) -> ConditionalFit:
        """Least squares with a given error sd, and the deviance where it ends."""
        problem = self._problem(point, free, sd / np.sqrt(self.beta))
        lower, upper = self.lower[free], self.upper[free]
        x = np.clip(point[free], lower, upper)
        if free.size:
            x = descend(problem, x, lower, upper, steps=steps, tolerance=1e-13).unknowns
        residual = problem.residual(x)
        if not np.isfinite(residual).all():
            return ConditionalFit(point, np.inf, sd)
        solution = point.copy()
        solution[free] = x
        if isinstance(problem, BalancedMounting):
            solution[self.theta :] = problem.mounting(x).ravel()
        # residuals are in units of sd / sqrt(beta)
        squares = float(residual[: self.rows] @ residual[: self.rows]) * sd**2 / self.beta
        new = max(np.sqrt(squares / self.rows), MIN_SD * self.data.peak)
        z = residual[self.rows :]
        deviance = 2.0 * self.beta * self.rows * np.log(new) + float(z @ z)
        return ConditionalFit(solution, deviance, float(new))

    def _problem(self, point: np.ndarray, free: np.ndarray, scale: float) -> LoadResiduals:
        lm = point[self.theta :].reshape(2, -1)
        theta = free[free < self.theta]
        if self.reads:
            return ReadMounting(
                self.data,
                "load",
                point[: self.theta],
                theta,
                scale,
                lm,
                self.law,
                reading=self.reading,
                reading_sd=self.reading_sd,
                unknown=free,
            )
        kind = BalancedMounting if self.settings.mounting == "exact" else LoadResiduals
        lm = np.ones_like(lm) if not self.settings.infers_mounting else lm
        return kind(self.data, "load", point[: self.theta], theta, scale, lm, self.law)
