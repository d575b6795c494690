"""The parameters and what the data determine, as rows of the page, and the methods paragraph."""

from __future__ import annotations

import contextlib
import math
import warnings
from dataclasses import dataclass
from functools import partial
from typing import Any

import pandas as pd

from biaxbayes.figures.quantities import number
from biaxbayes.identifiability.determined import MEASURED, determined, mounting_stated
from biaxbayes.identifiability.verdict_names import NOT_IDENTIFIED
from biaxbayes.parameters import MATERIAL, STRETCH, Parameter, Quantity
from biaxbayes.reports.words import cut
from biaxbayes.runs.run import Run
from biaxbayes.text_files import read_csv

# --- the rows of the parameter table: number, interval and verdict of every quantity -------------


WIDE = 8.0
"""Ratio of the ends of an interval from which two significant digits are all it deserves."""


@dataclass(frozen=True)
class Row:
    """One quantity of a run, as text.

    Attributes
    ----------
    quantity : Quantity
    median, low, high : str
        Posterior median and central 90 % interval; a dash where the chains say nothing.
    ess, rhat : str
    verdict, words : str
        From identifiability.csv; empty where there is none.
    refits : bool
        Whether the ends are those of fits to parts of the record, in place of an interval that
        the data contradict.
    stated : str
        Of a mounting stretch: what is stated of the tissue, whatever its law; empty where nothing
        was asked.
    """

    quantity: Quantity
    median: str
    low: str
    high: str
    ess: str
    rhat: str
    verdict: str = ""
    words: str = ""
    refits: bool = False
    stated: str = ""

    @property
    def name(self) -> str:
        """As in ``summary.csv``."""
        return self.quantity.name

    @property
    def meaning(self) -> str:
        """What it is, in words."""
        return self.quantity.parameter.words

    @property
    def unit(self) -> str:
        """Unit behind a number; empty for pure numbers."""
        return self.quantity.parameter.unit_symbol(self.quantity.load_unit)

    @property
    def interval(self) -> str:
        """Both ends; a fixed value has none."""
        if self.low == self.high:
            return "fixed" if self.low != DASH else DASH
        return f"{self.low} to {self.high}{' (refits)' if self.refits else ''}"


DASH, MINUS = "–", "\N{MINUS SIGN}"


def parameter_rows(run: Run) -> list[Row]:
    """Rows of summary.csv joined with the verdicts of identifiability.csv."""
    verdicts = _verdicts(run)
    rows = []
    for record in run.summary.to_dict("records"):
        name = str(record["parameter"])
        quantity = run.quantities[name]
        p = quantity.parameter
        q05, q50, q95 = (float(record[k]) for k in ("q05", "q50", "q95"))
        verdict, words, ends = verdicts.get(name, ("", "", None))
        refits = verdict == NOT_IDENTIFIED and ends is not None
        if refits and ends is not None:
            q05, q95 = ends
        low, median, high = interval_numbers(p, q05, q50, q95)
        ess = min(float(record["ess_bulk"]), float(record["ess_tail"]))
        rhat = float(record["rhat"])
        rows.append(
            Row(
                quantity,
                median,
                low,
                high,
                DASH if math.isnan(ess) else f"{ess:,.0f}",
                DASH if math.isnan(rhat) else f"{rhat:.4f}",
                verdict,
                words,
                refits,
                run.stated[name].in_words(p) if name in run.stated else "",
            )
        )
    return rows


def interval_numbers(p: Parameter, low: float, median: float, high: float) -> tuple[str, ...]:
    """Lower end, median and upper end of an interval as text, a dash for NaN."""
    log = p.logarithmic and low > 0.0 and high / low > WIDE
    write = _stretch if p.kind == STRETCH else partial(number, log=log)
    return tuple(DASH if math.isnan(v) else write(v, low, high) for v in (low, median, high))


def _stretch(value: float, low: float, high: float) -> str:
    """A stretch differs from one in its decimals: three digits of the width of its interval."""
    width = high - low
    return f"{value:.{min(max(2 - math.floor(math.log10(width)), 3), 6) if width > 0.0 else 4}f}"


def percent_stretch(rows: list[Row], run: Run) -> list[tuple[Quantity, str]]:
    """Mounting stretches as sentences, one a direction and mounted state."""
    values = {str(r["parameter"]): r for r in run.summary.to_dict("records")}
    out = []
    for row in rows:
        if row.quantity.parameter.kind != STRETCH:
            continue
        q05, q50, q95 = (100.0 * (float(values[row.name][q]) - 1.0) for q in QUANTILES)
        if math.isnan(q50):
            out.append((row.quantity, "not known: the chains have not converged"))
            continue
        if row.refits:
            low, high = (
                f"{100.0 * (float(v) - 1.0):.1f}".replace("-", MINUS) for v in (row.low, row.high)
            )
            out.append(
                (row.quantity, f"is not identified: {low} to {high} % by fits to parts of {TOE}")
            )
            continue
        digits = 1 if q95 - q05 > 0.2 else 2
        low, middle, high = (f"{v:.{digits}f}".replace("-", MINUS) for v in (q05, q50, q95))
        what = "stretched" if q50 >= 0.0 else "changed in length"
        text = f"{what} by {middle} % when mounted (90 %{{}}: {low} to {high} %)"
        if row.stated:
            text += f"; stated of the tissue: {row.stated}"
        out.append((row.quantity, text.format(" within the law" if row.stated else "")))
    return out


QUANTILES = ("q05", "q50", "q95")
TOE = "the record; the value rests on the model's toe, which these data contradict"
Verdict = tuple[str, str, tuple[float, float] | None]


def _verdicts(run: Run) -> dict[str, Verdict]:
    """Verdict, words and range of refits; none where the file is missing or no such table."""
    path = run.path / "identifiability.csv"
    if path.is_symlink() or not path.is_file():
        return {}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            table = read_csv(path, dtype=str, keep_default_na=False)
        return {
            str(r["parameter"]): (
                str(r["verdict"]),
                str(r["in_words"]).removeprefix(head(r)),
                refit_range(r),
            )
            for r in table.to_dict("records")
        }
    except (OSError, ValueError, KeyError, MemoryError):
        return {}


def head(record: dict) -> str:
    """The start of a sentence that the row of a table already shows."""
    return f"{record['parameter']}: "


def refit_ranges(run: Run) -> dict[str, tuple[float, float]]:
    """Ranges of the mounting stretches that are not identified, by name."""
    return {
        name: ends
        for name, (verdict, _, ends) in _verdicts(run).items()
        if verdict == NOT_IDENTIFIED and ends is not None
    }


def refit_range(record: dict) -> tuple[float, float] | None:
    """Range of a mounting stretch in fits to parts of the record, where the file has one."""
    try:
        low, high = (float(record[f"refit_{end}"]) for end in ("low", "high"))
    except (KeyError, ValueError):
        return None
    return (low, high) if math.isfinite(low) and math.isfinite(high) else None


# --- what the data determine, as rows of the page ------------------------------------------------


STATES = 3
"""Stretches of each kind that the page states; determined.csv has all."""
WORDS = {
    "Hx": "structure tensor, x",
    "Hy": "structure tensor, y",
    "Hz": "structure tensor, through the thickness",
}


DETERMINED_NUMBERS = (
    *("stretch_x", "stretch_y", "median", "low_90", "high_90", "relative_width"),
    *("tissue_low_90", "tissue_high_90"),
)


def determined_rows(run: Run) -> list[dict[str, str]]:
    """Quantities that do not depend on how the parameters are split."""
    table = _determined(run)
    out = []
    for r in table[_shown(table)].to_dict("records"):
        low, median, high = (float(r[k]) for k in ("low_90", "median", "high_90"))
        wide = low > 0.0 and high / low > 8.0
        told = [number(v, low, high, log=wide) for v in (median, low, high)]
        ends = [float(r[k]) for k in ("tissue_low_90", "tissue_high_90")]
        tissue = " to ".join(number(v, *ends) for v in ends)
        if math.isnan(ends[0]):
            tissue = "not stated" if str(r["quantity"]).startswith("Cauchy stress") else ""
        x, y = float(r["stretch_x"]), float(r["stretch_y"])
        name = cut(r["quantity"], 90)
        out.append(
            {
                "quantity": WORDS.get(name, name),
                "at": "" if math.isnan(x) else f"{x:g}, {y:g}",
                "unit": str(r["unit"]),
                "median": told[0],
                "interval": f"{told[1]} to {told[2]}",
                "tissue": tissue,
                "width": _percent(100.0 * float(r["relative_width"])),
            }
        )
    return out


def _determined(run: Run) -> pd.DataFrame:
    """The table that was written of them, made again where there is none."""
    path = run.path / "determined.csv"
    with contextlib.suppress(OSError, ValueError, KeyError, MemoryError):
        if path.is_file() and not path.is_symlink():
            table = read_csv(path).fillna({"unit": ""})
            return table.astype(dict.fromkeys(DETERMINED_NUMBERS, float))
    return determined(
        run.draws,
        run.specimen,
        run.law,
        refits=refit_ranges(run),
        values={name: (s.low, s.high) for name, s in run.stated.items() if s.is_value},
        mounting_known=mounting_stated(run.provenance["settings"].get("priors") or {}),
    )


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


def methods(run: Run, rows: list[Row]) -> str:
    """One paragraph of plain text."""
    sentences = [
        _test(run),
        _model(run),
        MOUNTING[str(run.provenance["settings"]["mounting"])],
        _noise(run),
        _priors(run),
        _sampling(run),
        _result(run, rows),
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
        f"{text}. Because the residuals are correlated, the log likelihood was weighted by "
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


def _result(run: Run, rows: list[Row]) -> str:
    if run.state == "unusable":
        return ""
    told = []
    for row in rows:
        if row.quantity.parameter.kind in (MATERIAL, STRETCH):
            unit = f" {row.unit}" if row.unit not in ("", "°") else row.unit
            what = f"{row.name} ({row.meaning})"
            if row.interval == "fixed":
                told.append(f"{what} {row.median}{unit}, fixed")
            else:
                told.append(f"{what} {row.median}{unit} ({row.interval})")
    return f"Posterior medians with central 90 % intervals: {'; '.join(told)}."
