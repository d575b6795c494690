"""Deterministic fits of a specimen: three that neglect nothing, two that many labs use."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.inference.alternation import best_alternation
from biaxbayes.inference.constrained import MOUNTING_STRETCH, constrained_fit, refuse_tared
from biaxbayes.inference.fit_result import FitResult, fit_result
from biaxbayes.inference.fixed_parameters import held_and_free
from biaxbayes.inference.multistart import best_descent
from biaxbayes.inference.readings import Readings, readings
from biaxbayes.inference.residuals import FreeMounting, GivenMounting
from biaxbayes.inference.starting_points import LOWER, UPPER, screened_points
from biaxbayes.inference.stress_response import coordinates_of
from biaxbayes.mechanics.goh import GOH
from biaxbayes.mechanics.mounting import BRACKET
from biaxbayes.specimens.specimen import Specimen

__all__ = ["METHODS", "PRESTRETCH_METHODS", "FitResult", "fit", "fit_all"]

METHODS = ("standard", "zeroed", "fip", "linden", "constrained")
PRESTRETCH_METHODS = ("fip", "linden", "constrained")


def fit(
    specimen: Specimen,
    method: str = "constrained",
    *,
    starts: int = 8,
    seed: int = 0,
    fixed: Mapping[str, float] | None = None,
    mounting_stretch: str = "shared",
    fibre_switch: bool = False,
    initial: GOH | None = None,
) -> FitResult:
    """Fit the GOH material, and the mounting stretch where the method has one.

    Parameters
    ----------
    specimen : Specimen
    method : str
        ``standard``: the mounted state is the reference, loads as they are.
        ``zeroed``: the same with the first load subtracted.
        ``fip``: the method paper's alternation of root finding and refitting.
        ``linden``: the mounting stretches are two more unknowns.
        ``constrained``: one least squares with the mounting stretch implicit.
        The first four minimise residuals of the Cauchy stress over all rows, as their
        authors did; ``constrained`` minimises residuals of the load, as the posterior does.
    starts : int
        Starting points, the most promising of 512 random ones. With ``initial`` it may be 0.
    seed : int
        Of the random starting points.
    fixed : mapping, optional
        Values held: C1, k1 in kPa, k2, alpha in degrees, kappa.
    mounting_stretch : {"shared", "per-protocol"}
    fibre_switch : bool
        Fibres carry no compression, as in Abaqus and FEBio.
    initial : GOH, optional
        A further starting point.

    Returns
    -------
    FitResult

    Raises
    ------
    TaredSpecimen
        If the method infers prestretch and the file's mounting force is zero.
    InputError
        For an unknown method or fixed parameter.
    """
    if method not in METHODS:
        raise InputError(f"unknown method {method!r}", remedy=f"one of {', '.join(METHODS)}")
    if mounting_stretch not in MOUNTING_STRETCH:
        raise InputError(
            f"unknown mounting stretch {mounting_stretch!r}",
            remedy=f"one of {', '.join(MOUNTING_STRETCH)}",
        )
    if method == "constrained":
        return constrained_fit(
            specimen,
            mounting_stretch=mounting_stretch,
            fixed=fixed,
            starts=starts,
            seed=seed,
            initial=initial,
            fibre_switch=fibre_switch,
        )
    if method in PRESTRETCH_METHODS:
        refuse_tared(specimen)
    point, free = held_and_free(fixed)
    data = readings(specimen, shared=mounting_stretch == "shared", zeroed=method == "zeroed")
    count = starts if initial is not None else max(starts, 1)
    points, stretches = screened_points(
        data,
        count,
        np.random.default_rng(seed),
        point=point,
        free=free,
        with_mounting=method in PRESTRETCH_METHODS,
    )
    if initial is not None:
        points = np.vstack([points.reshape(-1, 5), coordinates_of(initial)])
        stretches = np.vstack([stretches.reshape(-1, 2), np.ones(2)])
    return {
        "standard": _without_prestretch,
        "zeroed": _without_prestretch,
        "fip": _alternating,
        "linden": _free_mounting,
    }[method](method, data, points, stretches, point, free, fibre_switch)


def fit_all(
    specimen: Specimen,
    *,
    starts: int = 8,
    seed: int = 0,
    fixed: Mapping[str, float] | None = None,
    mounting_stretch: str = "shared",
    fibre_switch: bool = False,
) -> list[FitResult]:
    """Every method that the specimen allows; a tared one allows the two without prestretch."""
    methods = [m for m in METHODS if not (specimen.is_tared and m in PRESTRETCH_METHODS)]
    return [
        fit(
            specimen,
            method,
            starts=starts,
            seed=seed,
            fixed=fixed,
            mounting_stretch=mounting_stretch,
            fibre_switch=fibre_switch,
        )
        for method in methods
    ]


def _stress_scale(data: Readings) -> float:
    return max(float(np.abs(data.load * data.stretch / data.area[:, None]).max()), 1e-300)


def _without_prestretch(
    method: str,
    data: Readings,
    points: np.ndarray,
    stretches: np.ndarray,
    point: np.ndarray,
    free: np.ndarray,
    fibre_switch: bool,
) -> FitResult:
    one = np.ones_like(data.mounting_load)
    scale = _stress_scale(data)

    def problem() -> GivenMounting:
        return GivenMounting(data, "cauchy", point, free, scale, one, fibre_switch)

    found = best_descent(problem, [p[free] for p in points], LOWER[free], UPPER[free])
    return fit_result(
        method,
        data,
        problem().theta(found.unknowns),
        one,
        free,
        iterations=found.iterations,
        converged=found.converged,
        fibre_switch=fibre_switch,
    )


def _alternating(
    method: str,
    data: Readings,
    points: np.ndarray,
    stretches: np.ndarray,
    point: np.ndarray,
    free: np.ndarray,
    fibre_switch: bool,
) -> FitResult:
    held = np.setdiff1d(np.arange(5), free)
    points = points.copy()
    points[:, held] = point[held]
    found = best_alternation(
        data, list(points), free, _stress_scale(data), fibre_switch=fibre_switch
    )
    return fit_result(
        method,
        data,
        found.point,
        found.mounting,
        free,
        iterations=found.alternations,
        converged=found.converged,
        fibre_switch=fibre_switch,
    )


def _free_mounting(
    method: str,
    data: Readings,
    points: np.ndarray,
    stretches: np.ndarray,
    point: np.ndarray,
    free: np.ndarray,
    fibre_switch: bool,
) -> FitResult:
    scale = _stress_scale(data)
    groups = data.mounting_load.shape[1]
    one = np.ones_like(data.mounting_load)

    def problem() -> FreeMounting:
        return FreeMounting(data, "cauchy", point, free, scale, one, fibre_switch)

    starts = [
        np.concatenate([p[free], np.repeat(lm, groups)])
        for p, lm in zip(points, stretches, strict=True)
    ]
    lower = np.concatenate([LOWER[free], np.full(2 * groups, BRACKET[0])])
    upper = np.concatenate([UPPER[free], np.full(2 * groups, BRACKET[1])])
    found = best_descent(problem, starts, lower, upper)
    return fit_result(
        method,
        data,
        problem().theta(found.unknowns),
        found.unknowns[free.size :].reshape(2, -1),
        free,
        iterations=found.iterations,
        converged=found.converged,
        fibre_switch=fibre_switch,
    )
