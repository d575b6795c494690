"""Whether numbers can be what their column or key says, and whether they are usual.

What no soft tissue and no machine shows is refused; what may be right but looks like another unit
becomes a finding. All ranges stand here.
"""

from __future__ import annotations

import numpy as np

from biaxbayes.specimens.findings import Finding
from biaxbayes.specimens.protocol import LOAD_ROWS, ReadingError
from biaxbayes.specimens.specimen import STRESS_PAIRS, Specimen

# --- ranges --------------------------------------------------------------------------------------


STRESS_LIMIT_KPA = 5_000.0
"""Soft tissue tears below; beyond, the unit is wrong (``stress_limit_kPa`` overrides)."""
STRESS_FLOOR_KPA = 1e-6
OUTLIER = 1e4
"""So many times the limit is no question of units."""
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


def check_readings(specimen: Specimen) -> None:
    """Refuse a specimen whose numbers cannot be what they stand for.

    Protocols have checked what each number may be; here are stretches that never change, loads
    that no soft tissue bears, and a noise beyond every load.

    Raises
    ------
    ReadingError
    """
    protocols = specimen.protocols
    for key in ("stretch_x", "stretch_y"):
        if all(np.ptp(getattr(p, key)) == 0.0 for p in protocols):
            raise ReadingError(
                "the stretch never changes",
                argument=key,
                index=0,
                protocol=protocols[0].name,
                remedy="at least one protocol has to stretch this direction",
            )
    for p in protocols:
        if np.ptp(p.stretch_x) == 0.0 and np.ptp(p.stretch_y) == 0.0:
            raise ReadingError(
                f"the stretch never changes in protocol {p.name[:40]!r}",
                argument="stretch_x",
                index=0,
                protocol=p.name,
                remedy="nothing was tested; remove it",
            )
        if p.rest_rows == p.rows:
            raise ReadingError(
                f"rest_rows of {p.rest_rows} leaves no stretched row in protocol {p.name[:40]!r}",
                argument="rest_rows",
                protocol=p.name,
                remedy="rest_rows counts the leading rows recorded before the test starts",
            )
    sections = (None, None) if specimen.stress_pair != "force" else 1e3 * specimen.area
    limit = specimen.metadata.get("stress_limit_kPa")
    for key, section in zip(LOAD_ROWS, sections, strict=True):
        loads = [getattr(p, key) for p in protocols]
        # A protocol may carry no load in one direction, a specimen not.
        largest = max(range(len(loads)), key=lambda i: float(np.abs(loads[i]).max()))
        if np.ptp(np.concatenate(loads)) > 0.0 and np.ptp(loads[largest]) == 0.0:
            continue
        check_load(
            loads[largest],
            None if section is None else float(section),
            None if limit is None else float(limit),
            argument=key,
            protocol=protocols[largest].name,
        )
    noise, peak = (
        specimen.load_noise,
        max(float(np.abs([p.load_x, p.load_y]).max()) for p in protocols),
    )
    if noise is not None and noise > peak:
        raise ReadingError(
            f"load_noise_{specimen.unit} of {noise:g} exceeds every load of the record (at most "
            f"{peak:.4g})",
            argument="load_noise",
            remedy=f"give the standard deviation of one reading in {specimen.unit}",
        )


def check_load(
    values: np.ndarray,
    section_mm2: float | None,
    limit_kPa: float | None = None,
    *,
    argument: str,
    protocol: str | None = None,
) -> None:
    """Refuse loads without a load, or that no soft tissue bears.

    Parameters
    ----------
    values : ndarray, shape (n,)
        N where ``section_mm2`` is given, else kPa.
    section_mm2 : float or None
    limit_kPa : float, optional
        Another limit than :data:`STRESS_LIMIT_KPA`, as the file's header states it.
    argument, protocol : str
        For the message.

    Raises
    ------
    ReadingError
    """
    row = int(np.argmax(np.abs(values)))
    peak = abs(float(values[row]))
    if np.all(values == values[0]):
        raise ReadingError(
            "every value is zero" if peak == 0.0 else f"every value is {values[0]:g}",
            argument=argument,
            protocol=protocol,
            index=0,
            remedy=STRIPS,
        )
    # kPa = N / mm^2 * 1e3
    stress = peak if section_mm2 is None else peak / section_mm2 * 1e3
    limit = limit_kPa or STRESS_LIMIT_KPA
    if stress > limit:
        raise ReadingError(
            f"{values[row]:g} means a stress of {stress / 1000:.3g} MPa, "
            "more than soft tissue bears",
            argument=argument,
            protocol=protocol,
            index=row,
            remedy=_remedy(stress, limit, section_mm2),
        )
    if stress < STRESS_FLOOR_KPA:
        raise ReadingError(
            f"the largest value, {values[row]:g}, means a stress of {stress:.3g} kPa",
            argument=argument,
            protocol=protocol,
            index=row,
            remedy="check the unit",
        )


STRIPS = (
    "no load was recorded in this direction. Uniaxial strips are not taken: the model needs a "
    "planar biaxial test, with stretches and loads in both directions. A pair of strips, along x "
    "and y, is one file of two protocols where the transverse stretches were measured, with 0 for "
    "the transverse loads (sample it with --mounting-stretch per-protocol)"
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


# --- what is noticed -----------------------------------------------------------------------------


def unit_findings(specimen: Specimen) -> list[Finding]:
    """Findings about magnitudes."""
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
    findings = []
    peaks = np.abs(load).max(axis=0) / specimen.area
    peak = float(peaks.max())
    low, high = USUAL_PEAK_KPA
    factor = "mN" if specimen.stress_pair == "force" else "Pa"
    if peak > high:
        findings.append(
            _warn(
                f"the largest stress is {peak / 1000:.3g} MPa, much for soft tissue: "
                f"is the file in {factor}?"
            )
        )
    elif peak < low:
        findings.append(
            _warn(
                f"the largest stress is {peak:.2g} kPa, little for a biaxial test: is the file in "
                f"{'kN or gf' if specimen.stress_pair == 'force' else 'MPa'}?"
            )
        )
    if peaks.min() > 0.0 and peaks.max() / peaks.min() > 100.0:
        findings.append(
            _warn(
                f"the largest stresses in x and y are {peaks[0]:.3g} and {peaks[1]:.3g} kPa: "
                "are both columns in the same unit?"
            )
        )
    return findings


def _sign(specimen: Specimen) -> list[Finding]:
    """Tension must be positive: the load at the largest stretch of each direction."""
    findings = []
    limit = -NEGATIVE * specimen.peak_load
    names = STRESS_PAIRS[specimen.stress_pair]
    for k, axis in enumerate("xy"):
        ends = []
        for p in specimen.protocols:
            stretch = p.stretch_x if k == 0 else p.stretch_y
            row = int(np.argmax(stretch))
            ends.append((float(stretch[row]), float(specimen.load(p)[row, k])))
        stretch_there, load_there = max(ends)
        if load_there < -3.0 * specimen.noise_sd:
            findings.append(
                Finding(
                    "sign",
                    "error" if load_there < limit else "warning",
                    f"the load in {axis} is {load_there:.3g} {specimen.unit} at its largest "
                    f"stretch of {stretch_there:.3f}: tension must be positive. If the load cell "
                    f"counts tension negative, multiply the column {names[k]} by -1",
                )
            )
    return findings


def _stretch(specimen: Specimen) -> list[Finding]:
    top = np.array(
        [[p.stretch_x.max(), p.stretch_y.max()] for p in specimen.protocols], dtype=float
    ).max(axis=0)
    low, high = USUAL_STRETCH
    findings = []
    if top.max() < low:
        findings.append(
            _warn(f"the largest stretch is {top.max():.4f}: is the column a stretch, not a strain?")
        )
    if top.max() > high:
        findings.append(_warn(f"the largest stretch is {top.max():.3g}, much for soft tissue"))
    return findings


def _dimensions(specimen: Specimen) -> list[Finding]:
    findings = []
    for key in ("edge_x_mm", "edge_y_mm"):
        value = getattr(specimen, key)
        if value is not None and not USUAL_EDGE_MM[0] <= value <= USUAL_EDGE_MM[1]:
            findings.append(_warn(f"{key} of {value:g} is unusual: is it in mm?"))
    thickness = specimen.thickness_mm
    if thickness is None:
        return findings
    if not USUAL_THICKNESS_MM[0] <= thickness <= USUAL_THICKNESS_MM[1]:
        findings.append(_warn(f"thickness_mm of {thickness:g} is unusual: is it in mm?"))
    edges = [e for e in (specimen.edge_x_mm, specimen.edge_y_mm) if e is not None]
    if edges and thickness > 0.5 * min(edges):
        findings.append(
            _warn(
                f"the specimen is {thickness:g} mm thick and only {min(edges):g} mm wide: "
                "a membrane model does not hold"
            )
        )
    return findings


def _noise(specimen: Specimen) -> list[Finding]:
    stated, seen = specimen.load_noise, specimen.high_frequency_scatter()
    peak, unit = specimen.peak_load, specimen.unit
    findings = []
    if specimen.noise_sd > LARGE_NOISE * peak:
        findings.append(
            _warn(
                f"the load noise of {specimen.noise_sd:.2g} {unit} is "
                f"{100 * specimen.noise_sd / peak:.0f} % of the largest load"
            )
        )
    if stated is not None and seen > 0.0 and not 0.2 < seen / stated < 5.0:
        findings.append(
            Finding(
                "noise-differs",
                "warning",
                f"the header states a load noise of {stated:.2g} {unit}; neighbouring rows "
                f"scatter by {seen:.2g} {unit}"
                + (": the record was smoothed or averaged" if seen < stated else ""),
            )
        )
    if specimen.noise_sd == 0.0:
        findings.append(
            Finding(
                "no-noise",
                "warning",
                "the file states no load noise and its rows show none (a resampled or virtual "
                f"record): state load_noise_{unit}, or the mounting force can only be taken as "
                "exact",
            )
        )
    return findings
