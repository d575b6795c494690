"""What the data do determine: the structure tensor, stiffness, stress and energy.

These are what a biaxial test sees. Draws that disagree in every parameter may agree in all of
them.

Parameters that trade with each other can leave these sharp: the same curves mean the same stress.
A stress has two intervals. The model's holds what the parameters leave open; the tissue's holds,
with it, the error that the run inferred, which is mostly what the model misses, and, at total
stretches, a mounting stretch that is not identified.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from biaxbayes.forward import ForwardModel
from biaxbayes.identifiability.marginals import INTERVAL
from biaxbayes.laws.law import Law
from biaxbayes.laws.materials import Material
from biaxbayes.parameters import mounting_names
from biaxbayes.prediction.bands import mixture_percentiles
from biaxbayes.prediction.draws import mounting_labels, protocol_mounting
from biaxbayes.specimens.protocol import Protocol
from biaxbayes.specimens.specimen import Specimen

__all__ = [
    "FARTHEST",
    "MEASURED",
    "Derived",
    "derived_quantities",
    "determined",
    "largest_equibiaxial",
    "median_mounting",
    "mounting_stated",
    "some_draws",
    "stated_stretches",
]


# --- what a material does, draw by draw: structure tensor -----------------------------------------


STRESS, STIFFNESS, TENSOR = "stress", "stiffness", "structure tensor"


@dataclass(frozen=True)
class Derived:
    """A quantity that follows from the material parameters.

    Attributes
    ----------
    kind : {"stress", "stiffness", "structure tensor"}
    name : str
        ``Hx``, ``cauchy_x``, ``stiffness_x`` and the like.
    unit : str
        Empty for pure numbers.
    stretch : float or None
        Total equibiaxial stretch it is taken at.
    values : ndarray, shape (n,)
    """

    kind: str
    name: str
    unit: str
    stretch: float | None
    values: np.ndarray

    @property
    def key(self) -> str:
        """Name with the stretch, unique among the quantities of a run."""
        return self.name if self.stretch is None else f"{self.name} at {self.stretch:g}"


def derived_quantities(
    draws: pd.DataFrame,
    law: Law,
    stress_at: Sequence[float],
    stiffness_at: Sequence[float] = (),
    *,
    tensor: bool = True,
) -> list[Derived]:
    """Quantities of every draw.

    Parameters
    ----------
    draws : DataFrame
        With the parameters of the law.
    law : Law
    stress_at, stiffness_at : sequence of float
        Total equibiaxial stretches. The stress is the Cauchy stress; the stiffness is
        d s_x / d ln l_x at constant l_y (y alike), kPa. At a stretch of one that is the
        small-strain stiffness.
    tensor : bool
        Whether to give what the law says of itself, as the structure tensor.

    Returns
    -------
    list of Derived
    """
    material = law.material(draws)
    out = []
    if tensor:
        described = law.derived_quantities(material)
        out += [Derived(TENSOR, name, "", None, v[:, 0]) for name, v in described.items()]
    with np.errstate(over="ignore", invalid="ignore"):
        for stretch in stiffness_at:
            jacobian = material.cauchy_by_log_stretch(stretch, stretch)
            for i, axis in enumerate("xy"):
                own = jacobian[i, i, :, 0]
                out.append(Derived(STIFFNESS, f"stiffness_{axis}", "kPa", stretch, own))
        for stretch in stress_at:
            stress = material.cauchy(stretch, stretch)
            for axis, values in zip("xy", stress, strict=True):
                out.append(Derived(STRESS, f"cauchy_{axis}", "kPa", stretch, values[:, 0]))
    return out


def some_draws(draws: pd.DataFrame) -> pd.DataFrame:
    """At most :data:`MOST_DRAWS` rows, evenly chosen: the same wherever a quantity is told of."""
    return draws.iloc[:: -(-len(draws) // MOST_DRAWS)]


def median_mounting(draws: pd.DataFrame, specimen: Specimen) -> np.ndarray:
    """Median mounting stretch of every protocol, shape (protocols, 2); one where not inferred."""
    if not mounting_labels(draws, specimen):
        return np.ones((len(specimen.protocols), 2))
    return np.array([np.median(protocol_mounting(draws, p), axis=0) for p in specimen.protocols])


def largest_equibiaxial(draws: pd.DataFrame, specimen: Specimen) -> float:
    """Largest total stretch that the test reached in both directions, at the median mounting."""
    lm = median_mounting(draws, specimen)
    top = [
        np.array([p.stretch_x.max(), p.stretch_y.max()]) * m
        for p, m in zip(specimen.protocols, lm, strict=True)
    ]
    return float(np.max(top, axis=0).min())


# --- what the data do determine: the structure tensor, stiffness, stress and energy --------------


MOST_DRAWS = 8000
"""Draws, evenly chosen, that every number that follows from parameters is computed of."""
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
        lm = np.median(protocol_mounting(draws, protocol), axis=0)
        for measured in _measured(protocol):
            x, y = np.round(measured * lm, 3)
            if (state := (float(x), float(y))) not in out:
                out.append(state)
    return out


def mounting_stated(priors: Mapping[str, object]) -> bool:
    """Whether a user stated priors of the mounting stretch: it was measured then."""
    return not {"mounting_stretch", *mounting_names("stretch")}.isdisjoint(priors)


def _measured(protocol: Protocol) -> np.ndarray:
    """Measured stretches half-way and at the end, (2, 2)."""
    top = np.array([protocol.stretch_x.max(), protocol.stretch_y.max()])
    return 1.0 + np.array(SHARES)[:, None] * (top - 1.0)


def determined(
    draws: pd.DataFrame,
    specimen: Specimen,
    law: Law,
    *,
    stretches: Sequence[tuple[float, float]] | None = None,
    refits: Mapping[str, tuple[float, float]] | None = None,
    values: Mapping[str, tuple[float, float]] | None = None,
    mounting_known: bool = False,
) -> pd.DataFrame:
    """Quantities that do not depend on how the parameters are split, with 90 % intervals.

    Parameters
    ----------
    draws : DataFrame
        Posterior draws by the names of ``summary.csv``.
    specimen : Specimen
    law : Law
    stretches : sequence of (float, float), optional
        Total stretches (x, y); default :func:`stated_stretches`.
    refits : mapping of str to (float, float), optional
        Ranges of the mounting stretches that are not identified, by name. Stresses of the tissue at
        total stretches are those of a mounted state that lies anywhere in the range.
    values : mapping of str to (float, float), optional
        Both ends of the mounting stretches that are stated of the tissue as values, by name: they
        stand in the place of ``refits`` and of the draws' own interval, however far they are.
    mounting_known : bool
        Whether the mounting stretch was measured, as by an image, and its prior states it. Else
        stresses of the tissue at total stretches are not stated where one that is not stated as a
        value may be 1.1 or more.

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
    few = some_draws(draws)
    states = list(stretches) if stretches is not None else stated_stretches(draws, specimen)
    ranges = {**(refits or {}), **(values or {})}
    with np.errstate(over="ignore", invalid="ignore"):
        stated = mounting_known or _farthest(few, specimen, ranges, values or {}) < FARTHEST
        found = list(_quantities(few, specimen, states, law, ranges, stated))
        if stretches is None:
            found += _measured_stresses(few, specimen, law.material(few))
        tissue = _tissue([around for *_, around in found])
        rows = [_row(*of[:4], ends) for of, ends in zip(found, tissue, strict=True)]
    return pd.DataFrame(rows)


def _tissue(
    arounds: Sequence[tuple[np.ndarray, np.ndarray] | None],
) -> list[tuple[float, float]]:
    """Intervals of quantities with their errors, NaN where there is none.

    All whose draws are known at the same places are found at once, in a tenth of the time.
    """
    out = [(np.nan, np.nan)] * len(arounds)
    alike: dict[bytes, list[int]] = {}
    for i, around in enumerate(arounds):
        if around is not None:
            alike.setdefault(np.isfinite(around[0]).tobytes(), []).append(i)
    for mask, members in alike.items():
        known = np.frombuffer(mask, dtype=bool)
        centre, sd = (
            np.column_stack([around[k][known] for i in members if (around := arounds[i])])
            for k in (0, 1)
        )
        for i, low, high in zip(members, *mixture_percentiles(centre, sd, INTERVAL), strict=True):
            out[i] = (float(low), float(high))
    return out


def _row(
    name: str,
    unit: str,
    state: State,
    values: np.ndarray,
    tissue: tuple[float, float],
) -> dict[str, object]:
    values = np.nan_to_num(values, nan=np.inf)  # what overflows is large
    low, median, high = (float(q) for q in np.quantile(values, [INTERVAL[0], 0.5, INTERVAL[1]]))
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
    law: Law,
    ranges: Mapping[str, tuple[float, float]],
    stated: bool,
) -> Iterator[Quantity]:
    material = law.material(draws)
    nowhere = (np.nan, np.nan)
    for name, values in law.derived_quantities(material).items():
        yield name, "", nowhere, values[:, 0], None
    small = material.cauchy_by_log_stretch(1.0, 1.0)
    for name, i, j in TANGENTS:
        yield f"small-strain stiffness {name}", "kPa", (1.0, 1.0), small[i, j, :, 0], None
    lm = np.mean([protocol_mounting(draws, p) for p in specimen.protocols], axis=0)
    moved = _moved(specimen, lm, ranges)
    for state in states:
        at = [np.array([v]) for v in state]
        tangent = material.cauchy_by_log_stretch(*at)
        energy = material.strain_energy(*at)
        piola, error = _piola(draws, specimen, np.tile(state, (len(draws), 1)), lm, material)
        # Mounted elsewhere, the same loads of the test lie at other total stretches; over the
        # mounted section they then belong to another unloaded one: P = f / (Am lm).
        there, _ = _piola(draws, specimen, moved * state, lm, material)
        if specimen.geometry == "mounted":
            there = there * moved
        for axis, name in enumerate("xy"):
            # s_k = l_k P_k
            own, tissue, sd = (state[axis] * v[:, axis] for v in (piola, there, error))
            yield f"Cauchy stress {name}", "kPa", state, own, (tissue, sd) if stated else None
        for name, i, j in TANGENTS:
            yield f"tangent stiffness {name}", "kPa", state, tangent[i, j, :, 0], None
        yield "strain energy", "kPa", state, energy[:, 0], None
    tops = [np.tile(state, (len(draws), 1)) for state in states]
    for name, values in law.derived_at(material, tops).items():
        yield name, "", nowhere, values, None


TANGENTS = (("xx", 0, 0), ("yy", 1, 1), ("xy", 0, 1))


def _farthest(
    draws: pd.DataFrame,
    specimen: Specimen,
    ranges: Mapping[str, tuple[float, float]],
    values: Mapping[str, tuple[float, float]],
) -> float:
    """The largest mounting stretch that intervals and ranges hold, but for stated values."""
    states = mounting_labels(draws, specimen)
    columns = [name for state in states for name in mounting_names("stretch", state)]
    ends = {c: float(np.quantile(draws[c], INTERVAL[1])) for c in columns}
    for name, (_, high) in ranges.items():
        ends[name] = max(high, ends.get(name, high))
    return max((end for name, end in ends.items() if name not in values), default=1.0)


def _moved(
    specimen: Specimen, lm: np.ndarray, ranges: Mapping[str, tuple[float, float]]
) -> np.ndarray:
    """Mounting stretch of each draw over one that scatters over its range, (n, 2)."""
    out = np.ones_like(lm)
    rng = np.random.default_rng(0)
    states = ("", *(p.name for p in specimen.protocols))
    for axis in range(2):
        own = (ranges.get(mounting_names("stretch", state)[axis]) for state in states)
        found = [r for r in own if r is not None]
        if not found:
            continue
        low, high = np.mean(found, axis=0)
        first, last = np.quantile(lm[:, axis], INTERVAL)
        # As much scatter as fills the range with 90 %, together with that of the draws.
        sd = np.sqrt(max((high - low) ** 2 - (last - first) ** 2, 0.0)) / NORMAL_90
        shift = 0.5 * (low + high) - np.median(lm[:, axis])
        elsewhere = lm[:, axis] + shift + sd * rng.standard_normal(len(lm))
        out[:, axis] = lm[:, axis] / np.maximum(elsewhere, 0.5)
    return out


def _measured_stresses(
    draws: pd.DataFrame, specimen: Specimen, material: Material
) -> Iterator[Quantity]:
    """Nominal stresses half-way and at the end of every protocol, from its own mounted state."""
    if not mounting_labels(draws, specimen):
        return
    for protocol in specimen.protocols:
        lm = protocol_mounting(draws, protocol)
        for measured in _measured(protocol):
            x, y = np.round(measured, 4)
            state = (float(x), float(y))
            ending = MEASURED if len(specimen.protocols) == 1 else f"{MEASURED} of {protocol.name}"
            piola, error = _piola(draws, specimen, lm * state, lm, material)
            # f_k / A0_k = P_k (unloaded dimensions), f_k / Am_k = lm_k P_k (mounted)
            scale = lm if specimen.geometry == "mounted" else np.ones_like(lm)
            for axis, name in enumerate("xy"):
                own, sd = (scale[:, axis] * v[:, axis] for v in (piola, error))
                yield f"nominal stress {name}{ending}", "kPa", state, own, (own, sd)


def _piola(
    draws: pd.DataFrame,
    specimen: Specimen,
    total: np.ndarray,
    lm: np.ndarray,
    material: Material,
) -> tuple[np.ndarray, np.ndarray]:
    """Nominal stress of every draw at total stretches (n, 2), and the sd of its error; kPa."""
    pair = material.piola(total[:, :1], total[:, 1:])
    forward = ForwardModel.from_specimen(specimen, material.law)
    error = [forward.piola_sd(draws, axis, p, lm) for axis, p in enumerate(pair)]
    return np.hstack(pair), np.hstack(error)
