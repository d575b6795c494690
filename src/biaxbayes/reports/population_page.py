"""population.html: the result of a population on one page, with a methods paragraph."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
from markupsafe import Markup

from biaxbayes.errors import listed, printable
from biaxbayes.identifiability.verdict import COMBINATION, NOT_IDENTIFIED
from biaxbayes.parameters import unit_words
from biaxbayes.populations.population_result import PopulationResult
from biaxbayes.report_table import (
    DASH,
    Cell,
    Column,
    Row,
    Table,
    as_html,
    interval_texts,
    quantiles_of,
    three_digits,
    truncate,
)
from biaxbayes.reports.answers import (
    CHANCE,
    direction_text,
    ends_text,
    group_pairs,
    population_answers,
    ratio_of,
)
from biaxbayes.reports.page import (
    Block,
    Section,
    bullets,
    captioned,
    notice,
    page_html,
    paragraph,
    pictures,
    prose,
    remarks,
    subheading,
    titled,
)
from biaxbayes.reports.study_page import QUANTITY, UNIT, named
from biaxbayes.reports.text import VERDICT_TERMS, capital, plural, text_or_empty
from biaxbayes.studies.groups import KNOWN_QUANTITIES, LARGER, LOG, SMALLER

PAGE, LATEX = "population.html", "population.tex"
TABLES = {
    "groups": ("population.csv", "groups"),
    "specimens": ("specimens.csv", "every specimen alone and pooled"),
    "contrasts": ("contrasts.csv", "differences between groups"),
}
"""File and content of each table of a population."""
TERMS = (
    *("population, group", "posterior", "prior", "median, 90 % interval", "alone, pooled"),
    *("typical donor", "sd of donors, sd of specimens", "sd (standard deviation)", "factor"),
    *("donor effect", "new specimen", "new donor", *VERDICT_TERMS, "predictive p"),
    *("mounting stretch", "structure tensor", "tangent stiffness, small-strain stiffness"),
    *("Cauchy stress, nominal stress", "ratio", "P(larger)", "likelihood"),
    *("converged, tentative, unusable", "effective draws (ESS), bulk and tail", "R-hat"),
)
BANDS = "new-specimen-bands"
FILES = {
    **dict(TABLES.values()),
    f"{BANDS}.csv": "stress of a new specimen",
    LATEX: "the table of the groups as LaTeX, with both paragraphs",
    "population.nc": "all draws",
}
"""Files of a population, with their content."""
FIGURE_TEXTS = {
    "population-forest": (
        "Specimens alone and pooled",
        "Medians and 90 % intervals. Grey: the specimen by its own test alone; coloured: together "
        "with the others (pooled); diamond: the centre of the group; thin line: a new specimen.",
        "Medians and 90 % intervals of every specimen alone and pooled, with those of its group; "
        "the numbers are in the tables.",
    ),
    "population-pairs": (
        "New specimens",
        "Every parameter (diagonal) and every pair. The contours contain 50 and 90 % of new "
        "specimens; points are the tested ones, pooled.",
        "Contours of new specimens for every pair of parameters, with the tested specimens as "
        "points.",
    ),
    BANDS: (
        "Stress of a new specimen",
        "Equibiaxial Cauchy stress: median and 90 % of new specimens, coloured; thin lines are the "
        "records of the tested ones.",
        "Equibiaxial Cauchy stress of new specimens over total stretch, with the equibiaxial "
        "records; the numbers are in new-specimen-bands.csv.",
    ),
}
"""Title, caption and alternative text of each figure."""
OPEN_VERDICTS = (COMBINATION, NOT_IDENTIFIED)
OPEN_NOTE = f"{NOT_IDENTIFIED} on its own: the number may be mostly that of the prior"


# --- the tables ----------------------------------------------------------------------------------


def quantile_texts(
    row: Row, part: str, write: Callable[[float], str] = three_digits
) -> tuple[str, str]:
    """Median and 90 % interval; a dash and nothing where there are no numbers."""
    median, low, high = quantiles_of(row, part)
    return (DASH, "") if math.isnan(median) else (write(median), f"{write(low)} to {write(high)}")


def _marked(median: str, verdict: object) -> str | Markup:
    """A number in italics with an asterisk if it is not identified on its own."""
    if verdict not in OPEN_VERDICTS or median == DASH:
        return median
    return Markup("<i>{}*</i>").format(median)


def spread_parts(groups: pd.DataFrame) -> dict[str, str]:
    """The sds that are given: the total alone where donors and specimens cannot be separated."""
    split = groups["sd_donors_q50"].notna().any() or groups["sd_total_q50"].isna().all()
    if split:
        return {"sd_donors": "Donors differ by", "sd_specimens": "Specimens differ by"}
    return {"sd_total": "Specimens of different donors differ by"}


def group_table(group: str, part: pd.DataFrame) -> Table:
    """The typical donor of a group, how donors and specimens differ, and new ones."""

    def typical(r: Row) -> Cell:
        return _marked(_centre(r), r["verdict"])

    def text(name: str, r: Row) -> str:
        return text_or_empty(r[name]) or DASH

    def spread(side: str, r: Row) -> Cell:
        log, verdict = r["scale"] == LOG, text_or_empty(r[f"{side}_verdict"])
        write = (lambda v: three_digits(ratio_of(v))) if log else three_digits
        median, ends = quantile_texts(r, side, write)
        factor = f"factor {median}" if log and median != DASH else median
        return (_marked(factor, verdict), ends, verdict)

    def new(name: str, r: Row) -> Cell:
        middle, first, last = interval_texts(*quantiles_of(r, name), log=r["scale"] == LOG)
        return DASH if middle == DASH else (f"{first} to {last}", f"median {middle}")

    columns = [
        QUANTITY,
        UNIT,
        Column("mean_q50", "Typical donor", format=typical, number=True, term=True),
        Column("reported", "Interval", format=partial(text, "reported"), number=True),
        Column("verdict", "Verdict", format=partial(text, "verdict"), term=True),
        *(
            Column(side, head, format=partial(spread, side), number=True)
            for side, head in spread_parts(part).items()
        ),
        *(
            Column(name, head, format=partial(new, name), number=True, term=True)
            for name, head in (("new_specimen", "New specimen"), ("new_donor", "New donor"))
        ),
    ]
    return Table(columns, part, truncate(group, 60))


def _centre(r: Row) -> str:
    """Median of the typical donor, with the digits of its reported interval."""
    return interval_texts(*quantiles_of(r, "mean"), log=r["scale"] == LOG)[0]


def contrast_table(a: str, b: str, part: pd.DataFrame) -> Table:
    """The typical donors of group b beside those of group a."""
    columns = [
        QUANTITY,
        Column("scale", "Difference", format=_kind),
        Column("difference_q50", "Median", format=lambda r: _apart(r)[0], number=True),
        Column("difference_q05", "90 % interval", format=lambda r: _apart(r)[1], number=True),
        Column("direction", f"In {b}", format=direction_text),
        Column("probability_positive", "P(larger)", format=".3f", number=True, term=True),
    ]
    return Table(columns, part, f"{b} compared with {a}")


def _kind(r: Row) -> str:
    unit = unit_words(str(r["unit"]))
    return "ratio" if r["scale"] == LOG else f"difference{' in' if unit else ''}{unit}"


def _apart(r: Row) -> tuple[str, str]:
    """Median and 90 % interval of a difference or ratio, as the sentences have them."""
    log, values = r["scale"] == LOG, quantiles_of(r, "difference")
    if math.isnan(values[0]):
        return DASH, ""
    median, low, high = map(ratio_of, values) if log else values
    return three_digits(median), ends_text(low, high, log=log)


def group_differences(
    contrasts: pd.DataFrame, groups: pd.DataFrame
) -> list[tuple[list[str], Table]]:
    """How each pair of groups differs, in sentences and a table."""
    return [
        (population_answers(part, groups), contrast_table(a, b, part))
        for a, b, part in group_pairs(contrasts)
    ]


def specimens_table(table: pd.DataFrame) -> Table:
    """Every specimen pooled, and in brackets the interval reported by its own run."""
    rows = {(str(r["specimen"]), str(r["quantity"])): r for r in table.to_dict("records")}

    def label(r: Row) -> Cell:
        origin = f"{truncate(r['group'], 40)}, {truncate(r['donor'], 40)}"
        return (truncate(r["specimen"], 60), origin)

    def quantity(name: str, first: Row) -> Cell:
        r = rows.get((str(first["specimen"]), name))
        if r is None:
            return DASH
        median, ends = quantile_texts(r, "pooled", KNOWN_QUANTITIES[name].parameter.number)
        own = text_or_empty(r["reported"]) or DASH
        return (_marked(median, r["pooled_verdict"]), ends, f"({own})")

    def fits(r: Row) -> str:
        return three_digits(float(r["specimen_predictive_p"]))

    known = [KNOWN_QUANTITIES[n] for n in dict.fromkeys(table["quantity"]) if n in KNOWN_QUANTITIES]
    columns = [
        Column("specimen", "Specimen, group, donor", format=label),
        Column("specimen_predictive_p", "Predictive p", format=fits, number=True, term=True),
        *(Column(q.name, q, q.unit, partial(quantity, q.name), number=True) for q in known),
    ]
    return Table(columns, table.drop_duplicates("specimen"), "Specimens")


# --- the page ------------------------------------------------------------------------------------


def population_page(
    folder: Path, tables: Mapping[str, pd.DataFrame], record: Mapping[str, Any]
) -> str:
    """The page as HTML from the three tables and the record in population.json."""
    own = tables["specimens"].drop_duplicates("specimen")
    usable = record["convergence"]["state"] != "unusable"
    groups = _groups(tables["groups"], tuple(record["pooled"])) if usable else []
    figures = []
    for stem, picture in pictures(folder, tuple(FIGURE_TEXTS)).items():
        title, caption, alt = FIGURE_TEXTS[stem]
        figures.append(Section(stem, title, [captioned(picture, alt, caption, title)]))
    differences = group_differences(tables["contrasts"], tables["groups"]) if usable else []
    about = prose(
        "Centre of one group compared with that of the other, as a [ratio] where a quantity "
        "varies in ratios. [P(larger)]: probability that it is larger in the group that the "
        "heading names first."
    )
    contrasts = [block for _, table in differences for block in titled(table)]
    contrasts = contrasts and [paragraph(about), *contrasts]
    every = tables["specimens"]["quantity"].isin(KNOWN_QUANTITIES).all()
    more = Markup("Mounting stretches of single protocols are in specimens.csv.")
    pooled = prose(
        "Median and 90 % interval after [pooling], and in brackets the interval of the specimen's "
        "own run. In italics with *: not identified even with the other specimens. [Predictive p] "
        "of the specimen in its group: below 0.05 it does not belong there."
    )
    specimens: list[Block | None] = [paragraph(pooled), specimens_table(tables["specimens"])]
    specimens += [] if every else [paragraph(more, "soft")]
    files = [f"{name}: {words}. " for name, words in FILES.items() if (folder / name).is_file()]
    cards = prose("Material cards of new specimens: `biaxbayes export` on this folder with ")
    cards += prose("`--population GROUP`.")
    paragraphs = (population_methods(tables, record), population_results(tables, record))
    sections = [
        Section("glance", "At a glance", _glance(record, differences)),
        Section("groups", "Groups", groups),
        *figures,
        Section("specimens", "Specimens", specimens),
        Section("contrasts", "Differences between groups", contrasts),
        Section("methods", "Methods and results", [paragraph(t, "paste") for t in paragraphs]),
        Section("files", "Files", [paragraph(Markup.escape("".join(files)) + cards)]),
    ]
    counts = f"{plural(len(own), 'specimen')} of {plural(int(own['donor'].nunique()), 'donor')}"
    counts += ": what they have in common, how they differ, and what the next one would be"
    return page_html("population", truncate(record["name"]), counts, sections, TERMS)


def _glance(
    record: Mapping[str, Any], differences: Sequence[tuple[list[str], Table]]
) -> list[Block | None]:
    state, reason = (record["convergence"][k] for k in ("state", "reason"))
    converged = state == "converged"
    left = [f"left out: {truncate(k)}: {truncate(v, 300)}" for k, v in record["left_out"].items()]
    return [
        notice(
            state,
            "The chains have converged." if converged else f"The population is {state}:",
            left,
            "" if converged else f"{reason}; no verdict on any number.",
        ),
        paragraph(
            "Every specimen keeps its own parameters. Those of one group scatter about a common "
            "centre; specimens of one donor share its donor effect. All are inferred together, so "
            "that the other specimens inform a parameter that a specimen's own test leaves open."
        ),
        *(b for said, table in differences for b in (subheading(table.label), bullets(said))),
        paragraph(Markup.escape(CHANCE), "soft") if differences else None,
        remarks("Read the numbers with this in mind.", [truncate(n, 500) for n in record["notes"]]),
    ]


def _groups(table: pd.DataFrame, pooled: tuple[str, ...]) -> list[Block]:
    about = prose(
        "[Typical donor]: the centre of the group. [Donors differ by, specimens differ by]: "
        "standard deviations, a [factor] where a quantity varies in ratios; below each its own "
        "[verdict]. The small numbers below these, and the ranges of new specimens and donors, are "
        "90 % intervals. In italics with *: "
        f"{OPEN_NOTE}."
    )
    blocks: list[Block] = [paragraph(about)]
    for group, part in table.groupby("group", sort=False):
        shown = group_table(str(group), part)
        blocks += [subheading(shown.label), paragraph(Markup.escape(_members(part)), "soft"), shown]
        words = [
            as_html(named(r["quantity"])) + Markup(": {}").format(truncate(r["in_words"], 400))
            for r in part.to_dict("records")
            if r["quantity"] in pooled and isinstance(r["in_words"], str)
        ]
        if words:
            blocks += [paragraph("Verdicts on the centre of the group:"), bullets(words)]
    return blocks


def _members(part: pd.DataFrame) -> str:
    specimens, donors = (int(part[k].iloc[0]) for k in ("specimens", "donors"))
    return f"{plural(specimens, 'specimen')} of {plural(donors, 'donor')}"


def population_methods(tables: Mapping[str, pd.DataFrame], record: Mapping[str, Any]) -> str:
    """One paragraph for a paper, with the numbers of this population."""
    groups = tables["groups"].groupby("group", sort=False)
    members = "; ".join(f"{truncate(group, 60)}: {_members(part)}" for group, part in groups)
    pooled = record["pooled"]
    logs = [name for name, v in pooled.items() if v["scale"] == "log"]
    others = [name for name in pooled if name not in logs]
    scales = [f"the natural logs of {listed(logs)}"] if logs else []
    scales += [f"{listed(others)} truncated at their physical limits"] if others else []
    units = tables["groups"].drop_duplicates("quantity").set_index("quantity")["unit"]
    priors = "; ".join(
        f"{name}: mean {v['mean']}{unit_words(units[name])}, sds {v['sd_donors']} between donors "
        f"and {v['sd_specimens']} between specimens"
        + (" of its log" if name in logs else unit_words(units[name]))
        for name, v in pooled.items()
    )
    families = ["N(mean, sd) normal", "half-normal(scale)"]
    families += ["LN(median, sd of the log) lognormal"] if logs else []
    convergence = record["convergence"]
    chains = (
        f"R-hat was at most {convergence['worst_rhat']:.3f} and the effective sample size of "
        f"every reported quantity at least {convergence['worst_ess']:.0f}."
        if convergence["state"] == "converged"
        else f"The chains did not converge ({convergence['reason']})."
    )
    names = record["sampled_again"]
    again = (
        f"; {listed(names)} {'was' if len(names) == 1 else 'were'} sampled again under the "
        "population's prior, where the Pareto k of the weights was above 0.7"
        if names
        else ""
    )
    left = f" Left out: {listed(list(record['left_out']))}." if record["left_out"] else ""
    return (
        f"A hierarchical model pooled the specimens ({members}). {capital(listed(scales))} "
        "of a specimen were normal around the mean of its group plus the effect of its donor, "
        "which was common to the donor's specimens; each specimen kept the likelihood of its "
        "single run, and the run's prior of the pooled parameters was divided out. Priors "
        f"({'; '.join(families)}): {priors}. The draws of the single runs were reweighted (Hogg et "
        f"al. 2010){again}. {chains}{left}"
    )


def population_results(tables: Mapping[str, pd.DataFrame], record: Mapping[str, Any]) -> str:
    """The pooled values and their differences as a paragraph, with the numbers of the tables."""
    if record["convergence"]["state"] != "converged":
        return "The chains have not converged: no result to report."
    sentences = []
    for name, part in tables["groups"].groupby("group", sort=False):
        group, rows = truncate(name, 60), part.to_dict("records")[: len(record["pooled"])]
        known = [
            f"{r['quantity']} {_centre(r)}{unit_words(r['unit'])} ({r['reported']})"
            for r in rows
            if r["verdict"] not in OPEN_VERDICTS and text_or_empty(r["reported"])
        ]
        left = [str(r["quantity"]) for r in rows if r["verdict"] in OPEN_VERDICTS]
        size = plural(int(part.iloc[0]["specimens"]), "specimen")
        if known:
            text = f"Medians of a typical donor of the group {group} ({size}) were "
            sentences.append(f"{text}{listed(known)} (90 % intervals or 95 % bounds).")
        if left:
            sentences.append(f"The specimens of {group} did not identify {listed(left)}.")
    for a, b, part in group_pairs(tables["contrasts"]):
        different = [
            f"{r['quantity']} ({_kind(r)} {', '.join(_apart(r))})"
            for r in part.to_dict("records")[: len(record["pooled"])]
            if r["direction"] in (LARGER, SMALLER)
        ]
        words = f"differed in {listed(different)}" if different else "showed no difference in them"
        sentences.append(f"The groups {b} and {a} {words}.")
    return " ".join(sentences)


def population_latex(tables: Mapping[str, pd.DataFrame], record: Mapping[str, Any]) -> str:
    """The groups as a LaTeX table with booktabs rules; both paragraphs as comments."""
    groups = tables["groups"]
    table = group_table("", groups).without(*spread_parts(groups), "new_specimen", "new_donor")
    group = Column("group", "Group", format=lambda r: truncate(r["group"], 60))
    lines = [
        "% needs \\usepackage{booktabs}",
        f"% Methods: {population_methods(tables, record)}",
        f"% Results: {population_results(tables, record)}",
        *replace(table, columns=[group, *table.columns]).latex(),
    ]
    if groups["verdict"].isin(OPEN_VERDICTS).any():
        lines.append(f"{{\\par\\smallskip\\footnotesize * {OPEN_NOTE}.\\par}}")
    return "\n".join([*lines, ""])


# --- what the terminal shows ---------------------------------------------------------------------


def closing_message(result: PopulationResult) -> str:
    """Differences between groups in sentences, the tables and notes, for a terminal."""
    converged = result.state == "converged"
    state = result.state if converged else f"{result.state.upper()}: {result.reason}"
    lines = [f"{printable(result.name)}: {state}"]
    notes = ["", *(f"note: {printable(note)}" for note in result.notes)]
    notes.append(f"all tables and draws are in {result.folder}")
    if result.state == "unusable":  # the tables have no numbers
        lines.append(
            "No number is given: continue with --resume and a larger --max-steps, or compare the "
            "groups as study.html of batch does, specimen by specimen."
        )
        return "\n".join([*lines, *notes])
    differences = group_differences(result.contrasts, result.groups)
    for said, table in differences:
        lines += ["", printable(table.label), *(f"  {printable(text)}" for text in said)]
    for group, part in result.groups.groupby("group", sort=False):
        table = group_table(str(group), part).without("new_donor")
        lines += ["", f"{printable(table.label)}: {_members(part)}", *table.lines(brief=True)]
    lines += ["", f"* {OPEN_NOTE}; new specimen: 90 %"]
    for _, table in differences:
        lines += ["", printable(table.label), *table.lines()]
    return "\n".join([*lines, *notes])
