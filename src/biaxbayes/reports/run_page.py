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
    Picture,
    Section,
    bullets,
    captioned,
    fact_list,
    notice,
    page_html,
    paragraph,
    pictures,
    prose,
    remarks,
    subheading,
    titled,
)
from biaxbayes.reports.text import (
    CONVERGENCE_TEXTS,
    GLOSSARY,
    capital,
    derived_text,
    text_or_empty,
)
from biaxbayes.runs.run import Run
from biaxbayes.specimens.check import alignment_note
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.text_files import first_few

RUN_FIGURES = ("stress-bands", "corner", "identifiability", "trace", "grips")
REPORT_CAPTION = "Posterior medians with 90 % intervals, or 95 % bounds"


def report_page(run: Run) -> str:
    """The page as HTML: no scripts, no network, figures of the folder inside."""
    further = run.specimen.further[:12]
    bands = {s.name: f"stress-bands-{i}" for i, s in enumerate(further, start=2)}
    drawn = pictures(run.path, (*RUN_FIGURES, *bands.values()))

    def figure(stem: str, alt: str, caption: str) -> Markup:
        return captioned(drawn.get(stem), alt, caption, stem)

    mounted = any(s.experiment.is_mounted for s in run.specimen.pieces)
    what = f"{run.law.title} model{' and the mounting stretches' if mounted else ''}"
    tests = run.specimen.experiment.words
    if run.specimen.further:
        named = [f"{p.experiment.words} ({truncate(p.name, 40)})" for p in run.specimen.pieces]
        tests = f"{len(named)} pieces of one tissue: {first_few(named, 6)}"
    about = Markup("Posterior of the {} of <bdi>{}</bdi>").format(what, tests)
    sections = [
        Section("report", "What to report", _what_to_report(run, figure)),
        Section("stress", "Stress over data", _stress(run, figure, bands)),
        *_simulation(run),
        Section("test", "Specimen and test", _test(run, figure)),
        Section("evidence", "Evidence", _evidence(run, figure)),
        Section("convergence", "Convergence", _convergence(run, drawn.get("trace"))),
        Section("settings", "Settings and versions", _settings(run)),
        Section("methods", "Methods and citation", _paragraphs(run)),
    ]
    return page_html("report", truncate(run.specimen.name), about, sections, list(GLOSSARY))


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
    caption = "Posterior median and 90 % intervals at stretches in x and y"
    table = _determined_table(run.result.stresses, "Stresses to report", caption)
    of = "the tissue: of the law and its misfit" if run.settings.has_misfit else "the law"
    about = (
        f"Stresses of {of}. `report-stresses.csv` has them at more stretches. A nominal stress is "
        "the force over the section of the unloaded specimen. Stresses at total stretches rest on "
        "the mounting stretches and on the law below the mounted state, where nothing was read: "
        "their intervals hold what is not known of these."
    )
    of_piece = (
        "Measured load of a further piece against stretch with both bands, and the residuals below."
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
            figure(stem, of_piece, f"The same of {truncate(piece, 60)}.")
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
    s, provenance = run.specimen, run.provenance
    facts = [("Specimen", truncate(s.name))]
    if s.layer:
        facts.append(("Layer", truncate(s.layer)))
    if axes := [f"{a}: {truncate(n, 60)}" for a, n in (("x", s.axis_x), ("y", s.axis_y)) if n]:
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
    facts.append(("File", truncate(provenance.get("source", ""))))
    blocks: list[Block] = [fact_list(facts), _test_table(run)]
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
    texts = (*provenance["notes"], provenance["sampler"]["message"], alignment_note(s))
    notes = [truncate(f"{capital(n).rstrip('.')}.", 600) for n in texts if n]
    return [*blocks, subheading("Notes"), bullets(notes)] if notes else blocks


def _evidence(run: Run, figure: Draw) -> list[Block | None]:
    result, noise, smooth = run.result, run.provenance["noise"], run.provenance["misfit"]
    known_best = [d["in_words"] for d in result.directions[:1]] + [result.same_curves_in_words]
    checks = pd.DataFrame() if run.state == "unusable" else result.checks
    if smooth["amplitude"] is None:
        misfit = (
            f"The {noise['readings']} readings were taken as independent. If the law misses "
            "smoothly, the intervals are too narrow."
        )
    else:
        friction = smooth["friction"]
        probability = "less than 0.1 %" if friction < 1e-3 else f"{100 * friction:.2g} %"
        misfit = (
            "A smooth misfit of the law is part of the model, so the intervals hold it: by "
            f"the readings its relative size is {100 * smooth['amplitude']:.2g} %. Near the "
            f"mounted state this record follows the law to {100 * smooth['toe']:.2g} %, where "
            f"{100 * run.settings.toe:g} % was allowed for. Friction in the loads (or an error of "
            f"the first readings) has a probability of {probability}."
        )
    fit = f"{capital(result.fit)}: readings minus the law at its least-squares fit."
    better = f" {capital(result.better_law)}." if result.better_law else ""
    others = (
        "Other laws fitted to the same record by least squares, for information: nothing above "
        f"depends on them.{better}"
    )
    explore = "`biaxbayes app` shows these draws to brush, with their curves and other priors."
    determined = result.determined
    if len(determined):
        determined = determined[~determined["quantity"].str.contains(" stress ")]
    caption = "Posterior median and 90 % intervals, at stretches in x and y"
    structure = _determined_table(determined, "Stiffnesses and fibre structure", caption)
    return [
        paragraph(prose("Evidence for the table above. The tables are in the folder `evidence`.")),
        subheading("Misfit"),
        paragraph(fit) if result.fit else None,
        paragraph(misfit),
        *(paragraph(truncate(t, 400)) for t in (checks_in_words(checks) if len(checks) else ())),
        _misfit_table(checks) if len(checks) else None,
        *titled(_law_table(run), prose(others)),
        *titled(
            _information_table(run),
            "A parameter that the data determine has a contraction near 100 %; one that trades "
            "with others would be much narrower if these were known.",
            heading="Information of the data on each parameter",
        ),
        subheading("Joint posterior"),
        paragraph(prose(explore), "soft"),
        figure(
            "corner",
            "Corner plot: marginal density of every parameter on the diagonal, every pair below "
            "it.",
            "The posterior: every parameter (diagonal) and every pair. A narrow ridge is a "
            "combination that the data determine although its parts stay open.",
        ),
        *(paragraph(f"{capital(text)}.") for text in known_best if text),
        *titled(structure, "The data can determine these even if single parameters stay open."),
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
    summary = run.summary
    ess = summary[["ess_bulk", "ess_tail"]].min(axis=1, skipna=False)
    columns = [
        Column("parameter", "Quantity", format=lambda r: run.quantities[r["parameter"]]),
        Column("ess", "Effective draws", format=",.0f", number=True, term=True),
        Column("rhat", "R-hat", format=".4f", number=True, term=True),
    ]
    caption = "Effective sample size (the smaller of bulk and tail) and R-hat"
    table = Table(columns, summary.assign(ess=ess), "Convergence of every quantity", caption)
    alt = "Traces of every quantity, one line per ensemble; R-hat is in the table above."
    caption = "The chains over the steps, ensemble by ensemble."
    figures = [captioned(trace, alt, caption, "trace")] if trace else []
    return [paragraph(f"{text}."), table, *figures]


def _paragraphs(run: Run) -> list[Block]:
    blocks: list[Block] = [subheading("Methods paragraph"), paragraph(methods(run), "paste")]
    if results := results_paragraph(run):
        blocks += [subheading("Results paragraph"), paragraph(results, "paste")]
    cited = [
        (
            "The biaxbayes developers. biaxbayes: Bayesian material parameters and mounting "
            "stretches from planar biaxial tests, version "
            f"{truncate(run.provenance['biaxbayes'], 30)}.",
            "",
        ),
        (
            "Improved Mechanical Characterization of Soft Tissues Including Mounting Stretches. "
            "Mathematical and Computational Applications 29(4), 55, 2024.",
            "10.3390/mca29040055",
        ),
        (f"{run.law.source}.", run.law.doi),
        (
            "Foreman-Mackey, Hogg, Lang, Goodman. emcee: The MCMC Hammer. Publications of the "
            "Astronomical Society of the Pacific 125, 306-312, 2013.",
            "10.1086/670067",
        ),
    ]
    link = Markup(' <a href="https://doi.org/{0}" rel="noreferrer">doi:{0}</a>')
    items = [Markup("{}").format(text) + (link.format(doi) if doi else "") for text, doi in cited]
    return [*blocks, subheading("How to cite"), bullets(items)]


def _settings(run: Run) -> list[Block]:
    """Settings and priors; versions without times, so that the same run writes the same page."""
    provenance, settings = run.provenance, run.provenance["settings"]
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
    facts += [(f"Prior of {k}", words) for k, words in prior_texts(run).items()]
    versions = [
        ("biaxbayes", truncate(provenance["biaxbayes"], 30)),
        ("Seed", str(provenance["seed"])),
        ("SHA-256 of the specimen", truncate(provenance.get("specimen_sha256", ""), 64)),
        *((truncate(k, 30), truncate(v, 30)) for k, v in provenance["versions"].items()),
    ]
    return [fact_list(facts), subheading("Versions"), fact_list(versions)]


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
    """Largest stretches and loads of each protocol; a dash where nothing was read in x or y."""

    def texts(s: Specimen, values: np.ndarray, digits: str) -> list[str]:
        axes = s.experiment.axes
        return [f"{v:{digits}}" if k in axes and v == v else DASH for k, v in enumerate(values)]

    rows = []
    for i, s in enumerate(run.specimen.pieces):
        for p in s.protocols:
            name = p.name
            if i:
                name = f"{s.name}: {p.name}" if len(s.protocols) > 1 else s.name
            stretches = texts(s, p.stretch.max(axis=0), ".3f")
            loads = texts(s, abs(s.load(p)).max(axis=0), ".3g")
            at_rest = "none"
            if s.experiment.is_mounted:
                mounted = ", ".join(texts(s, s.mounting_reading(p), ".3g"))
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


def _information_table(run: Run) -> Table:
    """How much the data narrow each parameter, and what it is correlated with."""
    table = run.result.identifiability
    known = table[table["contraction"].notna()] if "contraction" in table else table.iloc[:0]
    known = known.assign(contraction=known["contraction"].clip(0.0, 0.999)) if len(known) else known

    def partners(r: Row) -> str:
        return truncate(", ".join(text_or_empty(r["partners"]).split())) or "none"

    columns = [
        Column("parameter", "Parameter", format=lambda r: run.quantities[r["parameter"]]),
        Column("contraction", "Contraction", format=".3g %", number=True, term=True),
        Column("partners", "Trades with", format=partners),
        Column("spread_given_partners", "Width left", format=".0f %", number=True),
        Column("prior_sensitivity", "Prior", format=".2f", number=True),
        Column("likelihood_sensitivity", "Data", format=".2f", number=True),
    ]
    caption = (
        "Contraction; what a parameter trades with and the width left once that is known; "
        "sensitivity to the prior and to the data"
    )
    return Table(columns, known, "Information of the data", caption)


def _law_table(run: Run) -> Table:
    """Least squares of every law under the same mounting constraint."""
    table = run.result.law_fits
    stretches = {q.name: q.parameter for q in run.quantities.of_kind(STRETCH) if q.name in table}
    unit = run.specimen.unit

    def mounting(r: Row) -> str:
        return ", ".join(p.number(float(r[n])) for n, p in stretches.items())

    columns = [
        Column("law", "Law", format=lambda r: truncate(r["law"], 30)),
        Column("rms", "Misfit", format=lambda r: load_text(r["rms"], unit), number=True),
        Column("", "Mounting stretches", format=mounting, number=True),
    ]
    pieces = " to all pieces" if run.specimen.further else ""
    caption = f"Root mean square misfit{pieces}; mounting stretches in x and y"
    return Table(columns, table, "Other laws", caption)


def _determined_table(table: pd.DataFrame, label: str, caption: str) -> Table:
    """Quantities at the three largest total stretches, and at the end of each protocol."""

    def name(r: Row) -> str:
        text = truncate(r["quantity"], 90)
        return "structure tensor, through the thickness" if text == "Hz" else derived_text(text)

    def at_stretch(r: Row) -> str:
        x, y = float(r["stretch_x"]), float(r["stretch_y"])
        return "" if math.isnan(x) else f"{x:g}, {y:g}"

    def texts(r: Row) -> tuple[str, str, str]:
        return interval_texts(r["median"], r["low"], r["high"], log=" stress " not in r["quantity"])

    def interval(r: Row) -> str:
        return " to ".join(texts(r)[1:])

    def width(r: Row) -> str:
        percent = 100.0 * float(r["relative_width"])
        text = f"{percent:.2g} %" if percent < 10.0 else f"{percent:.0f} %"
        return text if percent < 1e4 else "over 10,000 %"

    columns = [
        Column("quantity", "Quantity", format=name),
        Column("stretch_x", "At stretch", format=at_stretch, number=True),
        Column("median", "Median", format=lambda r: texts(r)[0], number=True),
        Column("low", "90 % interval", format=interval, number=True, term=True),
        Column("unit", "Unit"),
        Column("relative_width", "Width", format=width, number=True),
    ]
    if table.empty:
        return Table(columns, table, label, caption)
    measured = table["quantity"].str.contains(AT_MEASURED_STRETCH, regex=False)
    total = ~measured & (table["stretch_x"].notna()) & ~table["quantity"].str.startswith("small")
    state = table["stretch_x"].astype(str) + " " + table["stretch_y"].astype(str)
    last = list(dict.fromkeys(state[total]))[-3:]
    ends = measured & ~table["quantity"].duplicated(keep="last")
    shown = (~measured & ~total) | (total & state.isin(last)) | ends
    return Table(columns, table[shown], label, caption)
