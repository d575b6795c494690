"""Findings about a specimen: short name, severity, one sentence."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass

SEVERITIES = ("error", "warning", "note")
"""An error cannot be a loading curve; a warning can change what a fit means; a note explains."""
SERIOUS = (
    "units", "sign", "unloading", "jump", "time", "swapped", "stretch-drift", "camera-lag",
    "clipped",
)  # fmt: skip
"""Warnings that are repeated in the output of ``sample``; errors always are."""


@dataclass(frozen=True)
class Finding:
    """One result of a check."""

    code: str  # stable short name, such as tared
    severity: str  # one of SEVERITIES
    message: str  # one sentence with its numbers
    protocol: str | None = None  # None: the specimen

    def record(self) -> dict[str, str | None]:
        """The finding as plain values."""
        return asdict(self)

    def __str__(self) -> str:
        where = f"protocol {self.protocol}: " if self.protocol else ""
        return f"{self.severity}: {where}{self.message}"


def sorted_findings(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """The most severe first, otherwise in their order."""
    return tuple(sorted(findings, key=lambda finding: SEVERITIES.index(finding.severity)))


def serious(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Errors, and the warnings of a wrong file rather than of a difficult specimen."""
    return tuple(
        f
        for f in sorted_findings(findings)
        if f.severity == "error" or (f.severity == "warning" and f.code in SERIOUS)
    )
