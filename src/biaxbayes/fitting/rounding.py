"""How far the written digits of a record leave a fit open.

A record without noise is fitted down to the last digit of its file. There the cost is rounding
alone, no step lowers it, and whether its gradient vanishes cannot be told: a fit that
misses by no more than the rounding of the data has converged.
"""

from __future__ import annotations

import numpy as np

from biaxbayes.fitting.residuals import Readings
from biaxbayes.laws.law import StressResponse
from biaxbayes.mechanics.mounting import load_per_stress
from biaxbayes.specimens.specimen import Specimen

__all__ = ["half_digits", "rounding_bound"]

DIGITS = 15
"""Significant digits that a double holds whatever the number is."""


def half_digits(values: np.ndarray) -> np.ndarray:
    """Half a unit of the last written digit of each value of a column.

    A column is written with a fixed number of decimals or of significant digits. Either is the
    largest that one of its values needs; the coarser of the two holds for a value.

    Parameters
    ----------
    values : ndarray, shape (n,)
    """
    written = [f"{v:.{DIGITS - 1}e}".split("e") for v in np.abs(values).tolist()]
    significant = np.array([len(m.replace(".", "").rstrip("0")) for m, _ in written])
    leading = np.array([int(exponent) for _, exponent in written])
    nonzero = significant > 0
    if not nonzero.any():
        return np.zeros(len(values))
    decimals = int((significant - 1 - leading)[nonzero].max())
    by_significance = np.where(nonzero, leading + 1 - int(significant.max()), -decimals)
    return 0.5 * 10.0 ** np.maximum(-decimals, by_significance)


def rounding_bound(
    specimen: Specimen, data: Readings, mounting_stretch: np.ndarray, response: StressResponse
) -> float:
    """Largest root mean square miss of the Cauchy stress that rounding explains, in kPa.

    Parameters
    ----------
    specimen : Specimen
    data : Readings
        All its rows.
    mounting_stretch : ndarray, shape (2, m)
    response : StressResponse
        At the total stretches of ``data``.
    """
    stretch, load = _written(specimen)
    lm = mounting_stretch[:, data.group]
    factor = load_per_stress(data.area[:, None], data.stretch, lm, data.mounted)
    # data: f l lm / A0 (unloaded), f l / Am (mounted); model: s(l lm). Their difference moves by
    #   df / factor + s dl / l - sum_j ds/d(ln l_j) dl_j / l_j
    slope = np.abs(response.by_log_stretch) + np.eye(2)[:, :, None] * np.abs(response.stress)
    bound = load / factor + np.einsum("kjn,jn->kn", slope, stretch / data.stretch)
    return float(np.sqrt((bound**2).mean()))


def _written(specimen: Specimen) -> tuple[np.ndarray, np.ndarray]:
    """Half digits of the stretches and of the loads, each of shape (2, n)."""
    cauchy = specimen.stress_pair == "cauchy"
    # The reader divides stretches, and Cauchy stresses with them, by the stretch at rest.
    out = []
    for curves, divided in ((("stretch_x", "stretch_y"), True), (("load_x", "load_y"), cauchy)):
        for axis, name in enumerate(curves):
            by = np.concatenate(
                [np.full(p.rows, p.reference[axis] if divided else 1.0) for p in specimen.protocols]
            )
            column = np.concatenate([getattr(p, name) for p in specimen.protocols])
            out.append(half_digits(column * by) / by)
    return np.array(out[:2]), np.array(out[2:])
