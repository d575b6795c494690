"""Deterministic fits of a specimen: three that infer the mounting stretch, two that do not.

``fip`` is the alternation of Math. Comput. Appl. 2024, 29(4), 55, Section 2.2.2 and Figure 2. Its
fixed point is not a minimum of one objective: with noise it differs from the least squares.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.fitting.constrained import MOUNTING_STRETCH, constrained_fit, refuse_tared
from biaxbayes.fitting.least_squares import Descent, best_descent, descend
from biaxbayes.fitting.residuals import FreeMounting, LoadResiduals, Readings
from biaxbayes.fitting.result import FitResult, fit_result
from biaxbayes.fitting.starting_points import fixed_and_free, screened_points
from biaxbayes.laws import law_named
from biaxbayes.laws.law import Law
from biaxbayes.laws.materials import MaterialResponse
from biaxbayes.mechanics.mounting import BRACKET
from biaxbayes.options import FIT_METHODS, FitOptions
from biaxbayes.specimens.specimen import Specimen

METHODS = FIT_METHODS
PRESTRETCH_METHODS = ("fip", "linden", "constrained")

# --- the fit of the method paper: find the mounting stretch, update the data, refit, repeat ------

MAX_ALTERNATIONS = 500
FIRST_ALTERNATIONS = 40
TOLERANCE = 1e-10


@dataclass(frozen=True, eq=False)
class Alternation:
    """End of an alternation."""

    point: np.ndarray  # (p,), fit coordinates
    mounting: np.ndarray  # (2, m)
    cost: float  # sum of squared Cauchy residuals over the squared scale
    iterations: int
    converged: bool


def best_alternation(
    data: Readings, starts: Iterable[np.ndarray], free: np.ndarray, scale: float, law: Law
) -> Alternation:
    """Alternate loosely from every start, then the best to the end."""
    first = [
        alternate(data, p, free, scale, law, most=FIRST_ALTERNATIONS, tolerance=1e-4)
        for p in starts
    ]
    best = min(first, key=lambda end: (not end.converged, end.cost))
    end = alternate(data, best.point, free, scale, law, first=best.mounting)
    return replace(end, iterations=best.iterations + end.iterations)


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

    ``first`` (2, m) are mounting stretches for materials that balance no root; default one.
    """
    lm = np.ones_like(data.mounting_load) if first is None else first
    cost, settled, count = np.inf, False, 0
    for count in range(1, most + 1):  # noqa: B007 - reported
        root = data.forward(law).mounting_roots(point, data.mounting_load)
        has_root = bool(np.isfinite(root).all())
        new_lm = root if has_root else lm
        problem = LoadResiduals(data, "cauchy", point, free, scale, new_lm, law)
        descent = descend(
            problem,
            point[free],
            law.lower[free],
            law.upper[free],
            tolerance=min(1e-4 * tolerance, 1e-8),
        )
        new_point = problem.fit_coordinates(descent.unknowns)
        change = max(
            float(np.abs(new_lm - lm).max()),
            float((np.abs(new_point - point) / (np.abs(new_point) + 1e-3)).max()),
        )
        lm, point, cost = new_lm, new_point, descent.cost
        settled = has_root and descent.converged and change <= tolerance
        # Nothing changes any more, settled or stuck at a material that balances no root
        if change <= tolerance or not np.isfinite(cost):
            break
    return Alternation(point, lm, cost, count, settled)


# --- one method, and all of them -----------------------------------------------------------------


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
        Seed of the random starting points.
    fixed : mapping, optional
        Fixed values, by the law's parameters in their own units.
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
    point, free = fixed_and_free(fixed, chosen)
    data = Readings.from_specimen(
        specimen, shared=mounting_stretch == "shared", zeroed=method == "zeroed"
    )
    points, stretches = screened_points(
        data,
        starts if initial is not None else max(starts, 1),
        np.random.default_rng(seed),
        chosen,
        point=point,
        free=free,
        with_mounting=method in PRESTRETCH_METHODS,
    )
    if initial is not None:
        points = np.vstack([points.reshape(-1, chosen.lower.size), chosen.point(initial.values)])
        stretches = np.vstack([stretches.reshape(-1, 2), np.ones(2)])
    scale = max(float(np.abs(data.load * data.stretch / data.area[:, None]).max()), 1e-300)
    lower, upper = chosen.lower[free], chosen.upper[free]
    one = np.ones_like(data.mounting_load)
    common = (data, "cauchy", point, free, scale, one, chosen)
    end: Alternation | Descent
    if method == "fip":
        points[:, np.setdiff1d(np.arange(point.size), free)] = np.delete(point, free)
        end = best_alternation(data, points, free, scale, chosen)
        theta, lm = end.point, end.mounting
    elif method == "linden":
        groups = one.shape[1]
        both = np.hstack([points[:, free], np.repeat(stretches, groups, axis=1)])
        lower = np.concatenate([lower, np.full(2 * groups, BRACKET[0])])
        upper = np.concatenate([upper, np.full(2 * groups, BRACKET[1])])
        unknown = FreeMounting(*common)
        end = best_descent(unknown, both, lower, upper)
        theta, lm = unknown.fit_coordinates(end.unknowns), unknown.mounting(end.unknowns)
    else:
        given = LoadResiduals(*common)
        end = best_descent(given, points[:, free], lower, upper)
        theta, lm = given.fit_coordinates(end.unknowns), one
    return fit_result(
        method,
        specimen,
        data,
        theta,
        lm,
        free,
        iterations=end.iterations,
        converged=end.converged,
        law=chosen,
    )


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
