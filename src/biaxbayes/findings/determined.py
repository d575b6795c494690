"""What the data do determine: the structure tensor, stiffness, stress and energy.

Parameters that trade with each other can leave these sharp: the same curves mean the same stress.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from biaxbayes.findings.material_draws import (
    fibre_strains,
    mounting_labels,
    parameters,
    protocol_mounting,
)
from biaxbayes.mechanics.goh import (
    cauchy_stress,
    cauchy_stress_by_log_stretch,
    strain_energy,
    structure_tensor,
)
from biaxbayes.specimens.specimen import Specimen

__all__ = ["determined", "stated_stretches"]

MOST_DRAWS = 8000
INTERVAL = (0.05, 0.95)


def stated_stretches(draws: pd.DataFrame, specimen: Specimen) -> list[tuple[float, float]]:
    """Total stretches to state quantities at: half-way and at the end of every protocol.

    The measured stretches times the posterior median of the mounting stretch, to three decimals.
    """
    out: list[tuple[float, float]] = []
    for protocol in specimen.protocols:
        lm = np.ones(2)
        if mounting_labels(draws):
            lm = np.median(protocol_mounting(draws, protocol), axis=0)
        top = np.array([protocol.stretch_x.max(), protocol.stretch_y.max()])
        for share in (0.5, 1.0):
            x, y = np.round((1.0 + share * (top - 1.0)) * lm, 3)
            if (state := (float(x), float(y))) not in out:
                out.append(state)
    return out


def determined(
    draws: pd.DataFrame,
    specimen: Specimen,
    *,
    stretches: Sequence[tuple[float, float]] | None = None,
    fibre_switch: bool = False,
) -> pd.DataFrame:
    """Quantities that do not depend on how the parameters are split, with 90 % intervals.

    Parameters
    ----------
    draws : DataFrame
        Posterior draws by the names of ``summary.csv``.
    specimen : Specimen
    stretches : sequence of (float, float), optional
        Total stretches (x, y); default :func:`stated_stretches`.
    fibre_switch : bool

    Returns
    -------
    DataFrame
        Columns quantity, unit, stretch_x, stretch_y (NaN where there is none), median, low_90,
        high_90 and relative_width, the interval over the median's magnitude.

        Hx, Hy, Hz are the diagonal of the generalised structure tensor. Stiffnesses are derivatives
        of the Cauchy stress by the log stretch: d s_x / d ln l_x (xx), d s_y / d ln l_y (yy) and
        d s_x / d ln l_y (xy). The exponent is k2 E^2 at the largest stretch of the tests.
    """
    few = draws.iloc[:: -(-len(draws) // MOST_DRAWS)]
    states = list(stretches) if stretches is not None else stated_stretches(draws, specimen)
    rows = []
    for name, unit, state, values in _quantities(few, states, fibre_switch):
        low, median, high = np.quantile(values, [INTERVAL[0], 0.5, INTERVAL[1]])
        rows.append(
            {
                "quantity": name,
                "unit": unit,
                "stretch_x": state[0],
                "stretch_y": state[1],
                "median": float(median),
                "low_90": float(low),
                "high_90": float(high),
                "relative_width": float((high - low) / max(abs(median), 1e-300)),
            }
        )
    return pd.DataFrame(rows)


def _quantities(
    draws: pd.DataFrame, states: list[tuple[float, float]], fibre_switch: bool
) -> Iterator[tuple[str, str, tuple[float, float], np.ndarray]]:
    theta = parameters(draws)
    nowhere = (np.nan, np.nan)
    for name, H in zip(("Hx", "Hy", "Hz"), structure_tensor(*theta[3:]), strict=True):
        yield name, "", nowhere, H[:, 0]
    small = cauchy_stress_by_log_stretch(*theta, 1.0, 1.0, fibre_switch=fibre_switch)
    for name, i, j in (("xx", 0, 0), ("yy", 1, 1), ("xy", 0, 1)):
        yield f"small-strain stiffness {name}", "kPa", (1.0, 1.0), small[i, j, :, 0]
    strain2 = np.zeros(len(draws))
    for state in states:
        at = [np.array([v]) for v in state]
        stress = cauchy_stress(*theta, *at, fibre_switch=fibre_switch)
        tangent = cauchy_stress_by_log_stretch(*theta, *at, fibre_switch=fibre_switch)
        energy = strain_energy(*theta, *at, fibre_switch=fibre_switch)
        for name, column in zip("xy", stress, strict=True):
            yield f"Cauchy stress {name}", "kPa", state, column[:, 0]
        for name, i, j in (("xx", 0, 0), ("yy", 1, 1), ("xy", 0, 1)):
            yield f"tangent stiffness {name}", "kPa", state, tangent[i, j, :, 0]
        yield "strain energy", "kPa", state, energy[:, 0]
        strain2 = np.maximum(strain2, fibre_strains(draws, *at)[:, 0] ** 2)
    yield "exponent k2 E^2", "", nowhere, draws["k2"].to_numpy(dtype=float) * strain2
