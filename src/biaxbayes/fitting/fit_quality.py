"""Quality of the fit of a law to a record: its misfit, and exchanged loads of x and y."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from biaxbayes.evenly import evenly_chosen
from biaxbayes.fitting.constrained import FitSetup
from biaxbayes.fitting.fit import fit
from biaxbayes.fitting.fit_result import POOR_MISFIT, FitResult, misfit_sentence, root_mean_square
from biaxbayes.options import FitOptions
from biaxbayes.specimens.check import Finding
from biaxbayes.specimens.specimen import Specimen

NOTICEABLE_MISFIT = 0.01
"""Fraction of the largest load, and times the noise, beyond which exchanged columns are tried."""
BEYOND_NOISE = 3.0
MAX_FIT_ROWS = 150
QUICK_STARTS = 4


def quick_fit(
    specimen: Specimen, *, law: str = FitOptions.law, fibre_switch: bool = False
) -> FitResult:
    """The best fit to all rest rows and at most 150 stretched ones of each protocol.

    A tared file is fitted without a mounting stretch.
    """
    protocols = []
    for p in specimen.protocols:
        moving = np.arange(p.rest_rows, p.rows)
        chosen = moving[evenly_chosen(moving.size, MAX_FIT_ROWS)]
        index = np.concatenate([np.arange(p.rest_rows), chosen])
        time = None if p.time_s is None else p.time_s[index]
        protocols.append(replace(p.at_rows(index), time_s=time))
    reduced = replace(specimen, protocols=tuple(protocols)).with_noise_of(specimen)
    if specimen.is_tared:
        return fit(reduced, "standard", starts=QUICK_STARTS, law=law, fibre_switch=fibre_switch)
    setup = FitSetup.from_options(reduced, law=law, fibre_switch=fibre_switch)
    return setup.fitted(QUICK_STARTS, compiled=False)


def misfit_finding(specimen: Specimen, best: FitResult) -> Finding:
    """Finding on the misfit of the best fit: a warning beyond 7 % of the largest load."""
    if not np.isfinite(best.rms):
        text = f"the least-squares fit of {best.material.law.short_name} has no solution"
        return Finding("misfit", "warning", text)
    text, poor = _misfit(specimen, best)
    if len(best.residuals) > 1:
        misfits = [float(np.sqrt((part**2).mean())) for part in best.residuals]
        text += f"; most in {specimen.protocols[int(np.argmax(misfits))].name}"
    return Finding("misfit", "warning" if poor else "note", text + poor)


def poor_fit(specimen: Specimen, fits: Sequence[FitResult]) -> str:
    """A warning where even the best of several fits is too poor to use; else empty."""
    text, poor = _misfit(specimen, min(fits, key=lambda f: f.rms))
    return text + poor if poor else ""


def _misfit(specimen: Specimen, fit: FitResult) -> tuple[str, str]:
    """The misfit as a sentence, and another one if it is too large to use the parameters."""
    law_name, peak = fit.material.law.short_name, specimen.peak_load
    text = misfit_sentence(law_name, fit.rms, specimen.noise_sd, peak, specimen.unit)
    if not fit.rms > POOR_MISFIT * peak:
        return text, ""
    return text, (
        f". {law_name} does not describe this specimen (a misfit of more than "
        f"{100 * POOR_MISFIT:g} % of the largest load): do not use its parameters"
    )


SWAPPED = 0.6
"""Exchanged columns are reported where they leave less than this fraction of the misfit. The
largest was 0.06 among 36 virtual tests of three ratios, and 0.48 for an aorta with a misfit of
4 %."""


def swapped_columns(
    specimen: Specimen,
    residuals: Sequence[np.ndarray],
    *,
    law: str = FitOptions.law,
    fibre_switch: bool = False,
    best: FitResult | None = None,
) -> Finding | None:
    """A finding if a fit with `residuals` is poor and exchanging x and y of the load helps."""
    if not specimen.experiment.is_biaxial:
        return None
    specimen, peak = replace(specimen, further=()), specimen.peak_load
    bad = max(NOTICEABLE_MISFIT * peak, BEYOND_NOISE * specimen.noise_sd)
    if not root_mean_square(residuals[: len(specimen.protocols)]) > bad:
        return None
    other = replace(
        specimen,
        protocols=tuple(replace(p, load_x=p.load_y, load_y=p.load_x) for p in specimen.protocols),
    )
    best = best or quick_fit(specimen, law=law, fibre_switch=fibre_switch)
    rms = best.rms
    exchanged = quick_fit(other, law=law, fibre_switch=fibre_switch).rms
    if not (rms > bad and exchanged < SWAPPED * rms):
        return None
    return Finding(
        "swapped",
        "warning",
        f"x and y of the load seem to be swapped: the best fit misses by {100 * rms / peak:.2g} % "
        f"of the largest load, with the two columns exchanged by {100 * exchanged / peak:.2g} %",
    )
