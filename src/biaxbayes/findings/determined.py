"""What the data do determine: the structure tensor, stiffness, stress and energy.

Parameters that trade with each other can leave these sharp: the same curves mean the same stress.
A stress has two intervals. The model's holds what the parameters leave open; the tissue's holds,
with it, the error that the run inferred, which is mostly what the model misses, and, at total
stretches, a mounting stretch that is not identified.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pandas as pd

from biaxbayes.findings.material_draws import (
    fibre_strains,
    mounting_labels,
    parameters,
    piola_noise,
    protocol_mounting,
)
from biaxbayes.findings.percentile_bands import mixture_percentiles
from biaxbayes.mechanics.goh import (
    cauchy_stress_by_log_stretch,
    piola_stress,
    strain_energy,
    structure_tensor,
)
from biaxbayes.specimens.specimen import Protocol, Specimen

__all__ = ["FARTHEST", "MEASURED", "determined", "mounting_stated", "stated_stretches"]

MOST_DRAWS = 8000
INTERVAL = (0.05, 0.95)
MEASURED = " at the measured stretch"
"""Ending of a nominal stress whose stretches refer to the mounted state."""
FARTHEST = 1.1
"""Where the mounting stretch may be larger, total stretches rest too much on extrapolation."""
SHARES = (0.5, 1.0)
NORMAL_90 = 3.29
"""Width of a normal's central 90 % over its sd."""


State = tuple[float, float]
Quantity = tuple[str, str, State, np.ndarray, tuple[np.ndarray, np.ndarray] | None]
"""Name, unit, stretches, values of the draws, those of the tissue and the sd of their error."""


def stated_stretches(draws: pd.DataFrame, specimen: Specimen) -> list[tuple[float, float]]:
    """Total stretches to state quantities at: half-way and at the end of every protocol.

    The measured stretches times the posterior median of the mounting stretch, to three decimals.
    """
    out: list[tuple[float, float]] = []
    for protocol in specimen.protocols:
        lm = np.median(_mounting(draws, protocol), axis=0)
        for measured in _measured(protocol):
            x, y = np.round(measured * lm, 3)
            if (state := (float(x), float(y))) not in out:
                out.append(state)
    return out


def mounting_stated(priors: Mapping[str, object]) -> bool:
    """Whether a user stated priors of the mounting stretch: it was measured then."""
    return any(str(name).startswith("mounting_stretch") for name in priors)


def _measured(protocol: Protocol) -> np.ndarray:
    """Measured stretches half-way and at the end, (2, 2)."""
    top = np.array([protocol.stretch_x.max(), protocol.stretch_y.max()])
    return 1.0 + np.array(SHARES)[:, None] * (top - 1.0)


def _mounting(draws: pd.DataFrame, protocol: Protocol) -> np.ndarray:
    if not mounting_labels(draws):
        return np.ones((len(draws), 2))
    return protocol_mounting(draws, protocol)


def determined(
    draws: pd.DataFrame,
    specimen: Specimen,
    *,
    stretches: Sequence[tuple[float, float]] | None = None,
    fibre_switch: bool = False,
    refits: Mapping[str, tuple[float, float]] | None = None,
    mounting_known: bool = False,
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
    refits : mapping of str to (float, float), optional
        Ranges of the mounting stretches that are not identified, by name. Stresses of the tissue at
        total stretches are those of a mounted state that lies anywhere in the range.
    mounting_known : bool
        Whether the mounting stretch was measured, as by an image, and its prior states it. Else
        stresses of the tissue at total stretches are not stated where it may be 1.1 or more.

    Returns
    -------
    DataFrame
        Columns quantity, unit, stretch_x, stretch_y (NaN where there is none), median, low_90,
        high_90, relative_width, the interval over the median's magnitude, and for stresses
        tissue_low_90 and tissue_high_90 (else, and where they are not stated, NaN), which hold the
        error that the run inferred as well: the interval to state for the tissue.

        Stretches are total, but for the nominal stresses "at the measured stretch", half-way and
        at the end of every protocol and relative to its mounted state. These are loads over the
        section that the file's dimensions give, and do not rest on how far the model
        extrapolates to the unloaded state.

        Hx, Hy, Hz are the diagonal of the generalised structure tensor. Stiffnesses are derivatives
        of the Cauchy stress by the log stretch: d s_x / d ln l_x (xx), d s_y / d ln l_y (yy) and
        d s_x / d ln l_y (xy). The exponent is k2 E^2 at the largest stretch of the tests.
    """
    few = draws.iloc[:: -(-len(draws) // MOST_DRAWS)]
    states = list(stretches) if stretches is not None else stated_stretches(draws, specimen)
    with np.errstate(over="ignore", invalid="ignore"):
        stated = mounting_known or _farthest(few, refits or {}) < FARTHEST
        rows = [
            _row(*of)
            for of in _quantities(few, specimen, states, fibre_switch, refits or {}, stated)
        ]
        if stretches is None:
            rows += [_row(*of) for of in _measured_stresses(few, specimen, fibre_switch)]
    return pd.DataFrame(rows)


def _row(
    name: str,
    unit: str,
    state: State,
    values: np.ndarray,
    around: tuple[np.ndarray, np.ndarray] | None,
) -> dict[str, object]:
    values = np.nan_to_num(values, nan=np.inf)  # what overflows is large
    low, median, high = (float(q) for q in np.quantile(values, [INTERVAL[0], 0.5, INTERVAL[1]]))
    tissue = (np.nan, np.nan)
    if around is not None:
        known = np.isfinite(around[0])
        centre, sd = (v[known, None] for v in around)
        low_end, high_end = mixture_percentiles(centre, sd, INTERVAL)
        tissue = (float(low_end[0]), float(high_end[0]))
    return {
        "quantity": name,
        "unit": unit,
        "stretch_x": state[0],
        "stretch_y": state[1],
        "median": median,
        "low_90": low,
        "high_90": high,
        "relative_width": float((high - low) / max(abs(median), 1e-300)),
        "tissue_low_90": tissue[0],
        "tissue_high_90": tissue[1],
    }


def _quantities(
    draws: pd.DataFrame,
    specimen: Specimen,
    states: list[State],
    fibre_switch: bool,
    refits: Mapping[str, tuple[float, float]],
    stated: bool,
) -> Iterator[Quantity]:
    theta = parameters(draws)
    nowhere = (np.nan, np.nan)
    for name, H in zip(("Hx", "Hy", "Hz"), structure_tensor(*theta[3:]), strict=True):
        yield name, "", nowhere, H[:, 0], None
    small = cauchy_stress_by_log_stretch(*theta, 1.0, 1.0, fibre_switch=fibre_switch)
    for name, i, j in TANGENTS:
        yield f"small-strain stiffness {name}", "kPa", (1.0, 1.0), small[i, j, :, 0], None
    strain2 = np.zeros(len(draws))
    lm = np.mean([_mounting(draws, p) for p in specimen.protocols], axis=0)
    moved = _moved(draws, lm, refits)
    for state in states:
        at = [np.array([v]) for v in state]
        tangent = cauchy_stress_by_log_stretch(*theta, *at, fibre_switch=fibre_switch)
        energy = strain_energy(*theta, *at, fibre_switch=fibre_switch)
        piola, error = _piola(draws, specimen, np.tile(state, (len(draws), 1)), lm, fibre_switch)
        # Mounted elsewhere, the same loads of the test lie at other total stretches; over the
        # mounted section they then belong to another unloaded one: P = f / (Am lm).
        there, _ = _piola(draws, specimen, moved * state, lm, fibre_switch)
        if specimen.geometry == "mounted":
            there = there * moved
        for axis, name in enumerate("xy"):
            # s_k = l_k P_k
            own, tissue, sd = (state[axis] * v[:, axis] for v in (piola, there, error))
            yield f"Cauchy stress {name}", "kPa", state, own, (tissue, sd) if stated else None
        for name, i, j in TANGENTS:
            yield f"tangent stiffness {name}", "kPa", state, tangent[i, j, :, 0], None
        yield "strain energy", "kPa", state, energy[:, 0], None
        strain2 = np.maximum(strain2, fibre_strains(draws, *at)[:, 0] ** 2)
    yield "exponent k2 E^2", "", nowhere, draws["k2"].to_numpy(dtype=float) * strain2, None


TANGENTS = (("xx", 0, 0), ("yy", 1, 1), ("xy", 0, 1))


def _farthest(draws: pd.DataFrame, refits: Mapping[str, tuple[float, float]]) -> float:
    """The largest mounting stretch that the intervals and the ranges of refits hold."""
    columns = [c for c in draws.columns if str(c).startswith("mounting_stretch")]
    ends = [float(np.quantile(draws[c], INTERVAL[1])) for c in columns]
    return max([*ends, *(high for _, high in refits.values())], default=1.0)


def _moved(
    draws: pd.DataFrame, lm: np.ndarray, refits: Mapping[str, tuple[float, float]]
) -> np.ndarray:
    """Mounting stretch of each draw over one that scatters over the range of refits, (n, 2)."""
    out = np.ones_like(lm)
    rng = np.random.default_rng(0)
    for axis, name in enumerate("xy"):
        ranges = [r for key, r in refits.items() if key.startswith(f"mounting_stretch_{name}")]
        if not ranges:
            continue
        low, high = np.mean(ranges, axis=0)
        first, last = np.quantile(lm[:, axis], INTERVAL)
        # As much scatter as fills the range with 90 %, together with that of the draws.
        sd = np.sqrt(max((high - low) ** 2 - (last - first) ** 2, 0.0)) / NORMAL_90
        shift = 0.5 * (low + high) - np.median(lm[:, axis])
        elsewhere = lm[:, axis] + shift + sd * rng.standard_normal(len(lm))
        out[:, axis] = lm[:, axis] / np.maximum(elsewhere, 0.5)
    return out


def _measured_stresses(
    draws: pd.DataFrame, specimen: Specimen, fibre_switch: bool
) -> Iterator[Quantity]:
    """Nominal stresses half-way and at the end of every protocol, from its own mounted state."""
    if not mounting_labels(draws):
        return
    for protocol in specimen.protocols:
        lm = _mounting(draws, protocol)
        for measured in _measured(protocol):
            x, y = np.round(measured, 4)
            state = (float(x), float(y))
            ending = MEASURED if len(specimen.protocols) == 1 else f"{MEASURED} of {protocol.name}"
            piola, error = _piola(draws, specimen, lm * state, lm, fibre_switch)
            # f_k / A0_k = P_k (unloaded dimensions), f_k / Am_k = lm_k P_k (mounted)
            scale = lm if specimen.geometry == "mounted" else np.ones_like(lm)
            for axis, name in enumerate("xy"):
                own, sd = (scale[:, axis] * v[:, axis] for v in (piola, error))
                yield f"nominal stress {name}{ending}", "kPa", state, own, (own, sd)


def _piola(
    draws: pd.DataFrame, specimen: Specimen, total: np.ndarray, lm: np.ndarray, fibre_switch: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Nominal stress of every draw at total stretches (n, 2), and the sd of its error; kPa."""
    pair = piola_stress(*parameters(draws), total[:, :1], total[:, 1:], fibre_switch=fibre_switch)
    error = [piola_noise(draws, specimen, axis, p, lm) for axis, p in enumerate(pair)]
    return np.hstack(pair), np.hstack(error)
