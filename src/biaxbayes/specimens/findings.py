"""Findings about a specimen, and those about its rows at rest.

A tare, a sign, a drift, forces that differ, a reading lost in its noise.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from itertools import combinations

import numpy as np

from biaxbayes.specimens.specimen import Specimen

__all__ = ["SERIOUS", "SEVERITIES", "Finding", "mounting_findings", "serious", "sorted_findings"]


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


SERIOUS = ("units", "sign", "unloading", "jump", "time", "swapped")
"""Warnings that a sampled posterior is not told without; an error always is one of these."""


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
"""Differences of the stretch at rest between protocols beyond this are worth a warning."""
SIGNIFICANT = 3.0


def mounting_findings(specimen: Specimen) -> list[Finding]:
    """Findings about the mounted state.

    Parameters
    ----------
    specimen : Specimen

    Returns
    -------
    list of Finding
    """
    return [
        *_tared(specimen),
        *_weak_or_negative(specimen),
        *_unequal(specimen),
        *_drift(specimen),
        *_reference(specimen),
    ]


def _tared(specimen: Specimen) -> list[Finding]:
    if specimen.is_tared:
        return [
            Finding(
                "tared",
                "warning",
                "the force at the mounted state is zero in every protocol: the load cell was "
                "tared after mounting, or the record was shifted to start at zero. Prestretch "
                "cannot be inferred from this file; give the force with --mounting-force X Y, or "
                "sample with --mounting zeroed",
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
        for axis, value in zip("xy", specimen.mounting_reading(p), strict=True)
        if abs(value) <= limit
    ]


def _weak_or_negative(specimen: Specimen) -> list[Finding]:
    if specimen.is_tared:
        return []
    found = []
    readings, sds = specimen.mounting_readings(shared=False)
    unit = specimen.unit
    for p, reading, sd in zip(specimen.protocols, readings, sds, strict=True):
        for axis, value, error in zip("xy", reading, sd, strict=True):
            what = f"the mounting force in {axis}, {value:.3g} +- {error:.2g} {unit}"
            if value < -2.0 * error and value < 0.0:
                found.append(
                    Finding(
                        "negative-mounting-force",
                        "warning",
                        f"{what}, is compressive: a thin specimen buckles before it carries that, "
                        "so the load cell's zero is probably off",
                        p.name,
                    )
                )
            elif 1e-9 * specimen.peak_load < abs(value) < 2.0 * error:
                found.append(
                    Finding(
                        "mounting-force-in-noise",
                        "warning",
                        f"{what}, cannot be told from zero: expect a wide interval of the "
                        f"mounting stretch in {axis}",
                        p.name,
                    )
                )
    return found


def _unequal(specimen: Specimen) -> list[Finding]:
    if len(specimen.protocols) < 2 or specimen.is_tared:
        return []
    readings, sds = specimen.mounting_readings(shared=False)
    found = []
    for k, axis in enumerate("xy"):
        pairs = list(combinations(range(len(readings)), 2))
        sd = np.array([np.hypot(sds[i, k], sds[j, k]) for i, j in pairs])
        apart = np.array([abs(readings[i, k] - readings[j, k]) for i, j in pairs])
        worst = int(np.argmax(apart - SIGNIFICANT * sd))
        if apart[worst] <= SIGNIFICANT * sd[worst]:
            continue
        i, j = pairs[worst]
        names = [p.name for p in specimen.protocols]
        noise = f", {apart[worst] / sd[worst]:.1f} standard errors" if sd[worst] > 0.0 else ""
        found.append(
            Finding(
                "mounting-forces-differ",
                "warning",
                f"the mounting force in {axis} differs between protocols by up to "
                f"{apart[worst]:.3g} {specimen.unit} ({names[i]}: {readings[i, k]:.3g}, "
                f"{names[j]}: {readings[j, k]:.3g}){noise}: the mounted state is not the same in "
                "all of them; compare --mounting-stretch per-protocol",
            )
        )
    return found


def _drift(specimen: Specimen) -> list[Finding]:
    if len(specimen.protocols) < 2:
        return []
    reference = np.array([p.reference for p in specimen.protocols])
    span = np.ptp(reference, axis=0)
    if span.max() <= DRIFT:
        return []
    axis = "xy"[int(span.argmax())]
    low, high = reference[:, span.argmax()].min(), reference[:, span.argmax()].max()
    return [
        Finding(
            "stretch-drift",
            "warning",
            f"the stretch at rest drifts between protocols: from {low:.4f} to {high:.4f} in "
            f"{axis} ({100 * span.max():.1f} %). Each protocol was re-referenced to its own "
            "start, which hides the drift from a shared mounting stretch",
        )
    ]


def _reference(specimen: Specimen) -> list[Finding]:
    off = max(abs(value - 1.0) for p in specimen.protocols for value in p.reference)
    if off <= 1e-9:
        return []
    return [
        Finding(
            "re-referenced",
            "note",
            f"the file's stretches do not start at 1 (off by up to {off:.4f}); they were divided "
            "by their value at rest",
        )
    ]
