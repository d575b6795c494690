"""One least squares over theta with the mounting stretch implicit in the force balance.

It minimises the posterior's own misfit, without its priors. With z the mounting force less its
reading in sds s0 of the load cell, r the residuals of the n stretched rows, w their sd (profiled:
their root mean square) and beta their weight n_eff / n,

    sum z^2 + beta sum r^2 / w^2.

Its minimum is what is reported as a fit, where a sampler starts, and how other laws are fitted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from biaxbayes.errors import InputError, TaredSpecimen
from biaxbayes.fitting.effective_readings import effective_readings
from biaxbayes.fitting.least_squares import (
    FINALISTS,
    STEPS,
    TOLERANCE,
    Descent,
    best_descent,
    descend,
)
from biaxbayes.fitting.residuals import BalancedMounting, LoadResiduals, Readings
from biaxbayes.fitting.result import FitResult, fit_result
from biaxbayes.fitting.starting_points import fixed_and_free, screened_points
from biaxbayes.laws import law_named
from biaxbayes.laws.law import Law
from biaxbayes.laws.materials import MaterialResponse
from biaxbayes.options import MOUNTING_STRETCH, FitOptions
from biaxbayes.specimens.specimen import Specimen

FIT_MOUNTING = ("exact", "noisy", "ignored", "zeroed")
MAX_REWEIGHTINGS, REWEIGHTED_TOLERANCE = 50, 1e-10
MAX_WEIGHTS = 10
"""beta changes discontinuously, so it is frozen after this many iterations."""
MIN_SD = 1e-6
"""Relative to the peak load: a reading with a smaller sd is treated as exact."""


def constrained_fit(
    specimen: Specimen,
    *,
    mounting: str = "noisy",
    weighted: bool = True,
    mounting_stretch: str = "shared",
    fixed: Mapping[str, float] | None = None,
    starts: int = 8,
    seed: int = 0,
    initial: MaterialResponse | None = None,
    law: str = FitOptions.law,
    fibre_switch: bool = False,
    compiled: bool = True,
) -> FitResult:
    """Least squares on the measured load, the mounting stretch solved for at every step.

    ``mounting`` is one of:

    - noisy: the mounting force is unknown, and its reading is one datum with the load cell's sd
    - exact: the reading is taken as exact, as in files without load noise
    - ignored, zeroed: the mounted state is taken as unloaded, with loads as they are, or less
      their reading

    ``weighted`` counts rows by their effective number. ``initial`` is a further starting point,
    with which ``starts`` may be 0. ``compiled`` solves for the mounted state in compiled code; for
    a single fit, uncompiled code is faster than loading the cache.

    The result has not converged when no start could be evaluated (no mounting stretch balances the
    reading). Raises TaredSpecimen if a tared file has no mounting force to infer from, and
    InputError for an unknown option or fixed parameter.
    """
    chosen = law_named(law, fibre_switch=fibre_switch)
    setup = fit_setup(
        specimen, mounting, mounting_stretch, fixed, chosen, weighted=weighted, compiled=compiled
    )
    problem, descent = minimum(setup, starting_points(setup, starts, seed, initial))
    return setup.result(specimen, problem, descent)


@dataclass(frozen=True, eq=False)
class FitSetup:
    """Constant inputs of a fit."""

    data: Readings
    stretched: Readings
    point: np.ndarray
    free: np.ndarray
    mounting: str
    sd: np.ndarray | None  # of the mounting readings; None where they are exact
    law: Law
    weighted: bool
    compiled: bool

    @property
    def balanced(self) -> bool:
        """True if the mounting stretch is inferred."""
        return self.mounting in ("exact", "noisy")

    def problem(self, scale: float | None = None) -> LoadResiduals:
        """Residuals over the peak load, the reading exact; or over ``scale``, the reading noisy."""
        scaled = self.data.peak if scale is None else scale
        one = np.ones_like(self.data.mounting_load)
        common = (self.stretched, "load", self.point, self.free, scaled, one, self.law)
        if not self.balanced:
            return LoadResiduals(*common)
        sd = None if scale is None else self.sd
        return BalancedMounting(*common, reading_sd=sd, compiled=self.compiled)

    def by_protocol(self, residual: np.ndarray) -> list[np.ndarray]:
        """Rows of a residual vector, one array (n_p, 2) per protocol."""
        n = self.stretched.group.size
        pairs = residual[: 2 * n].reshape(2, n).T
        return [pairs[rows] for rows in self.stretched.rows]

    def result(self, specimen: Specimen, problem: LoadResiduals, descent: Descent) -> FitResult:
        """The fit result of a minimum."""
        method = "zeroed" if self.mounting == "zeroed" else "standard"
        return fit_result(
            "constrained" if self.balanced else method,
            specimen,
            self.data,
            problem.fit_coordinates(descent.unknowns),
            problem.mounting(descent.unknowns),
            self.free,
            iterations=descent.iterations,
            converged=descent.converged,
            law=self.law,
        )


def refuse_tared(specimen: Specimen) -> None:
    """Raise :class:`TaredSpecimen` where the mounting force was zeroed."""
    if specimen.is_tared:
        raise TaredSpecimen(
            f"{specimen.name}: the force at the mounted state is zero (a tared load cell), so "
            "prestretch cannot be inferred",
            remedy="give the force before taring with `mounting_force` X Y, or fit without "
            "prestretch (zeroed)",
        )


def fit_setup(
    specimen: Specimen,
    mounting: str,
    mounting_stretch: str,
    fixed: Mapping[str, float] | None,
    law: Law,
    *,
    weighted: bool,
    compiled: bool,
) -> FitSetup:
    """Inputs of a fit with checked options and fixed values."""
    if mounting not in FIT_MOUNTING:
        raise InputError(
            f"unknown mounting {mounting!r}", remedy=f"one of {', '.join(FIT_MOUNTING)}"
        )
    if mounting_stretch not in MOUNTING_STRETCH:
        raise InputError(
            f"unknown mounting stretch {mounting_stretch!r}",
            remedy=f"one of {', '.join(MOUNTING_STRETCH)}",
        )
    if mounting in ("exact", "noisy"):
        refuse_tared(specimen)
    point, free = fixed_and_free(fixed, law)
    data = Readings.from_specimen(
        specimen, shared=mounting_stretch == "shared", zeroed=mounting == "zeroed"
    )
    sd = None
    if mounting == "noisy" and data.mounting_sd.max() > MIN_SD * data.peak:
        sd = np.maximum(data.mounting_sd, MIN_SD * data.peak)
    return FitSetup(data, data.stretched(), point, free, mounting, sd, law, weighted, compiled)


def starting_points(
    setup: FitSetup, starts: int, seed: int, initial: MaterialResponse | None
) -> list[np.ndarray]:
    """Coordinates of materials to start from: screened random ones, and the one given."""
    count = starts if initial is not None else max(starts, 1)
    points: list[np.ndarray] = []
    if count:
        screened, _ = screened_points(
            setup.data,
            count,
            np.random.default_rng(seed),
            setup.law,
            point=setup.point,
            free=setup.free,
            with_mounting=setup.balanced,
        )
        points.extend(screened)
    if initial is not None:
        points.append(setup.law.point(initial.values))
    return points


def minimum(
    setup: FitSetup,
    points: Sequence[np.ndarray],
    *,
    finalists: int = FINALISTS,
    steps: int = STEPS,
    tolerance: float = TOLERANCE,
) -> tuple[LoadResiduals, Descent]:
    """The problem at its final weights, and its minimum."""
    exact = setup.problem()
    descent = best_descent(
        exact,
        [p[setup.free] for p in points],
        setup.law.lower[setup.free],
        setup.law.upper[setup.free],
        finalists=finalists,
        steps=steps,
        tolerance=tolerance,
    )
    if setup.sd is None or not np.isfinite(descent.cost):
        return exact, descent
    return _reweighted(setup, descent, steps, max(tolerance, REWEIGHTED_TOLERANCE))


def _reweighted(
    setup: FitSetup, exact: Descent, steps: int, tolerance: float
) -> tuple[LoadResiduals, Descent]:
    """Reweighted least squares with unknown mounting forces, until w and beta are stable."""
    offsets = setup.data.mounting_load.size
    unknowns = np.concatenate([exact.unknowns, np.zeros(offsets)])
    infinite = np.full(offsets, np.inf)
    lower = np.concatenate([setup.law.lower[setup.free], -infinite])
    upper = np.concatenate([setup.law.upper[setup.free], infinite])
    rows = 2 * setup.stretched.group.size
    floor = MIN_SD * setup.data.peak
    rms, beta = max(np.sqrt(exact.cost / rows) * setup.data.peak, floor), 1.0
    iterations, stable = exact.iterations, False
    for iteration in range(MAX_REWEIGHTINGS):
        scale = rms / np.sqrt(beta)
        problem = setup.problem(scale)
        descent = descend(problem, unknowns, lower, upper, steps=steps, tolerance=tolerance)
        unknowns, iterations = descent.unknowns, iterations + descent.iterations
        misfit = problem.residual(unknowns)[:rows] * scale
        new_rms = max(float(np.sqrt(misfit @ misfit / rows)), floor)
        new_beta = beta
        if setup.weighted and iteration < MAX_WEIGHTS:
            new_beta = effective_readings(setup.by_protocol(misfit)).beta
        stable = abs(new_rms - rms) <= 1e-4 * rms and abs(new_beta - beta) <= 0.01 * beta
        rms, beta = new_rms, new_beta
        if stable:
            break
    return problem, Descent(unknowns, descent.cost, iterations, descent.converged and stable)
