r"""Loads of a homogeneous test from those of a sheet on hooks, by finite elements.

    r_k = F_k / (A_k P_k(theta, l lm)),     k = x, y

with the force F of the finite-element sheet on an edge, the unloaded section A and the nominal
stress P of the material at the total stretch in the centre. r depends on the row and a little on
the material; scale and thickness cancel. The correction alternates

    f / r  ->  least-squares fit of theta and lm  ->  finite elements  ->  r

until r converges: the boundary-condition-corrected fit of Fehervary et al. (2016), with the
mounting stretch of Vander Linden et al. (2022). Stretches between opposite hooks are replaced by
those in the centre.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.interpolate import PchipInterpolator

from biaxbayes.errors import BiaxbayesError, InputError, NotConverged
from biaxbayes.fem.sheet import Sheet
from biaxbayes.fem.sheet_tester import SheetTester
from biaxbayes.fitting.fit_result import FitResult
from biaxbayes.forward import ForwardModel
from biaxbayes.grips.hooks import describe_hooks, edges_mm, stated_hooks
from biaxbayes.laws.goh import GOH
from biaxbayes.mechanics.mounting import newtons_per_kPa
from biaxbayes.specimens.check import Finding
from biaxbayes.specimens.protocol import CURVES, Protocol
from biaxbayes.specimens.specimen import Specimen

ELEMENTS, COARSE_ELEMENTS = 32, 16  # along an edge
STATES_PER_PROTOCOL = 24  # of finite elements, between which r is interpolated along the path
RATIO_TOLERANCE = 1e-4  # largest change of ln r between two rounds
MAX_ITERATIONS = 25
LEAVE_OUT = "leave out the line 'grips'"
MIN_LOAD_FRACTION = 0.03  # of the larger load; below it a direction takes the r of its nearest row
SPREAD_DRAWS = 16  # draws of the posterior at which r is computed to see how far it varies


class RowRatios(NamedTuple):
    """Ratios by row of a protocol, (rows, 2)."""

    force: np.ndarray  # load of the gripped sheet over that of a homogeneous test
    stretch: np.ndarray  # in the centre over measured, from the mounted state; one by markers


@dataclass(frozen=True, eq=False)
class GripCorrection:
    """A specimen corrected for its grips."""

    measured: Specimen  # as in the file
    # loads (and stretches) of a homogeneous test; its header has ``grip_correction: applied``
    specimen: Specimen
    ratios: tuple[RowRatios, ...]  # of each protocol
    uncorrected: FitResult  # to the loads as measured
    coarse_fit: FitResult  # with r on 16 elements per edge
    fit: FitResult
    rounds: int  # of fit and finite elements
    # largest change of ln r on 16 instead of 32 elements: about ten times the error of the latter
    mesh_difference: float
    seconds: float

    @property
    def range(self) -> np.ndarray:
        """Smallest and largest force ratio in x and y, shape (2, 2)."""
        force = np.concatenate([r.force for r in self.ratios])
        return np.stack([force.min(axis=0), force.max(axis=0)], axis=1)

    @property
    def sentence(self) -> str:
        """One sentence."""
        (low_x, high_x), (low_y, high_y) = self.range
        return (
            f"loads were divided by {low_x:.3f} to {high_x:.3f} in x and {low_y:.3f} to "
            f"{high_y:.3f} in y to correct for {describe_hooks(self.measured)}"
        )

    def table(self, sd_log_ratio: np.ndarray) -> pd.DataFrame:
        """The ratios, one line per row of the specimen, with the result of :meth:`sd_log_ratio`."""
        protocols = self.specimen.protocols
        columns = {"protocol": np.repeat([p.name for p in protocols], [p.rows for p in protocols])}
        for name, values in (
            ("stretch", np.concatenate([p.stretch for p in protocols])),
            ("force_ratio", np.concatenate([r.force for r in self.ratios])),
            ("stretch_ratio", np.concatenate([r.stretch for r in self.ratios])),
            ("sd_log_force_ratio", sd_log_ratio),
        ):
            columns |= {f"{name}_{axis}": values[:, k] for k, axis in enumerate("xy")}
        return pd.DataFrame(columns)

    def sd_log_ratio(self, draws: Mapping[str, np.ndarray], forward: ForwardModel) -> np.ndarray:
        """Sd of ln r over draws of the posterior, (rows, 2); NaN of fewer than two equilibria."""
        columns = {name: np.ravel(values) for name, values in draws.items()}
        size = columns["C1"].size
        logs = []
        for i in np.unique(np.linspace(0, size - 1, SPREAD_DRAWS).astype(int)):
            values = {name: float(column[i]) for name, column in columns.items()}
            C1, k1, k2, alpha, kappa = (values[p.name] for p in forward.law.parameters)
            material = GOH(C1, k1, k2, alpha, kappa, forward.law.fibre_switch)
            protocols = self.measured.protocols
            mounting = [forward.mounting_stretch(values, p.name)[0, 0] for p in protocols]
            try:
                ratios = grip_ratios(self.measured, material, mounting, COARSE_ELEMENTS)
            except BiaxbayesError:
                continue
            logs.append(np.log(np.concatenate([r.force for r in ratios])))
        if len(logs) < 2:
            return np.full((sum(p.rows for p in self.measured.protocols), 2), np.nan)
        return np.asarray(np.std(logs, axis=0, ddof=1))


def correct_for_grips(
    specimen: Specimen, fitted: Callable[[Specimen], FitResult]
) -> GripCorrection:
    """Correct a specimen for the grips that its file states, by least-squares fits of it."""
    start = time.perf_counter()
    stated_hooks(specimen)
    corrected = mark_grip_corrected(specimen)
    previous = first = coarse_fit = None
    elements = COARSE_ELEMENTS  # until r has converged on the coarse mesh
    for rounds in range(1, MAX_ITERATIONS + 1):
        fit = fitted(corrected)
        first = first or fit
        refuse_other_law(fit.material.law.name, specimen.name)
        mounting = list(np.broadcast_to(fit.mounting_stretch, (len(specimen.protocols), 2)))
        ratios = grip_ratios(specimen, fit.material, mounting, elements)
        change = np.inf if previous is None else np.abs(_logs(ratios) - previous).max()
        converged = change < RATIO_TOLERANCE
        if converged and coarse_fit is not None:
            corrected = _apply_ratios(specimen, ratios)
            coarse = _logs(grip_ratios(specimen, fit.material, mounting, COARSE_ELEMENTS))
            mesh = float(np.abs(coarse - _logs(ratios)).max())
            seconds = time.perf_counter() - start
            fits = (first, coarse_fit, fit)
            found = GripCorrection(specimen, corrected, ratios, *fits, rounds, mesh, seconds)
            noted = replace(corrected, notes=(*corrected.notes, found.sentence))
            return replace(found, specimen=noted)
        if converged:
            coarse_fit, elements = fit, ELEMENTS
            ratios = grip_ratios(specimen, fit.material, mounting, elements)
        corrected = _apply_ratios(specimen, ratios)
        previous = _logs(ratios)
    problem = f"the correction for grips has not converged in {MAX_ITERATIONS} rounds"
    raise NotConverged(f"{problem}; check the grip keys, or {LEAVE_OUT}")


def mark_grip_corrected(specimen: Specimen) -> Specimen:
    """The specimen with loads as they are, marked as corrected: others have no posterior."""
    if not specimen.needs_grip_correction:
        return specimen
    return replace(specimen, metadata={**specimen.metadata, "grip_correction": "applied"})


def refuse_other_law(law: str, file: object) -> None:
    """Refuse a law that the finite-element sheet does not have."""
    if law != "goh":
        problem = f"the correction for grips does not know the law {law}"
        remedy = f"choose the law goh, or {LEAVE_OUT}"
        raise InputError(problem, file=file, remedy=remedy)


def grip_ratios(
    specimen: Specimen, material: GOH, mounting: list[np.ndarray], elements: int
) -> tuple[RowRatios, ...]:
    """Ratios of each protocol for a material and its mounting stretches; may be NotConverged."""
    edges = edges_mm(specimen)
    if specimen.geometry == "mounted":
        edges = edges / np.mean(mounting, axis=0)
    sheet = Sheet(*edges, elements=elements)
    grips = stated_hooks(specimen, edges).on(sheet)
    control = str(specimen.metadata.get("stretch_from", "markers"))
    mounter = SheetTester(material, sheet, grips)
    tester = SheetTester(material, sheet, grips, control=control)
    area = newtons_per_kPa(edges[0], edges[1], thickness_mm=1.0)
    pairs = zip(specimen.protocols, mounting, strict=True)
    try:
        return tuple(_protocol_ratios(mounter, tester, area, p, lm) for p, lm in pairs)
    except NotConverged as error:
        problem = f"correction for grips at {material!r}: {error}"
        raise NotConverged(f"{problem}; check the grip keys, or {LEAVE_OUT}") from None


def _protocol_ratios(
    mounter: SheetTester, tester: SheetTester, area: np.ndarray, p: Protocol, lm: np.ndarray
) -> RowRatios:
    """Finite elements at some rows of a protocol, interpolated along its path."""
    path = np.vstack([np.ones(2), p.stretch])
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    targets = np.linspace(0.0, arc[-1], STATES_PER_PROTOCOL + 1)
    chosen = np.unique(np.searchsorted(arc, targets * (1.0 - 1e-12)))
    states = [mounter.mount((lm[0], lm[1]), increments=2)]
    origin = tester.controlled_stretch(states[0])
    for row in chosen[1:]:
        reached = tester.controlled_stretch(states[-1])
        states.append(tester.walk(states[-1], reached, origin * path[row], 1)[-1])
    total = np.array([tester.stretch(s) for s in states])
    force = np.array([tester.force_N(s) for s in states])
    # r = F / (A P)
    homogeneous = area * np.column_stack(tester.material.piola(*total.T))
    ratio = force / np.where(homogeneous == 0.0, np.nan, homogeneous)
    larger = np.abs(homogeneous).max(axis=1)[:, None]
    usable = (ratio > 0.0) & (np.abs(homogeneous) > MIN_LOAD_FRACTION * larger)
    if not usable.any(axis=0).all():
        raise NotConverged(f"protocol {p.name} has no load in one direction")
    centre = total / total[0] / path[chosen]
    columns = []
    for use, values in zip(usable.T, ratio.T, strict=True):
        at = arc[chosen][use]
        # monotone cubics; the nearest ratio outside the usable states
        columns.append(
            PchipInterpolator(at, values[use])(np.clip(arc[1:], at[0], at[-1]))
            if at.size > 1
            else np.broadcast_to(values[use], arc[1:].shape)
        )
    stretch = PchipInterpolator(arc[chosen], centre)(arc[1:])
    return RowRatios(np.column_stack(columns), stretch)


def _apply_ratios(specimen: Specimen, ratios: tuple[RowRatios, ...]) -> Specimen:
    """The specimen with its loads divided by r, as a homogeneous test would have recorded them."""
    protocols = []
    for p, r in zip(specimen.protocols, ratios, strict=True):
        stretch = p.stretch * r.stretch
        load = p.recorded_load / r.force * specimen.per_nominal(r.stretch)
        protocols.append(replace(p, **dict(zip(CURVES, (*stretch.T, *load.T), strict=True))))
    # single numbers, so divided by the mean ratio
    mean = float(np.mean(np.concatenate([r.force for r in ratios])))
    noise = None if specimen.load_noise is None else specimen.load_noise / mean
    metadata: dict[str, Any] = dict(mark_grip_corrected(specimen).metadata)
    for key in ("load_offset_sd_N", "load_offset_sd_kPa"):
        if key in metadata:
            metadata[key] = float(metadata[key]) / mean
    return replace(specimen, protocols=tuple(protocols), load_noise=noise, metadata=metadata)


def _logs(ratios: tuple[RowRatios, ...]) -> np.ndarray:
    """Logarithms of all ratios."""
    return np.log(np.concatenate([np.hstack([r.force, r.stretch]) for r in ratios]))


# --- warnings, and the record of a run -----------------------------------------------------------

MAX_QUIET_SD, MAX_QUIET_MESH_DIFFERENCE = 0.01, 0.005
"""Sd of ln r over the posterior, and difference between meshes, above which a warning is given."""


def grip_record(
    correction: GripCorrection, ratios: pd.DataFrame
) -> tuple[dict[str, Any], list[Finding]]:
    """The correction in the provenance of a run, and warnings where it is less certain than loads.

    ``ratios`` as of :meth:`GripCorrection.table`.
    """
    sd = float(ratios.filter(like="sd_log_force_ratio").to_numpy().max())
    mesh = correction.mesh_difference
    messages = []
    if not sd <= MAX_QUIET_SD:
        varies = f"varies by {100 * sd:.2g} % (sd)" if sd > 0.0 else "is not known"
        messages.append(
            f"the correction for the grips {varies} over the posterior, which the intervals "
            "leave out: fix a parameter that is known, or test another stretch ratio"
        )
    if mesh > MAX_QUIET_MESH_DIFFERENCE:
        messages.append(
            f"the correction for the grips differs by {100 * mesh:.2g} % between two meshes: check "
            "grip_width_mm and grip_inset_mm"
        )
    record = {
        "in_words": correction.sentence,
        "force_ratio_x": correction.range[0].tolist(),
        "force_ratio_y": correction.range[1].tolist(),
        "rounds": correction.rounds,
        "mesh_difference": mesh,
        "largest_sd_of_log_ratio": sd if np.isfinite(sd) else None,
        "seconds": round(correction.seconds, 3),
        "fit_as_measured": correction.uncorrected.record(),
        "fit_on_coarser_mesh": correction.coarse_fit.record(),
        "fit_corrected": correction.fit.record(),
    }
    return record, [Finding("grips", "warning", message) for message in messages]
