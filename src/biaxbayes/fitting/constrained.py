"""Least-squares fit of theta with the mounting stretch implicit in the force balance.

With z the mounting force less its reading in sds s0 of the load cell, r the residuals of the rows
after those at rest, w their sd in each piece (profiled: their root mean square), c the stiffness
of a further piece over that of the first, with sd s, and m +- v a mounting stretch that the header
gives, it minimises

    sum z^2 + sum r^2 / w^2 + sum (ln c)^2 / s^2 + sum (lm - m)^2 / v^2

by reweighted least squares: the mode of independent errors, without other priors. Its minimum is
what is reported as a fit, where a sampler starts, and how other laws are fitted.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from biaxbayes.errors import InputError, TaredSpecimen
from biaxbayes.fitting.fit_result import FitResult, rounding_bound
from biaxbayes.fitting.least_squares import (
    DESCENT_TOLERANCE,
    FINALISTS,
    MAX_DESCENT_STEPS,
    Descent,
    best_descent,
    descend,
)
from biaxbayes.fitting.residuals import BalancedMounting, LoadResiduals
from biaxbayes.fitting.starting_points import fixed_and_free, screened_points
from biaxbayes.laws import law_named
from biaxbayes.laws.law import Law
from biaxbayes.laws.materials import MaterialResponse
from biaxbayes.mechanics.mounting import BRACKET
from biaxbayes.options import MOUNTING_STRETCH, FitOptions, Settings
from biaxbayes.specimens.rows import MeasuredRows
from biaxbayes.specimens.specimen import Specimen

FIT_MOUNTING = ("exact", "noisy", "ignored", "zeroed")
MAX_REWEIGHTINGS, REWEIGHTED_TOLERANCE = 50, 1e-10
MIN_RELATIVE_SD = 1e-6
"""Relative to the peak load: a reading with a smaller sd is treated as exact."""


@dataclass(frozen=True, eq=False)
class FitSetup:
    """Constant inputs of a fit, for one of several modes of the mounting force.

    - noisy: it is unknown, and its reading is one datum with the load cell's sd
    - exact: the reading is taken as exact, as in files without load noise
    - ignored, zeroed: the mounted state is taken as unloaded, with unchanged loads, or loads
      less their first reading
    """

    specimen: Specimen
    law: Law
    mounting: str
    data: MeasuredRows
    point: np.ndarray  # fit coordinates with the fixed values
    free: np.ndarray  # indices of the others
    piece_sd: float = 0.0  # of the logs of the stiffnesses of further pieces

    @classmethod
    def from_options(
        cls,
        specimen: Specimen,
        mounting: str = "noisy",
        *,
        mounting_stretch: str = FitOptions.mounting_stretch,
        fixed: Mapping[str, float] | None = None,
        law: str = FitOptions.law,
        fibre_switch: bool = False,
        piece_sd: float = FitOptions.piece_sd,
    ) -> FitSetup:
        """Inputs of a fit with checked options and fixed values; options as in :func:`.fit`.

        Raises TaredSpecimen if a tared file has no mounting force to infer from, and InputError for
        an unknown option or fixed parameter.
        """
        chosen = law_named(law, fibre_switch=fibre_switch)
        for option, value, known in (
            ("mounting", mounting, FIT_MOUNTING),
            ("mounting stretch", mounting_stretch, MOUNTING_STRETCH),
        ):
            if value not in known:
                raise InputError(f"unknown {option} {value!r}", remedy=f"one of {', '.join(known)}")
        if mounting in ("exact", "noisy") and specimen.is_tared:
            raise TaredSpecimen(
                f"{specimen.name}: the force at the mounted state is zero (a tared load cell), so "
                "prestretch cannot be inferred",
                remedy="give the force before taring with `mounting_force` X Y, or fit without "
                "prestretch (zeroed)",
            )
        shared = mounting_stretch == "shared"
        data = MeasuredRows.from_specimen(specimen, shared=shared, mounting=mounting)
        sd = piece_sd if specimen.further else 0.0
        return cls(specimen, chosen, mounting, data, *fixed_and_free(fixed, chosen), sd)

    @classmethod
    def from_settings(
        cls, specimen: Specimen, settings: Settings, fixed: Mapping[str, float] | None = None
    ) -> FitSetup:
        """Inputs of the fit of a statistical model; ``fixed`` in place of its fixed values."""
        return cls.from_options(
            specimen,
            settings.fit_mounting,
            mounting_stretch=settings.mounting_stretch,
            fixed=settings.fixed_material if fixed is None else fixed,
            law=settings.law,
            fibre_switch=settings.fibre_switch,
            piece_sd=settings.piece_sd,
        )

    @property
    def balanced(self) -> bool:
        """True if the mounting stretch is inferred."""
        return self.mounting in ("exact", "noisy")

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of the free coordinates."""
        return self.law.lower[self.free], self.law.upper[self.free]

    def starting_points(
        self, starts: int, seed: int | np.random.Generator, initial: MaterialResponse | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Materials (n, p) and mounting stretches (n, 2): screened ones, and the initial one."""
        points, stretches = np.empty((0, self.point.size)), np.empty((0, 2))
        count = starts if initial is not None else max(starts, 1)
        if count:
            rng = np.random.default_rng(seed)
            points, stretches = screened_points(
                self.data, count, rng, self.law, self.point, self.free, with_mounting=self.balanced
            )
        if initial is not None:
            points = np.vstack([points, self.law.to_fit_coordinates(initial.values)])
            stretches = np.vstack([stretches, np.ones(2)])
        return points, stretches

    def fitted(
        self,
        starts: int = FitOptions.starts,
        seed: int | np.random.Generator = 0,
        initial: MaterialResponse | None = None,
        *,
        compiled: bool = True,  # one uncompiled fit is faster than loading the cache
        compared: FitSetup | None = None,  # of all rows of a record that was averaged, say
        **limits: Any,
    ) -> FitResult:
        """The fit from screened materials and the initial one; ``limits`` as in :func:`minimum`."""
        points, _ = self.starting_points(starts, seed, initial)
        problem, descent = minimum(self, points, compiled=compiled, **limits)
        method = "zeroed" if self.mounting == "zeroed" else "standard"
        return (compared or self).result(
            "constrained" if self.balanced else method,
            problem.fit_coordinates(descent.unknowns),
            problem.mounting(descent.unknowns),
            descent,
            problem.stiffness(descent.unknowns),
        )

    def result(
        self,
        method: str,
        point: np.ndarray,
        mounting_stretch: np.ndarray,
        descent: Descent,
        stiffness: np.ndarray | None = None,
    ) -> FitResult:
        """Result of fit coordinates and mounting stretches (m, 2), compared with the data."""
        data, law = self.data, self.law
        lm = np.where(np.isfinite(mounting_stretch), mounting_stretch, 1.0)
        stiffness = np.ones(len(data.pieces)) if stiffness is None else stiffness
        model = LoadResiduals(data, "load", point, self.free, 1.0, lm, law)
        with np.errstate(all="ignore"):
            response = model.response(point, lm, stiffness)
            mounting_load = model.mounted_response(point, lm).load
            mounting_load *= stiffness[data.piece_of_state, None]
            mounting_load[~data.is_mounted] = 0.0
            # Cauchy stress of the data: f l lm / A0 (unloaded), f l / Am (mounted)
            measured = (data.load / response.load_per_stress)[data.is_read]
            residual = measured - (response.load / response.load_per_stress)[data.is_read]
            total = float(((measured - measured.mean()) ** 2).sum())
            r2 = 1.0 - float((residual**2).sum()) / total if total > 0.0 else math.nan
            rmse = float(np.sqrt((residual**2).mean()))
            converged = descent.converged
            if not converged and np.isfinite(mounting_stretch).all():
                converged = rmse <= rounding_bound(data, response)
            load_residual = (data.load - response.load) / data.load_scale
            if np.sqrt((load_residual[data.is_read] ** 2).mean()) < self.specimen.load_resolution:
                load_residual = np.zeros_like(load_residual)
        at_bound = []  # names of the unknowns that ended on a bound
        for i in self.free:
            low, high, logarithmic = law.lower[i], law.upper[i], law.parameters[i].logarithmic
            at_low = point[i] <= low + (0.0 if logarithmic else 1e-9 * high)
            if at_low or point[i] >= high * (1.0 - 1e-9):
                at_bound.append(law.names[i])
        for axis, own in zip("xy", lm.T, strict=True):
            if method == "linden" and ((own <= BRACKET[0]) | (own >= BRACKET[1])).any():
                at_bound.append(f"mounting_stretch_{axis}")
        return FitResult(
            method=method,
            material=law.material_at(law.from_fit_coordinates(point)),
            mounting_stretch=lm,
            mounting_load=mounting_load,
            stiffness=stiffness,
            r2=r2,
            rmse_kPa=rmse,
            mae_kPa=float(np.abs(residual).mean()),
            iterations=descent.iterations,
            converged=bool(converged and np.isfinite(rmse)),
            at_bound=tuple(at_bound),
            residuals=tuple(
                load_residual[~data.at_rest & (data.protocol == p)] for p in range(len(data.names))
            ),
        )


def minimum(
    setup: FitSetup,
    points: np.ndarray,
    *,
    compiled: bool,
    finalists: int = FINALISTS,
    steps: int = MAX_DESCENT_STEPS,
    tolerance: float = DESCENT_TOLERANCE,
) -> tuple[LoadResiduals, Descent]:
    """The problem at its final weights, and its minimum; a noisy reading is exact at first."""
    data, rows_in_fit, free = setup.data, setup.data.loaded(), setup.free
    peaks, one = data.peaks, np.ones_like(data.mounting_load)

    def problem_at(
        scale: np.ndarray, reading_sd: np.ndarray, piece_sd: float = 0.0
    ) -> LoadResiduals:
        common = (rows_in_fit, "load", setup.point, free, scale, one, setup.law)
        if not setup.balanced:
            return LoadResiduals(*common)
        return BalancedMounting(*common, reading_sd, compiled, piece_sd)

    sd = np.zeros_like(data.mounting_sd)  # of noisy readings
    problem = problem_at(peaks, sd)
    lower, upper = setup.bounds
    limits: dict[str, Any] = {"steps": steps, "tolerance": tolerance}
    descent = best_descent(problem, points[:, free], lower, upper, finalists=finalists, **limits)
    floor = MIN_RELATIVE_SD * peaks
    least = floor[data.piece_of_state, None]
    exact = setup.mounting != "noisy" or (data.mounting_sd <= least).all()
    known = np.isfinite(data.measured_mounting).any()
    settled = exact and not setup.piece_sd and not known
    if not np.isfinite(descent.cost) or not setup.balanced or settled:
        return problem, descent

    if not exact:
        sd = np.where(data.is_mounted, np.maximum(data.mounting_sd, least), 0.0)
    others = int((sd > 0.0).sum()) + (len(data.pieces) - 1 if setup.piece_sd else 0)
    unknowns = np.concatenate([descent.unknowns, np.zeros(others)])
    lower = np.concatenate([lower, np.full(others, -np.inf)])
    upper = np.concatenate([upper, np.full(others, np.inf)])
    limits["tolerance"] = max(tolerance, REWEIGHTED_TOLERANCE)
    piece = np.repeat(rows_in_fit.piece, 2)
    count = np.bincount(piece, rows_in_fit.is_read.ravel(), minlength=len(peaks))

    def rms_of_pieces(problem: LoadResiduals, unknowns: np.ndarray) -> np.ndarray:
        residual = problem.residual(unknowns)[: piece.size] * problem.scale[piece]  # type: ignore[index]
        square = np.bincount(piece, residual**2, minlength=len(peaks)) / count
        return np.asarray(np.maximum(np.sqrt(square), floor))

    rms = rms_of_pieces(problem, descent.unknowns)
    iterations, stable = descent.iterations, False
    for _ in range(MAX_REWEIGHTINGS):
        problem = problem_at(rms, sd, setup.piece_sd)
        descent = descend(problem, unknowns, lower, upper, **limits)
        unknowns, iterations = descent.unknowns, iterations + descent.iterations
        new_rms = rms_of_pieces(problem, unknowns)
        stable = bool((np.abs(new_rms - rms) <= 1e-4 * rms).all())
        rms = new_rms
        if stable:
            break
    return problem, Descent(unknowns, descent.cost, iterations, descent.converged and stable)
