"""Refusal of readings that no soft tissue shows, as their unit is probably wrong."""

from __future__ import annotations

import numpy as np

from biaxbayes.errors import ReadingError
from biaxbayes.mechanics.mounting import N_PER_KPA_MM2
from biaxbayes.specimens.protocol import LOAD_ROWS, REST_REMEDY
from biaxbayes.specimens.specimen import Specimen

STRESS_LIMIT_KPA = 5_000.0  # soft tissue tears below it (``stress_limit_kPa`` overrides)
STRESS_FLOOR_KPA = 1e-6
FINER = {"N": "mN", "kPa": "Pa"}
OUTLIER = 1e4  # multiple of the limit beyond which the unit is not the reason
SMALL_SECTION_MM2 = 0.1  # an edge of 2 mm times a thickness of 0.05 mm, the smallest usual ones
NEGATIVE = 0.3
"""Compression at the largest stretch over the largest load, beyond which signs are wrong."""
STRIPS = (
    "no load was recorded in this direction. A uniaxial strip is stated by 'test: strip x' (or y); "
    "strips of one tissue are a file each, sampled together"
)


def check_readings(specimen: Specimen) -> None:
    """Refuse stretches that never change, impossible loads, and noise above every load."""
    protocols, axes = specimen.protocols, specimen.experiment.axes
    # without a mounted state one direction may be held, as a tube at one length
    for key in (f"stretch_{'xy'[k]}" for k in axes if specimen.experiment.is_mounted):
        k = "xy".index(key[-1])
        # protocols may hold it at levels of a common reference
        if np.ptp(np.concatenate([p.known_stretch[:, k] for p in protocols])) == 0.0:
            problem = "the stretch never changes"
            name = protocols[0].name
            remedy = "at least one protocol has to stretch this direction"
            raise ReadingError(problem, argument=key, index=0, protocol=name, remedy=remedy)
    for p in protocols:
        name = p.name
        if not np.ptp(p.stretch[:, axes], axis=0).any():
            problem = f"the stretch never changes in protocol {name[:40]!r}"
            remedy = "nothing was tested; remove it"
            raise ReadingError(problem, argument="stretch_x", index=0, protocol=name, remedy=remedy)
        if p.rest_rows == p.rows:
            problem = f"rest_rows of {p.rows} leaves no stretched row in protocol {name[:40]!r}"
            raise ReadingError(problem, argument="rest_rows", protocol=name, remedy=REST_REMEDY)
    for k in axes:
        _check_loads(specimen, k)
    noise, unit = specimen.load_noise, specimen.unit
    of_unit = specimen.same_unit(0)
    peak = max(float(np.abs(p.recorded_load[:, of_unit]).max()) for p in protocols)
    if noise is not None and noise > peak:
        problem = f"load_noise_{unit} of {noise:g} exceeds every load of the record (at most "
        remedy = f"give the standard deviation of one reading in {unit}"
        raise ReadingError(f"{problem}{peak:.4g})", argument="load_noise", remedy=remedy)


def _check_loads(specimen: Specimen, k: int) -> None:
    """Refuse loads of a direction that are all equal, or mean an impossible stress."""
    key, unit = LOAD_ROWS[k], specimen.units[k]
    # A protocol may carry no load in one direction, a specimen not.
    p = max(specimen.protocols, key=lambda p: float(np.abs(getattr(p, key)).max()))
    load = getattr(p, key)
    if np.ptp(np.concatenate([getattr(p, key) for p in specimen.protocols])) == 0.0:
        problem = f"every value is {load[0]:g}" if load[0] else "every value is zero"
        raise ReadingError(problem, argument=key, index=0, protocol=p.name, remedy=STRIPS)
    if np.ptp(load) == 0.0:
        return
    row = int(np.argmax(np.abs(load)))
    peak = abs(float(load[row]))
    section_mm2 = float(specimen.area[k]) / N_PER_KPA_MM2
    of_wall = specimen.experiment.stresses(p.stretch, specimen.load(p))
    stress = peak / float(specimen.area[k])
    if of_wall is not None and of_wall[:, k].any():
        stress = float(np.abs(of_wall[:, k]).max())
    limit = float(specimen.metadata.get("stress_limit_kPa", STRESS_LIMIT_KPA))
    problem = remedy = ""
    if stress < STRESS_FLOOR_KPA:
        problem = f"the largest value, {load[row]:g}, means a stress of {stress:.3g} kPa"
        remedy = "check the unit"
    elif stress > limit:
        problem = (
            f"{load[row]:g} means a stress of {stress / 1000:.3g} MPa, more than soft tissue bears"
        )
        remedy = f"if the values are in {FINER[unit]}, divide them by 1000; if they are right, "
        remedy += f"state 'stress_limit_kPa: {1.5 * stress:.2g}'"
        if specimen.unit == "N" and section_mm2 < SMALL_SECTION_MM2:
            remedy = f"the section under it is {section_mm2:.2g} mm^2: if edges or thickness are "
            remedy += "in metres, multiply them by 1000"
        elif stress > OUTLIER * limit:
            remedy = "correct the value or remove the row"
    if problem:
        raise ReadingError(problem, argument=key, index=row, protocol=p.name, remedy=remedy)
