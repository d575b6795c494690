"""Posterior predictive checks: residuals of the law, and for which tested paths it fails."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.special import ndtr

from biaxbayes.errors import load_text
from biaxbayes.evenly import evenly_chosen
from biaxbayes.fitting.fit_result import EXPLAINED
from biaxbayes.laws import DEFAULT_LAW, law_named
from biaxbayes.model.posterior import Posterior
from biaxbayes.prediction.tissue import Tissue

# --- residuals of the model compared with the load cell's noise ----------------------------------

SMOOTH_RUNS_Z = -3.0
"""Runs fewer than expected by this many standard deviations are not an accident."""
BAND_TAILS = (0.05, 0.95)
LARGE_RESIDUAL = 0.05
"""Fraction of the peak load beyond which a residual matters to whoever uses the parameters."""
NOISE_SDS = 4.0
"""Noise sds that the largest residual of some hundred readings may reach by chance."""
MIN_BAND_COVERAGE = 0.8
"""Fraction of readings inside a 90 % predictive band, below which the band is too narrow."""


def predictive_checks(
    posterior: Posterior, draws: pd.DataFrame, *, piece: int = 0, max_draws: int = 200
) -> pd.DataFrame:
    """Compare every curve with the median of the law, and with the predictive band of the tissue.

    One row per protocol and direction: ``protocol``, ``direction``, ``readings``, ``rms`` (of
    reading minus median model, in ``unit``), ``largest`` (of the same, with its sign) and ``at``
    (the measured stretch there), ``peak`` (largest absolute load), ``noise`` (of the load cell),
    ``autocorrelation`` (of neighbouring residuals), ``runs`` of one sign, ``expected_runs`` and
    ``runs_z`` (in standard deviations of independent errors), ``inside`` (fraction of the readings
    inside their own 90 % predictive band), ``share`` (largest residual over the largest load of the
    protocol, both directions), ``unit`` and ``agreement``: ``noise`` (no more than the load
    cell's), ``misses`` (above 5 % of the peak, and an rms above 1.5 times the noise), ``small``. A
    Cauchy file is compared as nominal stress.
    """
    tissue = Tissue(posterior, draws.iloc[evenly_chosen(len(draws), max_draws)], piece=piece)
    specimen, rows = posterior.pieces[piece].specimen, []
    for i, protocol in enumerate(specimen.as_compared(posterior.settings.mounting).protocols):
        stretch = protocol.stretch[protocol.rest_rows :]
        measured = specimen.load(protocol)[protocol.rest_rows :]
        if not len(measured):
            continue
        loads = tissue.tested(i, protocol.stretch, np.arange(protocol.rest_rows, protocol.rows))
        with np.errstate(over="ignore", invalid="ignore"):
            # F(y) = mean over draws of Phi((y - m) / sd)
            z = (measured - loads.reading) / np.maximum(loads.reading_sd, 1e-300)
            below = ndtr(z).mean(axis=0)
        inside = ((below >= BAND_TAILS[0]) & (below <= BAND_TAILS[1])).mean(axis=0)
        residuals = measured - np.median(loads.law, axis=0)
        for axis in specimen.experiment.axes:
            residual = residuals[:, axis]
            worst, n = int(np.argmax(np.abs(residual))), len(residual)
            centred = residual - residual.mean()
            square = float(centred @ centred)
            above = residual > 0.0
            runs = 1 + int(np.count_nonzero(above[1:] != above[:-1]))
            # Signs of independent errors about zero change at each of n - 1 steps with
            # probability 1/2.
            expected, runs_sd = 0.5 * (n + 1), 0.5 * np.sqrt(max(n - 1, 1))
            rows.append(
                {
                    "protocol": posterior.pieces[piece].title(protocol.name),
                    "direction": "xy"[axis],
                    "readings": n,
                    "rms": float(np.sqrt(np.mean(residual**2))),
                    "largest": float(residual[worst]),
                    "at": float(stretch[worst, axis]),
                    "peak": float(np.abs(measured[:, axis]).max()),
                    "noise": specimen.noise_sds[axis],
                    "autocorrelation": (
                        float(centred[:-1] @ centred[1:]) / square if square > 0.0 else np.nan
                    ),
                    "runs": runs,
                    "expected_runs": expected,
                    "runs_z": (runs - expected) / runs_sd,
                    "inside": float(inside[axis]),
                    "unit": specimen.units[axis],
                }
            )
    table = pd.DataFrame(rows)
    if table.empty:
        return table.assign(share=[], agreement=[])
    peak = table.groupby(["protocol", "unit"])["peak"].transform("max").clip(lower=1e-300)
    relative = table["largest"].abs() / peak
    within = (table["largest"].abs() <= NOISE_SDS * table["noise"]) & (
        table["runs_z"] >= SMOOTH_RUNS_Z
    )
    # a single reading far off is no miss of the law
    misses = (relative > LARGE_RESIDUAL) & (table["rms"] > EXPLAINED * table["noise"])
    agreement = np.where(within, "noise", np.where(misses, "misses", "small"))
    return table.assign(share=relative, agreement=agreement)


# --- posterior predictive checks as text: for which tested paths the model must not be used ------


def path_warnings(checks: pd.DataFrame, law: str = DEFAULT_LAW) -> list[str]:
    """One sentence for each protocol that the model misses."""
    missed = checks[checks["agreement"] == "misses"].to_dict("records")
    law_name, out = law_named(law).short_name, []
    for protocol in dict.fromkeys(row["protocol"] for row in missed):
        worst = max((r for r in missed if r["protocol"] == protocol), key=lambda r: r["share"])
        rms, largest = (load_text(abs(worst[k]), worst["unit"]) for k in ("rms", "largest"))
        out.append(
            f"{law_name} misses protocol {protocol} by {rms} root mean square at the posterior "
            f"median ({largest} or {100 * worst['share']:.0f} % of the protocol's peak at most, in "
            f"{worst['direction']} at a measured stretch of {worst['at']:.3f}): do not use these "
            "parameters for that path where this matters."
        )
    return out


def checks_in_words(checks: pd.DataFrame) -> list[str]:
    """Sentences on readings that agree with the law within their noise, and on narrow bands."""
    out = []
    if (checks["agreement"] == "noise").all():
        out.append(
            f"No reading lies further from the median model than {NOISE_SDS:g} times the load "
            "cell's noise."
        )
    for row in checks[checks["inside"] < MIN_BAND_COVERAGE].to_dict("records"):
        out.append(
            f"Only {100 * row['inside']:.0f} % of the readings of {row['protocol']} in "
            f"{row['direction']} lie inside their own 90 % predictive band: it is too narrow there."
        )
    return out
