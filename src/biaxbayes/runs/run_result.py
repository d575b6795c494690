"""results.json: the result of a run, from which all else is printed; its CSV files are exports."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd
from markupsafe import Markup

from biaxbayes.derived.determined import determined
from biaxbayes.derived.known import known_table, piece_stiffnesses
from biaxbayes.errors import RunError, listed
from biaxbayes.fitting.fit_result import POOR_MISFIT, misfit_sentence, root_mean_square
from biaxbayes.identifiability.identify import Identifiability
from biaxbayes.identifiability.reported import Reported, report_table
from biaxbayes.identifiability.sloppiness import sloppiness
from biaxbayes.identifiability.verdict import IDENTIFIED, MEASURED, NO_VERDICT, VERDICTS
from biaxbayes.laws import DEFAULT_LAW
from biaxbayes.model.posterior import Posterior
from biaxbayes.options import INFERRING_MODES
from biaxbayes.parameters import PIECE, STRETCH, Quantities, mounting_names
from biaxbayes.prediction.nearest_law import simulation_table
from biaxbayes.prediction.predictive_checks import path_warnings
from biaxbayes.report_table import Table
from biaxbayes.runs.folder import COPY_AGAIN
from biaxbayes.stored_data import from_json, json_values
from biaxbayes.text_files import atomic_write_text, write_csv

if TYPE_CHECKING:
    from biaxbayes.laws.law import Law

EVIDENCE = "evidence"
"""Sub-folder of a run: the tables behind the reported result."""
RESULTS, REPORT, STRESSES = "results.json", "report.csv", "report-stresses.csv"
README = "README.txt"
TABLE_DIGITS = 8
"""Significant digits of the exported tables."""
TABLES = {
    "identifiability": (
        "identifiability.csv",
        "how much the data narrow each parameter, which others it is correlated with, and which "
        "ends of its range stay open.",
    ),
    "law_fits": ("law-fits.csv", "other material laws fitted to the same record, for information."),
    "determined": (
        "determined.csv",
        "stresses, stiffnesses and structure tensors. The data can fix these where they leave "
        "single parameters open.",
    ),
    "same_curves": ("same-curves.csv", "sets of parameters that give the same curves."),
    "simulation": (
        "simulation.csv",
        "parameters of the law nearest to the drawn tissues, and its distance to the readings.",
    ),
    "checks": ("misfit.csv", "residuals of each curve, compared with the noise of a reading."),
}
"""Tables in the sub-folder evidence: file, and its content."""


@dataclass(frozen=True, eq=False)
class RunResult:
    """Result of a run: what to report, and the tables behind it (empty where not computed)."""

    law: str
    state: str  # converged, tentative or unusable
    reported: tuple[Reported, ...]
    fit: str  # quality of fit
    advice: str  # the next test that would change most; empty if every parameter is identified
    warnings: tuple[str, ...]  # sentences on pieces that differ, and protocols the law misfits
    pieces: tuple[str, ...]  # sentences on how stiff the other pieces of the tissue are
    findings: tuple[str, ...]  # of the specimen, before sampling
    better_law: str  # advice on a law that describes and predicts the record better, or empty
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
    simulation: pd.DataFrame
    checks: pd.DataFrame
    quantities: Quantities

    def __repr__(self) -> str:
        return "\n".join([*self.table.lines(heads=False), *self.pieces, self.fit]).rstrip()

    def __getitem__(self, name: str) -> Reported:
        """Reported row of a parameter."""
        return {row.name: row for row in self.reported}[name]

    @property
    def low_information(self) -> str:
        """Sentence on a test that identifies at most a third of its parameters; else empty."""
        if self.state != "converged" or not self.reported:
            return ""
        determined = [r for r in self.reported if r.verdict in (IDENTIFIED, MEASURED)]
        if len(determined) > len(self.reported) * (1.0 / 3.0):
            return ""
        names = f" ({listed([r.name for r in determined])})" if determined else ""
        return (
            f"this test determines {len(determined) or 'none'} of {len(self.reported)} parameters"
            f"{names}: compare specimens by stresses and stiffnesses, which are known better"
        )

    @property
    def known(self) -> Table:
        """Stresses, tangent stiffnesses and their ratio at states of the test."""
        return known_table(self.determined if self.state == "converged" else pd.DataFrame())

    @property
    def stresses(self) -> pd.DataFrame:
        """Stresses to report, as in ``report-stresses.csv``: median and 90 % interval."""
        if self.determined.empty:
            return pd.DataFrame()
        table = self.determined[self.determined["quantity"].str.contains(" stress ")]
        columns = ["quantity", "unit", "stretch_x", "stretch_y", "median", "low", "high"]
        return table[columns].reset_index(drop=True)

    @property
    def table(self) -> Table:
        """What to report of each parameter, and of each further piece."""
        return report_table((*self.reported, *self.stiffnesses))

    @property
    def stiffnesses(self) -> tuple[Reported, ...]:
        """Stiffness of each further piece over that of the first."""
        columns = (self.summary[c] for c in ("parameter", "q50", "q05", "q95"))
        return tuple(
            Reported(self.quantities[name], median, low, high, "", "over that of the first piece")
            for name, median, low, high in zip(*columns, strict=True)
            if self.quantities[name].parameter.kind == PIECE
        )

    def to_frame(self) -> pd.DataFrame:
        """The reported table, as in ``report.csv``."""
        return self.table.rows

    def _repr_html_(self) -> str:
        """The reported table, for notebooks."""
        return str(self.table.html() + Markup("<p>{}</p>").format(self.fit))


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
    nothing = fits = pd.DataFrame()
    usable, converged = verdicts.state != "unusable", verdicts.state == "converged"
    alike, different = piece_stiffnesses(posterior, draws) if usable else ([], [])
    curves = sloppiness(posterior, draws) if converged else None
    if verdicts.fits is not None:
        fits = verdicts.fits.to_frame(posterior.mounts if settings.infers_mounting else ())
    return RunResult(
        law=law.name,
        state=verdicts.state,
        reported=verdicts.reported,
        fit=_fit_in_words(posterior) if usable else "",
        advice=_advice(verdicts, posterior),
        warnings=(*different, *(path_warnings(verdicts.checks, law.key) if usable else ())),
        pieces=tuple(alike),
        findings=tuple(findings),
        better_law=verdicts.better_law,
        convergence=dict(convergence),
        thresholds=verdicts.all_thresholds,
        directions=() if curves is None else curves.directions,
        same_curves_in_words="" if curves is None else curves.text,
        summary=summary,
        identifiability=verdicts.to_frame(),
        law_fits=fits,
        determined=determined(posterior, draws) if converged else nothing,
        same_curves=nothing if curves is None else curves.path.to_frame(),
        simulation=simulation_table(posterior, draws) if converged else nothing,
        checks=verdicts.checks,
        quantities=posterior.quantities,
    )


def _fit_in_words(posterior: Posterior) -> str:
    """One sentence on how well the law fits the first piece at its best, as ``check`` says it."""
    specimen, paths = posterior.specimen, posterior.paths
    axes = list(specimen.experiment.axes)
    residuals = [
        ((specimen.load(p) - paths.load(p.stretch, i)) / specimen.load_scale)[p.rest_rows :, axes]
        for i, p in enumerate(specimen.as_compared(posterior.settings.mounting).protocols)
    ]
    rms = root_mean_square(residuals)
    noise, peak, law = specimen.noise_sd, specimen.peak_load, posterior.law.short_name
    record = "the first piece" if specimen.further else "this record"
    poor = rms > POOR_MISFIT * peak
    text = misfit_sentence(law, rms, noise, peak, specimen.unit, record=record, share=poor)
    # at its best: no mounting stretch and no parameters follow the record more closely
    return f"{text}: it does not describe {record}" if poor else text


def _advice(verdicts: Identifiability, posterior: Posterior) -> str:
    """The most useful next step: converge, the mounting stretch, a further test."""
    mounting = posterior.settings.mounting
    if verdicts.state != "converged":
        return "the chains have not converged: continue with --resume and a larger --max-steps"
    if mounting not in INFERRING_MODES:
        return (
            f"the mounting stretch was not inferred (mounting {mounting}): the parameters carry "
            "its error"
        )
    if verdicts.contradicted_priors:
        return f"correct the prior of {listed(list(verdicts.contradicted_priors))}, or its unit"
    reported = verdicts.reported
    undetermined = [r.quantity for r in reported if r.verdict not in (IDENTIFIED, MEASURED)]
    if undetermined and all(q.parameter.kind == STRETCH for q in undetermined):
        names = mounting_names("stretch")
        axes = sorted({q.axis for q in undetermined})
        lines = " and ".join(f"# {names[axis]}: VALUE +- SD" for axis in axes)
        return (
            "to know the mounting stretch, photograph two marks per axis before and after "
            "mounting, and write the ratio of their distances into the header of the specimen: "
            f"{lines}"
        )
    return further_test(posterior) if undetermined else ""


def further_test(posterior: Posterior) -> str:
    """The test that is expected to determine most, and how much it brought in simulations."""
    specimen, law = posterior.specimen, posterior.law
    ranked = "`biaxbayes design RUN` ranks tests for this specimen"
    if not specimen.experiment.is_biaxial:
        return (
            "test a square of the same tissue as well, and sample its file before this one: few "
            "parameters are known without"
        )
    strips = {p.experiment.axes for p in specimen.further if p.experiment.free_side is not None}
    missing = [axis for k, axis in enumerate("xy") if (k,) not in strips]
    if not missing or law.key != DEFAULT_LAW or len(strips) != len(specimen.further):
        return f"to know more parameters: {ranked}"
    # parameters of GOH that a simulated square identified, alone and with strips: docs/pieces.md
    brought = 3.3
    without = 2.1 if strips else 1.1
    if len(specimen.protocols) > 1 and not strips:  # three protocols
        brought, without = 3.6, 2.9
    pieces = f"a strip along {missing[0]}" if strips else "two strips, along x and y,"
    return (
        f"to know more parameters, cut {pieces} beside the square and sample all files together "
        f"(identified in simulations: {brought:g} of 5 parameters on average, {without:g} "
        f"without); {ranked}"
    )


# --- results.json, written and read --------------------------------------------------------------


def write_result(result: RunResult, folder: Path) -> None:
    """Write ``results.json``, ``report.csv`` and the tables behind them."""
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
    for name, table in tables.items():
        if table.empty and name != REPORT:
            (folder / name).unlink(missing_ok=True)
        else:
            write_csv(folder / name, table, digits=TABLE_DIGITS)


def as_record(result: RunResult) -> dict[str, Any]:
    """The result as JSON values."""
    rows = [
        {"name": r.name, "unit": r.unit, **{k: v for k, v in vars(r).items() if k != "quantity"}}
        for r in result.reported
    ]
    # the specimen and the law define the quantities
    others = {k: v for k, v in vars(result).items() if k != "quantities"}
    record: dict[str, Any] = json_values({**others, "reported": rows})
    return record


def result_from_record(record: Any, law: Law, quantities: Quantities, path: Path) -> RunResult:
    """Result from a ``results.json``, which is not trusted; RunError if it is not a run's."""
    try:
        names = [r["name"] for r in record["reported"]]
        for name in (*names, *(r["parameter"] for r in record["summary"])):
            if name not in quantities:
                raise ValueError(f"no quantity of this run is called {name!s:.40}")
        rows = [{**r, "quantity": quantities[r["name"]]} for r in record["reported"]]
        known = {"reported": rows, "quantities": quantities}
        result: RunResult = from_json(RunResult, {**record, **known})
        for r in result.reported:
            if r.verdict not in (*VERDICTS, NO_VERDICT):
                raise ValueError(f"verdict {r.verdict:.40}")
        for r in result.reported:
            if r.bound not in ("", "low", "high"):
                raise ValueError(f"bound {r.bound:.40}")
        if result.law != law.name:
            raise ValueError("another law")
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        problem = f"is not the result of this run ({error})"
        raise RunError(f"{path}: {problem}; {COPY_AGAIN}") from None
    return result
