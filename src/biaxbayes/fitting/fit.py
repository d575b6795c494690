"""Deterministic fits of a specimen: three that neglect nothing, two that many labs use.

Math. Comput. Appl. 2024, 29(4), 55, Section 2.2.2 and Figure 2. Its fixed point is not a
minimum of one objective: with noise it differs from the least-squares solutions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.fitting.constrained import MOUNTING_STRETCH, constrained_fit, refuse_tared
from biaxbayes.fitting.least_squares import best_descent, descend
from biaxbayes.fitting.residuals import (
    FreeMounting,
    GivenMounting,
    Readings,
    readings,
)
from biaxbayes.fitting.result import FitResult, fit_result
from biaxbayes.fitting.starting_points import held_and_free, screened_points
from biaxbayes.laws import law_named
from biaxbayes.laws.law import Law
from biaxbayes.laws.materials import MaterialResponse
from biaxbayes.mechanics.mounting import BRACKET
from biaxbayes.options import FIT_METHODS, FitOptions
from biaxbayes.specimens.specimen import Specimen

# --- the method paper's own fit: root-find the mounting stretch, update the data, refit; repeat --


MAX_ALTERNATIONS = 500
SCOUTING = 40
TOLERANCE = 1e-10


@dataclass(frozen=True, eq=False)
class Alternation:
    """Where an alternation ended.

    Attributes
    ----------
    point : ndarray, shape (p,)
        Coordinates of the fit.
    mounting : ndarray, shape (2, m)
    cost : float
        Sum of squared Cauchy residuals over the squared scale.
    """

    point: np.ndarray
    mounting: np.ndarray
    cost: float
    alternations: int
    converged: bool


def best_alternation(
    data: Readings,
    starts: Sequence[np.ndarray],
    free: np.ndarray,
    scale: float,
    law: Law,
) -> Alternation:
    """Alternate loosely from every start, then the best to the end."""
    scouted = [alternate(data, p, free, scale, law, most=SCOUTING, tolerance=1e-4) for p in starts]
    best = min(scouted, key=lambda found: (not found.converged, found.cost))
    end = alternate(data, best.point, free, scale, law, first=best.mounting)
    count = best.alternations + end.alternations
    return Alternation(end.point, end.mounting, end.cost, count, end.converged)


def alternate(
    data: Readings,
    point: np.ndarray,
    free: np.ndarray,
    scale: float,
    law: Law,
    *,
    first: np.ndarray | None = None,
    most: int = MAX_ALTERNATIONS,
    tolerance: float = TOLERANCE,
) -> Alternation:
    """Alternate from one material until neither mounting stretch nor stress changes.

    Parameters
    ----------
    point : ndarray, shape (p,)
        Starting coordinates of the fit.
    free : ndarray of int
    scale : float
        Stress in kPa that residuals are measured in.
    first : ndarray, shape (2, m), optional
        Mounting stretches to fall back on while the material balances no root; default one.
    tolerance : float
        On the change of the mounting stretches and, relative, of the parameters.
    """
    lm = np.ones_like(data.mounting_load) if first is None else first
    cost, settled, count = np.inf, False, 0
    for count in range(1, most + 1):  # noqa: B007 - reported
        root = data.forward(law).mounting_roots(point, data.mounting_load)
        found_root = bool(np.isfinite(root).all())
        new_lm = root if found_root else lm
        problem = GivenMounting(data, "cauchy", point, free, scale, new_lm, law)
        found = descend(
            problem,
            point[free],
            law.lower[free],
            law.upper[free],
            tolerance=min(1e-4 * tolerance, 1e-8),
        )
        new_point = problem.theta(found.unknowns)
        change = max(
            float(np.abs(new_lm - lm).max()),
            float((np.abs(new_point - point) / (np.abs(new_point) + 1e-3)).max()),
        )
        lm, point, cost = new_lm, new_point, found.cost
        settled = found_root and found.converged and change <= tolerance
        # Nothing changes any more, settled or stuck at a material that balances no root
        if change <= tolerance or not np.isfinite(cost):
            break
    return Alternation(point, lm, cost, count, settled)


# --- deterministic fits of a specimen: three that neglect nothing, two that many labs use --------


METHODS = FIT_METHODS
PRESTRETCH_METHODS = ("fip", "linden", "constrained")


def fit(
    specimen: Specimen,
    method: str = "constrained",
    *,
    starts: int = FitOptions.starts,
    seed: int = FitOptions.seed,
    fixed: Mapping[str, float] | None = None,
    mounting_stretch: str = FitOptions.mounting_stretch,
    law: str = FitOptions.law,
    fibre_switch: bool = False,
    initial: MaterialResponse | None = None,
) -> FitResult:
    """Fit a material, and the mounting stretch where the method has one.

    Parameters
    ----------
    method : str
        ``standard``: the mounted state is the reference, loads as they are.
        ``zeroed``: the same with the first load subtracted.
        ``fip``: the method paper's alternation of root finding and refitting.
        ``linden``: the mounting stretches are two more unknowns.
        ``constrained``: one least squares with the mounting stretch implicit, its force one reading
        with the load cell's noise: the mode of the posterior's own misfit.
        The first four minimise residuals of the Cauchy stress over all rows, as their
        authors did; ``constrained`` minimises residuals of the load, as the posterior does.
    starts : int
        Starting points, the most promising of 512 random ones. With ``initial`` it may be 0.
    seed : int
        Of the random starting points.
    fixed : mapping, optional
        Values held, by the law's parameters in their own units.
    mounting_stretch : {"shared", "per-protocol"}
    law : str
        Name of the material law.
    fibre_switch : bool
        Fibres carry no compression, for laws that leave it open.
    initial : Material, optional
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
            law=law,
            fibre_switch=fibre_switch,
        )
    if method in PRESTRETCH_METHODS:
        refuse_tared(specimen)
    chosen = law_named(law, fibre_switch=fibre_switch)
    point, free = held_and_free(fixed, chosen)
    data = readings(specimen, shared=mounting_stretch == "shared", zeroed=method == "zeroed")
    count = starts if initial is not None else max(starts, 1)
    points, stretches = screened_points(
        data,
        count,
        np.random.default_rng(seed),
        chosen,
        point=point,
        free=free,
        with_mounting=method in PRESTRETCH_METHODS,
    )
    if initial is not None:
        points = np.vstack([points.reshape(-1, chosen.lower.size), chosen.point(initial.values)])
        stretches = np.vstack([stretches.reshape(-1, 2), np.ones(2)])
    return {
        "standard": _without_prestretch,
        "zeroed": _without_prestretch,
        "fip": _alternating,
        "linden": _free_mounting,
    }[method](method, specimen, data, points, stretches, point, free, chosen)


def fit_all(
    specimen: Specimen,
    *,
    starts: int = FitOptions.starts,
    seed: int = FitOptions.seed,
    fixed: Mapping[str, float] | None = None,
    mounting_stretch: str = FitOptions.mounting_stretch,
    law: str = FitOptions.law,
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
            law=law,
            fibre_switch=fibre_switch,
        )
        for method in methods
    ]


def _stress_scale(data: Readings) -> float:
    return max(float(np.abs(data.load * data.stretch / data.area[:, None]).max()), 1e-300)


def _without_prestretch(
    method: str,
    specimen: Specimen,
    data: Readings,
    points: np.ndarray,
    stretches: np.ndarray,
    point: np.ndarray,
    free: np.ndarray,
    law: Law,
) -> FitResult:
    one = np.ones_like(data.mounting_load)
    scale = _stress_scale(data)

    def problem() -> GivenMounting:
        return GivenMounting(data, "cauchy", point, free, scale, one, law)

    found = best_descent(problem, [p[free] for p in points], law.lower[free], law.upper[free])
    return fit_result(
        method,
        specimen,
        data,
        problem().theta(found.unknowns),
        one,
        free,
        iterations=found.iterations,
        converged=found.converged,
        law=law,
    )


def _alternating(
    method: str,
    specimen: Specimen,
    data: Readings,
    points: np.ndarray,
    stretches: np.ndarray,
    point: np.ndarray,
    free: np.ndarray,
    law: Law,
) -> FitResult:
    held = np.setdiff1d(np.arange(point.size), free)
    points = points.copy()
    points[:, held] = point[held]
    found = best_alternation(data, list(points), free, _stress_scale(data), law)
    return fit_result(
        method,
        specimen,
        data,
        found.point,
        found.mounting,
        free,
        iterations=found.alternations,
        converged=found.converged,
        law=law,
    )


def _free_mounting(
    method: str,
    specimen: Specimen,
    data: Readings,
    points: np.ndarray,
    stretches: np.ndarray,
    point: np.ndarray,
    free: np.ndarray,
    law: Law,
) -> FitResult:
    scale = _stress_scale(data)
    groups = data.mounting_load.shape[1]
    one = np.ones_like(data.mounting_load)

    def problem() -> FreeMounting:
        return FreeMounting(data, "cauchy", point, free, scale, one, law)

    starts = [
        np.concatenate([p[free], np.repeat(lm, groups)])
        for p, lm in zip(points, stretches, strict=True)
    ]
    lower = np.concatenate([law.lower[free], np.full(2 * groups, BRACKET[0])])
    upper = np.concatenate([law.upper[free], np.full(2 * groups, BRACKET[1])])
    found = best_descent(problem, starts, lower, upper)
    return fit_result(
        method,
        specimen,
        data,
        problem().theta(found.unknowns),
        found.unknowns[free.size :].reshape(2, -1),
        free,
        iterations=found.iterations,
        converged=found.converged,
        law=law,
    )
