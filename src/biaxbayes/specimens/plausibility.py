"""Refusal of readings that no soft tissue shows, as their unit is probably wrong."""

from __future__ import annotations

from functools import partial

import numpy as np

from biaxbayes.mechanics.experiments import N_PER_KPA_MM2
from biaxbayes.specimens.protocol import LOAD_ROWS, ReadingError
from biaxbayes.specimens.specimen import Specimen

STRESS_LIMIT_KPA = 5_000.0
"""Soft tissue tears below this stress (``stress_limit_kPa`` overrides)."""
STRESS_FLOOR_KPA = 1e-6
FINER = {"N": "mN", "kPa": "Pa"}
OUTLIER = 1e4
"""Multiple of the limit beyond which the unit is not the reason."""
SMALL_SECTION_MM2 = 0.1
"""An edge of 2 mm times a thickness of 0.05 mm, the smallest usual ones."""
NEGATIVE = 0.3
"""Compression at the largest stretch over the largest load, beyond which signs are wrong."""


STRIPS = (
    "no load was recorded in this direction. A uniaxial strip is stated by a line '# test: strip "
    "x' (or y) at the top; strips of one tissue are a file each, sampled together"
)


def check_readings(specimen: Specimen) -> None:
    """Refuse stretches that never change, impossible loads, and noise above every load."""
    protocols, axes = specimen.protocols, specimen.experiment.axes
    # a tube may be inflated at one length, or stretched at one diameter
    for key in (f"stretch_{'xy'[k]}" for k in axes if specimen.experiment.is_mounted):
        if all(np.ptp(getattr(p, key)) == 0.0 for p in protocols):
            name = protocols[0].name
            remedy = "at least one protocol has to stretch this direction"
            problem = "the stretch never changes"
            raise ReadingError(problem, argument=key, index=0, protocol=name, remedy=remedy)
    for p in protocols:
        if not np.ptp(p.stretch[:, axes], axis=0).any():
            raise ReadingError(
                f"the stretch never changes in protocol {p.name[:40]!r}",
                argument="stretch_x",
                index=0,
                protocol=p.name,
                remedy="nothing was tested; remove it",
            )
        if p.rest_rows == p.rows:
            problem = f"rest_rows of {p.rest_rows} leaves no stretched row in protocol "
            raise ReadingError(
                f"{problem}{p.name[:40]!r}",
                argument="rest_rows",
                protocol=p.name,
                remedy="rest_rows counts the leading rows recorded before the test starts",
            )
    forces, limit = specimen.stress_pair == "force", specimen.metadata.get("stress_limit_kPa")
    for k in axes:
        key, unit = LOAD_ROWS[k], specimen.units[k]
        loads = [getattr(p, key) for p in protocols]
        # A protocol may carry no load in one direction, a specimen not.
        largest = max(range(len(loads)), key=lambda i: float(np.abs(loads[i]).max()))
        if np.ptp(np.concatenate(loads)) > 0.0 and np.ptp(loads[largest]) == 0.0:
            continue
        section = float(specimen.area[k]) / N_PER_KPA_MM2 if forces else None
        p = protocols[largest]
        stresses = specimen.experiment.stresses(p.stretch, specimen.load(p))
        if stresses is not None and stresses[:, k].any():
            # the section under which the largest load would be the largest stress
            largest_load = float(np.abs(p.recorded_load).max(axis=0)[k])
            section = largest_load / float(np.abs(stresses[:, k]).max()) / N_PER_KPA_MM2
        check_load(
            loads[largest],
            section,
            None if limit is None else float(limit),
            unit=unit,
            argument=key,
            protocol=protocols[largest].name,
        )
    noise, unit = specimen.load_noise, specimen.unit
    of_unit = specimen.experiment.same_unit(0)
    peak = max(float(np.abs(p.recorded_load[:, of_unit]).max()) for p in protocols)
    if noise is not None and noise > peak:
        problem = f"load_noise_{unit} of {noise:g} exceeds every load of the record (at most "
        remedy = f"give the standard deviation of one reading in {unit}"
        raise ReadingError(f"{problem}{peak:.4g})", argument="load_noise", remedy=remedy)


def check_load(
    values: np.ndarray,
    section_mm2: float | None,
    limit_kPa: float | None = None,
    *,
    argument: str,
    unit: str = "",
    protocol: str | None = None,
) -> None:
    """Refuse loads that are all equal, or impossible: N with a section, else kPa, or `unit`."""
    refusal = partial(ReadingError, argument=argument, protocol=protocol)
    unit = unit or ("kPa" if section_mm2 is None else "N")
    row = int(np.argmax(np.abs(values)))
    peak = abs(float(values[row]))
    if np.all(values == values[0]):
        problem = "every value is zero" if peak == 0.0 else f"every value is {values[0]:g}"
        raise refusal(problem, index=0, remedy=STRIPS)
    stress = peak if section_mm2 is None else peak / (section_mm2 * N_PER_KPA_MM2)
    limit = limit_kPa or STRESS_LIMIT_KPA
    if stress < STRESS_FLOOR_KPA:
        problem = f"the largest value, {values[row]:g}, means a stress of {stress:.3g} kPa"
        raise refusal(problem, index=row, remedy="check the unit")
    if stress > limit:
        problem = f"{values[row]:g} means a stress of {stress / 1000:.3g} MPa, "
        remedy = (
            f"if the values are in {FINER[unit]}, divide them by 1000; "
            f"if they are right, add a line '# stress_limit_kPa: {1.5 * stress:.2g}'"
        )
        if unit == "N" and section_mm2 is not None and section_mm2 < SMALL_SECTION_MM2:
            remedy = f"the section under it is {section_mm2:.2g} mm^2: if edges or thickness are "
            remedy += "in metres, multiply them by 1000"
        elif stress > OUTLIER * limit:
            remedy = "correct the value or remove the row"
        raise refusal(f"{problem}more than soft tissue bears", index=row, remedy=remedy)
