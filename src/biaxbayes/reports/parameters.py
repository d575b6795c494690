"""What the data determine, convergence and the methods paragraph of a run, as text."""

from __future__ import annotations

import math
from typing import Any

import pandas as pd

from biaxbayes.figures.quantities import number
from biaxbayes.identifiability.determined import MEASURED
from biaxbayes.reports.words import cut
from biaxbayes.runs.run import Run

# --- convergence of every quantity ---------------------------------------------------------------

DASH = "–"


def convergence_rows(run: Run) -> list[dict[str, Any]]:
    """Effective draws and R-hat of every quantity, as text."""
    out = []
    for record in run.summary.to_dict("records"):
        ess = min(float(record["ess_bulk"]), float(record["ess_tail"]))
        rhat = float(record["rhat"])
        out.append(
            {
                "quantity": run.quantities[str(record["parameter"])],
                "ess": DASH if math.isnan(ess) else f"{ess:,.0f}",
                "rhat": DASH if math.isnan(rhat) else f"{rhat:.4f}",
            }
        )
    return out


# --- what the data determine, as rows of the page ------------------------------------------------


STATES = 3
"""Stretches of each kind that the page states; determined.csv has all."""
WORDS = {
    "Hx": "structure tensor, x",
    "Hy": "structure tensor, y",
    "Hz": "structure tensor, through the thickness",
}


def determined_rows(run: Run) -> list[dict[str, str]]:
    """Quantities that do not depend on how the parameters are split."""
    table = run.result.determined
    out: list[dict[str, str]] = []
    if table.empty:
        return out
    for r in table[_shown(table)].to_dict("records"):
        low, median, high = (float(r[k]) for k in ("low_90", "median", "high_90"))
        wide = low > 0.0 and high / low > 8.0
        told = [number(v, low, high, log=wide) for v in (median, low, high)]
        ends = [float(r[k]) for k in ("tissue_low_90", "tissue_high_90")]
        tissue = " to ".join(number(v, *ends) for v in ends)
        if math.isnan(ends[0]):
            tissue = "not known" if str(r["quantity"]).startswith("Cauchy stress") else ""
        x, y = float(r["stretch_x"]), float(r["stretch_y"])
        name = cut(r["quantity"], 90)
        out.append(
            {
                "quantity": WORDS.get(name, name),
                "at": "" if math.isnan(x) else f"{x:g}, {y:g}",
                "unit": str(r["unit"] or ""),
                "median": told[0],
                "interval": f"{told[1]} to {told[2]}",
                "tissue": tissue,
                "width": _percent(100.0 * float(r["relative_width"])),
            }
        )
    return out


def _shown(table: pd.DataFrame) -> pd.Series:
    """The largest states of each kind: they are what the test was made for."""
    measured = table["quantity"].str.contains(MEASURED, regex=False)
    beyond = ~measured & (table["stretch_x"].notna()) & ~table["quantity"].str.startswith("small")
    out = ~measured & ~beyond
    for kind in (beyond, measured):
        # A stress at a measured stretch names its protocol: a state is that and the stretches.
        state = table["quantity"].where(measured, "").str.split(MEASURED).str[-1]
        state = state + table["stretch_x"].astype(str) + " " + table["stretch_y"].astype(str)
        last = list(dict.fromkeys(state[kind]))[-STATES:]
        out |= kind & state.isin(last)
    return out


def _percent(value: float) -> str:
    return (
        f"{value:.2g} %" if value < 10.0 else f"{value:.0f} %" if value < 1e4 else "over 10,000 %"
    )


# --- the methods paragraph of a run, with its own numbers, ready to paste into a paper -----------

LOADS = {
    "force": "the forces",
    "piola": "the first Piola-Kirchhoff stresses",
    "cauchy": "the nominal stresses (Cauchy stress over measured stretch)",
}
MOUNTING = {
    "noisy": (
        "For every draw the mounting stretches were the root of the balance between the model and "
        "the load at the mounted state, whose reading has the load cell's own error; the density "
        "was transformed with the determinant of that balance."
    ),
    "exact": (
        "For every draw the mounting stretches were the root of the balance between the model and "
        "the load read at the mounted state, taken as exact; the density was transformed with the "
        "determinant of that balance."
    ),
    "free": (
        "The mounting stretches were sampled directly, with the load read at the mounted state "
        "as a further datum."
    ),
    "ignored": "The mounting stretch was ignored: the mounted state was taken as unloaded.",
    "zeroed": (
        "The mounting stretch was ignored: the loads were zeroed at the mounted state, and that "
        "state was taken as unloaded."
    ),
}

INDEPENDENT = 0.95
"""Weight of the likelihood from which readings count as independent."""


def methods(run: Run) -> str:
    """One paragraph of plain text."""
    sentences = [
        _test(run),
        _model(run),
        MOUNTING[str(run.provenance["settings"]["mounting"])],
        _noise(run),
        _priors(run),
        _sampling(run),
        _result(run),
    ]
    return " ".join(s for s in sentences if s)


def _test(run: Run) -> str:
    s = run.specimen
    count = len(s.protocols)
    size = ""
    if s.edge_x_mm and s.edge_y_mm and s.thickness_mm:
        size = (
            f" of {s.edge_x_mm:g} mm by {s.edge_y_mm:g} mm and {s.thickness_mm:g} mm thickness "
            f"({s.geometry} dimensions)"
        )
    paths = "one loading path" if count == 1 else f"{count} loading paths"
    rows = sum(p.rows for p in s.protocols)
    thin = run.provenance["settings"].get("thin")
    kept = f" Longer protocols were averaged to {thin} rows." if thin else ""
    return f"A specimen{size} was tested planar-biaxially on {paths} ({rows:,} rows).{kept}"


def _model(run: Run) -> str:
    return (
        f"It was described by {run.law.in_words}. Measured stretches refer to the mounted state; "
        "the total stretch is the measured one times the mounting stretch."
    )


def _noise(run: Run) -> str:
    noise = run.provenance["noise"]
    loads = LOADS[run.specimen.stress_pair]
    text = f"Errors of {loads} were Gaussian with an inferred standard deviation"
    if run.provenance["settings"].get("noise_growth"):
        text += " that grows with the load"
    if noise["effective_readings"] is None:
        return f"{text} and taken as independent ({noise['readings']:,} readings)."
    if run.beta > INDEPENDENT:
        return f"{text}; their residuals showed no correlation that would lower their number."
    counted = "the autocorrelation of the residuals"
    if run.provenance["settings"].get("noise") == "systematic":
        counted += " and with what is common to an eighth of a curve as one error of the curve"
    return (
        f"{text}. As neighbouring residuals are correlated, the log likelihood was weighted by "
        f"{run.beta:.3g}: by {counted}, the {noise['readings']:,} "
        f"readings carry as much information as {noise['effective_readings']:.0f} independent ones."
    )


PRIOR_NUMBERS = {"sd_log": "sd of its logarithm", "low": "not below", "high": "not above"}
"""What the numbers of a prior are called, where that is not their name."""


def prior_in_words(prior: Any, unit: str = "") -> str:
    """A prior of provenance.json as a phrase, with its unit where it has one."""
    unit = f" {unit}" if unit not in ("", "1") else ""
    if not isinstance(prior, dict):
        return (
            f"fixed at {prior:g}{unit}" if isinstance(prior, int | float) else f"tied: {cut(prior)}"
        )
    shape = cut(prior.get("distribution", ""), 30)
    numbers = {k: v for k, v in prior.items() if isinstance(v, int | float)}
    if shape in ("uniform", "loguniform") and {"low", "high"} <= set(numbers):
        return f"{shape} from {numbers['low']:g} to {numbers['high']:.4g}{unit}"
    natural = {"median", "mean", "low", "high"} | ({"sd"} if "mean" in numbers else set())
    parts = [
        f"{PRIOR_NUMBERS.get(k, k)} {v:.4g}{unit if k in natural else ''}"
        for k, v in numbers.items()
    ]
    return f"{shape} ({', '.join(parts)})" if parts else shape


def unit_of(run: Run, name: str) -> str:
    """Unit of a quantity by its name in a provenance; none for a stranger's."""
    try:
        return run.quantities[name].unit
    except (KeyError, ValueError, TypeError):
        return ""


def _priors(run: Run) -> str:
    priors = run.provenance.get("priors")
    if not isinstance(priors, dict) or not priors:
        return ""
    told = [
        f"{cut(name, 40)} {prior_in_words(prior, unit_of(run, name))}"
        for name, prior in priors.items()
    ]
    return f"Priors: {'; '.join(told)}."


def _sampling(run: Run) -> str:
    record = run.provenance
    sampler, found = record["sampler"], record["convergence"]
    emcee = record.get("versions", {}).get("emcee", "")
    text = (
        f"The joint posterior was sampled with biaxbayes {cut(record.get('biaxbayes', ''), 30)} "
        f"(emcee {cut(emcee, 30)}) in {sampler.get('ensembles', 4)} independent ensembles of "
        f"{sampler.get('walkers', 0)} walkers for {sampler.get('steps', 0):,} steps after an "
        f"adaptive warm-up (seed {record['seed']})"
    )
    if run.state == "converged" and found.get("worst_rhat"):
        return (
            f"{text}; the largest split R-hat across ensembles was {found['worst_rhat']:.4f}, the "
            f"smallest effective sample size {found['worst_ess']:,.0f}."
        )
    return f"{text}. The chains did NOT converge: {cut(found['reason'], 300)}."


def _result(run: Run) -> str:
    """The reported table as a sentence; nothing of what is not reported."""
    rows = [row for row in run.result.rows if row.interval != DASH]
    without = [row.name for row in run.result.rows if row.interval == DASH]
    if run.state != "converged" or not (rows or without):
        return ""
    parts = [
        f"{row.name} ({row.quantity.parameter.words}) {row.interval_with_unit} ({row.verdict})"
        for row in rows
    ]
    text = f"Reported are 90 % intervals and 95 % bounds: {'; '.join(parts)}." if parts else ""
    if without:
        text += f" The data do not identify {', '.join(without)}."
    return f"{text} {run.result.fit[:1].upper()}{run.result.fit[1:]}.".strip()
