"""What the user chose: how the mounted state, the noise and the priors enter the posterior."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from biaxbayes.errors import InputError
from biaxbayes.inference.priors import Prior, Tie

__all__ = ["MOUNTING", "MOUNTING_STRETCH", "NOISE", "Settings"]

MOUNTING = ("noisy", "exact", "free", "ignored", "zeroed")
NOISE = ("effective", "systematic", "independent")
MOUNTING_STRETCH = ("shared", "per-protocol")


@dataclass(frozen=True)
class Settings:
    """Options of the statistical model.

    Attributes
    ----------
    mounting : {"noisy", "exact", "free", "ignored", "zeroed"}
        How the mounting force enters.
    noise : {"effective", "systematic", "independent"}
        Tempered by n_eff / n, by that with a smooth misfit as one error a curve, or not.
    mounting_stretch : {"shared", "per-protocol"}
    noise_growth : bool
        Whether the sd grows with the load.
    fibre_switch : bool
    thin : int
        Rows of a protocol that longer records are averaged to; 0 keeps all.
    priors : mapping
        Overrides of the default priors: a Prior, a number (fixed) or a Tie.
    """

    mounting: str = "noisy"
    noise: str = "effective"
    mounting_stretch: str = "shared"
    noise_growth: bool = False
    fibre_switch: bool = False
    thin: int = 0
    priors: Mapping[str, Prior | float | Tie] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, value, allowed in (
            ("mounting", self.mounting, MOUNTING),
            ("noise", self.noise, NOISE),
            ("mounting_stretch", self.mounting_stretch, MOUNTING_STRETCH),
        ):
            if value not in allowed:
                raise InputError(f"{name} must be one of {', '.join(allowed)}, not {value!r}")

    @property
    def infers_mounting(self) -> bool:
        """Whether the mounting stretch is an unknown."""
        return self.mounting in ("noisy", "exact", "free")

    @property
    def fixed(self) -> dict[str, float]:
        """Fixed parameters, natural units."""
        return {k: float(v) for k, v in self.priors.items() if isinstance(v, int | float)}
