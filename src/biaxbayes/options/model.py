"""Options of the statistical model, and of the deterministic fits."""

from __future__ import annotations

import numbers
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

from biaxbayes.errors import InputError
from biaxbayes.laws import DEFAULT_LAW, LAWS, law_named
from biaxbayes.options.option import Options, option, stated

if TYPE_CHECKING:
    from biaxbayes.laws.law import Law
    from biaxbayes.model.priors import Prior, Tie

INFERRING = ("noisy", "exact", "free")
"""Ways in which the mounting force enters where the mounting stretch is an unknown."""
MOUNTING = (*INFERRING, "ignored", "zeroed")
NOISE = ("effective", "systematic", "independent")
MOUNTING_STRETCH = ("shared", "per-protocol")
FIT_WORDS = {
    "standard": "takes the mounted state as unloaded, forces as read",
    "zeroed": "the same with the mounting force subtracted, as after a tare",
    "fip": "finds the mounting stretch by the force balance, refits, and repeats (method paper)",
    "linden": "takes the mounting stretches as two more parameters of the stress fit",
    "constrained": "fits the forces in one go, the mounting stretch from the force balance",
}
"""Deterministic fits, and what each does."""
FIT_METHODS = tuple(FIT_WORDS)
WHICH_FIT = (
    "Report constrained: it fits what was measured, as 'sample' does. Give fip to compare with the "
    "method paper, linden with work that used it; standard or zeroed only where the mounting force "
    "is lost, and say so. No fit has an interval: 'biaxbayes sample' gives it."
)
"""Which fit to report when."""
ALL_FITS = "all"
ALL_ROWS, AUTOMATIC = "none", "auto"


# --- the statistical model -----------------------------------------------------------------------


@dataclass(frozen=True)
class Settings(Options):
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
    law : str
        Name of the material law.
    fibre_switch : bool
        Fibres carry no compression, for laws that leave it open.
    mounting_sd : float
        Sd of the prior of the mounting stretches, about 1, where nothing else states one.
    thin : int
        Rows of a protocol that longer records are averaged to; 0 keeps all.
    priors : mapping
        Overrides of the default priors: a Prior, a number (fixed) or a Tie.
    """

    mounting: str = option("noisy", "How the mounting force enters.", choices=MOUNTING)
    noise: str = option(
        "effective",
        "Weigh the rows by the independent readings they are worth, or not.",
        choices=NOISE,
    )
    mounting_stretch: str = option(
        "shared", "One mounted state for all protocols, or one each.", choices=MOUNTING_STRETCH
    )
    noise_growth: bool = option(False, "Let the noise sd grow with the load.")
    law: str = option(DEFAULT_LAW, "The material law.", choices=tuple(LAWS))
    fibre_switch: bool = option(
        False, "Fibres carry no compression (Abaqus, FEBio); for laws that leave it open."
    )
    mounting_sd: float = option(
        0.1,
        "Sd of the prior of the mounting stretches, about 1.",
        least=0.0,
        most=10.0,
        inside=True,
    )
    thin: int = 0
    priors: Mapping[str, Prior | float | Tie] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.priors is None:
            object.__setattr__(self, "priors", {})
        if not isinstance(self.priors, Mapping):
            raise InputError("priors must be a table", remedy="one key a parameter")

    @property
    def material_law(self) -> Law:
        """The material law."""
        return law_named(self.law, fibre_switch=self.fibre_switch)

    @property
    def infers_mounting(self) -> bool:
        """Whether the mounting stretch is an unknown."""
        return self.mounting in INFERRING

    @property
    def fixed(self) -> dict[str, float]:
        """Fixed parameters, natural units."""
        return {k: float(v) for k, v in self.priors.items() if isinstance(v, int | float)}

    def keywords(self) -> dict[str, Any]:
        """As keyword arguments of :class:`~biaxbayes.model.posterior.Posterior`."""
        return {f.name: getattr(self, f.name) for f in fields(self)}


@dataclass(frozen=True)
class ModelOptions(Settings):
    """The same as it is asked for, before a specimen has settled the thinning.

    Attributes
    ----------
    thin : int, "none" or "auto"
        As in :func:`~biaxbayes.specimens.thinning.rows_to_keep`.
    """

    thin: int | str = option(  # type: ignore[assignment]
        AUTOMATIC,
        "Average longer protocols to N rows; auto: above 200 rows to 100, for effective "
        "noise alone.",
        metavar=f"N|{ALL_ROWS}|{AUTOMATIC}",
    )

    @classmethod
    def check(cls, name: str, value: Any, where: str = "", file: object = None) -> None:
        """As :meth:`Options.check`; a number of rows may be text, as the command line has it."""
        super().check(name, value, where, file)
        if name == "thin" and value not in (ALL_ROWS, AUTOMATIC):
            text = str(value) if isinstance(value, str | numbers.Integral) else ""
            if isinstance(value, bool) or not text.isdecimal() or len(text) > 15:
                raise InputError(
                    f"{where}thin must be a number of rows, {ALL_ROWS} or {AUTOMATIC}", file=file
                )


@dataclass(frozen=True)
class ProfileOptions(ModelOptions):
    """The same for a profile likelihood, which the mounting stretches cannot be free in."""

    mounting: str = option(
        Settings.mounting,
        stated(Settings)["mounting"].words,
        choices=tuple(m for m in MOUNTING if m != "free"),
    )


# --- deterministic fits --------------------------------------------------------------------------


@dataclass(frozen=True)
class FitOptions(Options):
    """Deterministic fits.

    Attributes
    ----------
    starts, seed : int
        Starting points, and the seed of the random ones.
    fixed : mapping, optional
        Values held, by the law's parameters in their own units.
    mounting_stretch : {"shared", "per-protocol"}
    law : str
    fibre_switch : bool
    initial : Material, optional
        A further starting point; with it ``starts`` may be 0.
    """

    starts: int = option(8, least=1, most=512, shown=True)
    seed: int = option(0, least=0, shown=True)
    fixed: Mapping[str, float] | None = None
    mounting_stretch: str = option(
        Settings.mounting_stretch,
        stated(Settings)["mounting_stretch"].words,
        choices=MOUNTING_STRETCH,
    )
    law: str = option(Settings.law, stated(Settings)["law"].words, choices=tuple(LAWS))
    fibre_switch: bool = option(False, stated(Settings)["fibre_switch"].words)
    initial: Any = None

    def __post_init__(self) -> None:
        for name in stated(type(self)):
            if not (name == "starts" and self.initial is not None and self.starts == 0):
                self.check(name, getattr(self, name))
