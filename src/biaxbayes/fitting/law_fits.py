"""Least-squares fits of several laws to one specimen: information on which no run depends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from biaxbayes.errors import two_digits
from biaxbayes.fitting.constrained import FitSetup
from biaxbayes.fitting.fit_result import FitResult, root_mean_square
from biaxbayes.fitting.least_squares import Descent
from biaxbayes.fitting.residuals import has_smooth_misfit
from biaxbayes.laws import DEFAULT_LAW, law_named
from biaxbayes.parameters import mounting_names
from biaxbayes.specimens.averaging import average_rows, averaged_specimen
from biaxbayes.specimens.specimen import Specimen

if TYPE_CHECKING:
    import pandas as pd

LAW_FIT_ROWS = 60
"""Rows of a protocol that the laws are fitted to, averaged."""
LAW_FIT_LIMITS: dict[str, Any] = {"finalists": 2, "steps": 100, "tolerance": 1e-8}
"""Limits of fits that are compared with one another. A flat valley of Fung's or Lee-Sacks'
law takes 500 steps to its floor; stopped like this, the rms of 56 fits to the shipped specimens lay
at most 3 % above it, and the mounting stretches within a tenth of their sd."""
CANDIDATE_LAWS = ("goh", "four-fibre", "fung", "goh-exponential", "holzapfel-2005", "lee-sacks")
"""Laws that are fitted in every run, beside its own."""
BETTER_RMS_RATIO = 0.75
"""Another law fits a specimen distinctly better where its rms is less than this fraction."""
MIN_RELATIVE_DIFFERENCE = 2e-4
"""Fraction of the largest load below which a difference between laws does not count."""


@dataclass(frozen=True, eq=False)
class LawFit:
    """Fit of a law to a specimen."""

    law: str
    key: str  # name of a law of the program, or text of a user's own
    rms: float  # of the load residuals, unit of the specimen
    rmse_kPa: float  # of the Cauchy stress
    mounting_stretch: np.ndarray  # (m, 2): one row, or one per protocol
    smooth: bool  # signs of the residuals show a smooth misfit
    converged: bool


@dataclass(frozen=True)
class LawFits:
    """Fits of all laws to one specimen."""

    fits: tuple[LawFit, ...]  # the best first
    noise: float  # sd of a mean of rows, as the laws were fitted to, unit of the specimen
    peak: float  # largest load

    def __getitem__(self, law: str) -> LawFit | None:
        return next((f for f in self.fits if f.law == law), None)

    @property
    def least_difference(self) -> float:
        """Smallest difference between rms values that counts."""
        return max(self.noise, MIN_RELATIVE_DIFFERENCE * self.peak)

    def to_frame(self, mounts: Sequence[str] = ("",)) -> pd.DataFrame:
        """One row per law: residuals, and mounting stretches by name."""
        from pandas import DataFrame

        columns = ["law", "converged", "misses_smoothly", "rms", "rmse_kPa"]
        columns += [name for mount in mounts for name in mounting_names("stretch", mount)]
        rows = [
            (f.law, f.converged, f.smooth, f.rms, f.rmse_kPa)
            + tuple(f.mounting_stretch[: len(mounts)].ravel().tolist())
            for f in self.fits
        ]
        return DataFrame(rows, columns=columns)


def fit_laws(
    specimen: Specimen,
    laws: Sequence[str] = CANDIDATE_LAWS,
    *,
    rows: int = LAW_FIT_ROWS,
    starts: int = 3,
    options_by_law: Mapping[str, Mapping[str, Any]] | None = None,
    known: Mapping[str, FitResult] | None = None,
    **options: Any,
) -> LawFits | None:
    """Fit laws to averaged rows and compare them with all; ``known`` fits stay.

    Options as in :meth:`.FitSetup.from_options`, for all laws and for one.
    """
    averaged, fits = averaged_specimen(specimen, rows), []
    for law in laws:
        fitted = (known or {}).get(law)
        if fitted is None:
            own = options | dict((options_by_law or {}).get(law, {}))
            setup, of_all = (FitSetup.from_options(s, law=law, **own) for s in (averaged, specimen))
            fitted = setup.fitted(starts, compiled=False, compared=of_all, **LAW_FIT_LIMITS)
        stretch, smooth = fitted.mounting_stretch, has_smooth_misfit(fitted.residuals)
        if np.isfinite(fitted.rms) and np.isfinite(stretch).all():
            name = law_named(law).name
            fits.append(
                LawFit(name, law, fitted.rms, fitted.rmse_kPa, stretch, smooth, fitted.converged)
            )
    ordered = tuple(sorted(fits, key=lambda f: f.rms))
    # a mean of k rows has noise s0 / sqrt(k)
    noise = specimen.noise_sd / np.sqrt(np.mean(average_rows(specimen, rows).weight))
    return LawFits(ordered, float(noise), specimen.peak_load) if fits else None


def better_law(
    specimen: Specimen,
    fits: LawFits,
    law: str,
    *,
    mounting: str = "noisy",
    mounting_stretch: str = "shared",
    options_by_law: Mapping[str, Mapping[str, Any]] | None = None,
) -> str:
    """Text on a law that fits distinctly better and, with several protocols, predicts better.

    A law with more parameters follows a misfit better, which is no reason to prefer it: each
    protocol is left out once, and both laws have to predict it. Empty if no law is better.
    """
    best, given = fits.fits[0], fits[law]
    if given is None or best.rms >= BETTER_RMS_RATIO * given.rms:
        return ""
    if given.rms - best.rms <= fits.least_difference:
        return ""
    peak = max(fits.peak, 1e-300)
    rms, own_rms = (f"{two_digits(100.0 * f.rms / peak)} %" for f in (best, given))
    other_name, own_name = (law_named(f.key).short_name for f in (best, given))
    text = (
        f"another law, {other_name}, misses the record by {rms} of the largest load, {own_name} "
        f"by {own_rms}"
    )
    remedy = f"`biaxbayes sample --law {best.law}` says what it changes"
    if len(specimen.protocols) == 1 or mounting_stretch != "shared":
        return f"{text}; no further protocol shows which predicts better: {remedy}"
    data = averaged_specimen(specimen, LAW_FIT_ROWS)
    other, own = (
        left_out_rms(data, f.key, mounting=mounting, **(options_by_law or {}).get(f.key, {})) / peak
        for f in (best, given)
    )
    if not other < own:
        return ""
    left_out = " and ".join(f"{two_digits(100.0 * v)} %" for v in (other, own))
    return f"{text}; they predict a protocol left out to {left_out}: {remedy}"


def left_out_rms(specimen: Specimen, law: str, *, starts: int = 2, **options: Any) -> float:
    """Root mean square load residual of each protocol at the fit to all others."""
    residuals: list[np.ndarray] = []
    for i in range(len(specimen.protocols)):
        others = tuple(p for k, p in enumerate(specimen.protocols) if k != i)
        of_others, setup = (
            FitSetup.from_options(replace(specimen, protocols=part, further=()), law=law, **options)
            for part in (others, (specimen.protocols[i],))
        )
        fitted = of_others.fitted(starts, compiled=False, **LAW_FIT_LIMITS)
        point = setup.law.to_fit_coordinates(fitted.material.values)
        nothing = Descent(point, 0.0, 0, True)
        residuals += setup.result("", point, fitted.mounting_stretch, nothing).residuals
    return root_mean_square(residuals)


QUICK: dict[str, Any] = {"rows": 20, "starts": 2}
"""Enough to distinguish laws that differ distinctly."""


def quick_better_law(specimen: Specimen) -> str:
    """Text on a law that describes a specimen distinctly better, by quick fits; else empty."""
    mounting = "ignored" if specimen.is_tared else "noisy"
    default = fit_laws(specimen, (DEFAULT_LAW,), mounting=mounting, **QUICK)
    # no law can fit better than the noise
    if default is None or default.fits[0].rms - default.noise < default.least_difference:
        return ""
    other_laws = [name for name in CANDIDATE_LAWS if name != DEFAULT_LAW]
    others = fit_laws(specimen, other_laws, mounting=mounting, **QUICK)
    fits = (*default.fits, *(others.fits if others else ()))
    ordered = tuple(sorted(fits, key=lambda f: f.rms))
    return better_law(specimen, replace(default, fits=ordered), DEFAULT_LAW, mounting=mounting)
