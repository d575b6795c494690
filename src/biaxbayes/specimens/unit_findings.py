"""Numbers that may be right but look like another unit."""

from __future__ import annotations

import numpy as np

from biaxbayes.specimens.finding import Finding
from biaxbayes.specimens.specimen import Specimen

__all__ = ["unit_findings"]

USUAL_PEAK_KPA = (1.0, 2_000.0)
USUAL_STRETCH = (1.01, 2.0)
USUAL_EDGE_MM = (2.0, 100.0)
USUAL_THICKNESS_MM = (0.05, 10.0)
LARGE_NOISE = 0.1


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
                    "warning",
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
