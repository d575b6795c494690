"""report.html: a run on one page."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd

from biaxbayes.figures.quantities import number
from biaxbayes.identifiability.determined import AT_MEASURED_STRETCH
from biaxbayes.identifiability.reported import COARSE_RATIO, DASH
from biaxbayes.mechanics.experiments import Tube
from biaxbayes.options import REPORTS
from biaxbayes.parameters import STRETCH
from biaxbayes.prediction.predictive_checks import checks_in_words
from biaxbayes.reports.methods import methods, prior_texts, results_paragraph
from biaxbayes.reports.templates import Row, page_template, pictures
from biaxbayes.reports.text import CONVERGENCE_TEXTS, tests_in_words, truncate
from biaxbayes.runs.run import Run, open_run
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.text_files import atomic_write_text

PAGE, EXPLORE = REPORTS["html"], REPORTS["explore"]
RUN_FIGURES = ("stress-bands", "corner", "identifiability", "trace", "ledger", "grips")
MOST_PIECES = 12
"""Pieces of a tissue whose bands are on the page."""
METHOD = (
    "Improved Mechanical Characterization of Soft Tissues Including Mounting Stretches. "
    "Mathematical and Computational Applications 29(4), 55, 2024.",
    "10.3390/mca29040055",
)
SAMPLER = (
    "Foreman-Mackey, Hogg, Lang, Goodman. emcee: The MCMC Hammer. Publications of the Astronomical "
    "Society of the Pacific 125, 306-312, 2013.",
    "10.1086/670067",
)
SOFTWARE = (
    "The biaxbayes developers. biaxbayes: Bayesian material parameters and mounting stretches "
    "from planar biaxial tests, version {}."
)
LOAD_WORDS = {"force": "force", "tube": "pressure and axial force"}
LOAD_TEXTS = {
    "force": "forces (N)",
    "piola": "first Piola-Kirchhoff stress (kPa)",
    "cauchy": "Cauchy stress (kPa)",
    "tube": "pressure (kPa) in x, and axial force (N) in y where it was read",
}


def write_report(folder: Path | str, run: Run | None = None) -> Path:
    """Write the report of a finished run into its folder, and return the path of the page.

    ``run`` is the same run if it is already open. Raises :class:`RunError` if the folder is not a
    run.
    """
    folder = Path(folder)
    page = report_page(run or open_run(folder), explore=(folder / EXPLORE).is_file())
    path = folder / PAGE
    atomic_write_text(path, page)
    return path


def report_page(run: Run, *, explore: bool = False) -> str:
    """The page as HTML: no scripts, no network, figures of the folder inside.

    ``explore``: add a link to explore.html beside it.
    """
    result, provenance = run.result, run.provenance
    notes = (*provenance["notes"], provenance["sampler"]["message"])
    checks = pd.DataFrame() if run.state == "unusable" else result.checks
    version = truncate(provenance["biaxbayes"], 30)
    return page_template("report.html.jinja").render(
        run=run,
        result=result,
        name=truncate(run.specimen.name),
        tests_in_words=tests_in_words(run.specimen),
        mounted=any(s.experiment.is_mounted for s in run.specimen.pieces),
        explore=EXPLORE if explore else "",
        verdict=CONVERGENCE_TEXTS[run.state],
        reason=truncate(provenance["convergence"]["reason"], 400),
        facts=_specimen_facts(run),
        tests=_test_rows(run),
        load=LOAD_WORDS.get(run.specimen.stress_pair, "nominal stress"),
        rows=[
            (q := r.quantity, r.median, r.interval, r.unit, r.verdict, r.reason, q.parameter.words)
            for r in result.rows
        ],
        convergence_rows=_convergence_rows(run),
        contractions=_contraction_rows(run),
        figures=pictures(run.path, (*RUN_FIGURES, *_further_bands(run).values())),
        further_bands=_further_bands(run),
        stresses=_determined_rows(result.stresses, with_width=False),
        determined=_determined_rows(_without_stresses(result.determined), with_width=True),
        grips=_grip_rows(run),
        noise=provenance["noise"],
        sampler=provenance["sampler"],
        convergence=provenance["convergence"],
        misfit_sentences=[truncate(t, 400) for t in checks_in_words(checks)] if len(checks) else [],
        misfit=_misfit_rows(checks),
        notes=[truncate(n, 400) for n in notes if n],
        settings_facts=_settings_facts(run),
        version_facts=_version_facts(run),
        citations=[
            *((SOFTWARE.format(version), ""), METHOD),
            *((f"{run.law.source}.", run.law.doi), SAMPLER),
        ],
        methods=methods(run),
        results=results_paragraph(run),
        laws=_law_rows(run),
    )


def _grip_rows(run: Run) -> list[tuple[str, ...]]:
    """Least-squares parameters as measured and corrected for the grips; empty without grips."""
    grips = run.provenance.get("grips", {})
    fits = [grips.get(f"fit_{key}") for key in ("as_measured", "corrected", "on_coarser_mesh")]
    values = [fit if isinstance(fit, dict) else {} for fit in fits]
    labels = [*(p.label for p in run.law.parameters), "mounting_stretch_x", "mounting_stretch_y"]
    rows = []
    for label in labels:
        if label in values[0]:
            # a number, or those of the first six mounted states
            cells = [np.ravel(fit.get(label, []))[:6] for fit in values]
            rows.append((label, *(", ".join(f"{v:.5g}" for v in cell) for cell in cells)))
    return rows


# --- lists of facts: specimen, settings, versions ------------------------------------------------


def _specimen_facts(run: Run) -> list[tuple[str, str]]:
    """Specimen and test at a glance."""
    s = run.specimen
    facts = [("Specimen", truncate(s.name))]
    if s.layer:
        facts.append(("Layer", truncate(s.layer)))
    axes = [f"{a}: {truncate(n, 60)}" for a, n in (("x", s.axis_x), ("y", s.axis_y)) if n]
    if axes:
        facts.append(("Axes", ", ".join(axes)))
    if isinstance(s.experiment, Tube):
        diameter = 2.0 * s.experiment.outer_radius_mm
        size = f"outer diameter {diameter:g} mm, wall {s.thickness_mm:g} mm, unloaded"
        facts.append(("Dimensions", size))
    elif s.edge_x_mm and s.edge_y_mm and s.thickness_mm:
        size = f"{s.edge_x_mm:g} × {s.edge_y_mm:g} mm, {s.thickness_mm:g} mm thick"
        facts.append(("Dimensions", f"{size}, {s.geometry}"))
    else:
        facts.append(("Reference of the stresses", f"{s.geometry} dimensions"))
    facts.append(("Measured", LOAD_TEXTS[s.stress_pair]))
    if s.noise_sd > 0.0:
        source = "given" if s.load_noise is not None else "estimated from the record"
        pairs = zip(s.noise_sds, s.units, strict=True)
        values = dict.fromkeys(f"{sd:.3g} {unit}" for sd, unit in pairs if sd > 0.0)
        facts.append(("Noise of one load reading", f"{', '.join(values)} ({source})"))
    facts.append(("File", truncate(run.provenance.get("source", ""))))
    return facts


def _settings_facts(run: Run) -> list[tuple[str, str]]:
    """Settings of the model and the priors."""
    settings = run.provenance["settings"]
    facts = [
        ("Material law", run.law.title),
        ("Mounting force", truncate(settings.get("mounting", ""), 30)),
        ("Mounted states", truncate(settings.get("mounting_stretch", ""), 30)),
        ("Errors", truncate(settings.get("noise", ""), 30)),
        ("Toe", f"{100 * run.settings.toe:g} %" if run.settings.has_misfit else "none"),
        ("Fibres in extension only", "yes" if settings.get("fibre_switch") is True else "no"),
    ]
    if settings.get("thin"):
        facts.append(("Longer protocols averaged to", f"{settings['thin']} rows"))
    return facts + [(f"Prior of {k}", words) for k, words in prior_texts(run).items()]


def _version_facts(run: Run) -> list[tuple[str, str]]:
    """Seed, hash and versions, without times, so that the same run writes the same page."""
    provenance = run.provenance
    return [
        ("biaxbayes", truncate(provenance["biaxbayes"], 30)),
        ("Seed", str(provenance["seed"])),
        ("SHA-256 of the specimen", truncate(provenance.get("specimen_sha256", ""), 64)),
        *((truncate(k, 30), truncate(v, 30)) for k, v in provenance["versions"].items()),
    ]


# --- rows of the tables --------------------------------------------------------------------------


def _test_rows(run: Run) -> list[Row]:
    """Largest stretches and loads of each protocol."""
    rows: list[Row] = []
    for i, s in enumerate(run.specimen.pieces):
        for p in s.protocols:
            name = p.name
            if i:
                name = f"{s.name}: {p.name}" if len(s.protocols) > 1 else s.name
            stretches = _read(s, p.stretch.max(axis=0), ".3f")
            loads = _read(s, abs(s.load(p)).max(axis=0), ".3g")
            at_rest = "none"
            if s.experiment.is_mounted:
                mounted = ", ".join(_read(s, s.mounting_reading(p), ".3g"))
                at_rest = mounted if p.rest_rows else "as the others"
            rows.append((truncate(name, 60), f"{p.rows:,}", *stretches, *loads, at_rest))
    return rows


def _read(specimen: Specimen, values: np.ndarray, digits: str) -> list[str]:
    """Numbers in x and y; a dash where nothing was read, such as across a strip."""
    axes = specimen.experiment.axes
    return [f"{v:{digits}}" if k in axes and v == v else DASH for k, v in enumerate(values)]


def _further_bands(run: Run) -> dict[str, str]:
    """Stems of the figures of bands of the other pieces, by their names."""
    further = run.specimen.further[:MOST_PIECES]
    return {truncate(s.name, 60): f"stress-bands-{i}" for i, s in enumerate(further, start=2)}


def _misfit_rows(checks: pd.DataFrame) -> list[Row]:
    """The posterior predictive check of every curve."""
    return [
        (
            truncate(r["protocol"], 60),
            r["direction"],
            f"{r['rms']:.3g} {r['unit']}",
            f"{100 * r['share']:.2g} %",
            f"{r['noise']:.3g}",
            str(r["runs"]),
            f"{r['expected_runs']:.0f}",
            f"{100 * r['inside']:.0f} %",
        )
        for r in checks.to_dict("records")
    ]


def _convergence_rows(run: Run) -> list[Row]:
    """Effective draws and R-hat of every quantity."""
    rows: list[Row] = []
    for row in run.summary.to_dict("records"):
        ess, rhat = min(row["ess_bulk"], row["ess_tail"]), row["rhat"]
        cells = (f"{ess:,.0f}", f"{rhat:.4f}")
        quantity = run.quantities[str(row["parameter"])]
        rows.append((quantity, *(DASH if text == "nan" else text for text in cells)))
    return rows


def _contraction_rows(run: Run) -> list[Row]:
    """Rows on how much the data narrow each parameter, and on its correlations."""
    rows: list[Row] = []
    for r in run.result.identifiability.to_dict("records"):
        contraction = float(r.get("contraction", math.nan))
        if math.isnan(contraction):
            continue
        quantity = run.quantities[str(r["parameter"])]
        partners = r["partners"] if isinstance(r["partners"], str) else ""
        rows.append(
            (
                quantity,
                f"{min(100.0 * max(contraction, 0.0), 99.9):.3g} %",
                truncate(", ".join(partners.split())) or "none",
                f"{100.0 * float(r['spread_given_partners']):.0f} %",
                f"{float(r['prior_sensitivity']):.2f}",
                f"{float(r['likelihood_sensitivity']):.2f}",
            )
        )
    return rows


def _law_rows(run: Run) -> list[Row]:
    """Least squares of every law under the same mounting constraint."""
    table = run.result.law_fits
    parameters = {q.name: q.parameter for q in run.quantities.of_kind(STRETCH) if q.name in table}
    rows: list[Row] = []
    for r in table.to_dict("records"):
        stretches = [p.number(float(r[n])) for n, p in parameters.items()]
        rows.append((truncate(r["law"], 30), f"{float(r['rms']):.3g}", ", ".join(stretches)))
    return rows


MOST_STRETCHES = 3
"""Number of total stretches on the page, besides those at the end of each protocol."""
TENSOR_TEXTS = {
    "Hx": "structure tensor, x",
    "Hy": "structure tensor, y",
    "Hz": "structure tensor, through the thickness",
}


def _determined_rows(table: pd.DataFrame, *, with_width: bool) -> list[Row]:
    """Quantities that follow from the draws, at the largest states of the test."""
    rows: list[Row] = []
    for r in table[_largest_states(table)].to_dict("records") if len(table) else ():
        low, median, high = (float(r[k]) for k in ("low", "median", "high"))
        wide = with_width and low > 0.0 and high / low > COARSE_RATIO
        middle, first, last = (number(v, low, high, log=wide) for v in (median, low, high))
        x, y = float(r["stretch_x"]), float(r["stretch_y"])
        state = "" if math.isnan(x) else f"{x:g}, {y:g}"
        name = truncate(r["quantity"], 90)
        row = [TENSOR_TEXTS.get(name, name), state, middle, f"{first} to {last}"]
        row.append(str(r["unit"] or ""))
        if with_width:
            percent = 100.0 * float(r["relative_width"])
            width = f"{percent:.2g} %" if percent < 10.0 else f"{percent:.0f} %"
            row.append(width if percent < 1e4 else "over 10,000 %")
        rows.append(tuple(row))
    return rows


def _without_stresses(table: pd.DataFrame) -> pd.DataFrame:
    return table[~table["quantity"].str.contains(" stress ")] if len(table) else table


def _largest_states(table: pd.DataFrame) -> pd.Series:
    """Rows at the largest total stretches, and at the end of each protocol."""
    measured = table["quantity"].str.contains(AT_MEASURED_STRETCH, regex=False)
    total = ~measured & (table["stretch_x"].notna()) & ~table["quantity"].str.startswith("small")
    state = table["stretch_x"].astype(str) + " " + table["stretch_y"].astype(str)
    last = list(dict.fromkeys(state[total]))[-MOST_STRETCHES:]
    ends = measured & ~table["quantity"].duplicated(keep="last")
    return (~measured & ~total) | (total & state.isin(last)) | ends
