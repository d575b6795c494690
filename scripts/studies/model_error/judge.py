"""What the intervals of a candidate hold of a specimen whose truth is known."""

from __future__ import annotations

from functools import cache

import numpy as np
import pandas as pd

from biaxbayes.fitting.law_fits import LawFits
from biaxbayes.identifiability.determined import AT_MEASURED_STRETCH, determined
from biaxbayes.identifiability.identify import Identifiability, identify_draws, run_law_fits
from biaxbayes.identifiability.verdict import NOT_IDENTIFIED
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import prepare
from biaxbayes.prediction.bands import bands
from studies.model_error.candidates import Answer
from studies.model_error.truths import Case, make_case

FAR = 1.09
"""Mounting stretches beyond this are strong."""
DRAWS = 300
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
    found = _verdicts(seed, answer)
    rows = [
        *_stresses(case, found, answer),
        *_mounting(case, found),
        *_parameters(case, answer),
    ]
    rows += _held_out(case, answer)
    return pd.DataFrame(rows, columns=["group", "label", "true", "low", "high"])


@cache
def _posterior(seed: int) -> tuple[Posterior, LawFits | None]:
    """The default posterior of a specimen, and the fits of all laws to it."""
    posterior = prepare(make_case(seed).specimen)
    return posterior, run_law_fits(posterior)


def _verdicts(seed: int, answer: Answer) -> Identifiability:
    """What the tool says of the draws."""
    posterior, fits = _posterior(seed)
    return identify_draws(posterior, answer.draws, "converged", fits=fits)


def _stresses(case: Case, found: Identifiability, answer: Answer) -> list[Row]:
    """Stresses as the tool states them: at half-way and the end of every protocol."""
    table = determined(
        answer.draws,
        case.specimen,
        answer.settings,
        refits=found.mounting_ranges(),
        values=found.mounting_values(),
    )
    nominal = table["quantity"].str.contains(AT_MEASURED_STRETCH, regex=False)
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


def _mounting(case: Case, found: Identifiability) -> list[Row]:
    """The interval, what the verdict makes of it, and what is stated of the tissue."""
    out: list[Row] = []
    for axis, true in enumerate(case.mounting):
        name = f"mounting_stretch_{'xy'[axis]}"
        row = found[name]
        e, stated = row.diagnostics, row.mounting
        assert e is not None and stated is not None
        ends = (e.low, e.high)
        out.append(("mounting", name, float(true), *ends))
        if row.posterior_verdict == NOT_IDENTIFIED:
            assert e.refits is not None
            out.append(("mounting, not identified", name, float(true), *ends))
            out.append(("mounting, not identified, range", name, float(true), *e.refits))
        else:
            out.append(("mounting, stands", name, float(true), *ends))
        if stated.is_value:
            out.append(("mounting, stated value", name, float(true), stated.low, stated.high))
        elif np.isfinite(stated.low):
            out.append(("mounting, stated low end", name, float(true), stated.low, np.inf))
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
    table = bands(case.held_out, answer.draws, settings=answer.settings, max_draws=DRAWS)
    table = table[table["row"] > 0]
    ends = table[["measured", "predictive_q05", "predictive_q95"]].to_numpy(dtype=float)
    return [
        ("held-out readings", str(i), float(true), float(low), float(high))
        for i, (true, low, high) in enumerate(ends)
    ]
