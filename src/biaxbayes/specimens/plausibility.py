"""Whether numbers can be what their column or key says, and whether they are usual.

What no soft tissue and no machine shows is refused; what may be right but looks like another unit
becomes a finding. All ranges stand here.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.specimens.findings import Finding
from biaxbayes.specimens.specimen import Specimen

__all__ = [
    "NUMBER_RANGES",
    "STRESS_LIMIT_KPA",
    "STRETCH_RANGE",
    "STRETCH_REMEDY",
    "check_load",
    "check_stretch",
    "check_time",
    "unit_findings",
]


# --- ranges --------------------------------------------------------------------------------------


STRETCH_RANGE = (0.2, 5.0)
STRESS_LIMIT_KPA = 5_000.0
"""Soft tissue tears below; beyond, the unit is wrong (``stress_limit_kPa`` overrides)."""
STRESS_FLOOR_KPA = 1e-6
OUTLIER = 1e4
"""So many times the limit is no question of units."""
TIME_LIMIT_S = 1e9
NUMBER_RANGES = {
    "edge_x_mm": (0.01, 10_000.0),
    "edge_y_mm": (0.01, 10_000.0),
    "thickness_mm": (1e-4, 1_000.0),
    "load_noise_N": (1e-15, 1e9),
    "load_noise_kPa": (1e-15, 1e9),
    "edge_sd_mm": (1e-9, 1_000.0),
    "thickness_sd_mm": (1e-9, 1_000.0),
    "load_offset_sd_N": (1e-15, 1e9),
    "load_offset_sd_kPa": (1e-15, 1e9),
    "stress_limit_kPa": (1.0, 1e9),
    "largest_shear": (0.0, 10.0),
    "largest_shear_angle_deg": (0.0, 90.0),
}
"""Numbers of a header, and the range outside of which the unit or the value must be wrong."""
USUAL_PEAK_KPA = (1.0, 2_000.0)
USUAL_STRETCH = (1.01, 2.0)
USUAL_EDGE_MM = (2.0, 100.0)
USUAL_THICKNESS_MM = (0.05, 10.0)
SMALL_SECTION_MM2 = 0.1
"""An edge of 2 mm times a thickness of 0.05 mm, both the least usual ones."""
LARGE_NOISE = 0.1
NEGATIVE = 0.3
"""Compression beyond this share of the largest load, where the stretch is largest, is no test."""


# --- what is refused -----------------------------------------------------------------------------


STRETCH_REMEDY = "stretches are ratios near 1, not strains or per cent"


def check_stretch(
    values: np.ndarray, lines: Sequence[int] | np.ndarray, column: str, file: object
) -> None:
    """Refuse stretches that are strains, per cent, or nonsense.

    Parameters
    ----------
    values : ndarray, shape (n,)
    lines : sequence of int
        Line of the file that each value stands in.
    column : str
    file : object
        For the message.
    """
    bad = np.flatnonzero((values < STRETCH_RANGE[0]) | (values > STRETCH_RANGE[1]))
    if not bad.size:
        return
    value = values[bad[0]]
    if value < 0.0 and np.median(values) > STRETCH_RANGE[0]:
        remedy = "a stretch is positive; mend the value or remove the row"
    else:
        remedy = STRETCH_REMEDY
    raise InputError(
        f"a stretch of {value:g} cannot be",
        file=file,
        row=int(lines[bad[0]]),
        column=column,
        remedy=remedy,
    )


def check_load(
    values: np.ndarray,
    lines: Sequence[int] | np.ndarray,
    column: str,
    file: object,
    *,
    section_mm2: float | None,
    limit_kPa: float | None = None,
) -> None:
    """Refuse a load column without a load, or with one that no soft tissue bears.

    Parameters
    ----------
    values : ndarray, shape (n,)
        N where ``section_mm2`` is given, else kPa.
    lines, column, file
        As in :func:`check_stretch`.
    section_mm2 : float or None
    limit_kPa : float, optional
        Another limit than :data:`STRESS_LIMIT_KPA`, as the file's header states it.
    """
    row = int(np.argmax(np.abs(values)))
    peak = abs(float(values[row]))
    if np.all(values == values[0]):
        raise InputError(
            "every value is zero" if peak == 0.0 else f"every value is {values[0]:g}",
            file=file,
            row=int(lines[0]),
            column=column,
            remedy="no load was recorded",
        )
    # kPa = N / mm^2 * 1e3
    stress = peak if section_mm2 is None else peak / section_mm2 * 1e3
    limit = limit_kPa or STRESS_LIMIT_KPA
    if stress > limit:
        raise InputError(
            f"{values[row]:g} means a stress of {stress / 1000:.3g} MPa, "
            "more than soft tissue bears",
            file=file,
            row=int(lines[row]),
            column=column,
            remedy=_remedy(stress, limit, section_mm2),
        )
    if stress < STRESS_FLOOR_KPA:
        raise InputError(
            f"the largest value, {values[row]:g}, means a stress of {stress:.3g} kPa",
            file=file,
            row=int(lines[row]),
            column=column,
            remedy="check the unit",
        )


def _remedy(stress: float, limit: float, section_mm2: float | None) -> str:
    if section_mm2 is not None and section_mm2 < SMALL_SECTION_MM2:
        return (
            f"the section under it is {section_mm2:.2g} mm^2: if edges or thickness are in metres, "
            "multiply them by 1000"
        )
    unit = "Pa" if section_mm2 is None else "mN"
    if stress > OUTLIER * limit:
        return "mend the value or remove the row"
    return (
        f"if the values are in {unit}, divide them by 1000; "
        f"if they are right, add a line '# stress_limit_kPa: {1.5 * stress:.2g}'"
    )


def check_time(
    values: np.ndarray, lines: Sequence[int] | np.ndarray, column: str, file: object
) -> None:
    """Refuse times that no record has."""
    bad = np.flatnonzero(np.abs(values) > TIME_LIMIT_S)
    if bad.size:
        raise InputError(
            f"a time of {values[bad[0]]:g} s",
            file=file,
            row=int(lines[bad[0]]),
            column=column,
            remedy="give seconds from the start of the test",
        )


# --- what is noticed -----------------------------------------------------------------------------


def unit_findings(specimen: Specimen) -> list[Finding]:
    """Findings about magnitudes.

    Parameters
    ----------
    specimen : Specimen

    Returns
    -------
    list of Finding
    """
    return [
        *_stress(specimen),
        *_sign(specimen),
        *_stretch(specimen),
        *_dimensions(specimen),
        *_noise(specimen),
    ]


def _warn(message: str) -> Finding:
    return Finding("units", "warning", message)


def _stress(specimen: Specimen) -> list[Finding]:
    load = np.concatenate([specimen.load(p) for p in specimen.protocols])
    found = []
    peaks = np.abs(load).max(axis=0) / specimen.area
    peak = float(peaks.max())
    low, high = USUAL_PEAK_KPA
    factor = "mN" if specimen.stress_pair == "force" else "Pa"
    if peak > high:
        found.append(
            _warn(
                f"the largest stress is {peak / 1000:.3g} MPa, much for soft tissue: "
                f"is the file in {factor}?"
            )
        )
    elif peak < low:
        found.append(
            _warn(
                f"the largest stress is {peak:.2g} kPa, little for a biaxial test: is the file in "
                f"{'kN or gf' if specimen.stress_pair == 'force' else 'MPa'}?"
            )
        )
    if peaks.min() > 0.0 and peaks.max() / peaks.min() > 100.0:
        found.append(
            _warn(
                f"the largest stresses in x and y are {peaks[0]:.3g} and {peaks[1]:.3g} kPa: "
                "are both columns in the same unit?"
            )
        )
    return found


def _sign(specimen: Specimen) -> list[Finding]:
    """Tension must be positive: the load at the largest stretch of each direction."""
    found = []
    limit = -NEGATIVE * specimen.peak_load
    for k, axis in enumerate("xy"):
        ends = []
        for p in specimen.protocols:
            stretch = p.stretch_x if k == 0 else p.stretch_y
            row = int(np.argmax(stretch))
            ends.append((float(stretch[row]), float(specimen.load(p)[row, k])))
        stretch_there, load_there = max(ends)
        if load_there < -3.0 * specimen.noise_sd:
            found.append(
                Finding(
                    "sign",
                    "error" if load_there < limit else "warning",
                    f"the load in {axis} is {load_there:.3g} {specimen.unit} at its largest "
                    f"stretch of {stretch_there:.3f}: tension must be positive",
                )
            )
    return found


def _stretch(specimen: Specimen) -> list[Finding]:
    top = np.array(
        [[p.stretch_x.max(), p.stretch_y.max()] for p in specimen.protocols], dtype=float
    ).max(axis=0)
    low, high = USUAL_STRETCH
    found = []
    if top.max() < low:
        found.append(
            _warn(f"the largest stretch is {top.max():.4f}: is the column a stretch, not a strain?")
        )
    if top.max() > high:
        found.append(_warn(f"the largest stretch is {top.max():.3g}, much for soft tissue"))
    return found


def _dimensions(specimen: Specimen) -> list[Finding]:
    found = []
    for key in ("edge_x_mm", "edge_y_mm"):
        value = getattr(specimen, key)
        if value is not None and not USUAL_EDGE_MM[0] <= value <= USUAL_EDGE_MM[1]:
            found.append(_warn(f"{key} of {value:g} is unusual: is it in mm?"))
    thickness = specimen.thickness_mm
    if thickness is None:
        return found
    if not USUAL_THICKNESS_MM[0] <= thickness <= USUAL_THICKNESS_MM[1]:
        found.append(_warn(f"thickness_mm of {thickness:g} is unusual: is it in mm?"))
    edges = [e for e in (specimen.edge_x_mm, specimen.edge_y_mm) if e is not None]
    if edges and thickness > 0.5 * min(edges):
        found.append(
            _warn(
                f"the specimen is {thickness:g} mm thick and only {min(edges):g} mm wide: "
                "a membrane model does not hold"
            )
        )
    return found


def _noise(specimen: Specimen) -> list[Finding]:
    stated, seen = specimen.load_noise, specimen.high_frequency_scatter()
    peak, unit = specimen.peak_load, specimen.unit
    found = []
    if specimen.noise_sd > LARGE_NOISE * peak:
        found.append(
            _warn(
                f"the load noise of {specimen.noise_sd:.2g} {unit} is "
                f"{100 * specimen.noise_sd / peak:.0f} % of the largest load"
            )
        )
    if stated is not None and seen > 0.0 and not 0.2 < seen / stated < 5.0:
        found.append(
            Finding(
                "noise-differs",
                "warning",
                f"the header states a load noise of {stated:.2g} {unit}; neighbouring rows "
                f"scatter by {seen:.2g} {unit}"
                + (": the record was smoothed or averaged" if seen < stated else ""),
            )
        )
    if specimen.noise_sd == 0.0:
        found.append(
            Finding(
                "no-noise",
                "warning",
                "the file states no load noise and its rows show none (a resampled or virtual "
                f"record): state load_noise_{unit}, or the mounting force can only be taken as "
                "exact",
            )
        )
    return found
