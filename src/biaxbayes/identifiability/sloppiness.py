"""Stiff and sloppy directions, and materials that give the same curves (non-identifiable paths).

Directions are eigenvectors of the posterior covariance of (ln C1, ln k1, ln k2, alpha, kappa), each
in units of its prior standard deviation. The eigenvector is straight, a posterior along it is often
bent: the sloppy direction is therefore given along materials with the same curves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.derived.determined import thin_draws
from biaxbayes.errors import two_digits
from biaxbayes.fitting.least_squares import descend
from biaxbayes.fitting.residuals import BalancedMounting, LoadResiduals
from biaxbayes.identifiability.marginals import (
    INTERVAL,
    LEVELS,
    Z90,
    ComparisonScale,
    parameter_scales,
)
from biaxbayes.laws.law import Law
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.priors import Prior, Tie
from biaxbayes.parameters import MATERIAL, STIFFNESS, mounting_names, name_of
from biaxbayes.prediction.draws import median_draw
from biaxbayes.specimens.rows import MeasuredRows

# --- materials that give the same curves: one parameter is moved, the others follow --------------

TARGET_ROWS = 40  # of each protocol, to fit; the reported change is over all rows
PATH_STEPS = 12


@dataclass(frozen=True)
class SameCurves:
    """A path of materials along which the curves stay."""

    moved: str  # the parameter that was fixed at each value
    materials: pd.DataFrame  # natural values (kPa, degrees), one row per point
    mounting_stretch: np.ndarray  # (points, m, 2); ones where not inferred
    mounting_load: np.ndarray  # (m, 2), of the whole path; zeros where not inferred
    change_kPa: float  # largest change of any stress of all rows from the first material to another
    largest_kPa: float  # largest stress of the first material

    def to_frame(self) -> pd.DataFrame:
        """Materials and mounting stretches, one row per point of the path."""
        table = self.materials.copy()
        for m in range(len(self.mounting_load)):
            tail = f"[{m + 1}]" if len(self.mounting_load) > 1 else ""
            for k, axis in enumerate("xy"):
                table[f"mounting_stretch_{axis}{tail}"] = self.mounting_stretch[:, m, k]
        return table


def same_curves(
    draw: pd.Series,
    posterior: Posterior,
    moved: str,
    values: tuple[float, float],
    free: tuple[str, ...],
) -> SameCurves:
    """Move one parameter of a draw between two natural values; those in `free` follow.

    At each value they are fitted to the loads of the draw, the mounting stretch following from its
    mounting force.
    """
    law, shared = posterior.law, posterior.settings.shared
    data = MeasuredRows.from_specimen(posterior.specimen, shared=shared)
    quantities = posterior.specimen.quantities(law.parameters, shared=shared)
    mounting_load, kind = np.zeros_like(data.mounting_load), LoadResiduals
    if posterior.settings.infers_mounting:
        kind = BalancedMounting
        # zero across a strip, which has no such force; of a piece as stiff as the first
        pairs = [mounting_names("force", state) for state in quantities.states]
        stiff = [
            float(draw.get(name_of(STIFFNESS.name, piece.label), 1.0))
            for piece in quantities.pieces
            for _ in piece.states
        ]
        forces = [[float(draw.get(name, 0.0)) for name in pair] for pair in pairs]
        mounting_load = np.array(forces) / np.array(stiff)[:, None]
    data = replace(data, mounting_load=mounting_load)
    one = np.ones_like(mounting_load)

    def curves(point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Loads (n, 2) of every row and mounting stretches (m, 2)."""
        problem = kind(data, "load", point, np.arange(point.size), 1.0, one, law)
        lm = problem.mounting(point)
        return problem.response(point, lm).load, lm

    values_of_draw, index = [float(draw[n]) for n in law.names], law.names.index(moved)
    origin = law.to_fit_coordinates(values_of_draw)
    follows = np.array([i for i, n in enumerate(law.names) if n != moved and n in free], dtype=int)
    target = replace(data, load=curves(origin)[0]).chosen(TARGET_ROWS)

    def fitted(value: float, start: np.ndarray) -> np.ndarray | None:
        """Fit coordinates of the material with the curves of the draw at a value; None without."""
        point = origin.copy()
        point[index] = value
        problem = kind(target, "load", point, follows, float(target.peaks[0]), one, law)
        box = law.lower[follows], law.upper[follows]
        descent = descend(problem, start, *box, steps=200, tolerance=1e-10)
        return problem.fit_coordinates(descent.unknowns) if np.isfinite(descent.cost) else None

    def path(value: float) -> list[np.ndarray]:
        """Materials from the draw to a natural value, until one has no fit."""
        natural = [*values_of_draw[:index], value, *values_of_draw[index + 1 :]]
        first, last = origin[index], law.to_fit_coordinates(natural)[index]
        out: list[np.ndarray] = []
        if first == last:
            return out
        logs = law.parameter(moved).logarithmic and min(first, last) > 0.0
        before = here = origin
        for at in (np.geomspace if logs else np.linspace)(first, last, PATH_STEPS)[1:]:
            found = fitted(at, here[follows] + 0.9 * (here - before)[follows])
            if found is None:
                found = fitted(at, here[follows])
            if found is None:
                break
            before, here = here, found
            out.append(found)
        return out

    low, high = values
    points = [*reversed(path(low)), origin, *path(high)]
    loads, stretches = zip(*map(curves, points), strict=True)
    area = np.array([piece.area for piece in data.pieces])[data.piece]
    stress = np.array(loads) / area / data.load_scale
    return SameCurves(
        moved,
        pd.DataFrame([law.from_fit_coordinates(p) for p in points], columns=list(law.names)),
        np.array(stretches),
        mounting_load,
        float(np.abs(stress - stress[0]).max()),
        float(np.abs(stress[0]).max()),
    )


# --- stiff and sloppy directions: what combination of parameters is known -------------------------

MAX_COVARIANCE_DRAWS = 4000
ERROR_DRAWS = 100
MIN_LOADING = 0.1  # of the largest loading: left out of the words
MAX_PERCENT_WIDTH = 0.7  # in ln: wider is given as a factor


@dataclass(frozen=True)
class Sloppiness:
    """Directions of a posterior, the stiffest first."""

    # posterior sd along each, in prior sds; loadings by parameter, per prior sd, whose squares sum
    # to one; words
    directions: tuple[dict[str, Any], ...]
    path: SameCurves  # along the sloppy direction
    text: str  # what moves along it and what that changes


def sloppiness(posterior: Posterior, draws: pd.DataFrame) -> Sloppiness | None:
    """Find the directions and follow the sloppy one; None without free or with tied parameters."""
    thinned = thin_draws(draws, MAX_COVARIANCE_DRAWS)
    scales = [
        s
        for s in parameter_scales(posterior.priors, posterior.quantities, thinned)
        if s.parameter.kind == MATERIAL and isinstance(s.prior, Prior)
    ]
    tied = any(isinstance(posterior.priors[name], Tie) for name in posterior.law.names)
    if not scales or tied:
        return None
    directions = _directions(scales, thinned)
    loadings = directions[-1]["loadings"]
    moved = max(loadings, key=lambda name: abs(loadings[name]))
    row = median_draw(thinned, posterior.specimen, posterior.law)
    low, high = np.quantile(thinned[moved], INTERVAL)
    free = tuple(s.name for s in scales)
    path = same_curves(thinned.iloc[row], posterior, moved, (float(low), float(high)), free)
    # error of a reading of the first piece, misfit and noise, at the median of the draws
    residual = posterior.residuals(thin_draws(thinned, ERROR_DRAWS), 0) / posterior.readings.scale
    residual = residual[:, posterior.readings.mounting_count :]
    error = float(np.median(np.sqrt(np.mean(residual**2, axis=1))))
    error_kPa = error / float(posterior.specimen.area.min())
    return Sloppiness(directions, path, path_text(path, error_kPa, thinned, posterior.law))


def _directions(scales: list[ComparisonScale], draws: pd.DataFrame) -> tuple[dict[str, Any], ...]:
    columns, units = [], []
    for scale in scales:
        assert isinstance(scale.prior, Prior)
        unit = float(scale.to_scale(scale.prior.ppf(LEVELS)).std())
        columns.append(scale.to_scale(draws[scale.name].to_numpy(dtype=float)) / unit)
        units.append(unit)
    values, vectors = np.linalg.eigh(np.atleast_2d(np.cov(np.array(columns))))
    out: list[dict[str, Any]] = []
    for value, vector in zip(values, vectors.T, strict=True):
        vector = vector * np.sign(vector[np.argmax(np.abs(vector))])
        spread = float(np.sqrt(max(value, 0.0)))
        rank = "known" if out else "best known"
        text = f"{rank}: {_combination(scales, vector, np.array(units), spread)}"
        loadings = dict(zip((s.name for s in scales), vector.tolist(), strict=True))
        out.append({"spread": spread, "loadings": loadings, "in_words": text})
    return tuple(out)


def _combination(
    scales: list[ComparisonScale], vector: np.ndarray, units: np.ndarray, spread: float
) -> str:
    """The combination as a product of powers or a sum, and how well it is known."""
    lead = int(np.argmax(np.abs(vector)))
    product = scales[lead].parameter.logarithmic
    # sum_i v_i x_i / u_i, scaled so that the leading parameter has coefficient one
    coefficient = vector / units * (units[lead] / vector[lead])
    width = Z90 * spread * units[lead] / abs(vector[lead])
    terms = []
    for scale, c, v in zip(scales, coefficient, vector, strict=True):
        if abs(v) < MIN_LOADING * abs(vector[lead]):
            continue
        alone = abs(c - 1.0) < 0.005
        if not product:
            name = scale.label
            terms.append(name if alone else f"{c:+.3g} {name}")
        elif scale.parameter.logarithmic:
            terms.append(scale.name if alone else f"{scale.name}^{c:.2g}")
        else:
            step, unit = (10.0, " deg") if scale.unit else (0.1, "")
            terms.append(f"exp({c * step:+.2g} {scale.name}/{step:g}{unit})")
    if not product:
        uncertainty = f"{width:.2g}{scales[lead].parameter.unit_words()}"
    elif width < MAX_PERCENT_WIDTH:
        uncertainty = f"{100.0 * np.expm1(width):.2g} %"
    else:
        uncertainty = f"a factor {np.exp(width):.2g}"
    return f"{' '.join(terms)}, to {uncertainty} (90 %)"


def path_text(path: SameCurves, error_kPa: float, draws: pd.DataFrame, law: Law) -> str:
    """Text on the parameters that move along a path, and the change of the curves."""
    first, last = path.materials.iloc[0], path.materials.iloc[-1]
    moves = []
    for name in (path.moved, *(n for n in law.names if n != path.moved)):
        parameter, a, b = law.parameter(name), float(first[name]), float(last[name])
        step = parameter.number(abs(b - a))
        if parameter.logarithmic and min(a, b) <= 0.0:
            moves.append(f"{name} from {a:.3g} to {b:.3g}")
        elif parameter.logarithmic:
            if abs(np.log(b / a)) >= 0.005:
                moves.append(f"{name} times {b / a:.3g}")
        elif float(step) != 0.0:
            moves.append(f"{name} {'up' if b > a else 'down'} {step}{parameter.unit_words()}")
    if mounting_names("stretch")[0] in draws or len(path.mounting_load) > 1:
        for k, axis in enumerate("xy"):
            change = float(np.mean((path.mounting_stretch[-1] - path.mounting_stretch[0])[:, k]))
            if abs(change) >= 5e-4:
                way = "up" if change > 0 else "down"
                moves.append(f"mounting stretch {axis} {way} {abs(change):.3f}")
    amount = 0.0
    if path.change_kPa > 0.0:  # two digits, never less than the value: it is a limit
        digit = 10.0 ** (np.floor(np.log10(path.change_kPa)) - 1.0)
        amount = float(f"{np.ceil(path.change_kPa / digit - 1e-9) * digit:.2g}")
    share = 100.0 * path.change_kPa / max(path.largest_kPa, 1e-300)
    return (
        f"the same curves: {', '.join(moves)}; no stress of the tests changes by more than "
        f"{amount:g} kPa ({share:.2g} % of the largest; one reading errs by "
        f"{two_digits(error_kPa)} kPa)"
    )
