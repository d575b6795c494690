"""Quantities that the data determine: structure tensor, stiffness, stress and energy.

These can be narrow although parameters are strongly correlated: the same curves mean the same
stress.
A stress has two intervals. The law's holds the uncertainty of the parameters; the tissue's holds
the inferred error as well, mostly model error, and at total stretches a mounting stretch that is
not identified.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from biaxbayes.forward import ForwardModel
from biaxbayes.identifiability.marginals import INTERVAL, Z90
from biaxbayes.laws.law import Law
from biaxbayes.laws.materials import Material
from biaxbayes.options import Settings
from biaxbayes.parameters import mounting_names
from biaxbayes.prediction.bands import mixture_percentiles
from biaxbayes.prediction.draws import mounting_labels, protocol_mounting
from biaxbayes.specimens.protocol import Protocol
from biaxbayes.specimens.specimen import Specimen

# --- draw by draw: structure tensor, stiffness, stress --------------------------------------------


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
    stress_at, stiffness_at : sequence of float
        Total equibiaxial stretches. The stress is the Cauchy stress; the stiffness is
        d s_x / d ln l_x at constant l_y (and vice versa), kPa. At a stretch of one that is the
        small-strain stiffness.
    tensor : bool
        Whether to give quantities of the law itself, as the structure tensor.

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
                values = jacobian[i, i, :, 0]
                out.append(Derived(STIFFNESS, f"stiffness_{axis}", "kPa", stretch, values))
        for stretch in stress_at:
            stress = material.cauchy(stretch, stretch)
            for axis, values in zip("xy", stress, strict=True):
                out.append(Derived(STRESS, f"cauchy_{axis}", "kPa", stretch, values[:, 0]))
    return out


MAX_DERIVED_DRAWS = 8000
"""Draws, evenly chosen, from which every derived quantity is computed."""


def thin_draws(draws: pd.DataFrame, max_draws: int = MAX_DERIVED_DRAWS) -> pd.DataFrame:
    """Every n-th draw, at most ``max_draws``."""
    return draws.iloc[:: -(-len(draws) // max_draws)]


def median_mounting(draws: pd.DataFrame, specimen: Specimen) -> np.ndarray:
    """Median mounting stretch of every protocol, shape (protocols, 2); one where not inferred."""
    return np.array([np.median(protocol_mounting(draws, p), axis=0) for p in specimen.protocols])


def largest_equibiaxial(draws: pd.DataFrame, specimen: Specimen) -> float:
    """Largest total stretch that the test reached in both directions, at the median mounting."""
    lm = median_mounting(draws, specimen)
    largest = [p.stretch.max(axis=0) * m for p, m in zip(specimen.protocols, lm, strict=True)]
    return float(np.max(largest, axis=0).min())


# --- the table: determined.csv ------------------------------------------------------------------


AT_MEASURED_STRETCH = " at the measured stretch"
"""Ending of a nominal stress whose stretches refer to the mounted state."""
MAX_MOUNTING_STRETCH = 1.1
"""Above this mounting stretch, stresses at total stretches rest too much on extrapolation."""
PATH_FRACTIONS = (0.5, 1.0)


def determined(
    draws: pd.DataFrame,
    specimen: Specimen,
    settings: Settings,
    *,
    stretches: Sequence[tuple[float, float]] | None = None,
    refits: Mapping[str, tuple[float, float]] | None = None,
    values: Mapping[str, tuple[float, float]] | None = None,
) -> pd.DataFrame:
    """Quantities that do not depend on how the parameters are split, with 90 % intervals.

    Parameters
    ----------
    draws : DataFrame
        Posterior draws by the names of ``summary.csv``.
    settings : Settings
        Those of the run.
    stretches : sequence of (float, float), optional
        Total stretches (x, y). Default: half-way and at the end of every protocol, the measured
        stretches times the posterior median of the mounting stretch, to three decimals.
    refits : mapping of str to (float, float), optional
        Ranges of the mounting stretches that are not identified, by name. Stresses of the tissue at
        total stretches are those of a mounted state that lies anywhere in the range.
    values : mapping of str to (float, float), optional
        Both ends of the mounting stretches that are identified, by name: they replace ``refits``
        and the interval of the draws. The tissue has no stresses at total stretches where a
        mounting stretch that is not identified may be 1.1 or more.

    Returns
    -------
    DataFrame
        Columns quantity, unit, stretch_x, stretch_y (NaN where there is none), median, low_90,
        high_90, relative_width, the interval over the median's magnitude, and for stresses
        tissue_low_90 and tissue_high_90 (else, and where there are none, NaN), which hold the
        error that the run inferred as well: the interval of the tissue.

        Stretches are total, but for the nominal stresses "at the measured stretch", half-way and
        at the end of every protocol and relative to its mounted state. These are loads over the
        section that the file's dimensions give, and do not rest on how far the model
        extrapolates to the unloaded state.

        Hx, Hy, Hz are the diagonal of the generalised structure tensor. Stiffnesses are derivatives
        of the Cauchy stress with respect to the log stretch: d s_x / d ln l_x (xx),
        d s_y / d ln l_y (yy) and d s_x / d ln l_y (xy).
        The exponent is k2 E^2 at the largest stretch of the tests.
    """
    thinned = thin_draws(draws)
    forward = ForwardModel.from_specimen(specimen, settings)
    identified = values or {}
    ranges = {**(refits or {}), **identified}
    states = list(stretches or ())
    if stretches is None:
        for protocol in specimen.protocols:
            lm = np.median(protocol_mounting(draws, protocol), axis=0)
            x_and_y = np.round(_half_way_and_end(protocol) * lm, 3)
            states += [(float(x), float(y)) for x, y in x_and_y]
        states = list(dict.fromkeys(states))
    # the largest mounting stretch in intervals and ranges, without those that are identified
    names = [n for s in mounting_labels(thinned, specimen) for n in mounting_names("stretch", s)]
    ends = {name: float(np.quantile(thinned[name], INTERVAL[1])) for name in names}
    for name, (_, high) in ranges.items():
        ends[name] = max(high, ends.get(name, high))
    farthest = max((end for name, end in ends.items() if name not in identified), default=1.0)
    with np.errstate(over="ignore", invalid="ignore"):
        rows = list(
            _rows(thinned, specimen, states, forward, ranges, farthest < MAX_MOUNTING_STRETCH)
        )
        if stretches is None:
            rows += _measured_rows(thinned, specimen, forward)
    return pd.DataFrame(rows)


def _half_way_and_end(protocol: Protocol) -> np.ndarray:
    """Measured stretches half-way and at the end, (2, 2)."""
    return 1.0 + np.array(PATH_FRACTIONS)[:, None] * (protocol.stretch.max(axis=0) - 1.0)


def _row(
    name: str,
    unit: str,
    stretches: tuple[float, float],
    values: np.ndarray,
    tissue: tuple[np.ndarray, np.ndarray] | None = None,
) -> dict[str, object]:
    """A row of the table; `tissue` has the values of the draws and the sd of their error."""
    values = np.nan_to_num(values, nan=np.inf)  # what overflows is large
    low, median, high = (float(q) for q in np.quantile(values, [INTERVAL[0], 0.5, INTERVAL[1]]))
    ends = (np.nan, np.nan)
    if tissue is not None:
        finite = np.isfinite(tissue[0])
        centre, sd = (part[finite][:, None] for part in tissue)
        first, last = mixture_percentiles(centre, sd, INTERVAL)
        ends = (float(first[0]), float(last[0]))
    return {
        "quantity": name,
        "unit": unit,
        "stretch_x": stretches[0],
        "stretch_y": stretches[1],
        "median": median,
        "low_90": low,
        "high_90": high,
        "relative_width": float((high - low) / max(abs(median), 1e-300)),
        "tissue_low_90": ends[0],
        "tissue_high_90": ends[1],
    }


def _rows(
    draws: pd.DataFrame,
    specimen: Specimen,
    states: list[tuple[float, float]],
    forward: ForwardModel,
    ranges: Mapping[str, tuple[float, float]],
    near: bool,
) -> Iterator[dict[str, object]]:
    """Quantities of the law, and those at total stretches."""
    law, material = forward.law, forward.law.material(draws)
    nowhere = (np.nan, np.nan)
    for name, values in law.derived_quantities(material).items():
        yield _row(name, "", nowhere, values[:, 0])
    small = material.cauchy_by_log_stretch(1.0, 1.0)
    for name, i, j in TANGENTS:
        yield _row(f"small-strain stiffness {name}", "kPa", (1.0, 1.0), small[i, j, :, 0])
    lm = np.mean([protocol_mounting(draws, p) for p in specimen.protocols], axis=0)
    moved = mounting_ratio(specimen, lm, ranges)
    for state in states:
        at = [np.array([v]) for v in state]
        tangent = material.cauchy_by_log_stretch(*at)
        energy = material.strain_energy(*at)
        piola, error = _piola(draws, forward, np.tile(state, (len(draws), 1)), lm, material)
        # Mounted elsewhere, the same loads of the test lie at other total stretches; over the
        # mounted section they then belong to another unloaded one: P = f / (Am lm).
        there, _ = _piola(draws, forward, moved * state, lm, material)
        if specimen.geometry == "mounted":
            there = there * moved
        for axis, name in enumerate("xy"):
            # s_k = l_k P_k
            cauchy, tissue, sd = (state[axis] * v[:, axis] for v in (piola, there, error))
            of_tissue = (tissue, sd) if near else None
            yield _row(f"Cauchy stress {name}", "kPa", state, cauchy, of_tissue)
        for name, i, j in TANGENTS:
            yield _row(f"tangent stiffness {name}", "kPa", state, tangent[i, j, :, 0])
        yield _row("strain energy", "kPa", state, energy[:, 0])
    stretches = [np.tile(state, (len(draws), 1)) for state in states]
    for name, values in law.derived_at(material, stretches).items():
        yield _row(name, "", nowhere, values)


TANGENTS = (("xx", 0, 0), ("yy", 1, 1), ("xy", 0, 1))


def mounting_ratio(
    specimen: Specimen, lm: np.ndarray, ranges: Mapping[str, tuple[float, float]]
) -> np.ndarray:
    """Ratio lm / lm' of each draw, (n, 2), with lm' scattered over the range of the stretch."""
    out = np.ones_like(lm)
    rng = np.random.default_rng(0)
    states = ("", *(p.name for p in specimen.protocols))
    for axis in range(2):
        by_state = (ranges.get(mounting_names("stretch", state)[axis]) for state in states)
        given = [r for r in by_state if r is not None]
        if not given:
            continue
        low, high = np.mean(given, axis=0)
        first, last = np.quantile(lm[:, axis], INTERVAL)
        # sd^2 + sd_draws^2 = ((high - low) / (2 z90))^2: together with the draws, 90 % of a normal
        # about the centre of the range lies inside it
        sd = np.sqrt(max((high - low) ** 2 - (last - first) ** 2, 0.0)) / (2.0 * Z90)
        shift = 0.5 * (low + high) - np.median(lm[:, axis])
        elsewhere = lm[:, axis] + shift + sd * rng.standard_normal(len(lm))
        out[:, axis] = lm[:, axis] / np.maximum(elsewhere, 0.5)
    return out


def _measured_rows(
    draws: pd.DataFrame, specimen: Specimen, forward: ForwardModel
) -> Iterator[dict[str, object]]:
    """Nominal stresses half-way and at the end of every protocol, from its own mounted state."""
    if not mounting_labels(draws, specimen):
        return
    material = forward.law.material(draws)
    for protocol in specimen.protocols:
        lm = protocol_mounting(draws, protocol)
        # f_k / A0_k = P_k (unloaded dimensions), f_k / Am_k = lm_k P_k (mounted)
        scale = lm if specimen.geometry == "mounted" else np.ones_like(lm)
        ending = (
            AT_MEASURED_STRETCH
            if len(specimen.protocols) == 1
            else f"{AT_MEASURED_STRETCH} of {protocol.name}"
        )
        for x, y in np.round(_half_way_and_end(protocol), 4):
            state = (float(x), float(y))
            piola, error = _piola(draws, forward, lm * state, lm, material)
            for axis, name in enumerate("xy"):
                nominal, sd = (scale[:, axis] * v[:, axis] for v in (piola, error))
                yield _row(f"nominal stress {name}{ending}", "kPa", state, nominal, (nominal, sd))


def _piola(
    draws: pd.DataFrame,
    forward: ForwardModel,
    total: np.ndarray,
    lm: np.ndarray,
    material: Material,
) -> tuple[np.ndarray, np.ndarray]:
    """Nominal stress of every draw at total stretches (n, 2), and the sd of its error; kPa."""
    pair = material.piola(total[:, :1], total[:, 1:])
    error = [forward.piola_sd(draws, axis, p, lm) for axis, p in enumerate(pair)]
    return np.hstack(pair), np.hstack(error)
