"""results.json: the result of a run, from which everything else is printed.

The CSV files of a run are exports for spreadsheets and scripts, which no part of the package reads.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from biaxbayes.errors import RunError, listed
from biaxbayes.fitting.result import misfit_sentence, root_mean_square
from biaxbayes.identifiability.determined import determined
from biaxbayes.identifiability.identify import Identifiability
from biaxbayes.identifiability.piece_stiffness import disagreements, piece_stiffnesses
from biaxbayes.identifiability.reported import (
    Reported,
    ReportRow,
    measurement_advice,
    report_frame,
    report_rows,
    row_lines,
)
from biaxbayes.identifiability.sloppiness import sloppiness
from biaxbayes.identifiability.verdict import (
    COMBINATION,
    IDENTIFIED,
    NO_VERDICT,
    VERDICTS,
)
from biaxbayes.model.posterior import Posterior
from biaxbayes.options import INFERRING_MODES
from biaxbayes.parameters import STRETCH, Quantities, mounting_names
from biaxbayes.prediction.predictive_checks import path_warnings
from biaxbayes.runs.folder import EVIDENCE
from biaxbayes.text_files import atomic_write_text, write_csv

if TYPE_CHECKING:
    from biaxbayes.laws.law import Law

RESULTS, REPORT, STRESSES = "results.json", "report.csv", "report-stresses.csv"
README = "README.txt"
TABLE_DIGITS, JSON_DIGITS = 8, 12
"""Significant digits of the exported tables and of results.json."""
TABLES = {
    "identifiability": (
        "identifiability.csv",
        "how much the data narrow each parameter, which others it is correlated with, and which "
        "ends of its range stay open.",
    ),
    "law_fits": (
        "law-fits.csv",
        "other material laws fitted to the same record. One that describes it as well and puts a "
        "mounting stretch elsewhere takes its verdict away.",
    ),
    "determined": (
        "determined.csv",
        "stresses, stiffnesses and structure tensors. The data can fix these where they leave "
        "single parameters open.",
    ),
    "same_curves": ("same-curves.csv", "sets of parameters that give the same curves."),
    "checks": (
        "misfit.csv",
        "residuals of each curve, compared with the noise of a reading.",
    ),
}
"""Tables in the sub-folder evidence: file, and its content."""
LOW_INFORMATION = 1.0 / 3.0
"""A test that identifies at most this fraction of its parameters determines little."""


@dataclass(frozen=True, eq=False)
class RunResult:
    """Result of a run: what to report, and the tables behind it (empty where not computed)."""

    law: str
    state: str  # converged, tentative or unusable
    reported: tuple[Reported, ...]
    fit: str  # quality of fit
    advice: str  # the most useful next measurement; empty if every parameter is identified
    warnings: tuple[str, ...]  # sentences on pieces that disagree, and protocols the law misfits
    pieces: tuple[str, ...]  # sentences on how stiff the other pieces of the tissue are
    findings: tuple[str, ...]  # of the specimen, before sampling
    better_law: str  # a law that fits clearly better, or empty
    convergence: dict[str, Any]
    thresholds: dict[str, float]  # of the verdicts
    # eigenvectors of the scaled posterior covariance, the smallest spread first: spread, loadings
    # and a sentence
    directions: tuple[dict[str, Any], ...]
    same_curves_in_words: str
    summary: pd.DataFrame  # as in summary.csv
    identifiability: pd.DataFrame
    law_fits: pd.DataFrame
    determined: pd.DataFrame
    same_curves: pd.DataFrame
    checks: pd.DataFrame
    quantities: Quantities

    def __repr__(self) -> str:
        return "\n".join([*row_lines(self.rows), *self.pieces, self.fit]).rstrip()

    def __getitem__(self, name: str) -> Reported:
        """Reported row of a parameter."""
        for row in self.reported:
            if row.name == name:
                return row
        raise KeyError(name)

    @property
    def low_information(self) -> str:
        """Sentence on a test that identifies at most a third of its parameters; else empty."""
        if self.state != "converged" or not self.reported:
            return ""
        determined = [r for r in self.reported if r.verdict == IDENTIFIED]
        if len(determined) > len(self.reported) * LOW_INFORMATION:
            return ""
        names = f" ({listed([r.name for r in determined])})" if determined else ""
        return (
            f"this test determines {len(determined) or 'none'} of {len(self.reported)} parameters"
            f"{names}: do not compare the others between specimens"
        )

    @property
    def stresses(self) -> pd.DataFrame:
        """Stresses to report, as in ``report-stresses.csv``: median and 90 % interval."""
        if self.determined.empty:
            return pd.DataFrame()
        table = self.determined[self.determined["quantity"].str.contains(" stress ")]
        columns = ["quantity", "unit", "stretch_x", "stretch_y", "median", "low", "high"]
        return table[columns].reset_index(drop=True)

    @property
    def rows(self) -> list[ReportRow]:
        """The reported table as text."""
        return report_rows(self.reported, self.quantities)

    def to_frame(self) -> pd.DataFrame:
        """The reported table, as in ``report.csv``."""
        return report_frame(self.reported, self.quantities)

    def _repr_html_(self) -> str:
        """The reported table, for notebooks."""
        shown = self.to_frame()
        return str(shown.to_html(index=False)) + f"<p>{self.fit}</p>"


def run_result(
    verdicts: Identifiability,
    posterior: Posterior,
    draws: pd.DataFrame,
    summary: pd.DataFrame,
    convergence: Mapping[str, Any],
    findings: Sequence[str] = (),
) -> RunResult:
    """Result of a run from its draws (natural quantities, one row per draw) and their verdicts."""
    law, settings = posterior.law, posterior.settings
    nothing = pd.DataFrame()
    usable, converged = verdicts.state != "unusable", verdicts.state == "converged"
    checks = verdicts.checks
    pieces = piece_stiffnesses(posterior, draws) if usable else ()
    curves = sloppiness(posterior, draws) if converged else None
    directions = () if curves is None else curves.directions
    reported = verdicts.reported
    fits = nothing
    if verdicts.fits is not None:
        fits = verdicts.fits.to_frame(posterior.mounts if settings.infers_mounting else ())
    table = nothing
    if converged:
        stretches = [r for r in reported if posterior.quantities[r.name].parameter.kind == STRETCH]
        known = all(r.verdict == IDENTIFIED for r in stretches)
        table = determined(posterior, draws, total=known)
    return RunResult(
        law=law.name,
        state=verdicts.state,
        reported=reported,
        fit=_fit_in_words(posterior) if usable else "",
        advice=_advice(reported, verdicts, settings.mounting, posterior),
        warnings=(
            *disagreements(pieces),
            *(path_warnings(checks, law.key) if usable else ()),
        ),
        pieces=tuple(str(piece) for piece in pieces if not piece.disagrees),
        findings=tuple(findings),
        better_law=verdicts.better_law,
        convergence=dict(convergence),
        thresholds=verdicts.all_thresholds,
        directions=tuple(
            {"spread": d.spread, "loadings": d.loadings, "in_words": d.text} for d in directions
        ),
        same_curves_in_words="" if curves is None else curves.text,
        summary=summary,
        identifiability=verdicts.to_frame(),
        law_fits=fits,
        determined=table,
        same_curves=nothing if curves is None else curves.path.to_frame(),
        checks=checks,
        quantities=posterior.quantities,
    )


def _fit_in_words(posterior: Posterior) -> str:
    """One sentence on how well the law fits the first piece at its best, as ``check`` says it."""
    specimen, paths = posterior.specimen, posterior.paths
    axes = list(specimen.experiment.same_unit(0))
    residuals = [
        (specimen.load(p) - paths.load(p.stretch, i))[p.rest_rows :, axes]
        for i, p in enumerate(specimen.as_compared(posterior.settings.mounting).protocols)
    ]
    rms = root_mean_square(residuals)
    noise, peak = specimen.noise_sd, specimen.peak_load
    return misfit_sentence(posterior.law.short_name, rms, noise, peak, specimen.unit)


def _advice(
    reported: Sequence[Reported], verdicts: Identifiability, mounting: str, posterior: Posterior
) -> str:
    """The most useful next step: converge, another law, the mounting stretch, a further test."""
    quantities = posterior.quantities
    if verdicts.state != "converged":
        return "the chains have not converged: continue with --resume and a larger --max-steps"
    if verdicts.better_law:
        return verdicts.better_law
    if verdicts.law_misses:
        return (
            f"{verdicts.law_misses} (root mean square): do not use its parameters. State the noise "
            "of the readings if it is larger than their scatter, or leave out a start that check "
            "calls concave"
        )
    if mounting not in INFERRING_MODES:
        return (
            f"the mounting stretch was not inferred (mounting {mounting}): the parameters carry "
            "its error"
        )
    if verdicts.contradicted_priors:
        return f"correct the prior of {listed(list(verdicts.contradicted_priors))}, or its unit"
    undetermined = [r for r in reported if r.verdict != IDENTIFIED]
    axes = {
        quantities[r.name].axis
        for r in undetermined
        if quantities[r.name].parameter.kind == STRETCH
    }
    if axes:
        names = mounting_names("stretch")
        missing_names = [names[axis] for axis in (0, 1) if axis in axes]
        return f"to know the mounting stretch, {measurement_advice(missing_names)}"
    if undetermined:
        verb = "separate" if all(r.verdict == COMBINATION for r in undetermined) else "narrow"
        parameters = listed([r.name for r in undetermined])
        if posterior.specimen.test != "biaxial":
            return f"to {verb} {parameters}: test another piece of the tissue, such as a square"
        return f"to {verb} {parameters}: biaxbayes design RUN says which test to add"
    return ""


# --- results.json, written and read --------------------------------------------------------------


def write_result(result: RunResult, folder: Path) -> list[str]:
    """Write ``results.json``, ``report.csv`` and the tables behind them; return the file names."""
    (folder / EVIDENCE).mkdir(exist_ok=True)
    text = json.dumps(as_record(result), indent=1, ensure_ascii=False, allow_nan=False)
    atomic_write_text(folder / RESULTS, text + "\n")
    tables = {REPORT: result.to_frame(), STRESSES: result.stresses}
    lines = ["The tables behind report.csv.", ""]
    for name, (file, sentence) in TABLES.items():
        tables[f"{EVIDENCE}/{file}"] = getattr(result, name)
        if not getattr(result, name).empty:
            lines.append(f"{file}: {sentence}")
    atomic_write_text(folder / EVIDENCE / README, "\n".join(lines) + "\n")
    names = [RESULTS, f"{EVIDENCE}/{README}"]
    for name, table in tables.items():
        if table.empty and name != REPORT:
            (folder / name).unlink(missing_ok=True)
            continue
        write_csv(folder / name, table, digits=TABLE_DIGITS)
        names.append(name)
    return names


TEXT_FIELDS = ("law", "state", "fit", "advice", "better_law", "same_curves_in_words")
LIST_FIELDS = ("warnings", "findings", "pieces", "directions")
DICT_FIELDS = ("convergence", "thresholds")


def as_record(result: RunResult) -> dict[str, Any]:
    """The result as JSON values of twelve digits; NaN and infinity become null."""
    record: dict[str, Any] = {
        name: getattr(result, name) for name in (*TEXT_FIELDS, *DICT_FIELDS, *LIST_FIELDS)
    }
    record["reported"] = [vars(r) for r in result.reported]
    record["summary"] = result.summary.to_dict("records")
    record["evidence"] = {name: getattr(result, name).to_dict("records") for name in TABLES}
    cleaned = json_values(record)
    assert isinstance(cleaned, dict)
    return cleaned


def json_values(value: Any) -> Any:
    """Values as JSON has them: numbers to twelve digits; NaN and infinity become null."""
    if isinstance(value, Mapping):
        return {str(k): json_values(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [json_values(v) for v in value]
    if isinstance(value, bool | str) or value is None:
        return value
    number = value.item() if hasattr(value, "item") else value
    if not isinstance(number, float):
        return number
    # Sums of the same draws differ in the last digit with where an array lies in memory.
    return float(f"{number:.{JSON_DIGITS}g}") if math.isfinite(number) else None


def result_from_record(record: Any, law: Law, quantities: Quantities, path: Path) -> RunResult:
    """Result from a ``results.json``, which is not trusted; RunError if it is not a run's."""
    try:
        plain = {name: str(record[name]) for name in TEXT_FIELDS}
        tables = {name: _table(record["evidence"][name]) for name in TABLES}
        reported = tuple(_reported(r, quantities) for r in record["reported"])
        values: dict[str, Any] = {**plain, **tables}
        result = RunResult(
            reported=reported,
            warnings=tuple(str(v) for v in record["warnings"]),
            findings=tuple(str(v) for v in record["findings"]),
            pieces=tuple(str(v) for v in record["pieces"]),
            directions=tuple(dict(v) for v in record["directions"]),
            convergence=dict(record["convergence"]),
            thresholds={str(k): float(v) for k, v in record["thresholds"].items()},
            summary=_table(record["summary"]),
            quantities=quantities,
            **values,
        )
        for name in result.summary["parameter"]:
            if name not in quantities:
                raise ValueError(f"no quantity of this run is called {name!s:.40}")
        if result.law != law.name:
            raise ValueError("another law")
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise RunError(
            f"{path}: is not the result of this run ({error}); copy the folder again, or sample "
            "again"
        ) from None
    return result


def _reported(record: Mapping[str, Any], quantities: Quantities) -> Reported:
    numbers = ("median", "low", "high")
    values: dict[str, Any] = {
        k: math.nan if record[k] is None else float(record[k]) for k in numbers
    }
    texts: dict[str, Any] = {
        k: str(record[k]) for k in ("name", "unit", "verdict", "reason", "bound")
    }
    if texts["bound"] not in ("", "low", "high"):
        raise ValueError(f"unknown bound {texts['bound']:.40}")
    if texts["verdict"] not in (*VERDICTS, NO_VERDICT):
        raise ValueError(f"unknown verdict {texts['verdict']:.40}")
    if texts["name"] not in quantities:
        raise ValueError(f"no quantity of this run is called {texts['name']:.40}")
    return Reported(**texts, **values, partners=tuple(str(p) for p in record["partners"]))


def _table(records: Any) -> pd.DataFrame:
    """A table from its rows; columns without any value are NaN."""
    table = pd.DataFrame(list(records))
    empty = [c for c in table.columns if table[c].isna().all()]
    return table.astype(dict.fromkeys(empty, float))
