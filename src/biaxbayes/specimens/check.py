"""Checks of a specimen, returned as findings, and those of its curves.

Unloading, jumps, a stiff start, one direction only.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.specimens.findings import Finding, mounting_findings, serious, sorted_findings
from biaxbayes.specimens.path import SWING, progress, relapse, scatter
from biaxbayes.specimens.plausibility import check_readings, unit_findings
from biaxbayes.specimens.protocol import Protocol, rest_rows, still_rows
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.specimen_file import read_specimen

START_BINS = (0.0, 0.05, 0.1, 0.2, 0.4)
"""Shares of the load's range between which stiffnesses are compared."""
STIFF_START = 1.5
PROPORTIONAL = 0.01
JUMP = 0.05
FEW_ROWS = 8
LAG = 3.0
DISORDER = 0.15
"""Scatter about the neighbours, as a share of the range; shuffled rows have 0.25 to 0.3."""


def path_findings(specimen: Specimen) -> list[Finding]:
    """Findings about the loading paths."""
    findings = []
    for p in specimen.protocols:
        stretch = np.column_stack([p.stretch_x, p.stretch_y])
        load = specimen.load(p)
        if p.rows < FEW_ROWS:
            findings.append(
                Finding("few-rows", "warning", f"only {p.rows} rows in this protocol", p.name)
            )
        findings += _unloading(p, stretch, load) or _backwards(p, stretch, load, specimen.noise_sd)
        findings += _jumps(p, stretch, load)
        findings += _time(p)
        findings += _camera_lag(p)
    return [
        *findings,
        *_resampled(specimen),
        *_stiff_start(specimen),
        *_one_direction(specimen),
    ]


def _unloading(p: Protocol, stretch: np.ndarray, load: np.ndarray) -> list[Finding]:
    path = progress(stretch, load)
    # Loads that are mostly noise scatter as much; shuffled rows shuffle the stretches, too.
    if p.rows >= FEW_ROWS and _disordered(path) and _disordered(progress(stretch, stretch)):
        return [
            Finding(
                "shuffled",
                "error",
                f"neighbouring rows lie {100 * scatter(path) / float(np.ptp(path)):.0f} % of the "
                "whole range apart: the rows are out of order. Sort them by time",
                p.name,
            )
        ]
    back = relapse(path)
    if back is None:
        return []
    peak, _ = back
    fallen = float(path[peak] - path[peak:].min())
    return [
        Finding(
            "unloading",
            "error" if fallen >= SWING * float(np.ptp(path)) else "warning",
            f"the path turns back at row {peak + 1} of {p.rows}: unloading (or several cycles) "
            "mixed in. An elastic model has one curve; convert with --branch loading",
            p.name,
        )
    ]


def _disordered(path: np.ndarray) -> bool:
    return scatter(path) > DISORDER * float(np.ptp(path))


def _backwards(p: Protocol, stretch: np.ndarray, load: np.ndarray, noise: float) -> list[Finding]:
    """Rows in the wrong order: stretch and load both fall from the first row on."""
    change, loss = (curve[-1] - curve[0] for curve in (stretch, load))
    if not (change.sum() < 0.0 and loss.sum() < -3.0 * noise):
        return []
    return [
        Finding(
            "backwards",
            "error",
            f"stretch and load fall from row to row, to {stretch[-1, 0]:.4g} and "
            f"{stretch[-1, 1]:.4g} of the first stretches: the rows are in reverse order, or "
            "belong to unloading. The first row must be the mounted state; reverse the rows",
            p.name,
        )
    ]


def _jumps(p: Protocol, stretch: np.ndarray, load: np.ndarray) -> list[Finding]:
    """Single readings beside the curve: a wrong digit, a lost marker, a line cut off."""
    if p.rows < 12:
        return []
    findings = []
    curves = zip(("stretch", "stretch", "load", "load"), "xyxy", (*stretch.T, *load.T), strict=True)
    for kind, axis, curve in curves:
        limit = max(JUMP * float(np.ptp(curve)), 30.0 * float(np.median(np.abs(np.diff(curve, 2)))))
        left, middle, right = curve[:-2], curve[1:-1], curve[2:]
        beside = np.maximum(middle - np.maximum(left, right), np.minimum(left, right) - middle)
        row = int(np.argmax(beside)) + 1
        if beside[row - 1] <= limit:
            # The last reading has one neighbour: compare it with the way the curve was going.
            row = p.rows - 1
            if abs(curve[-1] - 2.0 * curve[-2] + curve[-3]) <= 4.0 * limit:
                continue
        findings.append(
            Finding(
                "jump",
                "warning",
                f"the {kind} in {axis} jumps to {curve[row]:.4g} at row {row + 1} of {p.rows}, "
                f"from {curve[row - 1]:.4g}: a wrong reading, or a file cut off",
                p.name,
            )
        )
    return findings


def _camera_lag(p: Protocol) -> list[Finding]:
    """A load that rises while the stretch rests, and by more than such a small stretch explains."""
    still = still_rows(p.stretch_x, p.stretch_y)
    load = np.column_stack([p.load_x, p.load_y])
    rest = rest_rows(p.stretch_x, p.stretch_y, load)
    if rest == still or 2 * still > p.rows:
        return []
    rise = load[still - 1] - load[:rest].mean(axis=0)
    k = int(np.argmax(rise))
    stretch = p.stretch_x + p.stretch_y
    # What the load rises by per stretch in as many rows after the rest
    later = load[2 * still - 1, k] - load[still - 1, k]
    moved = abs(float(stretch[2 * still - 1] - stretch[still - 1]))
    explained = later * float(np.ptp(stretch[:still])) / max(moved, 1e-12)
    if rise[k] <= LAG * max(explained, 0.0):
        return []
    time = p.time_s
    long = f" ({time[still - 1] - time[rest - 1]:.2g} s)" if time is not None else ""
    counted = "row 1 counts" if rest == 1 else f"rows 1 to {rest} count"
    return [
        Finding(
            "camera-lag",
            "warning",
            f"the load in {'xy'[k]} rises by {rise[k]:.3g} over rows {rest} to {still}{long} while "
            f"the stretch rests: the camera lags behind the load cell, or the grips slip. Only "
            f"{counted} as at rest; shift the stretches back in time by that delay",
            p.name,
        )
    ]


def _stiff_start(specimen: Specimen) -> list[Finding]:
    """Stiffness that falls along the start, and faster than that of the matrix alone does."""
    ratios, ends, names = [], [], []
    for p in specimen.protocols:
        start = max(p.rest_rows - 1, 0)
        lx, ly = p.stretch_x[start:], p.stretch_y[start:]
        # Neo-Hookean matrix: P_x = 2 C1 (lx - lx^-3 ly^-2), concave by itself
        matrix = np.column_stack([lx - lx**-3 * ly**-2, ly - ly**-3 * lx**-2])
        load = specimen.load(p)[start:]
        for k, axis in enumerate("xy"):
            bins = _bins(load[:, k])
            stiffness = [_slope(lx + ly - 2.0, load[:, k], matrix[:, k], rows) for rows in bins]
            known = [(s, rows) for s, rows in zip(stiffness, bins, strict=True) if s is not None]
            if stiffness[0] is None or len(known) < 2:
                continue
            first, error = stiffness[0]
            (softest, other), rows = min(known[1:], key=lambda pair: pair[0])
            enough = first - softest > 4.0 * np.hypot(error, other)
            if enough and first > STIFF_START * softest > 0.0:
                ratios.append(first / softest)
                ends.append(float(load[rows, k].mean()))
                names.append(f"{p.name} {axis}")
    if not ratios:
        return []
    shown = ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
    return [
        Finding(
            "stiff-start",
            "warning",
            f"{len(ratios)} of {2 * len(specimen.protocols)} curves are concave at their start: up "
            f"to {max(ratios):.1f} times as stiff there as at about {np.median(ends):.2g} "
            f"{specimen.unit} ({shown}). GOH predicts a convex start, from which the mounting "
            "stretch is inferred",
        )
    ]


def _bins(curve: np.ndarray) -> list[slice]:
    """Rows between shares of the load's range, by the first crossing of the smoothed curve."""
    width = max(1, curve.size // 30)
    smooth = np.convolve(curve, np.ones(width) / width, mode="valid")
    low, high = float(smooth[0]), float(smooth.max())
    if high <= low:
        return [slice(0, 0)] * (len(START_BINS) - 1)
    ends = [
        int(np.argmax(smooth >= low + share * (high - low))) + width // 2 for share in START_BINS
    ]
    ends[0] = 0
    return [slice(a, b) for a, b in pairwise(ends)]


def _slope(
    path: np.ndarray, curve: np.ndarray, matrix: np.ndarray, rows: slice
) -> tuple[float, float] | None:
    """Stiffness over some rows relative to that of a unit matrix, and its standard error."""
    x, y, unit = path[rows], curve[rows], matrix[rows]
    if x.size < 6 or np.ptp(x) <= 1e-6 or not np.all(np.isfinite(unit)):
        return None
    centred = x - x.mean()
    square = float(centred @ centred)
    slope = float(centred @ y) / square
    basis = float(centred @ unit) / square
    residual = y - y.mean() - slope * centred
    error = float(np.sqrt(residual @ residual / (x.size - 2) / square))
    # A path that hardly advances, or on which the matrix itself unloads, tells nothing.
    if basis < 0.5:
        return None
    return slope / basis, error / basis


def _resampled(specimen: Specimen) -> list[Finding]:
    """Loads on an even grid: no load cell records that beside a stretch that is not."""
    names = []
    for p in specimen.protocols:
        load = specimen.load(p)
        tiny = 1e-6 * np.ptp(load, axis=0)
        step = np.abs(np.diff(load, axis=0))[1:]
        even = (np.abs(np.diff(load, 2, axis=0)) < tiny) & (step > tiny)
        if p.rows >= 12 and even.mean(axis=0).min() >= 0.8:
            names.append(p.name)
    if not names:
        return []
    where = "" if len(names) == len(specimen.protocols) else f" of {', '.join(names)}"
    return [
        Finding(
            "resampled",
            "warning",
            f"the loads{where} lie on an evenly spaced grid: the record was resampled or "
            "smoothed, so its rows are not independent and its noise cannot be estimated",
        )
    ]


def _time(p: Protocol) -> list[Finding]:
    if p.time_s is None:
        return []
    back = np.flatnonzero(np.diff(p.time_s) < 0.0)
    if not back.size:
        return []
    return [
        Finding("time", "warning", f"time_s runs backwards at row {back[0] + 2}", p.name),
    ]


def _one_direction(specimen: Specimen) -> list[Finding]:
    stretch = np.concatenate(
        [np.column_stack([p.stretch_x, p.stretch_y]) - 1.0 for p in specimen.protocols]
    )
    load = np.concatenate([specimen.load(p) for p in specimen.protocols])
    misses = []
    for curves in (stretch, load):
        scale = np.abs(curves).max(axis=0)
        if scale.min() <= 0.0:
            return []
        # How far the two columns are from one multiple of each other: the smaller singular value.
        values = np.linalg.svd(curves / scale, compute_uv=False)
        misses.append(float(values[1] / values[0]))
    if max(misses) > PROPORTIONAL:
        return []
    return [
        Finding(
            "one-direction",
            "warning",
            "x and y are proportional to each other within "
            f"{100 * max(misses):.1f} %, in stretch and in load: the file holds one effective "
            "direction; stiffness, fibre angle and dispersion may trade with each other; "
            "'sample' shows whether they do",
        )
    ]


# --- everything that is noticed ------------------------------------------------------------------


def check_specimen(specimen: Specimen | str | Path) -> tuple[Finding, ...]:
    """Everything that a user should know of a specimen before trusting a fit of it.

    Returns
    -------
    tuple of Finding
        The most severe first, each group in the order: mounted state, paths, units, origin.
    """
    if not isinstance(specimen, Specimen):
        specimen = read_specimen(specimen)
    check_readings(specimen)
    findings = [
        *mounting_findings(specimen),
        *path_findings(specimen),
        *unit_findings(specimen),
        *_origin(specimen),
    ]
    return sorted_findings(findings)


def refuse_no_loading_curve(specimen: Specimen, file: object) -> tuple[Finding, ...]:
    """Refuse what cannot be a loading curve; else the serious findings.

    Parameters
    ----------
    specimen : Specimen
    file : object
        For the message; None refuses nothing.

    Raises
    ------
    InputError
        With the first finding that is an error.
    """
    findings = serious(check_specimen(specimen))
    errors = [f for f in findings if f.severity == "error"]
    if errors and file is not None:
        more = f" ({len(errors) - 1} more of the kind)" if len(errors) > 1 else ""
        message = str(errors[0]).removeprefix("error: ")
        if errors[0].code != "stretch-drift":
            message = f"cannot be a loading curve: {message}"
        raise InputError(
            f"{message}{more}",
            file=file,
            remedy="or add `anyway=True` to go on all the same",
        )
    return findings


def _origin(specimen: Specimen) -> list[Finding]:
    findings = []
    shear = specimen.metadata.get("largest_shear")
    if shear is not None:
        angle = specimen.metadata.get("largest_shear_angle_deg")
        turned = "" if angle is None else f"; the right angle changes by up to {angle:.2g} degrees"
        findings.append(
            Finding(
                "shear",
                "warning" if float(shear) > 0.02 else "note",
                f"the record holds shear: |F12|, |F21| up to {float(shear):.2g}{turned}. "
                "The model has none and ignores it",
            )
        )
    cycle, branch = specimen.metadata.get("cycle"), specimen.metadata.get("branch")
    if cycle is not None:
        findings.append(Finding("cycle", "note", f"converted from cycle {cycle}"))
    if branch is not None:
        loading = set(str(branch).replace(",", " ").split()) == {"loading"}
        findings.append(
            Finding(
                "branch",
                "note" if loading else "warning",
                f"converted from the {branch} branch"
                + ("" if loading else ": parameters of unloading are not those of loading"),
            )
        )
    return findings
