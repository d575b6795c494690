"""Stiff and sloppy directions: what combination of parameters is known, and which moves freely.

Directions are eigenvectors of the posterior covariance of (ln C1, ln k1, ln k2, alpha, kappa), each
in units of its prior standard deviation. The eigenvector is straight, the ridge of a posterior is
not: the sloppy direction is therefore stated along :mod:`biaxbayes.findings.same_curves`, with the
change of the curves that was found when it was walked.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from biaxbayes.findings.material_draws import mounting_labels
from biaxbayes.findings.representative_draws import median_draw
from biaxbayes.findings.same_curves import SameCurves, same_curves
from biaxbayes.findings.sampling_scale import Scale, judged_scales, prior_values
from biaxbayes.inference.posterior import Posterior
from biaxbayes.inference.priors import Prior, Tie
from biaxbayes.mechanics.goh import PARAMETERS

__all__ = ["Direction", "Sloppiness", "sloppiness"]

MOST_DRAWS = 4000
SMALL = 0.1  # of the largest loading: left out of the words
Z90 = 1.645
FACTOR = 0.7  # in ln: wider is told as a factor


@dataclass(frozen=True)
class Direction:
    """A direction in scaled parameter space.

    Attributes
    ----------
    loadings : dict of float
        By parameter, per prior standard deviation; the squares sum to one.
    spread : float
        Posterior standard deviation along it, in prior standard deviations.
    words : str
    """

    loadings: dict[str, float]
    spread: float
    words: str


@dataclass(frozen=True)
class Sloppiness:
    """Directions of a posterior, the stiffest first.

    Attributes
    ----------
    directions : tuple of Direction
    path : SameCurves
        The sloppy direction, walked.
    words : str
        What moves along it and what that changes.
    """

    directions: tuple[Direction, ...]
    path: SameCurves
    words: str

    @property
    def stiff(self) -> Direction:
        """The best-known combination."""
        return self.directions[0]

    @property
    def sloppy(self) -> Direction:
        """The least-known combination."""
        return self.directions[-1]

    def in_words(self) -> list[str]:
        """One sentence on the stiff and one on the sloppy direction."""
        return [self.stiff.words, self.words]


def sloppiness(posterior: Posterior, draws: pd.DataFrame) -> Sloppiness | None:
    """Find the directions and walk the sloppy one.

    Parameters
    ----------
    posterior : Posterior
    draws : DataFrame
        Of reliable chains.

    Returns
    -------
    Sloppiness or None
        None where no material parameter is free, or two are tied: curves cannot be followed then
        without letting go of the tie. The path moves the parameter with the largest loading on
        the sloppy direction over its 90 % interval, from the curves of the median draw.
    """
    few = draws.iloc[:: -(-len(draws) // MOST_DRAWS)]
    scales = [
        s
        for s in judged_scales(posterior.priors, few)
        if s.kind in PARAMETERS and isinstance(s.prior, Prior)
    ]
    tied = any(isinstance(posterior.priors[name], Tie) for name in PARAMETERS)
    if not scales or tied:
        return None
    directions = _directions(scales, few)
    loadings = directions[-1].loadings
    moved = max(loadings, key=lambda name: abs(loadings[name]))
    row = median_draw(few, posterior.specimen, fibre_switch=posterior.settings.fibre_switch)
    low, high = np.quantile(few[moved], [0.05, 0.95])
    path = same_curves(
        few.iloc[row],
        posterior.specimen,
        posterior.settings,
        moved,
        (float(low), float(high)),
        tuple(s.name for s in scales),
    )
    return Sloppiness(directions, path, path_words(path, _error_kPa(posterior, few), few))


def _directions(scales: list[Scale], draws: pd.DataFrame) -> tuple[Direction, ...]:
    columns, units = [], []
    for scale in scales:
        assert isinstance(scale.prior, Prior)
        unit = float(scale.of(prior_values(scale.prior)).std())
        columns.append(scale.of(draws[scale.name].to_numpy(dtype=float)) / unit)
        units.append(unit)
    values, vectors = np.linalg.eigh(np.atleast_2d(np.cov(np.array(columns))))
    out = []
    for value, vector in zip(values, vectors.T, strict=True):
        lead = int(np.argmax(np.abs(vector)))
        vector = vector * np.sign(vector[lead])
        spread = float(np.sqrt(max(value, 0.0)))
        words = _known_words(scales, vector, np.array(units), spread)
        loadings = {s.name: float(v) for s, v in zip(scales, vector, strict=True)}
        out.append(Direction(loadings, spread, words))
    return tuple(out)


def _known_words(scales: list[Scale], vector: np.ndarray, units: np.ndarray, spread: float) -> str:
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
        unit = " degrees" if scales[lead].kind == "alpha" else ""
        return f"best known: {' '.join(terms)}, to {width:.2g}{unit} (90 %)"
    known = (
        f"{100.0 * np.expm1(width):.2g} %" if width < FACTOR else f"a factor {np.exp(width):.2g}"
    )
    return f"best known: {' '.join(terms)}, to {known} (90 %)"


def _term(scale: Scale, coefficient: float, product: bool) -> str:
    """One factor of a product of powers, or one term of a sum."""
    alone = abs(coefficient - 1.0) < 0.005
    if not product:
        name = f"ln {scale.name}" if scale.logarithmic else scale.name
        return name if alone else f"{coefficient:+.3g} {name}"
    if scale.logarithmic:
        return scale.name if alone else f"{scale.name}^{coefficient:.2g}"
    step, label = (10.0, "alpha/10 deg") if scale.kind == "alpha" else (0.1, "kappa/0.1")
    return f"exp({coefficient * step:+.2g} {label})"


def _error_kPa(posterior: Posterior, draws: pd.DataFrame) -> float:
    """Median error sd as a stress."""
    noise = float(np.median(draws["noise_sd"]))
    return noise / float(posterior.specimen.area.min())


def path_words(path: SameCurves, error_kPa: float, draws: pd.DataFrame) -> str:
    """What moves together along a path, and what it changes."""
    first, last = path.materials.iloc[0], path.materials.iloc[-1]
    names = [path.moved, *(n for n in PARAMETERS if n != path.moved)]
    moves = [text for n in names if (text := _move(n, float(first[n]), float(last[n])))]
    if mounting_labels(draws):
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
    """Two digits, never less than the value: it is stated as a limit."""
    if not value > 0.0:
        return 0.0
    digit = 10.0 ** (np.floor(np.log10(value)) - 1.0)
    return float(f"{np.ceil(value / digit - 1e-9) * digit:.2g}")


def _move(name: str, first: float, last: float) -> str:
    """How one parameter moves; empty where it does not."""
    if name in ("C1", "k1", "k2"):
        if min(first, last) <= 0.0:
            return f"{name} from {first:.3g} to {last:.3g}"
        ratio = last / first
        return f"{name} times {ratio:.3g}" if abs(np.log(ratio)) >= 0.005 else ""
    step = last - first
    least, form, unit = (0.05, ".1f", " degrees") if name == "alpha" else (5e-4, ".3f", "")
    if abs(step) < least:
        return ""
    return f"{name} {'up' if step > 0 else 'down'} {abs(step):{form}}{unit}"
