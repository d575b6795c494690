"""What the intervals of a candidate hold of a specimen whose truth is known."""

from __future__ import annotations

from functools import cache

import numpy as np
import pandas as pd

from biaxbayes.identifiability.determined import MEASURED, determined
from biaxbayes.identifiability.toe import MountingRefits, mounting_refits
from biaxbayes.identifiability.verdict import Thresholds
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import prepare
from biaxbayes.model.priors import Prior
from biaxbayes.prediction.bands import bands
from studies.model_error.candidates import Answer
from studies.model_error.truths import Case, make_case

__all__ = ["FAR", "judged"]

FAR = 1.09
"""Mounting stretches beyond this are strong."""
DRAWS = 300
LOST = "mounting, not identified, range"
Row = tuple[str, str, float, float, float]
"""Group, label, truth, and the ends of the interval."""


def judged(case: Case, seed: int, answer: Answer) -> pd.DataFrame:
    """Everything with a truth, one row an interval.

    Parameters
    ----------
    case : Case
    seed : int
        That the case was made from.
    answer : Answer

    Returns
    -------
    DataFrame
        ``group``, ``label``, ``true``, ``low``, ``high``.
    """
    rows = [
        *_stresses(case, seed, answer),
        *_mounting(case, seed, answer),
        *_parameters(case, answer),
    ]
    rows += _held_out(case, answer)
    return pd.DataFrame(rows, columns=["group", "label", "true", "low", "high"])


def _stresses(case: Case, seed: int, answer: Answer) -> list[Row]:
    """Stresses as the tool states them: at half-way and the end of every protocol."""
    refits = {n: (low, high) for g, n, _, low, high in _mounting(case, seed, answer) if g == LOST}
    law = _refits(seed)[1].law
    table = determined(answer.draws, case.specimen, law, refits=refits)
    nominal = table["quantity"].str.contains(MEASURED, regex=False)
    table = table[nominal | table["quantity"].str.startswith("Cauchy stress")]
    measured = nominal[table.index].to_numpy(dtype=bool)
    total = table[["stretch_x", "stretch_y"]].to_numpy()
    total = np.where(measured[:, None], total * case.mounting, total)
    truth = case.stress(total)
    truth = np.where(measured[:, None], truth / total, truth)
    out: list[Row] = []
    for i, row in enumerate(table.to_dict("records")):
        axis = 0 if " stress x" in row["quantity"] else 1
        where = "measured" if measured[i] else "total"
        ends = (row["low_90"], row["high_90"]), (row["tissue_low_90"], row["tissue_high_90"])
        for whose, (low, high) in zip(("model", "tissue"), ends, strict=True):
            group = f"{whose} at {where} stretches"
            if np.isnan(low):
                continue  # not stated
            out.append((group, row["quantity"], float(truth[i, axis]), low, high))
    return out


@cache
def _refits(seed: int) -> tuple[MountingRefits | None, Posterior]:
    posterior = prepare(make_case(seed).specimen)
    return mounting_refits(posterior), posterior


def _mounting(case: Case, seed: int, answer: Answer) -> list[Row]:
    """The interval, and what the verdict makes of it."""
    refits, posterior = _refits(seed)
    limits = Thresholds()
    out: list[Row] = []
    for axis, true in enumerate(case.mounting):
        name = f"mounting_stretch_{'xy'[axis]}"
        low, high = (float(q) for q in np.quantile(answer.draws[name], [0.05, 0.95]))
        out.append(("mounting", name, float(true), low, high))
        wide = (low, high)
        if refits is not None:
            prior = posterior.priors[name]
            assert isinstance(prior, Prior)
            wide = refits.range(name, (low, high), limits.refit_errors, prior)
        stands = high - low >= limits.refit_share * (wide[1] - wide[0])
        out.append(("mounting, range of refits", name, float(true), *wide))
        verdict = "stands" if stands else "not identified"
        out.append((f"mounting, {verdict}", name, float(true), low, high))
        stated = (low, high) if stands else wide
        out.append(("mounting, as stated", name, float(true), *stated))
        if not stands:
            out.append((LOST, name, float(true), *wide))
    return out


def _parameters(case: Case, answer: Answer) -> list[Row]:
    if case.material is None:
        return []
    return [
        ("parameters", name, float(v), *np.quantile(answer.draws[name], [0.05, 0.95]))
        for name, v in zip(case.material.law.names, case.material.values, strict=True)
    ]


def _held_out(case: Case, answer: Answer) -> list[Row]:
    """Readings of a path that was not sampled, against their predictive band."""
    table = bands(case.held_out, answer.draws, max_draws=DRAWS)
    table = table[table["row"] > 0]
    ends = table[["measured", "predictive_q05", "predictive_q95"]].to_numpy(dtype=float)
    return [
        ("held-out readings", str(i), float(true), float(low), float(high))
        for i, (true, low, high) in enumerate(ends)
    ]
