"""The best fit with one parameter fixed: what a profile likelihood is made of.

The deviance is -2 ln L of the posterior's own likelihood, with the error sd profiled out:

    D(theta, lm) = n_eff ln RSS(theta, lm) + sum_k ((f0_k - A0_k P_k(theta, lm)) / s0_k)^2

RSS is the misfit of the loads after the mounted state, n_eff = beta n the effective number of its n
readings (beta = 1 for independent errors), f0 the mounting reading with its own sd s0, never
tempered. No prior enters. The logarithm lies below its tangent, so least squares with the sd of the
last step lowers D at every step until it converges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from biaxbayes.fitting.least_squares import descend
from biaxbayes.fitting.residuals import (
    BalancedMounting,
    FreeMounting,
    LoadResiduals,
    Readings,
)
from biaxbayes.fitting.starting_points import screened_points
from biaxbayes.mechanics.mounting import BRACKET
from biaxbayes.options import Settings
from biaxbayes.specimens.specimen import Specimen

MAX_ROUNDS, MAX_CONDITIONAL_STEPS = 30, 200
DEVIANCE_TOLERANCE = 1e-7
MIN_ERROR_SD = 1e-9  # of the peak load: the misfit of exact data


@dataclass(frozen=True, eq=False)
class ConditionalFit:
    """A conditional optimum."""

    unknowns: np.ndarray  # (p + 2 m,): fit coordinates, then mounting stretches in x and in y
    deviance: float  # infinite where there is no fit
    error_sd: float  # in the unit of the loads


class ConditionalLikelihood:
    """The likelihood as a function of fixed parameters (by index, in fit coordinates)."""

    def __init__(
        self, specimen: Specimen, settings: Settings, beta: float, fixed: dict[int, float]
    ) -> None:
        self.settings, self.beta, self.fixed = settings, beta, dict(fixed)
        self.law = settings.material_law
        data = Readings.from_specimen(
            specimen, shared=settings.shared, zeroed=settings.mounting == "zeroed"
        )
        self.data: Readings = data.loaded_rows()
        self.rows = 2 * self.data.group.size
        self.groups = data.mounting_load.shape[1]
        self.theta = self.law.lower.size  # unknowns before the mounting stretches
        stretches = 2 * self.groups
        self.lower = np.concatenate([self.law.lower, np.full(stretches, BRACKET[0])])
        self.upper = np.concatenate([self.law.upper, np.full(stretches, BRACKET[1])])

    def best(
        self,
        fixed_values: dict[int, float],
        start: np.ndarray,
        error_sd: float,
        *,
        rounds: int = MAX_ROUNDS,
        steps: int = MAX_CONDITIONAL_STEPS,
    ) -> ConditionalFit:
        """The lowest deviance with some unknowns fixed; `error_sd` is a first value."""
        fixed = {**self.fixed, **fixed_values}
        point = np.array(start, dtype=float)
        for index, value in fixed.items():
            point[index] = value
        count = self.lower.size if self.settings.reads_force else self.theta
        free = np.array([i for i in range(count) if i not in fixed], dtype=int)
        floor = MIN_ERROR_SD * self.data.peak
        sd, previous = max(error_sd, floor), np.inf
        fit = ConditionalFit(point, np.inf, sd)
        for _ in range(rounds):
            fit = self._step(fit.unknowns, free, sd, steps)
            sd = max(fit.error_sd, floor)
            if not (np.isfinite(fit.deviance) and previous - fit.deviance > DEVIANCE_TOLERANCE):
                break
            previous = fit.deviance
        return fit

    def extra_starts(self, fixed_values: dict[int, float], count: int) -> list[np.ndarray]:
        """Promising starting points far from any other fit, the best of many random materials."""
        point = np.zeros(self.theta)
        fixed = {i: v for i, v in {**self.fixed, **fixed_values}.items() if i < self.theta}
        point[list(fixed)] = list(fixed.values())
        free = np.array([i for i in range(self.theta) if i not in fixed], dtype=int)
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
        settings, split = self.settings, self.theta
        lm = point[split:].reshape(2, -1) if settings.infers_mounting else np.ones((2, self.groups))
        scale = sd / np.sqrt(self.beta)
        common = (self.data, "load", point[:split], free[free < split], scale, lm, self.law)
        if settings.reads_force:
            free_mounting = free[free >= split] - split
            problem: LoadResiduals = FreeMounting(*common, free_mounting, self.data.mounting_sd)
        elif settings.mounting == "exact":
            problem = BalancedMounting(*common)
        else:
            problem = LoadResiduals(*common)
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
            solution[split:] = problem.mounting(x).ravel()
        # residuals are in units of sd / sqrt(beta)
        squares = float(residual[: self.rows] @ residual[: self.rows]) * sd**2 / self.beta
        new = max(np.sqrt(squares / self.rows), MIN_ERROR_SD * self.data.peak)
        z = residual[self.rows :]
        deviance = 2.0 * self.beta * self.rows * np.log(new) + float(z @ z)
        return ConditionalFit(solution, deviance, float(new))
