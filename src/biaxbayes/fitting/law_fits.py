"""Least-squares fits of several laws to one specimen, and which of them describe it.

Only :data:`CANDIDATE_LAWS` are fitted beside the law of a run, so that a law that is added to the
package does not change the verdicts of others unnoticed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from biaxbayes.fitting.constrained import FitSetup
from biaxbayes.fitting.residuals import has_smooth_misfit
from biaxbayes.laws import DEFAULT_LAW, law_named
from biaxbayes.parameters import mounting_names
from biaxbayes.specimens.averaging import averaged_specimen
from biaxbayes.specimens.specimen import Specimen

if TYPE_CHECKING:
    import pandas as pd

# --- one law -------------------------------------------------------------------------------------

LAW_FIT_LIMITS: dict[str, Any] = {"finalists": 2, "steps": 100, "tolerance": 1e-8}
"""Limits of fits that are compared with one another. A flat valley of Fung's or Lee-Sacks'
law takes 500 steps to its floor; stopped like this, the rms of 56 fits to the shipped specimens lay
at most 3 % above it, and the mounting stretches within a tenth of their sd."""


@dataclass(frozen=True, eq=False)
class LawFit:
    """Fit of a law to a specimen."""

    law: str
    rms: float  # of the load residuals, unit of the specimen
    rmse_kPa: float  # of the Cauchy stress
    mounting_stretch: np.ndarray  # (m, 2): one row, or one per protocol
    smooth: bool  # signs of the residuals show a smooth misfit
    converged: bool


def fit_law(specimen: Specimen, law: str, *, starts: int = 3, **options: Any) -> LawFit:
    """Least-squares fit of a law to the load; options as in :meth:`.FitSetup.from_options`."""
    setup = FitSetup.from_options(specimen, law=law, **options)
    fitted = setup.fitted(starts, compiled=False, **LAW_FIT_LIMITS)
    return LawFit(
        law_named(law).name,
        fitted.rms,
        fitted.rmse_kPa,
        fitted.mounting_stretch,
        has_smooth_misfit(fitted.residuals),
        fitted.converged,
    )


# --- several laws --------------------------------------------------------------------------------

CANDIDATE_LAWS = ("goh", "four-fibre", "fung", "goh-exponential", "holzapfel-2005", "lee-sacks")
"""Laws that are fitted in every run, beside its own."""
LAW_FIT_ROWS = 60
"""Rows of a protocol that the laws are fitted to, averaged."""
CLOSE_RMS = 1.15
"""Laws whose rms is within this factor of that of the best, or of the noise, fit a specimen."""
BETTER_RMS_RATIO = 0.75
"""Another law fits a specimen distinctly better where its rms is less than this fraction."""
MIN_RELATIVE_DIFFERENCE = 2e-3
"""Fraction of the largest load: about the error that the calibration of a load cell leaves."""


@dataclass(frozen=True)
class LawFits:
    """Fits of all laws to one specimen."""

    fits: tuple[LawFit, ...]  # the best first
    noise: float  # sd of a reading by the load cell, unit of the specimen
    peak: float  # largest load

    def __getitem__(self, law: str) -> LawFit | None:
        return next((f for f in self.fits if f.law == law), None)

    def as_good_as(self, law: str) -> tuple[LawFit, ...]:
        """Other laws that describe the record about as well as a law, or better."""
        given = self[law]
        if given is None:
            return ()
        limit = CLOSE_RMS * max(given.rms, self.noise)
        return tuple(f for f in self.fits if f.law != law and f.rms <= limit)

    @property
    def least_difference(self) -> float:
        """Smallest difference between rms values that counts."""
        return max(self.noise, MIN_RELATIVE_DIFFERENCE * self.peak)

    def to_frame(self, mounts: Sequence[str] = ("",)) -> pd.DataFrame:
        """One row per law: residuals, and mounting stretches by name."""
        from pandas import DataFrame

        return DataFrame(
            [
                {
                    "law": f.law,
                    "converged": f.converged,
                    "misses_smoothly": f.smooth,
                    "rms": f.rms,
                    "rmse_kPa": f.rmse_kPa,
                    **{
                        name: float(f.mounting_stretch[i, axis])
                        for i, mount in enumerate(mounts)
                        for axis, name in enumerate(mounting_names("stretch", mount))
                    },
                }
                for f in self.fits
            ]
        )


def fit_laws(
    specimen: Specimen,
    laws: Sequence[str] = CANDIDATE_LAWS,
    *,
    mounting: str = "noisy",
    mounting_stretch: str = "shared",
    rows: int = LAW_FIT_ROWS,
    starts: int = 3,
    options_by_law: Mapping[str, Mapping[str, Any]] | None = None,
) -> LawFits | None:
    """Fit laws to an averaged record; `options_by_law` are further arguments of `fit_law`."""
    data = averaged_specimen(specimen, rows)
    common: dict[str, Any] = {
        "mounting": mounting,
        "mounting_stretch": mounting_stretch,
        "starts": starts,
    }
    fits = [fit_law(data, law, **common, **(options_by_law or {}).get(law, {})) for law in laws]
    usable = [f for f in fits if np.isfinite(f.rms) and np.isfinite(f.mounting_stretch).all()]
    ordered = tuple(sorted(usable, key=lambda f: f.rms))
    return LawFits(ordered, specimen.noise_sd, specimen.peak_load) if usable else None


def better_law_message(fits: LawFits, law: str) -> str:
    """Text on a law that fits distinctly better, or without smooth misfit; else empty."""
    best, given = fits.fits[0], fits[law]
    if given is None or best.law == law:
        return ""
    message = (
        f"{best.law} describes the record better than {law}: sample again with --law {best.law}"
    )
    if best.rms < BETTER_RMS_RATIO * given.rms and given.rms - best.rms > fits.least_difference:
        return message
    # a law without smooth misfit where this one has it
    close = given.rms <= CLOSE_RMS * max(best.rms, fits.noise)
    return message if not close and not best.smooth else ""


QUICK: dict[str, Any] = {"rows": 20, "starts": 2}
"""Enough to distinguish laws that differ distinctly."""


def quick_better_law(specimen: Specimen) -> str:
    """Text on a law that fits a specimen distinctly better, by quick fits; else empty."""
    mounting = "ignored" if specimen.is_tared else "noisy"
    default = fit_laws(specimen, (DEFAULT_LAW,), mounting=mounting, **QUICK)
    # no law can fit better than the noise
    if default is None or default.fits[0].rms - default.noise < default.least_difference:
        return ""
    others = fit_laws(
        specimen,
        [name for name in CANDIDATE_LAWS if name != DEFAULT_LAW],
        mounting=mounting,
        **QUICK,
    )
    fits = (*default.fits, *(others.fits if others else ()))
    ordered = tuple(sorted(fits, key=lambda f: f.rms))
    return better_law_message(replace(default, fits=ordered), DEFAULT_LAW)
