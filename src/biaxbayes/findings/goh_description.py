"""Whether GOH can follow a specimen at all: the misfit of its best least-squares fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from biaxbayes.inference.fit import FitResult, fit
from biaxbayes.specimens.finding import Finding
from biaxbayes.specimens.specimen import Specimen

__all__ = ["goh_description", "poor_fit"]

POOR = 0.07
"""A misfit beyond this share of the largest load is no description."""
NOTICEABLE = 0.01
BEYOND_NOISE = 3.0
ROWS = 150


def goh_description(specimen: Specimen, *, starts: int = 4, seed: int = 0) -> Finding:
    """Say how closely the best GOH fit follows the record.

    The fit infers the mounting stretch where the file allows it; a tared file is fitted with
    its mounted state as reference.

    Parameters
    ----------
    specimen : Specimen
    starts, seed : int
        Of the least-squares fit.

    Returns
    -------
    Finding
        A warning where the misfit passes 7 % of the largest load, else a note.
    """
    method = "standard" if specimen.is_tared else "constrained"
    found = fit(thinned(specimen), method, starts=starts, seed=seed)
    misfits = [float(np.sqrt((part**2).mean())) for part in found.residuals]
    rms = float(np.sqrt(np.mean(np.concatenate(found.residuals) ** 2)))
    peak, unit, noise = specimen.peak_load, specimen.unit, specimen.noise_sd
    if not np.isfinite(rms):
        return Finding("goh-misfit", "warning", "the least-squares fit of GOH found no solution")
    size = f"{rms:.2g} {unit} rms, {100 * rms / peak:.1f} % of the largest load ({peak:.3g} {unit})"
    if len(misfits) > 1:
        worst = int(np.argmax(misfits))
        size += f", worst in {specimen.protocols[worst].name} ({misfits[worst]:.2g} {unit})"
    if rms > POOR * peak:
        return Finding(
            "goh-misfit",
            "warning",
            f"GOH does not describe this specimen: its best fit misses by {size}. Do not trust "
            "parameters of it",
        )
    if rms > NOTICEABLE * peak and rms > BEYOND_NOISE * noise:
        return Finding(
            "goh-misfit",
            "note",
            f"GOH follows this specimen roughly: its best fit misses by {size}, more than the "
            "load cell's noise; errors are correlated along the curves",
        )
    return Finding(
        "goh-misfit", "note", f"GOH follows this specimen: its best fit misses by {size}"
    )


def poor_fit(specimen: Specimen, fits: Sequence[FitResult]) -> str:
    """A warning where even the closest of some fits is no description; else empty.

    Parameters
    ----------
    specimen : Specimen
    fits : sequence of FitResult
    """
    misses = [float(np.sqrt(np.mean(np.concatenate(f.residuals) ** 2))) for f in fits]
    rms, peak = min(misses, default=0.0), specimen.peak_load
    if not rms > POOR * peak:
        return ""
    return (
        f"GOH does not describe this specimen: the closest fit misses by {rms:.2g} {specimen.unit} "
        f"rms, {100 * rms / peak:.1f} % of the largest load. Do not trust its parameters"
    )


def thinned(specimen: Specimen, rows: int = ROWS) -> Specimen:
    """The same specimen with at most so many stretched rows a protocol, the rest rows kept."""
    protocols = []
    for p in specimen.protocols:
        moving = np.arange(p.rest_rows, p.rows)
        if moving.size <= rows:
            protocols.append(p)
            continue
        kept = moving[np.unique(np.linspace(0, moving.size - 1, rows).round().astype(int))]
        index = np.concatenate([np.arange(p.rest_rows), kept])
        time = None if p.time_s is None else p.time_s[index]
        curves = (p.stretch_x, p.stretch_y, p.load_x, p.load_y)
        x, y, fx, fy = (curve[index] for curve in curves)
        protocols.append(replace(p, stretch_x=x, stretch_y=y, load_x=fx, load_y=fy, time_s=time))
    # The scatter of neighbouring rows is lost by thinning: state it.
    noise = specimen.noise_sd or None
    return replace(specimen, protocols=tuple(protocols), load_noise=noise)
