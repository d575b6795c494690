"""A finding about a specimen file: what a user should know before trusting a fit of it."""

from __future__ import annotations

from dataclasses import asdict, dataclass

__all__ = ["Finding"]


@dataclass(frozen=True)
class Finding:
    """One thing that was noticed.

    Attributes
    ----------
    code : str
        Stable short name, such as ``tared``.
    severity : {"warning", "note"}
        A warning can change what a fit means; a note explains.
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
