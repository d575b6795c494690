"""report.html: a run on one page."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TypeAlias

import numpy as np
import pandas as pd
from markupsafe import Markup

from biaxbayes.derived.determined import AT_MEASURED_STRETCH
from biaxbayes.errors import load_text
from biaxbayes.identifiability.reported import report_table
from biaxbayes.parameters import STRETCH
from biaxbayes.prediction.nearest_law import TO_READINGS
from biaxbayes.prediction.predictive_checks import checks_in_words
from biaxbayes.report_table import DASH, Column, Row, Table, interval_texts, truncate
from biaxbayes.reports.methods import methods, prior_texts, results_paragraph
from biaxbayes.reports.page import (
    Block,
    Page,
    Section,
    bullets,
    captioned,
    fact_list,
    notice,
    paragraph,
    prose,
    remarks,
    subheading,
    titled,
)
from biaxbayes.reports.templates import Picture, pictures
from biaxbayes.reports.text import CONVERGENCE_TEXTS, GLOSSARY, capital, tests_in_words
from biaxbayes.runs.run import Run
from biaxbayes.specimens.check import alignment_note
from biaxbayes.specimens.specimen import Specimen

RUN_FIGURES = ("stress-bands", "corner", "identifiability", "trace", "grips")
REPORT_CAPTION = "Posterior medians with 90 % intervals, or 95 % bounds"
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


def report_page(run: Run) -> str:
    """The page as HTML: no scripts, no network, figures of the folder inside."""
    bands = {
        s.name: f"stress-bands-{i}" for i, s in enumerate(run.specimen.further[:MOST_PIECES], 2)
    }
    drawn = pictures(run.path, (*RUN_FIGURES, *bands.values()))

    def figure(stem: str, alt: str, caption: str) -> Markup:
        return captioned(drawn.get(stem), alt, caption, stem)

    mounted = any(s.experiment.is_mounted for s in run.specimen.pieces)
    about = Markup("Posterior of the {} model{} of <bdi>{}</bdi>").format(
        run.law.title,
        " and the mounting stretches" if mounted else "",
        tests_in_words(run.specimen),
    )
    sections = [
        Section("report", "What to report", _what_to_report(run, figure)),
        Section("stress", "Stress over data", _stress(run, figure, bands)),
        *_simulation(run),
        Section("test", "Specimen and test", _test(run, figure)),
        Section("evidence", "Evidence", _evidence(run, figure)),
        Section("convergence", "Convergence", _convergence(run, drawn.get("trace"))),
        Section(
            "settings",
            "Settings and versions",
            [
                fact_list(_settings_facts(run)),
                subheading("Versions"),
                fact_list(_version_facts(run)),
            ],
        ),
        Section("methods", "Methods and citation", _paragraphs(run)),
    ]
    return Page("report", truncate(run.specimen.name), about, sections, list(GLOSSARY)).html()


# --- the sections --------------------------------------------------------------------------------


Draw: TypeAlias = Callable[[str, str, str], Markup]
"""A figure of the folder by its stem, with its alternative text and caption."""


def _what_to_report(run: Run, figure: Draw) -> list[Block | None]:
    result, reason = run.result, run.provenance["convergence"]["reason"]
    rows = (*result.reported, *result.stiffnesses)
    low = [f"{capital(result.low_information)}."] if result.low_information else []
    return [
        notice(run.state, CONVERGENCE_TEXTS[run.state], text=truncate(reason, 400)),
        remarks("Look at the record first.", result.findings),
        result.known or None,
        report_table(rows, caption=REPORT_CAPTION, meaning=True),
        *(paragraph(f"{capital(text)}.") for text in (result.fit, *result.pieces) if text),
        remarks("Most parameters are not determined.", low),
        remarks("The law misses some protocols.", result.warnings),
        paragraph(prose(f"{capital(result.advice)}.")) if result.advice else None,
        figure(
            "identifiability",
            "Prior and posterior of every parameter beside its row of the table above.",
            "Prior (grey) and posterior (blue) of every parameter, beside its row of the table.",
        ),
    ]


def _stress(run: Run, figure: Draw, further: Mapping[str, str]) -> list[Block]:
    table = _determined_table(
        run.result.stresses,
        "Stresses to report",
        "Posterior median and 90 % intervals at stretches in x and y",
    )
    of = "the tissue: of the law and its misfit" if run.settings.has_misfit else "the law"
    about = (
        f"Stresses of {of}. `report-stresses.csv` has them at more stretches. A nominal stress is "
        "the force over the section of the unloaded specimen. Stresses at total stretches rest on "
        "the mounting stretches and on the law below the mounted state, where nothing was read: "
        "their intervals hold what is not known of these."
    )
    return [
        figure(
            "stress-bands",
            "Measured load of every protocol in x and y against stretch, with the credible and the "
            "predictive 90 % band and the nearest law, and the residuals below.",
            "Measured points with the credible band (of the tissue) and the predictive band (of a "
            "new reading), protocol by protocol; dotted the law nearest to the tissue, as on the "
            "median card for a simulation. Residuals about the median below.",
        ),
        *(
            figure(
                stem,
                "Measured load of a further piece against stretch with both bands, and the "
                "residuals below.",
                f"The same of {truncate(piece, 60)}.",
            )
            for piece, stem in further.items()
        ),
        *titled(table.without("relative_width"), prose(about)),
    ]


def _simulation(run: Run) -> list[Section]:
    """What to put into a simulation; nothing of runs without it."""
    table = run.result.simulation
    if table.empty:
        return []
    rows = {str(r["quantity"]): r for r in table.to_dict("records")}
    off, low, high = (100.0 * rows[TO_READINGS][k] for k in ("median_card", "q05", "q95"))
    about = (
        "A drawn law and its misfit together pass through the readings; the law alone need not. "
        "For a simulation take the law nearest to the drawn tissue on the tested paths. "
        if run.settings.has_misfit
        else "Errors are independent here, so that a drawn law goes into a simulation unchanged. "
    ) + (
        f"The median one is off the readings by {off:.2g} % (relative root mean square; "
        f"{low:.2g} to {high:.2g} % over the draws). The spread is what a simulation should carry:"
    )
    values = []
    for q in (run.quantities[name] for name in run.law.names):
        card, low, high = (float(rows[q.name][k]) for k in ("median_card", "q05", "q95"))
        middle, first, last = interval_texts(card, low, high, q.parameter)
        unit = q.parameter.unit_words()
        values.append(f"{q.name}: {middle}{unit} ({first} to {last}{unit})")
    command = prose("`biaxbayes export RUN --to abaqus` writes the median card, `--draws 20` more.")
    blocks: list[Block] = [paragraph(about), bullets(values), paragraph(command)]
    return [Section("simulation", "For a simulation", blocks)]


def _test(run: Run, figure: Draw) -> list[Block]:
    provenance = run.provenance
    blocks: list[Block] = [fact_list(_specimen_facts(run)), _test_table(run)]
    if grips := _grip_table(run):
        blocks += [
            subheading("Correction for the hooks"),
            figure(
                "grips",
                "Sketch of the sheet and its hooks to scale; force on the hooks over that of a "
                "uniform test along each protocol.",
                "The hooks, and the ratio by which the loads were divided, with twice its sd over "
                "the posterior.",
            ),
            grips,
        ]
    texts = (*provenance["notes"], provenance["sampler"]["message"], alignment_note(run.specimen))
    notes = [truncate(f"{capital(n).rstrip('.')}.", 600) for n in texts if n]
    return [*blocks, subheading("Notes"), bullets(notes)] if notes else blocks


def _evidence(run: Run, figure: Draw) -> list[Block | None]:
    result, noise, smooth = run.result, run.provenance["noise"], run.provenance["misfit"]
    known_best = [d["in_words"] for d in result.directions[:1]] + [result.same_curves_in_words]
    checks = pd.DataFrame() if run.state == "unusable" else result.checks
    misfit = (
        f"The {noise['readings']} readings were taken as independent. If the law misses "
        "smoothly, the intervals are too narrow."
        if smooth["amplitude"] is None
        else "A smooth misfit of the law is part of the model, so the intervals hold it: by "
        f"the readings its relative size is {100 * smooth['amplitude']:.2g} %. Near the "
        f"mounted state this record follows the law to {100 * smooth['toe']:.2g} %, where "
        f"{100 * run.settings.toe:g} % was allowed for. Friction in the loads (or an error of "
        f"the first readings) has a probability of {_percent(smooth['friction'])}."
    )
    fit = f"{capital(result.fit)}: readings minus the law at its least-squares fit."
    found = checks_in_words(checks) if len(checks) else []
    better = f" {capital(result.better_law)}." if result.better_law else ""
    determined = result.determined
    if len(determined):
        determined = determined[~determined["quantity"].str.contains(" stress ")]
    return [
        paragraph(prose("Evidence for the table above. The tables are in the folder `evidence`.")),
        subheading("Misfit"),
        paragraph(fit) if result.fit else None,
        paragraph(misfit),
        *(paragraph(truncate(text, 400)) for text in found),
        _misfit_table(checks) if len(checks) else None,
        *titled(
            _law_table(run),
            prose(
                "Other laws fitted to the same record by least squares, for information: nothing "
                f"above depends on them.{better}"
            ),
        ),
        *titled(
            _information_table(run),
            "A parameter that the data determine has a contraction near 100 %; one that trades "
            "with others would be much narrower if these were known.",
            heading="Information of the data on each parameter",
        ),
        subheading("Joint posterior"),
        paragraph(
            prose(
                "`biaxbayes app` shows these draws to brush, with their curves and other priors."
            ),
            "soft",
        ),
        figure(
            "corner",
            "Corner plot: marginal density of every parameter on the diagonal, every pair below "
            "it.",
            "The posterior: every parameter (diagonal) and every pair. A narrow ridge is a "
            "combination that the data determine although its parts stay open.",
        ),
        *(paragraph(f"{capital(text)}.") for text in known_best if text),
        *titled(
            _determined_table(
                determined,
                "Stiffnesses and fibre structure",
                "Posterior median and 90 % intervals, at stretches in x and y",
            ),
            "The data can determine these even if single parameters stay open.",
        ),
    ]


def _convergence(run: Run, trace: Picture | None) -> list[Block]:
    convergence, sampler = (run.provenance[k] for k in ("convergence", "sampler"))
    text = CONVERGENCE_TEXTS[run.state]
    if convergence["worst_rhat"]:
        text += (
            " Over all quantities the largest R-hat across ensembles is "
            f"{convergence['worst_rhat']:.4f}, the smallest effective sample size "
            f"{convergence['worst_ess']:,.0f}."
        )
    text += f" {sampler['ensembles']} independent ensembles of {sampler['walkers']} walkers, "
    text += f"{sampler['steps']:,} steps each"
    if isinstance(sampler.get("acceptance"), float):
        text += f", {100 * sampler['acceptance']:.0f} % accepted"
    alt = "Traces of every quantity, one line per ensemble; R-hat is in the table above."
    caption = "The chains over the steps, ensemble by ensemble."
    figures = [captioned(trace, alt, caption, "trace")] if trace else []
    return [paragraph(f"{text}."), _convergence_table(run), *figures]


def _paragraphs(run: Run) -> list[Block]:
    blocks: list[Block] = [subheading("Methods paragraph"), paragraph(methods(run), "paste")]
    if results := results_paragraph(run):
        blocks += [subheading("Results paragraph"), paragraph(results, "paste")]
    version = truncate(run.provenance["biaxbayes"], 30)
    cited = [(SOFTWARE.format(version), ""), METHOD, (f"{run.law.source}.", run.law.doi), SAMPLER]
    link = Markup(' <a href="https://doi.org/{0}" rel="noreferrer">doi:{0}</a>')
    items = [Markup("{}").format(text) + (link.format(doi) if doi else "") for text, doi in cited]
    return [*blocks, subheading("How to cite"), bullets(items)]


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
    if size := s.experiment.size(s.header):
        facts.append(("Dimensions", f"{size}, {s.geometry}"))
    else:
        facts.append(("Reference of the stresses", f"{s.geometry} dimensions"))
    of_units = dict.fromkeys(s.units[k] for k in s.experiment.axes)
    facts.append(("Measured", f"{s.kind_of_loads.words} ({', '.join(of_units)})"))
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
    if settings.get("max_rows"):
        facts.append(("Longer protocols averaged to", f"{settings['max_rows']} rows"))
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


# --- the tables ----------------------------------------------------------------------------------


def _grip_table(run: Run) -> Table:
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
    heads = ("As measured", "Corrected", "On a coarser mesh")
    return Table.of_texts(
        [Column("Parameter"), *(Column(head, number=True) for head in heads)],
        rows,
        "Fit with and without the correction",
        "Least-squares parameters of the loads as measured, and corrected on two meshes",
    )


def _test_table(run: Run) -> Table:
    """Largest stretches and loads of each protocol."""
    rows = []
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
    first = run.specimen
    nominal = first.unit == "kPa" and first.experiment.is_mounted
    load = "nominal stress" if nominal else first.kind_of_loads.words
    heads = ("Rows", "Stretch x", "Stretch y", "Load x", "Load y", "Mounted x, y")
    return Table.of_texts(
        [Column("Protocol"), *(Column(head, number=True) for head in heads)],
        rows,
        "Protocols",
        f"Protocols: rows, largest measured stretch, largest {load} and reading at the mounted "
        f"state ({first.unit})",
    )


def _read(specimen: Specimen, values: np.ndarray, digits: str) -> list[str]:
    """Numbers in x and y; a dash where nothing was read, such as across a strip."""
    axes = specimen.experiment.axes
    return [f"{v:{digits}}" if k in axes and v == v else DASH for k, v in enumerate(values)]


def _percent(probability: float) -> str:
    """A probability in percent."""
    return "less than 0.1 %" if probability < 1e-3 else f"{100 * probability:.2g} %"


def _misfit_table(checks: pd.DataFrame) -> Table:
    """The posterior predictive check of every curve."""
    columns = [
        Column("protocol", "Protocol", format=lambda r: truncate(r["protocol"], 60)),
        Column("direction", "Direction"),
        Column("runs", "Runs", number=True, term=True),
        Column("expected_runs", "Expected", format=".0f", number=True),
        Column("inside", "In 90 % band", format=".0f %", number=True),
    ]
    caption = (
        "Readings minus the law at the posterior median: runs of one sign, and those expected of "
        "independent errors; readings in their own predictive band"
    )
    return Table(columns, checks, "Check of every curve", caption)


def _convergence_table(run: Run) -> Table:
    """Effective draws and R-hat of every quantity."""
    summary = run.summary
    ess = summary[["ess_bulk", "ess_tail"]].min(axis=1, skipna=False)
    columns = [
        Column("parameter", "Quantity", format=lambda r: run.quantities[r["parameter"]]),
        Column("ess", "Effective draws", format=",.0f", number=True, term=True),
        Column("rhat", "R-hat", format=".4f", number=True, term=True),
    ]
    caption = "Effective sample size (the smaller of bulk and tail) and R-hat"
    return Table(columns, summary.assign(ess=ess), "Convergence of every quantity", caption)


def _information_table(run: Run) -> Table:
    """How much the data narrow each parameter, and what it is correlated with."""
    table = run.result.identifiability
    known = table[table["contraction"].notna()] if "contraction" in table else table.iloc[:0]
    known = known.assign(contraction=known["contraction"].clip(0.0, 0.999)) if len(known) else known
    columns = [
        Column("parameter", "Parameter", format=lambda r: run.quantities[r["parameter"]]),
        Column("contraction", "Contraction", format=".3g %", number=True, term=True),
        Column("partners", "Trades with", format=lambda r: _partners(r["partners"])),
        Column("spread_given_partners", "Width left", format=".0f %", number=True),
        Column("prior_sensitivity", "Prior", format=".2f", number=True),
        Column("likelihood_sensitivity", "Data", format=".2f", number=True),
    ]
    caption = (
        "Contraction; what a parameter trades with and the width left once that is known; "
        "sensitivity to the prior and to the data"
    )
    return Table(columns, known, "Information of the data", caption)


def _partners(names: object) -> str:
    return truncate(", ".join(names.split())) if isinstance(names, str) and names else "none"


def _law_table(run: Run) -> Table:
    """Least squares of every law under the same mounting constraint."""
    table = run.result.law_fits
    stretches = {q.name: q.parameter for q in run.quantities.of_kind(STRETCH) if q.name in table}
    columns = [
        Column("law", "Law", format=lambda r: truncate(r["law"], 30)),
        Column(
            "rms", "Misfit", format=lambda r: load_text(r["rms"], run.specimen.unit), number=True
        ),
        Column(
            "",
            "Mounting stretches",
            format=lambda r: ", ".join(p.number(float(r[n])) for n, p in stretches.items()),
            number=True,
        ),
    ]
    pieces = " to all pieces" if run.specimen.further else ""
    caption = f"Root mean square misfit{pieces}; mounting stretches in x and y"
    return Table(columns, table, "Other laws", caption)


MOST_STRETCHES = 3
"""Number of total stretches on the page, besides those at the end of each protocol."""
TENSOR_TEXTS = {
    "Hx": "structure tensor, x",
    "Hy": "structure tensor, y",
    "Hz": "structure tensor, through the thickness",
}


def _determined_table(table: pd.DataFrame, label: str, caption: str) -> Table:
    """Quantities that follow from the draws, at the largest states of the test."""
    columns = [
        Column("quantity", "Quantity", format=_derived_name),
        Column("stretch_x", "At stretch", format=_at_stretch, number=True),
        Column("median", "Median", format=lambda r: _texts(r)[0], number=True),
        Column(
            "low",
            "90 % interval",
            format=lambda r: " to ".join(_texts(r)[1:]),
            number=True,
            term=True,
        ),
        Column("unit", "Unit"),
        Column("relative_width", "Width", format=_width, number=True),
    ]
    return Table(columns, table[_largest_states(table)] if len(table) else table, label, caption)


def _texts(r: Row) -> tuple[str, str, str]:
    return interval_texts(r["median"], r["low"], r["high"], log=" stress " not in r["quantity"])


def _derived_name(r: Row) -> str:
    name = truncate(r["quantity"], 90)
    return TENSOR_TEXTS.get(name, name)


def _at_stretch(r: Row) -> str:
    x, y = float(r["stretch_x"]), float(r["stretch_y"])
    return "" if math.isnan(x) else f"{x:g}, {y:g}"


def _width(r: Row) -> str:
    percent = 100.0 * float(r["relative_width"])
    width = f"{percent:.2g} %" if percent < 10.0 else f"{percent:.0f} %"
    return width if percent < 1e4 else "over 10,000 %"


def _largest_states(table: pd.DataFrame) -> pd.Series:
    """Rows at the largest total stretches, and at the end of each protocol."""
    measured = table["quantity"].str.contains(AT_MEASURED_STRETCH, regex=False)
    total = ~measured & (table["stretch_x"].notna()) & ~table["quantity"].str.startswith("small")
    state = table["stretch_x"].astype(str) + " " + table["stretch_y"].astype(str)
    last = list(dict.fromkeys(state[total]))[-MOST_STRETCHES:]
    ends = measured & ~table["quantity"].duplicated(keep="last")
    return (~measured & ~total) | (total & state.isin(last)) | ends
