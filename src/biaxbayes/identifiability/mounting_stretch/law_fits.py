"""All laws fitted to one record under the same mounting constraint, and how they differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from biaxbayes.fitting.law_fit import LawFit, fit_law
from biaxbayes.laws import DEFAULT_LAW, LAWS
from biaxbayes.parameters import mounting_names
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.thinning import averaged_specimen

if TYPE_CHECKING:
    import pandas as pd

ROWS = 60
"""Rows of a protocol that the laws are fitted to, averaged."""
CLOSE_RMS = 1.15
"""Laws whose misfit is within this factor of that of the best, or of the noise, fit a record."""
CLOSE_CHI2 = 6.0
"""So does a law whose chi-square lies within this of the best: 2 ln 20, odds of one to twenty."""
FEWEST = 2
"""Mounting stretches are compared over the laws that fit, and over this many of the best at least:
one law alone does not show how far laws differ."""
BETTER = 0.75
"""Another law describes a record distinctly better where it misses by less than this share."""
LEAST_SHARE = 2e-3
"""Share of the largest load: about the error that the calibration of a load cell leaves."""


@dataclass(frozen=True)
class LawFits:
    """Fits of all laws to one record."""

    fits: tuple[LawFit, ...]  # the best first
    noise: float  # sd of a reading by the load cell, unit of the specimen
    peak: float  # largest load

    @classmethod
    def from_fits(cls, fits: Sequence[LawFit], specimen: Specimen) -> LawFits:
        """Fits of laws to a specimen, at least one, in any order."""
        ordered = tuple(sorted(fits, key=lambda f: f.rms))
        return cls(ordered, specimen.noise_sd, specimen.peak_load)

    def __getitem__(self, law: str) -> LawFit | None:
        return next((f for f in self.fits if f.law == law), None)

    @property
    def fitting(self) -> tuple[LawFit, ...]:
        """Fits about as close as the best, or not distinguishable from it by chi-square."""
        best = self.fits[0]
        least = max(best.rms, self.noise, 1e-300)

        def chi2(f: LawFit) -> float:
            # n_eff (rms^2 / s^2 - 1) and the squared error of the mounting reading
            return best.independent * ((max(f.rms, least) / least) ** 2 - 1.0) + f.reading_chi2

        return tuple(
            f
            for f in self.fits
            if f.rms <= CLOSE_RMS * least or chi2(f) - best.reading_chi2 <= CLOSE_CHI2
        )

    @property
    def compared(self) -> tuple[LawFit, ...]:
        """Fits whose mounting stretches count: all that fit, the two best at least."""
        return self.fits[
            : max(FEWEST, *(i + 1 for i, f in enumerate(self.fits) if f in self.fitting))
        ]

    @property
    def least_difference(self) -> float:
        """Smallest difference between misfits that counts."""
        return max(self.noise, LEAST_SHARE * self.peak)

    def to_frame(self, mounts: Sequence[str] = ("",)) -> pd.DataFrame:
        """One row per law: misfits, mounting stretches by name, their sd and widening."""
        from pandas import DataFrame

        return DataFrame(
            [
                {
                    "law": f.law,
                    "fits": f in self.fitting,
                    "converged": f.converged,
                    "misses_smoothly": f.smooth,
                    "rms": f.rms,
                    "rmse_kPa": f.rmse_kPa,
                    "reading_chi2": f.reading_chi2,
                    "independent_readings": f.independent,
                    "smooth_misfit": f.misfit,
                    **{
                        key: float(values[i, axis])
                        for i, state in enumerate(mounts)
                        for axis, name in enumerate(mounting_names("stretch", state))
                        for key, values in (
                            (name, f.mounting_stretch),
                            (f"{name}_sd", f.sd),
                            (f"{name}_widening", f.mounting_widening),
                        )
                        if values is not None
                    },
                    **{f"{name}_widening": value for name, value in f.widening.items()},
                }
                for f in self.fits
            ]
        )


def fit_laws(
    specimen: Specimen,
    laws: Sequence[str] = tuple(LAWS),
    *,
    mounting: str = "noisy",
    mounting_stretch: str = "shared",
    rows: int = ROWS,
    starts: int = 3,
    own: Mapping[str, Mapping[str, Any]] | None = None,
) -> LawFits | None:
    """Fit laws to an averaged record; `own` are further arguments of `fit_law` by law."""
    data = averaged_specimen(specimen, rows)
    common: dict[str, Any] = {
        "mounting": mounting,
        "mounting_stretch": mounting_stretch,
        "starts": starts,
    }
    fits = [fit_law(data, law, **common, **(own or {}).get(law, {})) for law in laws]
    usable = [f for f in fits if np.isfinite(f.rms) and np.isfinite(f.mounting_stretch).all()]
    return LawFits.from_fits(usable, specimen) if usable else None


def better_law_message(fits: LawFits, law: str) -> str:
    """Text on a law that fits distinctly better, or without smooth misfit; else empty."""
    best, own = fits.fits[0], fits[law]
    if own is None or best.law == law:
        return ""
    message = (
        f"{best.law} fits better than {law} (root mean square error {best.rmse_kPa:.2g} and "
        f"{own.rmse_kPa:.2g} kPa): see biaxbayes laws"
    )
    if best.rms < BETTER * own.rms and own.rms - best.rms > fits.least_difference:
        return message
    return message if own not in fits.fitting and not best.smooth else ""


QUICK_ROWS, QUICK_STARTS = 20, 2
"""Enough to distinguish laws that differ distinctly."""


def quick_better_law(specimen: Specimen) -> str:
    """Words on a law that describes a record distinctly better, by quick fits; else empty."""
    mounting = "ignored" if specimen.is_tared else "noisy"

    def fitted(laws: Sequence[str]) -> LawFits | None:
        return fit_laws(specimen, laws, mounting=mounting, rows=QUICK_ROWS, starts=QUICK_STARTS)

    own = fitted((DEFAULT_LAW,))
    # no law misses by less than the noise
    if own is None or own.fits[0].rms - own.noise < own.least_difference:
        return ""
    others = fitted(tuple(name for name in LAWS if name != DEFAULT_LAW))
    fits = (*own.fits, *(others.fits if others else ()))
    ordered = tuple(sorted(fits, key=lambda f: f.rms))
    return better_law_message(replace(own, fits=ordered), DEFAULT_LAW)
