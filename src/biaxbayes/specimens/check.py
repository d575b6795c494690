"""Checks of a specimen: its mounted state, its curves, its magnitudes and its origin."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.experiments.experiment import DIMENSIONS
from biaxbayes.specimens.branches import (
    CYCLE_FRACTION,
    SIDES,
    jumps,
    path_progress,
    path_scatter,
    repeats,
    reversal,
)
from biaxbayes.specimens.plausibility import NEGATIVE, check_readings
from biaxbayes.specimens.protocol import Protocol, rest_rows, still_rows
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.specimen_file import parse_specimen, read_specimen, specimen_text
from biaxbayes.text_files import first_few

SEVERITIES = ("error", "warning", "note")
"""An error cannot be a loading curve; a warning can change what a fit means; a note explains."""
SERIOUS = (
    "units", "sign", "unloading", "jump", "time", "swapped", "stretch-drift", "camera-lag",
    "repeats", "clipped",
)  # fmt: skip
"""Warnings that are repeated in the output of ``sample``; errors always are."""
DRIFT = 0.002  # of the first stretches of protocols, from which a warning is given
LARGE_DRIFT = 0.02
"""Difference from which they are refused until the header gives their reference: twice the drift of
the preconditioned aorta among the project's measured tissue."""
FAR_START = 0.1  # distance of the first stretches from 1 from which a warning is given
SIGNIFICANT_SDS = 3.0
CLIPPED_ROWS = 3
START_BINS = (0.0, 0.05, 0.1, 0.2, 0.4)
"""Fractions of the load range between which stiffnesses are compared."""
STIFF_START = 1.5
LEAST_ROWS_OF_CURVE = 12
FEW_ROWS = 8
LAG = 3.0
DISORDER = 0.15  # scatter about the neighbours over the range; shuffled rows have 0.25 to 0.3
USUAL_PEAK_KPA = (1.0, 2_000.0)
USUAL_STRETCH = (1.01, 2.0)
USUAL_EDGE_MM = (2.0, 100.0)
USUAL_THICKNESS_MM = (0.05, 10.0)
LARGE_NOISE = 0.1
FORCE_LIMIT = 3.0
"""Largest ratio of a mounting force to the peak load; beyond it the unit is probably wrong."""


@dataclass(frozen=True)
class Finding:
    """One result of a check."""

    code: str  # stable short name, such as tared
    severity: str  # one of SEVERITIES
    message: str  # one sentence with its numbers
    protocol: str | None = None  # None: the specimen

    def __str__(self) -> str:
        where = f"protocol {self.protocol}: " if self.protocol else ""
        return f"{self.severity}: {where}{self.message}"


def warning(code: str, message: str, protocol: str | None = None) -> Finding:
    """A finding of the most frequent severity."""
    return Finding(code, "warning", message, protocol)


def sorted_findings(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """The most severe first, otherwise in their order."""
    return tuple(sorted(findings, key=lambda finding: SEVERITIES.index(finding.severity)))


def check_specimen(specimen: Specimen | str | Path) -> tuple[Finding, ...]:
    """List everything that a user should know of a specimen before trusting a fit of it.

    Returns
    -------
    tuple of Finding
        The most severe first, each group in the order: mounted state, paths, units, origin.
    """
    if not isinstance(specimen, Specimen):
        specimen = read_specimen(specimen)
    checks = (
        _mounting_force, _clipped, _unequal, _references,
        _paths, _resampled, _stiff_start,
        _stress, _sign, _dimensions, _noise, _origin,
    )  # fmt: skip
    of_mounted = (_mounting_force, _unequal, _references, _stiff_start)
    findings = []
    for piece in specimen.pieces:
        check_readings(piece)
        known = piece
        if not all(np.isfinite(p.stretch).all() for p in piece.protocols):
            # stretches of 1 where none was measured
            pairs = [(p, p.known_stretch) for p in piece.protocols]
            protocols = tuple(replace(p, stretch_x=s[:, 0], stretch_y=s[:, 1]) for p, s in pairs)
            known = replace(piece, protocols=protocols)
        of_piece = [c for c in checks if piece.experiment.is_mounted or c not in of_mounted]
        found = [finding for check in of_piece for finding in check(known)]
        if len(specimen.pieces) > 1:
            named = [", ".join(filter(None, (piece.name, f.protocol))) for f in found]
            found = [replace(f, protocol=name) for f, name in zip(found, named, strict=True)]
        findings += found
    return sorted_findings(findings)


def refuse_no_loading_curve(specimen: Specimen, file: object) -> tuple[Finding, ...]:
    """Return the serious findings; InputError for the first error, unless `file` is None."""
    findings = check_specimen(specimen)
    errors = [f for f in findings if f.severity == "error"]
    if errors and file is not None:
        more = f" ({len(errors) - 1} more of the kind)" if len(errors) > 1 else ""
        message = str(errors[0]).removeprefix("error: ")
        if errors[0].code != "stretch-drift":
            message = f"cannot be a loading curve: {message}"
        remedy = "or add `anyway=True` to sample it nevertheless"
        raise InputError(f"{message}{more}", file=file, remedy=remedy)
    return (*errors, *(f for f in findings if f.severity == "warning" and f.code in SERIOUS))


# --- a specimen that is changed or made by the program --------------------------------------------


def with_force(specimen: Specimen, mounting_force: Sequence[float], file: object) -> Specimen:
    """A tared specimen with its mounting force added back; refuses one that cannot be right."""
    unit, largest = specimen.unit, specimen.peak_load
    if not specimen.is_tared:
        remedy = "`mounting_force` is for files whose force was zeroed after mounting"
        raise InputError("already has a mounting force", file=file, remedy=remedy)
    try:
        x, y = (float(v) for v in mounting_force)
    except (TypeError, ValueError):
        x = y = math.nan
    if not math.isfinite(x + y) or (x, y) == (0.0, 0.0):
        problem = "`mounting_force` must be two finite numbers, not both zero"
        raise InputError(problem, remedy=f"give the force before taring, in {unit}")
    problem = ""
    if max(abs(x), abs(y)) > FORCE_LIMIT * largest:
        problem = f"more than {FORCE_LIMIT:g} times the largest load recorded"
    elif (changed := specimen.with_mounting_force(x, y)).is_tared:
        problem = "negligible compared with the largest recorded load"
    if problem:
        problem = f"`mounting_force` {x:g} {y:g} is {problem}, {largest:.3g} {unit}"
        raise InputError(problem, file=file, remedy=f"give it in {unit}")
    check_round_trip(changed, file)
    return changed


def check_round_trip(specimen: Specimen, file: object) -> None:
    """Refuse a specimen that cannot be read again from the copy in a run folder."""
    check_readings(specimen)  # names the row
    try:
        parse_specimen(specimen_text(specimen).split("\n"), Path("specimen.csv"))
    except InputError as error:
        where = f" in {error.column}" if error.column else ""
        raise InputError(f"{error.problem}{where}", file=file, remedy=error.remedy) from None


# --- the mounted state ----------------------------------------------------------------------------


def _mounting_force(specimen: Specimen) -> Iterator[Finding]:
    """Mounting forces that are zero, compressive, or less than their noise."""
    if specimen.is_tared:
        yield warning(
            "tared",
            "the force at the mounted state is zero in every protocol: the load cell was tared "
            "after mounting, or the record was shifted to start at zero before it was exported. "
            "The mounting stretch cannot be inferred from this file; give the force with "
            "--mounting-force X Y, or sample with --mounting zeroed",
        )
        return
    zero, unit = 1e-9 * specimen.peak_load, specimen.unit
    readings, sds = specimen.mounting_readings(shared=False)
    for p, *of_force in zip(specimen.protocols, readings, sds, strict=True):
        for axis, value, error, curve in zip("xy", *of_force, p.recorded_load.T, strict=True):
            force = f"the mounting force in {axis}, {value:.3g} +- {error:.2g} {unit}"
            # A direction without any load is the free direction of a uniaxial strip.
            if abs(value) <= zero and curve.any():
                message = f"the mounting force in {axis} is exactly zero, as after a tare in this "
                yield warning("tared", f"{message}direction", p.name)
            elif value < min(0.0, -2.0 * error):
                message = f"{force}, is compressive: a thin specimen buckles before it carries "
                message += "that, so the load cell's zero is probably off"
                yield warning("negative-mounting-force", message, p.name)
            elif zero < abs(value) < 2.0 * error:
                message = f"{force}, cannot be distinguished from zero: expect a wide interval of "
                message += f"the mounting stretch in {axis}"
                yield warning("mounting-force-in-noise", message, p.name)


def _clipped(specimen: Specimen) -> Iterator[Finding]:
    """Loads clipped at zero, or at the limit of the load cell."""
    below_zero = (
        " and none is negative: forces below zero were clipped before export, and the start of the "
        "curve is lost with them. Export the raw readings"
    )
    at_limit = ", the largest: the load cell or the amplifier was at its limit. Remove these rows"
    for p in specimen.protocols:
        for axis, curve, unit in zip("xy", p.recorded_load.T, specimen.units, strict=True):
            for value, words in ((float(curve.min()), below_zero), (float(curve.max()), at_limit)):
                same = curve == value
                others = curve[~same]
                # Coarse digits repeat every value, and not only the lowest or the highest one.
                fine = np.unique(others).size > 0.8 * others.size
                enough = min(same.sum(), others.size) >= CLIPPED_ROWS and same[p.rest_rows :].any()
                if fine and enough and (value == 0.0 or words == at_limit):
                    lost = words == below_zero and same[: p.rest_rows].any()
                    message = f"{same.sum()} of {p.rows} loads in {axis} are exactly {value:g} "
                    message += f"{unit}{words}"
                    yield Finding("clipped", "error" if lost else "warning", message, p.name)


def _unequal(specimen: Specimen) -> Iterator[Finding]:
    """Mounting forces that differ between protocols by more than their errors."""
    resting = [p.rest_rows > 0 for p in specimen.protocols]
    if sum(resting) < 2 or specimen.is_tared:
        return
    readings, sds = (values[resting] for values in specimen.mounting_readings(shared=False))
    names = [p.name for p in specimen.protocols if p.rest_rows]
    differing = []
    for axis, reading, error in zip("xy", readings.T, sds.T, strict=True):
        apart, sd = np.abs(np.subtract.outer(reading, reading)), np.hypot.outer(error, error)
        worst = i, j = np.unravel_index(np.argmax(apart - SIGNIFICANT_SDS * sd), sd.shape)
        if apart[worst] > SIGNIFICANT_SDS * sd[worst]:
            noise = f", {apart[worst] / sd[worst]:.1f} standard errors" if sd[worst] > 0.0 else ""
            of = f"{names[i]}: {reading[i]:.3g}, {names[j]}: {reading[j]:.3g}{noise}"
            differing.append(f"in {axis} by up to {apart[worst]:.3g} {specimen.unit} ({of})")
    if differing:
        message = f"the mounting force differs between protocols, {' and '.join(differing)}: the "
        message += "mounted state is not the same in all of them; compare --mounting-stretch "
        yield warning("mounting-forces-differ", f"{message}per-protocol")


def _references(specimen: Specimen) -> Iterator[Finding]:
    """First rows that differ in stretch, and the state that stretches are relative to."""
    names = [p.name for p in specimen.protocols]
    if specimen.reference == "common":
        apart = [p.name for p in specimen.protocols if p.rest_rows == 0]
        message = f"{len(apart)} of {len(names)} protocols do not start at the mounted state "
        message += f"({first_few(apart, 4)}): the mounting force is taken from the others"
        yield from [Finding("common-reference", "note", message)] if apart else ()
        return
    starts = np.array([p.reference for p in specimen.protocols])
    span = np.ptp(starts, axis=0)
    off = float(np.abs(starts - 1.0).max())
    if span.max() > DRIFT:
        k = int(np.argmax(span))
        low, high = int(np.argmin(starts[:, k])), int(np.argmax(starts[:, k]))
        remedy = ", as stated by '# reference: each protocol' in the header"
        if not specimen.reference:
            remedy = (
                ". Add '# reference: common' to the header if the stretches share one reference, "
                "'# reference: each protocol' if each protocol starts at the mounted state"
            )
        severity = "error" if span[k] > LARGE_DRIFT and not specimen.reference else "warning"
        message = (
            f"the protocols start at different stretches, from {starts[low, k]:.4f} ({names[low]}) "
            f"to {starts[high, k]:.4f} ({names[high]}) in {'xy'[k]}, and each was divided by its "
            f"own start{remedy}"
        )
        yield Finding("stretch-drift", severity, message)
    elif off > 1e-9:
        message = f"the file's stretches do not start at 1 (off by up to {off:.2g}); they were "
        message += "divided by their value at rest"
        far = ": is the length right by which they were divided before?" * (off > FAR_START)
        severity = "warning" if far else "note"
        yield Finding("re-referenced", severity, f"{message}{far}")


# --- the curves -----------------------------------------------------------------------------------


def _paths(specimen: Specimen) -> Iterator[Finding]:
    """Each protocol: its number of rows, its order and direction, its time."""
    for p in specimen.protocols:
        load = specimen.load(p)
        if p.rows < FEW_ROWS:
            yield warning("few-rows", f"only {p.rows} rows in this protocol", p.name)
        yield from _order(p, load, specimen.noise_sd)
        curves = dict(zip(SIDES, (*p.stretch.T, *load.T), strict=True))
        for name, apart in jumps(p.stretch, load).items() if p.rows >= LEAST_ROWS_OF_CURVE else ():
            row, curve = int(apart[0]), curves[name]
            message = (
                f"the {name} jumps to {curve[row]:.4g} at row {row + 1} of {p.rows}, "
                f"from {curve[row - 1]:.4g}: a wrong reading, or a file cut off"
            )
            yield warning("jump", message, p.name)
        back = np.flatnonzero(np.diff(p.time_s if p.time_s is not None else [0.0]) < 0.0)
        if back.size:
            yield warning("time", f"time_s runs backwards at row {back[0] + 2}", p.name)
        if repeats(p.stretch, load, p.rest_rows):
            message = (
                "stretches repeat from row to row while the load goes on: a camera slower than "
                "the load cell, a coarse or a frozen stretch. Convert with --still first"
            )
            yield warning("repeats", message, p.name)
        elif specimen.experiment.is_mounted:
            yield from _camera_lag(p)


def _order(p: Protocol, load: np.ndarray, noise_sd: float) -> Iterator[Finding]:
    """Rows that are shuffled, that turn back, or that are in reverse order."""
    path = path_progress(p.stretch, load)
    peak = reversal(path)
    # Loads that are mostly noise scatter as much; shuffled rows shuffle the stretches, too.
    disorder = [
        path_scatter(along) / max(float(np.ptp(along)), 1e-300)
        for along in (path, path_progress(p.stretch, p.stretch))
    ]
    change, loss = (curve[-1] - curve[0] for curve in (p.stretch, load))
    if p.rows >= FEW_ROWS and min(disorder) > DISORDER:
        message = f"neighbouring rows lie {100 * disorder[0]:.0f} % of the whole range apart: the "
        yield Finding(
            "shuffled", "error", f"{message}rows are out of order. Sort them by time", p.name
        )
    elif peak is not None:
        cycle = path[peak] - path[peak:].min() >= CYCLE_FRACTION * float(np.ptp(path))
        message = f"the path turns back at row {peak + 1} of {p.rows}: unloading (or several "
        message += "cycles) mixed in. An elastic model has one curve; convert with --branch loading"
        yield Finding("unloading", "error" if cycle else "warning", message, p.name)
    elif change.sum() < 0.0 and loss.sum() < -3.0 * noise_sd:
        message = (
            f"stretch and load fall from row to row, to {p.stretch_x[-1]:.4g} and "
            f"{p.stretch_y[-1]:.4g} of the first stretches: the rows are in reverse order, or "
            "belong to unloading. The first row must be the mounted state; reverse the rows"
        )
        yield Finding("backwards", "error", message, p.name)


def _camera_lag(p: Protocol) -> Iterator[Finding]:
    """A load that rises at constant stretch by more than small changes of stretch explain."""
    still = still_rows(p.stretch_x, p.stretch_y)
    load = p.recorded_load
    rest = rest_rows(p.stretch_x, p.stretch_y, load)
    if rest == still or 2 * still > p.rows:
        return
    rise = load[still - 1] - load[:rest].mean(axis=0)
    k = int(np.argmax(rise))
    stretch = p.stretch_x + p.stretch_y
    # rise of the load per stretch in the same number of rows after the rest
    later = load[2 * still - 1, k] - load[still - 1, k]
    moved = abs(float(stretch[2 * still - 1] - stretch[still - 1]))
    explained = later * float(np.ptp(stretch[:still])) / max(moved, 1e-12)
    if rise[k] <= LAG * max(explained, 0.0):
        return
    time = p.time_s
    duration = f" ({time[still - 1] - time[rest - 1]:.2g} s)" if time is not None else ""
    counted = "row 1 counts" if rest == 1 else f"rows 1 to {rest} count"
    message = (
        f"the load in {'xy'[k]} rises by {rise[k]:.3g} over rows {rest} to {still}{duration} while "
        f"the stretch rests: the camera lags behind the load cell, or the grips slip. Only "
        f"{counted} as at rest; shift the stretches back in time by that delay"
    )
    yield warning("camera-lag", message, p.name)


def _resampled(specimen: Specimen) -> Iterator[Finding]:
    """Loads on an evenly spaced grid, which a load cell does not record."""
    names = []
    for p in specimen.protocols:
        load = specimen.load(p)
        tiny = 1e-6 * np.ptp(load, axis=0)
        step = np.abs(np.diff(load, axis=0))[1:]
        even = (np.abs(np.diff(load, 2, axis=0)) < tiny) & (step > tiny)
        if p.rows >= 12 and np.min(even.mean(axis=0)) >= 0.8:
            names.append(p.name)
    if names:
        where = "" if len(names) == len(specimen.protocols) else f" of {', '.join(names)}"
        yield warning(
            "resampled",
            f"the loads{where} lie on an evenly spaced grid: the record was resampled or "
            "smoothed, so its rows are not independent and its noise cannot be estimated",
        )


def _stiff_start(specimen: Specimen) -> Iterator[Finding]:
    """Stiffness that falls along the start faster than that of the matrix alone."""
    found = []
    for p in specimen.protocols:
        start = max(p.rest_rows - 1, 0)
        stretch, load = p.stretch[start:], specimen.load(p)[start:]
        # neo-Hookean matrix, which is concave: P_x = 2 C1 (lx - lx^-3 ly^-2)
        matrix = stretch - stretch**-3 * stretch[:, ::-1] ** -2
        path = stretch.sum(axis=1)
        for axis, curve, unit in zip("xy", load.T, matrix.T, strict=True):
            # rows between fractions of the load's range, by the first crossing of the smooth curve
            width = max(1, curve.size // 30)
            smooth = np.convolve(curve, np.ones(width) / width, mode="valid")
            levels = smooth[0] + np.array(START_BINS[1:]) * (smooth.max() - smooth[0])
            ends = [int(np.argmax(smooth >= level)) + width // 2 for level in levels]
            bins = [slice(a, b) for a, b in pairwise([0, *ends])]
            slopes = [_slope(path[rows], curve[rows], unit[rows]) for rows in bins]
            (first, *later), (first_error, *errors) = np.transpose(slopes)
            if np.isnan(later).all():
                continue
            k = int(np.nanargmin(later))
            certain = first - later[k] > 4.0 * np.hypot(first_error, errors[k])
            if certain and first > STIFF_START * later[k] > 0.0:
                end = float(curve[bins[1 + k]].mean())
                found.append((first / later[k], end, f"{p.name} {axis}"))
    if found:
        ratios, loads, names = zip(*found, strict=True)
        yield warning(
            "stiff-start",
            f"{len(ratios)} of {2 * len(specimen.protocols)} curves are concave at their start: up "
            f"to {max(ratios):.1f} times as stiff there as at about {np.median(loads):.2g} "
            f"{specimen.unit} ({first_few(names, 4)}). GOH predicts a convex start, from which the "
            "mounting stretch is inferred",
        )


def _slope(path: np.ndarray, curve: np.ndarray, matrix: np.ndarray) -> tuple[float, float]:
    """Stiffness relative to that of a unit matrix, and its standard error; NaN where not known."""
    if path.size < 6 or np.ptp(path) <= 1e-6 or not np.isfinite(matrix).all():
        return np.nan, np.nan
    x = path - path.mean()
    slope, covariance = np.polyfit(x, curve, 1, cov=True)
    basis = float(np.polyfit(x, matrix, 1)[0])
    # no stiffness on a path that hardly advances, or on which the matrix unloads
    basis = basis if basis >= 0.5 else np.nan
    return slope[0] / basis, np.sqrt(covariance[0, 0]) / basis


# --- magnitudes -----------------------------------------------------------------------------------


def _stress(specimen: Specimen) -> Iterator[Finding]:
    """Stresses that are large or small for soft tissue, or differ much between x and y."""
    peaks = np.abs(np.concatenate([specimen.stresses(p) for p in specimen.protocols])).max(axis=0)
    peak, low, high = float(peaks.max()), *USUAL_PEAK_KPA
    smaller, larger = ("gf or mN", "kgf or kN") if specimen.unit == "N" else ("Pa", "MPa")
    yield from _units(
        {
            f"the largest stress is {peak / 1000:.3g} MPa, much for soft tissue: is the file in "
            f"{smaller}?": peak > high,
            f"the largest stress is {peak:.2g} kPa, little for a biaxial test: is the file in "
            f"{larger}?": peak < low,
            f"the largest stresses in x and y are {peaks[0]:.3g} and {peaks[1]:.3g} kPa: are both "
            "columns in the same unit?": peak > 100.0 * peaks.min() > 0.0,
        }
    )


def _units(holds: Mapping[str, bool]) -> Iterator[Finding]:
    """Warnings of the messages that hold."""
    yield from (warning("units", message) for message, holding in holds.items() if holding)


def _sign(specimen: Specimen) -> Iterator[Finding]:
    """Tension must be positive: the load at the largest stretch of each direction."""
    for k, (axis, name) in enumerate(zip("xy", specimen.kind_of_loads.columns, strict=True)):
        if k not in specimen.same_unit(0):
            continue  # a short tube pushes against its ends
        p = max(specimen.protocols, key=lambda p: float(p.stretch[:, k].max()))
        row = int(np.argmax(p.stretch[:, k]))
        stretch, load = float(p.stretch[row, k]), float(specimen.load(p)[row, k])
        if load < -3.0 * specimen.noise_sd:
            severity = "error" if load < -NEGATIVE * specimen.peak_load else "warning"
            message = f"the load in {axis} is {load:.3g} {specimen.unit} at its largest stretch of "
            message += f"{stretch:.3f}: tension must be positive. If the load cell counts tension "
            yield Finding("sign", severity, f"{message}negative, multiply the column {name} by -1")


def _dimensions(specimen: Specimen) -> Iterator[Finding]:
    """Unusual stretches, edges and thickness, and what may mislead in this kind of test."""
    top, (low, high) = max(float(p.stretch.max()) for p in specimen.protocols), USUAL_STRETCH
    stated = {key: value for key in DIMENSIONS if (value := getattr(specimen, key)) is not None}
    thickness = stated.get("thickness_mm", 0.0)
    width = min((value for key, value in stated.items() if key != "thickness_mm"), default=math.inf)
    unusual = {
        f"{key} of {value:g} is unusual: is it in mm?": not least <= value <= most
        for key, value in stated.items()
        for least, most in [USUAL_THICKNESS_MM if key == "thickness_mm" else USUAL_EDGE_MM]
    }
    yield from _units(
        {
            f"the largest stretch is {top:.4f}: is the column a stretch, not a strain?": top < low,
            f"the largest stretch is {top:.3g}, much for soft tissue": top > high,
            **unusual,
            f"the specimen is {thickness:g} mm thick and only {width:g} mm wide: a membrane model "
            "does not hold": thickness > 0.5 * width,
        }
    )
    for code, message in specimen.experiment.warnings(specimen.header):
        yield warning(code, message)


def _noise(specimen: Specimen) -> Iterator[Finding]:
    """Load noise that is large, differs from the scatter of the rows, or is absent."""
    given, scatter = specimen.load_noise, specimen.high_frequency_scatter()
    noise, peak, unit = specimen.noise_sd, specimen.peak_load, specimen.unit
    if noise > LARGE_NOISE * peak:
        share = f"{100.0 * noise / peak:.0f} % of the largest load"
        yield warning("units", f"the load noise of {noise:.2g} {unit} is {share}")
    if given is not None and scatter > 0.0 and not 0.2 < scatter / given < 5.0:
        smoothed = ": the record was smoothed or averaged" if scatter < given else ""
        yield warning(
            "noise-differs",
            f"the header states a load noise of {given:.2g} {unit}; neighbouring rows "
            f"scatter by {scatter:.2g} {unit}{smoothed}",
        )
    if noise == 0.0:
        yield warning(
            "no-noise",
            "the file states no load noise and its rows show none (a resampled or virtual "
            f"record): state load_noise_{unit}, or the mounting force can only be taken as exact",
        )


MAX_SHEAR, MAX_ROTATION_DEG = 0.02, 3.0
"""Shear |F12| and change of the right angle beyond which the axes are not those of the tissue."""
ALIGNMENT = (
    "no shear is recorded, so the axes of the machine are taken as axes of symmetry of the tissue, "
    "which this record cannot show. GOH fitted to three protocols of twelve tissues turned by 5 "
    "degrees (10 degrees) had k1 1.2 (1.8) times, k2 1.1 (1.6) times and kappa 0.03 (0.10) too "
    "large and alpha off by 2 (13) degrees, at a misfit of the load cell's noise (1.2 times); "
    "mounting stretches were right"
)
"""Medians of least-squares fits: scripts/studies/alignment.py."""


def alignment_note(specimen: Specimen) -> str:
    """What a record without shear assumes of its axes; empty for one that shows them."""
    known = specimen.metadata.get("largest_shear") is not None
    return "" if known or specimen.test != "biaxial" else ALIGNMENT


def _origin(specimen: Specimen) -> Iterator[Finding]:
    """Findings from the notes of ``convert`` on shear and branch."""
    shear = specimen.metadata.get("largest_shear")
    if shear is not None:
        angle = specimen.metadata.get("largest_shear_angle_deg")
        turned = "" if angle is None else f"; the right angle changes by up to {angle:.2g} degrees"
        message = f"the record contains shear: |F12|, |F21| up to {float(shear):.2g}{turned}. "
        large = float(shear) > MAX_SHEAR or float(angle or 0.0) > MAX_ROTATION_DEG
        severity = "warning" if large else "note"
        yield Finding("shear", severity, f"{message}The model ignores it")
    branch = str(specimen.metadata.get("branch", "loading"))
    if set(branch.replace(",", " ").split()) != {"loading"}:
        message = f"converted from the {branch} branch: parameters of unloading are not those of "
        yield warning("branch", f"{message}loading")
