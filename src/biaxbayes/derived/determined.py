"""Quantities that the data determine: structure tensor, stiffness, stress and energy.

They can be narrow although parameters are strongly correlated: the same curves, the same stress.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from biaxbayes.laws.law import Law
from biaxbayes.model.posterior import Posterior
from biaxbayes.prediction.draws import mounting_labels, protocol_mounting, with_free_sides
from biaxbayes.prediction.percentiles import QUANTILES, percentiles
from biaxbayes.prediction.tissue import Tissue
from biaxbayes.specimens.protocol import Protocol
from biaxbayes.specimens.specimen import Specimen

# --- draw by draw: structure tensor, stiffness, stress --------------------------------------------


STRESS, STIFFNESS, TENSOR = "stress", "stiffness", "structure tensor"


@dataclass(frozen=True)
class Derived:
    """A quantity that follows from the material parameters."""

    kind: str  # stress, stiffness or structure tensor
    name: str  # ``Hx``, ``cauchy_x``, ``stiffness_x`` and the like
    unit: str  # empty for pure numbers
    stretch: float | None  # total equibiaxial stretch it is taken at
    values: np.ndarray  # (n,)

    @property
    def key(self) -> str:
        """Name with the stretch, unique among the quantities of a run."""
        return self.name if self.stretch is None else f"{self.name} at {self.stretch:g}"


def derived_quantities(
    draws: pd.DataFrame, law: Law, stress_at: Sequence[float], stiffness_at: Sequence[float]
) -> list[Derived]:
    """The structure tensor of every draw, stresses and stiffnesses.

    At total equibiaxial stretches: the Cauchy stress, and the stiffness d s_x / d ln l_x at
    constant l_y (and vice versa), kPa; at a stretch of one that is the small-strain stiffness.
    """
    material = law.material(draws)
    described = law.derived_quantities(material)
    out = [Derived(TENSOR, name, "", None, v[:, 0]) for name, v in described.items()]
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


def largest_equibiaxial(draws: pd.DataFrame, specimen: Specimen) -> float:
    """Largest total stretch that the test reached in both directions, at the median mounting."""
    largest = [
        (p.stretch * np.median(protocol_mounting(draws, p), axis=0)).max(axis=0)
        for p in specimen.protocols
    ]
    # a strip is stretched along itself
    return float(np.max(largest, axis=0)[list(specimen.experiment.axes)].min())


# --- the table: determined.csv ------------------------------------------------------------------


AT_MEASURED_STRETCH = " at the measured stretch"
"""Ending of quantities whose stretches refer to the mounted state."""
AT_PHYSIOLOGICAL = " at the physiological state"
"""Ending of quantities at the total stretches that the header gives."""
STRESS_DRAWS = 1000
"""Draws, evenly chosen, from which the stresses of the tissue are computed."""
PATH_FRACTIONS = (0.5, 1.0)


def determined(
    posterior: Posterior,
    draws: pd.DataFrame,
    *,
    stretches: Sequence[tuple[float, float]] | None = None,
) -> pd.DataFrame:
    """Quantities that do not depend on how the parameters are split, with 90 % intervals.

    ``stretches`` are total (x, y). Default: half-way and at the end of every protocol, the measured
    stretches times the posterior median of the mounting stretch, to three decimals.

    Columns quantity, unit, stretch_x, stretch_y (NaN where there is none), median, low, high and
    relative_width, the interval over the median's magnitude. Stretches are total, but for
    quantities "at the measured stretch", half-way and at the end of every protocol and relative to
    its mounted state. Stresses are those of the tissue, the law and its misfit, the others the
    law's. Nominal stresses are forces over the section of the unloaded specimen.
    Quantities at total stretches rest on the law between the unloaded and the mounted state; their
    intervals hold what is not known of the mounting stretch.

    Hx, Hy, Hz are the diagonal of the generalised structure tensor. Stiffnesses are derivatives of
    the Cauchy stress with respect to the log stretch: d s_x / d ln l_x (xx), d s_y / d ln l_y (yy)
    and d s_x / d ln l_y (xy); the ratio is that of xx to yy. The exponent is k2 E^2 at the largest
    stretch of the tests.
    """
    specimen = with_free_sides(draws, posterior.specimen, posterior.law)
    states = list(stretches or ())
    axes = specimen.experiment.axes if stretches is None else (0, 1)
    side = specimen.experiment.free_side
    if stretches is None:
        for protocol in specimen.protocols:
            lm = np.median(protocol_mounting(draws, protocol), axis=0)
            x_and_y = np.round(_half_way_and_end(protocol, side) * lm, 3)
            states += [(float(x), float(y)) for x, y in x_and_y]
        states = list(dict.fromkeys(states))
    few, law, nowhere = thin_draws(draws), posterior.law, (np.nan, np.nan)
    with np.errstate(over="ignore", invalid="ignore"):
        material = law.material(few)
        described = law.derived_quantities(material)
        rows = [_row(name, "", nowhere, v[:, 0]) for name, v in described.items()]
        small = material.cauchy_by_log_stretch(1.0, 1.0)
        for name, i, j in TANGENTS:
            values = small[i, j, :, 0]
            rows.append(_row(f"small-strain stiffness {name}", "kPa", (1.0, 1.0), values))
        if states:
            rows += _total_rows(posterior, few, states, axes)
            tiled = [np.tile(state, (len(few), 1)) for state in states]
            largest = law.largest_exponents(material.constants, tiled)
            for formula, values in zip(law.formulas, largest, strict=True):
                rows.append(_row(f"exponent {formula}", "", nowhere, values))
        if stretches is None and specimen.physiological:
            body = [specimen.physiological]
            rows += _total_rows(posterior, draws, body, (0, 1), AT_PHYSIOLOGICAL)
        if stretches is None:
            rows += _measured_rows(posterior, specimen, thin_draws(draws, STRESS_DRAWS))
    return pd.DataFrame(rows)


def _half_way_and_end(protocol: Protocol, side: int | None) -> np.ndarray:
    """Measured stretches half-way and at the end, (2, 2); a free side has those that it had there.

    It shortens, so that its largest stretch is that of the start.
    """
    states = 1.0 + np.array(PATH_FRACTIONS)[:, None] * (protocol.stretch.max(axis=0) - 1.0)
    if side is not None:
        along, across = protocol.stretch[:, 1 - side], protocol.stretch[:, side]
        order = np.argsort(along)
        states[:, side] = np.interp(states[:, 1 - side], along[order], across[order])
    return states


def _row(
    name: str,
    unit: str,
    stretches: tuple[float, float],
    values: np.ndarray,
    sd: np.ndarray | float = 0.0,
) -> dict[str, object]:
    """A row of the table, of values of the draws with the sd of the tissue about each."""
    values = np.nan_to_num(values, nan=np.inf)[:, None]  # what overflows is large
    spread = np.broadcast_to(np.reshape(sd, (-1, 1)), values.shape)
    if np.any(spread):
        finite = np.isfinite(values[:, 0])
        values, spread = values[finite], spread[finite]
    low, median, high = percentiles(values, spread, list(QUANTILES.values()))[:, 0]
    head = {"quantity": name, "unit": unit, "stretch_x": stretches[0], "stretch_y": stretches[1]}
    return head | {
        "median": float(median),
        "low": float(low),
        "high": float(high),
        "relative_width": float((high - low) / max(abs(median), 1e-300)),
    }


def _total_rows(
    posterior: Posterior,
    draws: pd.DataFrame,
    states: list[tuple[float, float]],
    axes: Sequence[int],
    ending: str = "",
) -> Iterator[dict[str, object]]:
    """Stresses of the tissue, stiffnesses and energy of the law at total stretches."""
    few = thin_draws(draws, STRESS_DRAWS)
    tissue, all_draws = Tissue(posterior, few), posterior.law.material(draws)
    material = posterior.law.material(few)
    lm = np.mean([protocol_mounting(few, p) for p in posterior.specimen.protocols], axis=0)
    section = posterior.forward.unloaded_section(few, lm[:, None])
    for state in states:
        # one state at a time: each may lie on the path of another protocol
        measured = np.array([state]) / np.median(lm, axis=0)
        misfit, sd, _ = tissue.nominal_misfit(measured, section)
        at = [np.array([v]) for v in state]
        stresses = material.cauchy(*at)
        for axis in axes:
            # s_k = l_k P_k
            stress, scale = stresses[axis], state[axis]
            values = stress[:, 0] + scale * misfit[:, 0, axis]
            name, spread = f"Cauchy stress {'xy'[axis]}{ending}", scale * sd[:, 0, axis]
            yield _row(name, "kPa", state, values, spread)
        tangent = all_draws.cauchy_by_log_stretch(*at)
        for name, j, k in TANGENTS:
            yield _row(f"tangent stiffness {name}{ending}", "kPa", state, tangent[j, k, :, 0])
        yield _row(f"{RATIO}{ending}", "", state, _ratio(tangent)[:, 0])
        yield _row(f"strain energy{ending}", "kPa", state, all_draws.strain_energy(*at)[:, 0])


TANGENTS = (("xx", 0, 0), ("yy", 1, 1), ("xy", 0, 1))
RATIO = "stiffness ratio xx/yy"


def _ratio(tangent: np.ndarray) -> np.ndarray:
    """Tangent stiffness in x over that in y."""
    with np.errstate(divide="ignore"):
        return np.asarray(tangent[0, 0] / tangent[1, 1])


def _measured_rows(
    posterior: Posterior, specimen: Specimen, draws: pd.DataFrame
) -> Iterator[dict[str, object]]:
    """Nominal stresses and stiffnesses half-way and at the end of each protocol, from mounting."""
    if not mounting_labels(draws, specimen):
        return
    tissue, material = Tissue(posterior, draws), posterior.law.material(draws)
    for i, protocol in enumerate(specimen.protocols):
        ending = AT_MEASURED_STRETCH
        if len(specimen.protocols) > 1:
            ending += f" of {protocol.name}"
        states = np.round(_half_way_and_end(protocol, specimen.experiment.free_side), 4)
        lm = protocol_mounting(draws, protocol)
        # P = f / A0
        section = posterior.forward.unloaded_section(draws, lm[:, None])
        rows = [int(np.argmin(np.linalg.norm(protocol.stretch - s, axis=1))) for s in states]
        loads = tissue.tested(i, protocol.stretch, np.array(rows))
        # the misfit of the nearest row: it is smooth
        misfit = loads.mean - loads.law
        nominal = (tissue.law(states, protocol.name) + misfit) / section
        sd = np.broadcast_to(loads.sd, nominal.shape) / section
        for j, (x, y) in enumerate(states):
            state = (float(x), float(y))
            for axis in specimen.experiment.axes:
                name, values = f"nominal stress {'xy'[axis]}{ending}", nominal[:, j, axis]
                yield _row(name, "kPa", state, values, sd[:, j, axis])
            if not specimen.experiment.is_biaxial:
                continue  # of a strip the side is free
            tangent = material.cauchy_by_log_stretch(x * lm[:, :1], y * lm[:, 1:])
            for name, k, m in TANGENTS[:2]:
                yield _row(f"tangent stiffness {name}{ending}", "kPa", state, tangent[k, m, :, 0])
            yield _row(f"{RATIO}{ending}", "", state, _ratio(tangent)[:, 0])
