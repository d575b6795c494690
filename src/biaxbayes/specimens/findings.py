"""Findings about a specimen, and those about its rows at rest.

A tare, a sign, a drift, forces that differ, a reading lost in its noise.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from itertools import combinations

import numpy as np

from biaxbayes.specimens.specimen import Specimen

SEVERITIES = ("error", "warning", "note")
"""An error cannot be a loading curve; a warning can change what a fit means; a note explains."""


@dataclass(frozen=True)
class Finding:
    """One thing that was noticed.

    Attributes
    ----------
    code : str
        Stable short name, such as ``tared``.
    severity : {"error", "warning", "note"}
        As in :data:`SEVERITIES`.
    message : str
        One sentence with the numbers it rests on.
    protocol : str or None
        Where it was noticed; None for the specimen.
    """

    code: str
    severity: str
    message: str
    protocol: str | None = None

    def record(self) -> dict[str, str | None]:
        """The finding as plain values."""
        return asdict(self)

    def __str__(self) -> str:
        where = f"protocol {self.protocol}: " if self.protocol else ""
        return f"{self.severity}: {where}{self.message}"


SERIOUS = (
    "units",
    "sign",
    "unloading",
    "jump",
    "time",
    "swapped",
    "stretch-drift",
    "camera-lag",
    "clipped",
)
"""Warnings that are repeated in the output of ``sample``; errors always are."""


def sorted_findings(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """The most severe first, else in their order."""
    return tuple(sorted(findings, key=lambda finding: SEVERITIES.index(finding.severity)))


def serious(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Errors, and the warnings of a wrong file rather than of a difficult specimen."""
    return tuple(
        f
        for f in sorted_findings(findings)
        if f.severity == "error" or (f.severity == "warning" and f.code in SERIOUS)
    )


# --- what the rows at rest say -----------------------------------------------------------------


DRIFT = 0.002
"""First rows of protocols that differ by more in stretch are worth a warning."""
LARGE_DRIFT = 0.02
"""First rows that differ by more are refused until the header says what they are relative to:
twice what the preconditioned aorta of the project's measured tissue drifts by."""
SIGNIFICANT = 3.0
CLIPPED_ROWS = 3


def mounting_findings(specimen: Specimen) -> list[Finding]:
    """Findings about the mounted state."""
    return [
        *_tared(specimen),
        *_clipped(specimen),
        *_weak_or_negative(specimen),
        *_unequal(specimen),
        *_references(specimen),
    ]


def _tared(specimen: Specimen) -> list[Finding]:
    if specimen.is_tared:
        return [
            Finding(
                "tared",
                "warning",
                "the force at the mounted state is zero in every protocol: the load cell was "
                "tared after mounting, or the record was shifted to start at zero before it was "
                "exported. Prestretch cannot be inferred from this file; give the force with "
                "--mounting-force X Y, or sample with --mounting zeroed",
            )
        ]
    limit = 1e-9 * specimen.peak_load
    return [
        Finding(
            "tared",
            "warning",
            f"the mounting force in {axis} is exactly zero, as after a tare in this direction",
            p.name,
        )
        for p in specimen.protocols
        for axis, value, curve in zip(
            "xy", specimen.mounting_reading(p), (p.load_x, p.load_y), strict=True
        )
        # A direction without any load is the free one of a uniaxial strip.
        if abs(value) <= limit and np.any(curve != 0.0)
    ]


def _clipped(specimen: Specimen) -> list[Finding]:
    """Loads cut off at zero, or at the top of the load cell."""
    findings = []
    for p in specimen.protocols:
        for axis, curve in zip("xy", (p.load_x, p.load_y), strict=True):
            zeros = _repeats(curve, 0.0, p.rest_rows) if curve.min() == 0.0 else 0
            if zeros:
                lost = bool(np.any(curve[: p.rest_rows] == 0.0))
                message = (
                    f"{zeros} of {p.rows} loads in {axis} are exactly 0 {specimen.unit} and none "
                    "is negative: forces below zero were clipped before export, and the start of "
                    "the curve is lost with them. Export the raw readings"
                )
                severity = "error" if lost else "warning"
                findings.append(Finding("clipped", severity, message, p.name))
            tops = _repeats(curve, float(curve.max()), p.rest_rows)
            if tops:
                message = (
                    f"{tops} of {p.rows} loads in {axis} are exactly {curve.max():g} "
                    f"{specimen.unit}, the largest: the load cell or the amplifier was at its "
                    "limit. Remove these rows"
                )
                findings.append(Finding("clipped", "warning", message, p.name))
    return findings


def _repeats(curve: np.ndarray, value: float, resting: int) -> int:
    """Rows of exactly this load, if they are no matter of coarse digits or of the rest; else 0."""
    same = curve == value
    others = curve[~same]
    # Coarse digits repeat every value, and not only the lowest or the highest one.
    fine = np.unique(others).size > 0.8 * others.size
    count = int(same.sum())
    enough = count >= CLIPPED_ROWS and others.size >= CLIPPED_ROWS
    return count if enough and fine and bool(same[resting:].any()) else 0


def _weak_or_negative(specimen: Specimen) -> list[Finding]:
    if specimen.is_tared:
        return []
    findings = []
    readings, sds = specimen.mounting_readings(shared=False)
    unit = specimen.unit
    for p, reading, sd in zip(specimen.protocols, readings, sds, strict=True):
        if p.rest_rows == 0:
            continue
        for axis, value, error in zip("xy", reading, sd, strict=True):
            what = f"the mounting force in {axis}, {value:.3g} +- {error:.2g} {unit}"
            if value < -2.0 * error and value < 0.0:
                findings.append(
                    Finding(
                        "negative-mounting-force",
                        "warning",
                        f"{what}, is compressive: a thin specimen buckles before it carries that, "
                        "so the load cell's zero is probably off",
                        p.name,
                    )
                )
            elif 1e-9 * specimen.peak_load < abs(value) < 2.0 * error:
                findings.append(
                    Finding(
                        "mounting-force-in-noise",
                        "warning",
                        f"{what}, cannot be distinguished from zero: expect a wide interval of the "
                        f"mounting stretch in {axis}",
                        p.name,
                    )
                )
    return findings


def _unequal(specimen: Specimen) -> list[Finding]:
    if len(specimen.protocols) < 2 or specimen.is_tared:
        return []
    readings, sds = specimen.mounting_readings(shared=False)
    at_rest = [p.rest_rows > 0 for p in specimen.protocols]
    readings, sds = readings[at_rest], sds[at_rest]
    names = [p.name for p in specimen.protocols if p.rest_rows]
    if len(names) < 2:
        return []
    pairs = list(combinations(range(len(readings)), 2))
    differing = []
    for k, axis in enumerate("xy"):
        sd = np.array([np.hypot(sds[i, k], sds[j, k]) for i, j in pairs])
        apart = np.array([abs(readings[i, k] - readings[j, k]) for i, j in pairs])
        worst = int(np.argmax(apart - SIGNIFICANT * sd))
        if apart[worst] > SIGNIFICANT * sd[worst]:
            i, j = pairs[worst]
            noise = f", {apart[worst] / sd[worst]:.1f} standard errors" if sd[worst] > 0.0 else ""
            differing.append(
                f"in {axis} by up to {apart[worst]:.3g} {specimen.unit} ({names[i]}: "
                f"{readings[i, k]:.3g}, {names[j]}: {readings[j, k]:.3g}{noise})"
            )
    if not differing:
        return []
    return [
        Finding(
            "mounting-forces-differ",
            "warning",
            f"the mounting force differs between protocols, {' and '.join(differing)}: the mounted "
            "state is not the same in all of them; compare --mounting-stretch per-protocol",
        )
    ]


def _references(specimen: Specimen) -> list[Finding]:
    """First rows that differ in stretch, and the state that stretches are relative to."""
    if specimen.reference == "common":
        away = [p.name for p in specimen.protocols if p.rest_rows == 0]
        if not away:
            return []
        return [
            Finding(
                "common-reference",
                "note",
                f"{len(away)} of {len(specimen.protocols)} protocols do not start at the mounted "
                f"state ({', '.join(away[:4])}{' ...' if len(away) > 4 else ''}): the mounting "
                "force is that of the others",
            )
        ]
    starts = np.array([p.reference for p in specimen.protocols])
    span = np.ptp(starts, axis=0)
    k = int(span.argmax())
    if span[k] > DRIFT:
        low, high = int(starts[:, k].argmin()), int(starts[:, k].argmax())
        names = [p.name for p in specimen.protocols]
        reported = specimen.reference is not None
        remedy = (
            ", as '# reference: each protocol' of the header says"
            if reported
            else ". Add '# reference: common' to the header if the stretches share one reference, "
            "'# reference: each protocol' if each protocol starts at the mounted state"
        )
        return [
            Finding(
                "stretch-drift",
                "error" if span[k] > LARGE_DRIFT and not reported else "warning",
                f"the protocols start at different stretches, from {starts[low, k]:.4f} "
                f"({names[low]}) to {starts[high, k]:.4f} ({names[high]}) in {'xy'[k]}, and each "
                f"was divided by its own start{remedy}",
            )
        ]
    off = float(np.abs(starts - 1.0).max())
    if off <= 1e-9:
        return []
    return [
        Finding(
            "re-referenced",
            "note",
            f"the file's stretches do not start at 1 (off by up to {off:.2g}); they were divided "
            "by their value at rest",
        )
    ]
