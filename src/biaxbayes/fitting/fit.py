"""Deterministic fits of a specimen: three that infer the mounting stretch, two that do not.

``fip`` is the alternation of Math. Comput. Appl. 2024, 29(4), 55, Section 2.2.2 and Figure 2. Its
fixed point is not a minimum of one objective: with noise it differs from the least-squares fit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.fitting.constrained import FitSetup
from biaxbayes.fitting.fit_result import FitResult
from biaxbayes.fitting.least_squares import Descent, best_descent, descend
from biaxbayes.fitting.residuals import BalancedMounting, FreeMounting, LoadResiduals
from biaxbayes.laws.materials import MaterialResponse
from biaxbayes.mechanics.mounting import BRACKET
from biaxbayes.options import FIT_METHODS, FitOptions
from biaxbayes.specimens.specimen import Specimen

METHODS = FIT_METHODS
PRESTRETCH_METHODS = ("fip", "linden", "constrained")
MAX_ALTERNATIONS = 500
FIRST_ALTERNATIONS = 40
ALTERNATION_TOLERANCE = 1e-10


def alternate(
    setup: FitSetup,
    point: np.ndarray,
    scale: float,
    *,
    first: np.ndarray | None = None,
    max_alternations: int = MAX_ALTERNATIONS,
    tolerance: float = ALTERNATION_TOLERANCE,
) -> tuple[Descent, np.ndarray]:
    """Alternate from one material until neither mounting stretch nor stress changes.

    Solve for the mounting stretch, update the data, refit, repeat. Returns the end, with all fit
    coordinates, and its mounting stretches (m, 2). ``first`` (m, 2) are those for materials that
    balance no root; default one.
    """
    data, free, law = setup.data, setup.free, setup.law
    lm = np.ones_like(data.mounting_load) if first is None else first
    cost, converged, count = np.inf, False, 0
    for count in range(1, max_alternations + 1):  # noqa: B007 - reported
        balanced = BalancedMounting(data, "cauchy", point, free, scale, lm, law)
        root = balanced.mounting(point[free])
        has_root = bool(np.isfinite(root).all())
        new_lm = root if has_root else lm
        problem = LoadResiduals(data, "cauchy", point, free, scale, new_lm, law)
        tight = min(1e-4 * tolerance, 1e-8)
        descent = descend(problem, point[free], *setup.bounds, tolerance=tight)
        new_point = problem.fit_coordinates(descent.unknowns)
        change = max(
            float(np.abs(new_lm - lm).max()),
            float((np.abs(new_point - point) / (np.abs(new_point) + 1e-3)).max()),
        )
        lm, point, cost = new_lm, new_point, descent.cost
        converged = has_root and descent.converged and change <= tolerance
        # Nothing changes any more, converged or stuck at a material that balances no root
        if change <= tolerance or not np.isfinite(cost):
            break
    return Descent(point, cost, count, converged), lm


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
    piece_sd: float = FitOptions.piece_sd,
    initial: MaterialResponse | None = None,
) -> FitResult:
    """Fit a material, and the mounting stretch where the method has one.

    Parameters
    ----------
    method : str
        ``standard``: the mounted state is the reference, with unchanged loads.
        ``zeroed``: the same with the first load subtracted.
        ``fip``: the method paper's alternation of root finding and refitting.
        ``linden``: the mounting stretches are two more unknowns.
        ``constrained``: a least-squares fit with the mounting stretch implicit and its force as one
        reading with the load cell's noise: the maximum of the posterior's likelihood.
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
    piece_sd : float
        Sd of the log of the stiffness of each further piece over that of the first.
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
    mounting = {"standard": "ignored", "zeroed": "zeroed", "constrained": "noisy"}
    setup = FitSetup.from_options(
        specimen,
        mounting.get(method, "exact"),
        mounting_stretch=mounting_stretch,
        fixed=fixed,
        law=law,
        fibre_switch=fibre_switch,
        piece_sd=piece_sd,
    )
    if method == "constrained":
        return setup.fitted(starts, seed, initial)
    points, stretches = setup.starting_points(starts, seed, initial)
    data, free = setup.data, setup.free
    if specimen.further or not specimen.experiment.is_biaxial:
        raise InputError(
            f"the fit {method} is for one planar biaxial test",
            file=specimen.name,
            remedy="use `method=constrained`",
        )
    scale = max(float(np.abs(data.load * data.stretch / specimen.area).max()), 1e-300)
    if method == "fip":
        known = np.setdiff1d(np.arange(setup.point.size), free)
        points[:, known] = setup.point[known]
        # loosely from every start, then the best to the end
        loose: dict[str, Any] = {"max_alternations": FIRST_ALTERNATIONS, "tolerance": 1e-4}
        first = [alternate(setup, point, scale, **loose) for point in points]
        best, lm = min(first, key=lambda end: (not end[0].converged, end[0].cost))
        end, lm = alternate(setup, best.unknowns, scale, first=lm)
        end = replace(end, iterations=best.iterations + end.iterations)
        return setup.result(method, end.unknowns, lm, end)
    one = np.ones_like(data.mounting_load)
    common = (data, "cauchy", setup.point, free, scale, one, setup.law)
    unknowns, (lower, upper) = points[:, free], setup.bounds
    problem = LoadResiduals(*common)
    if method == "linden":
        problem = FreeMounting(*common)
        unknowns = np.hstack([unknowns, np.tile(stretches, len(one))])
        lower = np.concatenate([lower, np.full(one.size, BRACKET[0])])
        upper = np.concatenate([upper, np.full(one.size, BRACKET[1])])
    end = best_descent(problem, unknowns, lower, upper)
    theta, lm = problem.fit_coordinates(end.unknowns), problem.mounting(end.unknowns)
    return setup.result(method, theta, lm, end)


def fit_all(specimen: Specimen, **options: Any) -> list[FitResult]:
    """As :func:`fit` by every method that the specimen allows, a tared one two of them."""
    if specimen.further or not specimen.experiment.is_biaxial:
        return [fit(specimen, "constrained", **options)]
    methods = [m for m in METHODS if not (specimen.is_tared and m in PRESTRETCH_METHODS)]
    return [fit(specimen, method, **options) for method in methods]
