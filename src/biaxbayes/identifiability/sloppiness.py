"""Stiff and sloppy directions, and what a parameter trades with.

The conditional spread is the residual spread of a polynomial regression of the parameter on the
others (all on their sampling scales): cubic in each, with all products of two. Partners are those
that alone explain much of the parameter (or it of them), since on a ridge all move together,
and the fewest that are needed besides to explain its spread. Every set of up to three is tried:
one that adds the best partner at a time stops where two explain nothing alone and much together.

Directions are eigenvectors of the posterior covariance of (ln C1, ln k1, ln k2, alpha, kappa), each
in units of its prior standard deviation. The eigenvector is straight, the ridge of a posterior is
not: the sloppy direction is therefore given along
:mod:`biaxbayes.identifiability.same_curves`, with the change of the curves along it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np
import pandas as pd

from biaxbayes.identifiability.determined import some_draws
from biaxbayes.identifiability.marginals import INTERVAL, LEVELS, Scale, parameter_scales
from biaxbayes.identifiability.same_curves import SameCurves, same_curves
from biaxbayes.laws.law import Law
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.priors import Prior, Tie
from biaxbayes.parameters import MATERIAL, Parameter, mounting_names
from biaxbayes.prediction.draws import median_draw

# --- what a parameter trades with: how narrow it would be if others were known -------------------


DRAWS = 3000
MOST_PARTNERS = 3
WORTH = 0.8  # partners must shrink the spread to this share, at least
TOGETHER = 0.6  # two parameters move together where one leaves this share of the other's spread
NEAR = 1.25  # partners suffice once the spread is this close to that given everything
NEAR_THREE = 1.1  # or, where no three come so near, this close to that given the best three


@dataclass(frozen=True)
class Partners:
    """The parameters that one trades with."""

    names: tuple[str, ...]  # those that explain much alone first
    spread_given_all: float  # sd given all other parameters, over the marginal one
    spread_given_partners: float  # the same given the partners alone


def find_partners(values: np.ndarray, names: tuple[str, ...]) -> dict[str, Partners]:
    """Partners of every parameter, from draws (n, d) on the sampling scales."""
    step = max(1, len(values) // DRAWS)
    few = values[::step]
    spread = few.std(axis=0)
    z = (few - few.mean(axis=0)) / np.where(spread > 0.0, spread, 1.0)
    # a far draw must not steer the polynomial
    known = _Regressions.from_draws(np.clip(z, -6.0, 6.0))
    pair = np.ones((len(names), len(names)))
    for i, j in permutations(range(len(names)), 2):
        pair[i, j] = known.spread(i, (j,))
    pair = np.minimum(pair, pair.T)
    return {name: _best_partners(known, j, names, pair[j]) for j, name in enumerate(names)}


def _best_partners(
    known: _Regressions, target: int, names: tuple[str, ...], pair: np.ndarray
) -> Partners:
    """The fewest parameters that explain about as much of one as all others, or as any three."""
    others = [j for j in range(len(names)) if j != target]
    if not others:
        return Partners((), 1.0, 1.0)
    full = known.spread(target, others)
    together = [j for j in sorted(others, key=lambda j: pair[j]) if pair[j] <= TOGETHER]
    together = together[:MOST_PARTNERS]
    left = [j for j in others if j not in together]
    best: list[tuple[float, list[int]]] = []  # of each size
    for more in range(min(MOST_PARTNERS - len(together), len(left)) + 1):
        tried = [[*together, *added] for added in combinations(left, more)]
        best.append(min((known.spread(target, given), given) for given in tried))
    enough = max(NEAR * full, NEAR_THREE * best[-1][0])
    spread, chosen = next(candidate for candidate in best if candidate[0] <= enough)
    if spread > WORTH and not together:
        return Partners((), full, 1.0)
    return Partners(tuple(names[j] for j in chosen), full, spread)


@dataclass(frozen=True)
class _Regressions:
    """Sums of products of all terms, from which every regression follows."""

    gram: np.ndarray  # (m, m), of: one, the first three powers of each parameter, products of two
    power: np.ndarray  # (d, 3): columns of the powers
    product: np.ndarray  # (d, d): columns of the products of two different ones
    draws: int

    @classmethod
    def from_draws(cls, z: np.ndarray) -> _Regressions:
        """Regressions of standardised draws, shape (n, d)."""
        d = z.shape[1]
        product = np.zeros((d, d), dtype=int)
        columns = [np.ones(len(z)), *z.T, *(z**2).T, *(z**3).T]
        for i, j in combinations(range(d), 2):
            product[i, j] = product[j, i] = len(columns)
            columns.append(z[:, i] * z[:, j])
        terms = np.array(columns)
        power = 1 + np.arange(d)[:, None] + d * np.arange(3)
        return cls(terms @ terms.T, power, product, len(z))

    def spread(self, target: int, given: Sequence[int]) -> float:
        """Residual spread of a parameter given others, over its marginal spread."""
        y = self.power[target, 0]
        total = self.gram[y, y] - self.gram[0, y] ** 2 / self.draws
        if not total > 0.0:
            return 1.0
        used = [0, *self.power[list(given)].ravel()]
        used += [self.product[i, j] for i, j in combinations(given, 2)]
        gram, with_y = self.gram[np.ix_(used, used)], self.gram[used, y]
        # normal equations with a little ridge: neighbouring powers are nearly collinear
        ridged = gram + 1e-9 * self.draws * np.eye(len(used))
        c = np.linalg.solve(ridged, with_y)
        # |y - F c|^2 = y.y - 2 c.F'y + c.F'F c
        residual = max(self.gram[y, y] - 2.0 * c @ with_y + c @ gram @ c, 0.0)
        freedom = max(self.draws - len(used), 1)
        return float(min(np.sqrt(residual / freedom * self.draws / total), 1.0))


# --- stiff and sloppy directions: what combination of parameters is known -------------------------


MOST_DRAWS = 4000
SMALL = 0.1  # of the largest loading: left out of the words
Z90 = 1.645
FACTOR = 0.7  # in ln: wider is given as a factor


@dataclass(frozen=True)
class Direction:
    """A direction in scaled parameter space."""

    loadings: dict[str, float]  # by parameter, per prior sd; the squares sum to one
    spread: float  # posterior sd along it, in prior sds
    text: str


@dataclass(frozen=True)
class Sloppiness:
    """Directions of a posterior, the stiffest first."""

    directions: tuple[Direction, ...]
    path: SameCurves  # along the sloppy direction
    text: str  # what moves along it and what that changes


def sloppiness(posterior: Posterior, draws: pd.DataFrame) -> Sloppiness | None:
    """Find the directions and follow the sloppy one; None without free or with tied parameters."""
    few = some_draws(draws, MOST_DRAWS)
    scales = [
        s
        for s in parameter_scales(posterior.priors, posterior.quantities, few)
        if s.parameter.kind == MATERIAL and isinstance(s.prior, Prior)
    ]
    tied = any(isinstance(posterior.priors[name], Tie) for name in posterior.law.names)
    if not scales or tied:
        return None
    directions = _directions(scales, few)
    loadings = directions[-1].loadings
    moved = max(loadings, key=lambda name: abs(loadings[name]))
    row = median_draw(few, posterior.specimen, posterior.law)
    low, high = np.quantile(few[moved], INTERVAL)
    path = same_curves(
        few.iloc[row],
        posterior.specimen,
        posterior.settings,
        moved,
        (float(low), float(high)),
        tuple(s.name for s in scales),
    )
    return Sloppiness(
        directions, path, path_text(path, _error_kPa(posterior, few), few, posterior.law)
    )


def _directions(scales: list[Scale], draws: pd.DataFrame) -> tuple[Direction, ...]:
    columns, units = [], []
    for scale in scales:
        assert isinstance(scale.prior, Prior)
        unit = float(scale.to_scale(scale.prior.ppf(LEVELS)).std())
        columns.append(scale.to_scale(draws[scale.name].to_numpy(dtype=float)) / unit)
        units.append(unit)
    values, vectors = np.linalg.eigh(np.atleast_2d(np.cov(np.array(columns))))
    out: list[Direction] = []
    for value, vector in zip(values, vectors.T, strict=True):
        rank = "known" if out else "best known"
        lead = int(np.argmax(np.abs(vector)))
        vector = vector * np.sign(vector[lead])
        spread = float(np.sqrt(max(value, 0.0)))
        text = f"{rank}: {_combination(scales, vector, np.array(units), spread)}"
        loadings = {s.name: float(v) for s, v in zip(scales, vector, strict=True)}
        out.append(Direction(loadings, spread, text))
    return tuple(out)


def _combination(scales: list[Scale], vector: np.ndarray, units: np.ndarray, spread: float) -> str:
    """The combination as a product of powers, and how well it is known."""
    lead = int(np.argmax(np.abs(vector)))
    # sum_i v_i x_i / u_i, scaled so that the leading parameter has coefficient one
    coefficient = vector / units * (units[lead] / vector[lead])
    width = Z90 * spread * units[lead] / abs(vector[lead])
    terms = [
        _term(scale, float(c), scales[lead].logarithmic)
        for scale, c, v in zip(scales, coefficient, vector, strict=True)
        if abs(v) >= SMALL * abs(vector[lead])
    ]
    if not scales[lead].logarithmic:
        unit = scales[lead].parameter.unit_words()
        return f"{' '.join(terms)}, to {width:.2g}{unit} (90 %)"
    known = (
        f"{100.0 * np.expm1(width):.2g} %" if width < FACTOR else f"a factor {np.exp(width):.2g}"
    )
    return f"{' '.join(terms)}, to {known} (90 %)"


def _term(scale: Scale, coefficient: float, product: bool) -> str:
    """One factor of a product of powers, or one term of a sum."""
    alone = abs(coefficient - 1.0) < 0.005
    if not product:
        name = f"ln {scale.name}" if scale.logarithmic else scale.name
        return name if alone else f"{coefficient:+.3g} {name}"
    if scale.logarithmic:
        return scale.name if alone else f"{scale.name}^{coefficient:.2g}"
    step, unit = (10.0, " deg") if scale.unit else (0.1, "")
    return f"exp({coefficient * step:+.2g} {scale.name}/{step:g}{unit})"


def _error_kPa(posterior: Posterior, draws: pd.DataFrame) -> float:
    """Error sd of a reading at the median load, as a stress, at the medians of the draws."""
    specimen, errors = posterior.specimen, posterior.settings.error_model
    load = np.median(np.abs(np.concatenate([specimen.load(p) for p in specimen.protocols])))
    values = {p.name: float(np.median(draws[p.name])) for p in errors.parameters}
    return float(errors.sd(values, load)) / float(specimen.area.min())


def path_text(path: SameCurves, error_kPa: float, draws: pd.DataFrame, law: Law) -> str:
    """Text on the parameters that move along a path, and the change of the curves."""
    first, last = path.materials.iloc[0], path.materials.iloc[-1]
    names = [path.moved, *(n for n in law.names if n != path.moved)]
    moves = [
        text for n in names if (text := _move(law.parameter(n), float(first[n]), float(last[n])))
    ]
    if mounting_names("stretch")[0] in draws or path.mounting_stretch.shape[2] > 1:
        for k, axis in enumerate("xy"):
            step = float(np.mean(path.mounting_stretch[-1, k] - path.mounting_stretch[0, k]))
            if abs(step) >= 5e-4:
                way = "up" if step > 0 else "down"
                moves.append(f"mounting stretch {axis} {way} {abs(step):.3f}")
    amount = _rounded_up(path.change_kPa)
    share = 100.0 * path.change_kPa / max(path.largest_kPa, 1e-300)
    return (
        f"the same curves: {', '.join(moves)}; no stress of the tests changes by more than "
        f"{amount:g} kPa ({share:.2g} % of the largest; one reading errs by {error_kPa:.2g} kPa)"
    )


def _rounded_up(value: float) -> float:
    """Two digits, never less than the value: it is a limit."""
    if not value > 0.0:
        return 0.0
    digit = 10.0 ** (np.floor(np.log10(value)) - 1.0)
    return float(f"{np.ceil(value / digit - 1e-9) * digit:.2g}")


def _move(parameter: Parameter, first: float, last: float) -> str:
    """Text on the move of one parameter; empty if it does not move."""
    name = parameter.name
    if parameter.logarithmic:
        if min(first, last) <= 0.0:
            return f"{name} from {first:.3g} to {last:.3g}"
        ratio = last / first
        return f"{name} times {ratio:.3g}" if abs(np.log(ratio)) >= 0.005 else ""
    step = abs(last - first)
    text = parameter.number(step)
    if float(text) == 0.0:
        return ""
    return f"{name} {'up' if last > first else 'down'} {text}{parameter.unit_words()}"
