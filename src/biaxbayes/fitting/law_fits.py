"""Fits of all laws to a specimen: residuals, mounting stretches, standard errors, comparison.

Two standard errors are computed at the least-squares fit of a law. That of the fit itself includes
the noise of all readings, the mounting one among them, and the smooth misfit of the law
(:mod:`~biaxbayes.fitting.smooth_misfit`). That of the posterior follows from its curvature, rows
weighted by their effective number. Their ratio is the factor by which an interval is widened. The
prior limits both errors of a material parameter: where the prior, and not the data, bounds an
interval, a misfit of the law does not widen it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from biaxbayes.fitting.constrained import FitSetup, minimum
from biaxbayes.fitting.effective_readings import effective_readings, has_smooth_misfit
from biaxbayes.fitting.residuals import BalancedMounting, LoadResiduals
from biaxbayes.fitting.smooth_misfit import pseudo_inverse, smooth_misfit
from biaxbayes.laws import DEFAULT_LAW, LAWS
from biaxbayes.options import FitOptions
from biaxbayes.parameters import mounting_names
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.thinning import averaged_specimen

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
    sd: np.ndarray  # (m, 2), standard errors: noise of all readings and smooth misfit
    smooth: bool  # signs of the residuals show a smooth misfit
    converged: bool
    reading_chi2: float = 0.0  # squared residuals of the mounting readings over their sd
    n_effective: float = np.inf  # effective number of readings
    discrepancy_sd: float = 0.0  # sd of the smooth misfit over the load
    # by parameter: error of the fit over that of the posterior, at least one
    widening: Mapping[str, float] = field(default_factory=dict)
    mounting_widening: np.ndarray | None = None  # (m, 2), the same without any prior


def fit_law(
    specimen: Specimen,
    law: str,
    *,
    mounting: str = "noisy",
    mounting_stretch: str = FitOptions.mounting_stretch,
    starts: int = 3,
    fixed: Mapping[str, float] | None = None,
    fibre_switch: bool = False,
    weighted: bool = True,
    prior_sd: Mapping[str, float] | None = None,
) -> LawFit:
    """Least-squares fit of a law to the measured load, with standard errors.

    Options as in :func:`.constrained_fit`. ``prior_sd`` (of logs, of cos^2 for angles) limits the
    errors whose ratio is ``widening``.
    """
    setup = FitSetup.from_options(
        specimen, mounting, mounting_stretch, fixed, law, fibre_switch=fibre_switch
    )
    points, _ = setup.starting_points(starts, 0, None)
    problem, descent = minimum(setup, points, weighted=weighted, compiled=False, **LAW_FIT_LIMITS)
    fitted = setup.constrained_result(problem, descent)
    without_errors = LawFit(
        law,
        fitted.rms,
        fitted.rmse_kPa,
        fitted.mounting_stretch,
        np.zeros_like(fitted.mounting_stretch),
        has_smooth_misfit(fitted.residuals),
        fitted.converged,
        n_effective=effective_readings(fitted.residuals).total,
    )
    if not np.isfinite(descent.cost):
        return without_errors
    with np.errstate(all="ignore"):
        return _with_errors(
            without_errors, setup, problem, descent.unknowns, prior_sd or {}, weighted=weighted
        )


def _with_errors(
    without_errors: LawFit,
    setup: FitSetup,
    problem: LoadResiduals,
    unknowns: np.ndarray,
    prior_sd: Mapping[str, float],
    *,
    weighted: bool,
) -> LawFit:
    law, data = setup.law, problem.data
    r, jacobian = problem.evaluate(unknowns)
    # unknowns on a bound are fixed there
    point, (lower, upper) = unknowns[: setup.free.size], setup.bounds
    inside = (point > lower) & (point < upper)
    interior = np.flatnonzero(np.concatenate([inside, np.ones(unknowns.size - point.size, bool)]))
    jacobian = jacobian[:, interior]
    if not (np.isfinite(r).all() and np.isfinite(jacobian).all()):
        return replace(without_errors, sd=np.full_like(without_errors.sd, np.inf))
    reading_sd = problem.reading_sd if isinstance(problem, BalancedMounting) else None
    noise_sd = setup.specimen.noise_sd
    relative_sd, full = smooth_misfit(data, r, jacobian, problem.scale, noise_sd, reading_sd)

    # covariance by the curvature of the posterior, with n readings, n_eff of them effective, and p
    # parameters:
    # C = (J^T J / unit^2 + J_m^T J_m)^-1,   unit^2 = |r|^2 n_eff / (n (n_eff - p) beta)
    count = 2 * data.group.size
    n_eff, beta = float(count), 1.0
    if weighted:
        readings = effective_readings(data.by_protocol(r[:count]))
        n_eff, beta = readings.total, readings.beta
    freedom = max(n_eff - setup.free.size, 1.0)
    unit = max(float(np.sqrt(r[:count] @ r[:count] / count * n_eff / freedom / beta)), 1e-12)
    root = pseudo_inverse(np.vstack([jacobian[:count] / unit, jacobian[count:]]))
    of_posterior = root @ root.T

    prior = _prior_precision(setup, point, interior, prior_sd)
    ratio = np.sqrt(
        np.diag(_add_precision(full, prior)) / np.diag(_add_precision(of_posterior, prior))
    )
    by_unknown = dict(zip(interior.tolist(), ratio.tolist(), strict=True))
    # parameters on a bound: the median ratio of the others
    median_ratio = float(np.median(ratio[interior < point.size])) if inside.any() else 1.0
    widening = {
        law.names[i]: _at_least_one(by_unknown.get(k, median_ratio))
        for k, i in enumerate(setup.free)
    }
    sd, mounting_widening = without_errors.sd, None
    if isinstance(problem, BalancedMounting):
        lm = problem.mounting(unknowns)
        slope = problem.log_stretch_jacobian(unknowns, lm)[:, interior]
        total, within = (
            (np.sqrt(np.einsum("ij,jk,ik->i", slope, c, slope)).reshape(lm.shape) * lm).T
            for c in (full, of_posterior)
        )
        sd = np.where(np.isfinite(total), total, np.inf)
        mounting_widening = np.vectorize(_at_least_one)(total / within)
    return replace(
        without_errors,
        sd=sd,
        reading_chi2=float(np.sum(r[count:] ** 2)),
        discrepancy_sd=relative_sd,
        widening=widening,
        mounting_widening=mounting_widening,
    )


def _prior_precision(
    setup: FitSetup, point: np.ndarray, interior: np.ndarray, prior_sd: Mapping[str, float]
) -> np.ndarray:
    """Prior precision of the unknowns inside their bounds; zero where no prior is given."""
    law, precision = setup.law, np.zeros(interior.size)
    for k, unknown in enumerate(interior):
        if unknown >= point.size or law.names[i := setup.free[unknown]] not in prior_sd:
            continue
        value, parameter = float(point[unknown]), law.parameters[i]
        slope = 1.0 / value if parameter.logarithmic else 1.0
        precision[k] = (slope / prior_sd[parameter.name]) ** 2
    return precision


def _add_precision(covariance: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """Covariance (C^-1 + P)^-1 = C - C P^1/2 (1 + P^1/2 C P^1/2)^-1 P^1/2 C with P diagonal."""
    root = np.sqrt(precision)
    C_root = covariance * root
    middle = np.eye(root.size) + root[:, None] * C_root
    limited: np.ndarray = covariance - C_root @ np.linalg.solve(middle, C_root.T)
    return limited


def _at_least_one(ratio: float) -> float:
    return max(float(ratio), 1.0) if np.isfinite(ratio) else 1.0


# --- all laws ------------------------------------------------------------------------------------

LAW_FIT_ROWS = 60
"""Rows of a protocol that the laws are fitted to, averaged."""
CLOSE_RMS = 1.15
"""Laws whose rms is within this factor of that of the best, or of the noise, fit a specimen."""
CLOSE_CHI2 = 6.0
"""So does a law whose chi-square lies within this of the best: 2 ln 20, odds of one to twenty."""
MIN_COMPARED_LAWS = 2
"""Mounting stretches are compared over the laws that fit, or over this many of the best where fewer
do: one law alone does not show how far laws differ."""
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

    @property
    def fitting(self) -> tuple[LawFit, ...]:
        """Fits about as close as the best, or not distinguishable from it by chi-square."""
        best = self.fits[0]
        least = max(best.rms, self.noise, 1e-300)
        out = []
        for f in self.fits:
            # n_eff (rms^2 / least^2 - 1) and the squared error of the mounting reading
            chi2 = best.n_effective * ((max(f.rms, least) / least) ** 2 - 1.0) + f.reading_chi2
            if f.rms <= CLOSE_RMS * least or chi2 - best.reading_chi2 <= CLOSE_CHI2:
                out.append(f)
        return tuple(out)

    @property
    def compared(self) -> tuple[LawFit, ...]:
        """Fits whose mounting stretches count: all that fit; the two best where only one does."""
        return (
            self.fitting
            if len(self.fitting) >= MIN_COMPARED_LAWS
            else self.fits[:MIN_COMPARED_LAWS]
        )

    @property
    def least_difference(self) -> float:
        """Smallest difference between rms values that counts."""
        return max(self.noise, MIN_RELATIVE_DIFFERENCE * self.peak)

    def to_frame(self, mounts: Sequence[str] = ("",)) -> pd.DataFrame:
        """One row per law: residuals, mounting stretches by name, their sd and widening."""
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
                    "independent_readings": f.n_effective,
                    "smooth_misfit": f.discrepancy_sd,
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
        f"{best.law} fits better than {law} (root mean square error {best.rmse_kPa:.2g} and "
        f"{given.rmse_kPa:.2g} kPa): see biaxbayes laws"
    )
    if best.rms < BETTER_RMS_RATIO * given.rms and given.rms - best.rms > fits.least_difference:
        return message
    return message if given not in fits.fitting and not best.smooth else ""


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
        specimen, [name for name in LAWS if name != DEFAULT_LAW], mounting=mounting, **QUICK
    )
    fits = (*default.fits, *(others.fits if others else ()))
    ordered = tuple(sorted(fits, key=lambda f: f.rms))
    return better_law_message(replace(default, fits=ordered), DEFAULT_LAW)
