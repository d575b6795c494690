"""population.html: the result of a population on one page, with a methods paragraph."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
from markupsafe import Markup

from biaxbayes.errors import listed, printable
from biaxbayes.identifiability.verdict import FIXED, NOT_IDENTIFIED
from biaxbayes.parameters import unit_words
from biaxbayes.populations.result import PopulationResult
from biaxbayes.populations.text import (
    DASH,
    contrast_rows,
    group_rows,
    interval,
    spread_parts,
    three_digits,
)
from biaxbayes.reports.study_page import KNOWN_QUANTITIES, named, unit_text, with_unit
from biaxbayes.reports.templates import Cell, Row, page_template, pictures
from biaxbayes.reports.text import derived_text, latex_tabular, latex_text, plural, truncate
from biaxbayes.studies.groups import LARGER, SMALLER, USABLE_VERDICTS
from biaxbayes.text_files import aligned

PAGE, LATEX = "population.html", "population.tex"
TABLES = {
    "groups": ("population.csv", "groups"),
    "specimens": ("specimens.csv", "every specimen alone and pooled"),
    "contrasts": ("contrasts.csv", "differences between groups"),
}
"""File and content of each table of a population."""
BANDS = "new-specimen-bands"
NO_NUMBERS = (
    "No number is given: continue with --resume and a larger --max-steps, or compare the groups as "
    "study.html of batch does, specimen by specimen"
)
"""What to do where the chains do not agree."""
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
        "Equibiaxial Cauchy stress: the band contains 90 % of new specimens; thin lines are the "
        "records of the tested ones.",
        "Equibiaxial Cauchy stress of new specimens over total stretch, with the equibiaxial "
        "records; the numbers are in new-specimen-bands.csv.",
    ),
}
"""Title, caption and alternative text of each figure."""


def population_page(
    folder: Path, tables: Mapping[str, pd.DataFrame], record: Mapping[str, Any]
) -> str:
    """The page as HTML from the three tables and the record in population.json."""
    files = [(name, words) for name, words in FILES.items() if (folder / name).is_file()]
    drawn = pictures(folder, tuple(FIGURE_TEXTS))
    own = tables["specimens"].drop_duplicates("specimen")
    state, reason = (record["convergence"][k] for k in ("state", "reason"))
    converged = state == "converged"
    names = list(dict.fromkeys(tables["specimens"]["quantity"]))
    shown = [n for n in names if n in KNOWN_QUANTITIES]
    heads = [Markup(">") + with_unit(n, KNOWN_QUANTITIES[n].unit) for n in shown]
    return page_template("population.html.jinja").render(
        name=truncate(record["name"]),
        specimens=plural(len(own), "specimen"),
        donors=plural(int(own["donor"].nunique()), "donor"),
        state=state,
        verdict="The chains have converged." if converged else f"The population is {state}:",
        reason="" if converged else reason,
        left_out=[(truncate(k), truncate(v, 300)) for k, v in record["left_out"].items()],
        notes=[truncate(n, 500) for n in record["notes"]],
        figure_titles={stem: FIGURE_TEXTS[stem][0] for stem in drawn},
        figures=[(k, *FIGURE_TEXTS[k], picture) for k, picture in drawn.items()],
        groups=[] if state == "unusable" else _groups(tables["groups"], tuple(record["pooled"])),
        columns=["Specimen, group, donor", ">#Predictive p", *heads],
        own=_specimens(tables["specimens"], shown),
        more=len(shown) < len(names),
        contrasts=[] if state == "unusable" else _contrasts(tables["contrasts"]),
        methods=population_methods(tables, record),
        results=population_results(tables, record),
        files=files,
    )


def _marked(median: str, identified: bool) -> str | Markup:
    """Text in italics with an asterisk if it is not identified."""
    return median if identified else Markup("<i>{}*</i>").format(median)


def _groups(table: pd.DataFrame, pooled: tuple[str, ...]) -> list[dict[str, Any]]:
    out = []
    for group, part in table.groupby("group", sort=False):
        split = len(spread_parts(part)) > 1
        spreads = ["Donors differ by", "Specimens differ by"]
        heads = spreads if split else ["Specimens of different donors differ by"]
        rows: list[Row] = []
        for r in group_rows(part):
            sds = [
                (*cells, verdict)
                for cells, verdict in zip(r.spreads, r.spread_verdicts, strict=True)
            ]
            median = (_marked(r.median, r.identified), r.reported)
            rows.append((named(r.quantity), unit_text(r.unit), median, r.verdict, *sds, *r.new))
        sentences = [
            (named(r["quantity"]), truncate(r["in_words"], 400))
            for r in part.to_dict("records")
            if r["quantity"] in pooled and isinstance(r["in_words"], str)
        ]
        counts = {k: plural(int(part.iloc[0][k]), k[:-1]) for k in ("specimens", "donors")}
        columns = ["Quantity", "Unit", ">#Typical donor", "#Verdict"]
        columns += [*(f">{head}" for head in heads), ">#New specimen", ">#New donor"]
        out.append(
            {
                "name": truncate(group, 60),
                "columns": columns,
                "rows": rows,
                "words": sentences,
                **counts,
            }
        )
    return out


def _specimens(table: pd.DataFrame, names: list[str]) -> list[Row]:
    """Every specimen pooled, and in brackets the interval reported by its own run."""
    out: list[Row] = []
    for label, part in table.groupby("specimen", sort=False):
        rows = {str(r["quantity"]): r for r in part.to_dict("records")}
        cells: list[Cell] = []
        for name in names:
            r = rows.get(name)
            if r is None:
                cells.append(DASH)
                continue
            median, ends = interval(r, "pooled", KNOWN_QUANTITIES[name].parameter.number)
            alone = r["reported"] if isinstance(r["reported"], str) and r["reported"] else DASH
            identified = r["pooled_verdict"] in (*USABLE_VERDICTS, FIXED)
            cells.append((_marked(median, identified), ends, f"({alone})"))
        first = part.iloc[0]
        group, donor = truncate(first["group"], 40), truncate(first["donor"], 40)
        head = (truncate(label, 60), f"{group}, {donor}")
        out.append((head, three_digits(float(first["specimen_predictive_p"])), *cells))
    return out


def _contrasts(table: pd.DataFrame) -> list[tuple[str, str, list[Row]]]:
    """Both groups and the rows of their differences."""
    out = []
    for (a, b), part in table.groupby(["group_a", "group_b"], sort=False):
        rows: list[Row] = [
            (named(r.quantity), r.kind, r.median, r.interval, r.direction, r.probability)
            for r in contrast_rows(part)
        ]
        out.append((truncate(a, 40), truncate(b, 40), rows))
    return out


def population_methods(tables: Mapping[str, pd.DataFrame], record: Mapping[str, Any]) -> str:
    """One paragraph for a paper, with the numbers of this population."""
    groups = tables["groups"].drop_duplicates("group")
    members = "; ".join(
        f"{truncate(r['group'], 60)}: {plural(r['specimens'], 'specimen')} of "
        f"{plural(r['donors'], 'donor')}"
        for r in groups.to_dict("records")
    )
    pooled = record["pooled"]
    logs = [name for name, v in pooled.items() if v["scale"] == "log"]
    others = [name for name in pooled if name not in logs]
    scales = []
    if logs:
        scales.append(f"the natural logs of {listed(logs)}")
    if others:
        scales.append(f"{listed(others)} truncated at their physical limits")
    values = listed(scales)
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
        f"A hierarchical model pooled the specimens ({members}). {values[:1].upper()}{values[1:]} "
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
        group, rows = truncate(name, 60), group_rows(part)[: len(record["pooled"])]
        known = [
            f"{r.quantity} {r.median}{unit_words(r.unit)} ({r.reported})"
            for r in rows
            if r.identified and r.reported != DASH
        ]
        left = [r.quantity for r in rows if not r.identified]
        size = plural(int(part.iloc[0]["specimens"]), "specimen")
        if known:
            text = f"Medians of a typical donor of the group {group} ({size}) were "
            sentences.append(f"{text}{listed(known)} (90 % intervals or 95 % bounds).")
        if left:
            sentences.append(f"The specimens of {group} did not identify {listed(left)}.")
    for (a, b), part in tables["contrasts"].groupby(["group_a", "group_b"], sort=False):
        rows_apart = contrast_rows(part)[: len(record["pooled"])]
        different = [
            f"{r.quantity} ({r.kind} {r.median}, {r.interval})"
            for r in rows_apart
            if r.direction in (LARGER, SMALLER)
        ]
        words = f"differed in {listed(different)}" if different else "showed no difference in them"
        sentences.append(f"The groups {truncate(b, 40)} and {truncate(a, 40)} {words}.")
    return " ".join(sentences)


def population_latex(tables: Mapping[str, pd.DataFrame], record: Mapping[str, Any]) -> str:
    """The groups as a LaTeX table with booktabs rules; both paragraphs as comments."""
    rows = []
    for group, part in tables["groups"].groupby("group", sort=False):
        for row in group_rows(part):
            cells = (group, derived_text(row.quantity), row.unit, row.median, row.reported)
            rows.append([latex_text(c) for c in (*cells, row.verdict)])
    heads = ("Group", "Quantity", "Unit", "Median", "Interval", "Verdict")
    return "\n".join(
        [
            "% needs \\usepackage{booktabs}",
            f"% Methods: {population_methods(tables, record)}",
            f"% Results: {population_results(tables, record)}",
            *latex_tabular(heads, rows),
            "",
        ]
    )


# --- what the terminal shows ---------------------------------------------------------------------


UNDETERMINED_MARK = "*"


def closing_message(result: PopulationResult) -> str:
    """Groups, differences between them and notes, for a terminal."""
    converged = result.state == "converged"
    state = result.state if converged else f"{result.state.upper()}: {result.reason}"
    lines = [f"{printable(result.name)}: {state}"]
    if result.state == "unusable":  # the tables have no numbers
        return "\n".join([*lines, f"{NO_NUMBERS}.", *_notes(result)])
    for group, part in result.groups.groupby("group", sort=False):
        lines += ["", *_group_lines(str(group), part)]
    groups = result.groups
    if any((groups[f"{side}_verdict"] == NOT_IDENTIFIED).any() for side in spread_parts(groups)):
        lines += [
            "",
            f"{UNDETERMINED_MARK} {NOT_IDENTIFIED}: the specimens determine little of this sd",
        ]
    for (a, b), part in result.contrasts.groupby(["group_a", "group_b"], sort=False):
        first, second = printable(str(a)), printable(str(b))
        table = [["quantity", "", "median", "5 to 95 %", f"in {second}"]]
        for row in contrast_rows(part):
            table.append([row.quantity, row.kind, row.median, row.interval, row.direction])
        lines += ["", f"{second} compared with {first}", *aligned(table)]
    return "\n".join([*lines, *_notes(result)])


def _notes(result: PopulationResult) -> list[str]:
    notes = [f"note: {printable(note)}" for note in result.notes]
    return ["", *notes, f"all tables and draws are in {result.folder}"]


def _group_lines(group: str, part: pd.DataFrame) -> list[str]:
    """Table of a group: medians, spreads and new specimens."""
    first = part.iloc[0]
    members = f"{plural(first['specimens'], 'specimen')} of {plural(first['donors'], 'donor')}"
    split = len(spread_parts(part)) > 1
    sds = ["sd donors", "sd specimens"] if split else ["sd total"]
    table = [["quantity", "unit", "median", "5 to 95 %", *sds, "new specimen", "verdict"]]
    for row in group_rows(part):
        spreads = [
            text + (UNDETERMINED_MARK if verdict == NOT_IDENTIFIED else "")
            for (text, _), verdict in zip(row.spreads, row.spread_verdicts, strict=True)
        ]
        cells = [row.quantity, row.unit, row.median, row.reported, *spreads, row.new[0][1]]
        table.append([*cells, row.verdict])
    return [f"{printable(group)}: {members}", *aligned(table)]
