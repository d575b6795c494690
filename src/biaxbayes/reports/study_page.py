"""study.html, all specimens of a study on one page, and its tables and figure."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from functools import partial
from importlib.util import find_spec
from urllib.parse import quote

import numpy as np
import pandas as pd
from markupsafe import Markup

from biaxbayes.errors import printable
from biaxbayes.figures.groups import study_figure
from biaxbayes.figures.style import save_pictures
from biaxbayes.identifiability.verdict import FIXED
from biaxbayes.parameters import DIMENSION, LOAD, MATERIAL, STRETCH, Quantity, unit_text
from biaxbayes.report_table import (
    DASH,
    Cell,
    Column,
    Row,
    Table,
    interval_texts,
    number,
    three_digits,
    truncate,
)
from biaxbayes.reports.answers import CHANCE, answers, direction_text, ends_text, group_pairs
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
)
from biaxbayes.reports.text import VERDICT_TERMS, derived_text, plural, text_or_empty
from biaxbayes.studies.groups import KNOWN_QUANTITIES, LEAST_DONORS, LOG
from biaxbayes.studies.study_result import FAILED, StudyResult
from biaxbayes.text_files import atomic_write_bytes, atomic_write_text, write_csv

FIGURE = "study-specimens"
TOO_FEW = f"fewer than {LEAST_DONORS} converged specimens of a group: nothing to compare"
TERMS = (
    *("posterior", "prior", "median, 90 % interval", "mounting stretch", *VERDICT_TERMS),
    *("converged, tentative, unusable", "structure tensor"),
    *("tangent stiffness, small-strain stiffness", "mean", "sd between", "factor"),
)


# --- the tables ----------------------------------------------------------------------------------


def named(name: object) -> Quantity | str:
    """A quantity by its name, or text for a derived one."""
    return KNOWN_QUANTITIES.get(str(name)) or derived_text(str(name))


QUANTITY = Column("quantity", "Quantity", format=lambda r: named(r["quantity"]))
UNIT = Column("unit", "Unit", format=lambda r: unit_text(r["unit"]))


def specimens_table(result: StudyResult) -> Table:
    """What the run of each specimen reports; its name leads to its own report."""
    reported = {
        (str(r["specimen"]), str(r["quantity"])): r for r in result.table.to_dict("records")
    }

    def label(r: Row) -> Cell:
        text, page = truncate(r["specimen"], 60), f"{r['folder']}/report.html"
        if (result.folder / page).is_file():
            text = Markup('<a href="{}">{}</a>').format(quote(page), text)
        return (text, ", ".join(truncate(r[k], 40) for k in ("layer", "donor") if r[k]))

    def own(name: str, r: Row) -> Cell:
        return truncate(r[name], 40)

    def quantity(name: str, r: Row) -> Cell:
        return _reported(reported.get((str(r["specimen"]), name)))

    known = [q for q in KNOWN_QUANTITIES.assessed() if (result.table["quantity"] == q.name).any()]
    columns = [
        Column("specimen", "Specimen, layer, donor", format=label),
        *(Column(n, truncate(n, 40), format=partial(own, n)) for n in result.own_columns),
        Column("state", "State"),
        *(Column(q.name, q, q.unit, partial(quantity, q.name), number=True) for q in known),
    ]
    return Table(columns, result.specimens, "Specimens")


def _reported(row: Row | None) -> Cell:
    """The median, the reported interval and the verdict."""
    if row is None:
        return DASH
    if row["verdict"] == FIXED:
        return (f"{float(row['q50']):.4g}", FIXED)
    interval, verdict = (text_or_empty(row[k]) for k in ("reported", "verdict"))
    if interval in ("", DASH):
        return (DASH, verdict)
    parameter = KNOWN_QUANTITIES[str(row["quantity"])].parameter
    median, _, _ = interval_texts(row["q50"], row["q05"], row["q95"], parameter)
    return (median, interval, verdict)


def group_tables(groups: pd.DataFrame, by: str) -> list[tuple[str, Table]]:
    """The specimens of each group counted, and the properties of their tissue and test."""

    def mean(r: Row) -> tuple[str, str, str]:
        return interval_texts(r["mean"], r["mean_low"], r["mean_high"], log=True)

    def interval(r: Row) -> str:
        return " to ".join(mean(r)[1:])

    def medians(r: Row) -> str:
        # with the digits of the mean
        ends = (r["mean_low"], r["mean_high"])
        return " to ".join(number(r[k], *ends, log=True) for k in ("lowest", "highest"))

    def spread(r: Row) -> str:
        between = float(r["sd_between"])
        if math.isnan(between):
            return DASH
        return f"factor {math.exp(between):.2f}" if r["scale"] == LOG else f"{between:.2g}"

    columns = [
        QUANTITY,
        UNIT,
        Column("converged", "Specimens", format="d", number=True),
        Column("mean", "Mean", format=lambda r: mean(r)[0], number=True, term=True),
        Column("mean_low", "90 % interval", format=interval, number=True),
        Column("lowest", "Range of medians", format=medians, number=True),
        Column("sd_between", "Sd between", format=spread, number=True, term=True),
    ]
    out = []
    for group, part in groups[groups["group_by"] == by].groupby("group", sort=False):
        counts = f"{plural(int(part['specimens'].max()), 'specimen')}, "
        counts += f"{part['converged'].max():.0f} converged"
        shown = part[(part["converged"] > 0) & part["quantity"].map(_is_of_tissue)]
        out.append((counts, Table(columns, shown, truncate(group, 60))))
    return out


def _is_of_tissue(name: str) -> bool:
    """True for properties of the tissue, which groups are summarised in; not errors and loads."""
    of_tissue = KNOWN_QUANTITIES.of_kind(MATERIAL, STRETCH, DIMENSION)
    known = [q.name for q in of_tissue if q.parameter.unit != LOAD]
    return name in known or name not in KNOWN_QUANTITIES


def group_differences(contrasts: pd.DataFrame) -> list[tuple[list[str], Table]]:
    """How groups differ, in sentences and a table, the same on the page and in a terminal."""

    def mean(side: str, r: Row) -> str:
        return f"{three_digits(r[f'mean_{side}'])} (n={r[f'donors_{side}']})"

    def difference(r: Row) -> str:
        return f"{'ratio ' if r['scale'] == LOG else ''}{three_digits(r['difference'])}"

    def interval(r: Row) -> str:
        return ends_text(r["difference_low"], r["difference_high"], log=r["scale"] == LOG)

    def detectable(r: Row) -> str:
        return three_digits(r["detectable"])

    out = []
    for a, b, part in group_pairs(contrasts):
        columns = [
            QUANTITY,
            UNIT,
            Column("mean_a", f"Mean, {a}", format=partial(mean, "a"), number=True),
            Column("mean_b", f"Mean, {b}", format=partial(mean, "b"), number=True),
            Column("difference", "Difference", format=difference, number=True),
            Column("difference_low", "90 % interval", format=interval, number=True),
            Column("detectable", "Could show", format=detectable, number=True),
            Column("direction", f"In {b}", format=direction_text),
        ]
        known = part[part["direction"].map(lambda text: isinstance(text, str))]
        table = Table(columns, known, f"{b} compared with {a}")
        out.append((answers(part.to_dict("records")), table))
    return out


# --- the page ------------------------------------------------------------------------------------


def study_page(result: StudyResult, files: Sequence[tuple[str, str]] = ()) -> str:
    """The page as HTML, with its files and their content; links lead to the reports of the runs."""
    specimens = prose(
        "What the run of each specimen reports: the median, the 90 % interval or a 95 % bound, and "
        "the [verdict]. The specimen's name leads to its report, with the reasons."
    )
    about = prose(
        "Of all converged specimens, with their number. [Mean]: of the group, with its 90 % "
        "interval. [Sd between]: spread of the specimens beyond the width of their own "
        "intervals; a [factor] for stiffnesses and k2."
    )
    groups: list[Block] = []
    for counts, table in group_tables(result.groups, "all" if result.own_columns else "layer"):
        groups += [subheading(table.label), paragraph(Markup.escape(counts), "soft")]
        groups.append(table or paragraph("No specimen has converged.", "soft"))
    written = "".join(f"{name}: {content}. " for name, content in files)
    runs = "runs: a run folder of every specimen with its own report."
    total = sum(result.states.values())
    terms = (*TERMS, "includes 0, includes 1") if len(result.group_contrasts) else TERMS
    sections = [
        Section("glance", "At a glance", _glance(result)),
        Section("specimens", "Specimens", [paragraph(specimens), specimens_table(result)]),
        Section("groups", "Groups", groups and [paragraph(about), *groups]),
        Section("files", "Files", [paragraph(written + runs)]),
    ]
    about_study = f"{plural(total, 'specimen')}: what their tests say of the parameters of a "
    about_study += "material law and of the mounting stretches"
    return page_html("study", truncate(result.name), about_study, sections, terms)


def _glance(result: StudyResult) -> list[Block | None]:
    states, total = result.states, sum(result.states.values())
    converged = states.get("converged", 0)
    others = ", ".join(f"{n} {state}" for state, n in states.items() if state != "converged")
    text = f"{others}: no verdict on their parameters, and no part in the summaries."
    blocks: list[Block | None] = [
        notice(
            "converged" if converged == total else "tentative" if converged else "unusable",
            f"{converged} of {total} specimens have converged.",
            [f"{truncate(k)}: {truncate(v, 300)}" for k, v in result.failures.items()],
            text if others else "",
        )
    ]
    differences = group_differences(result.group_contrasts)
    too_few = "There are fewer than two converged specimens of a group: nothing to compare."
    for answered, table in differences:
        blocks += [subheading(table.label), bullets(answered), table or paragraph(too_few)]
    if differences:
        about = prose(
            "From the draws of every converged specimen, each donor once (n): one that knows "
            "little of a quantity weighs little. As each donor counts once and the groups share "
            "one spread, these means can differ from those of the groups below, which count every "
            "specimen. A ratio where a quantity varies in ratios. [Includes 0 or 1]: no difference "
            f"is shown. {CHANCE} For specimens pooled in one model: `biaxbayes population` on "
            "this folder."
        )
        blocks.append(paragraph(about, "soft"))
    missed = [f"{truncate(k)}: {truncate(v, 300)}" for k, v in result.missed.items()]
    blocks.append(remarks("The law misses these specimens.", missed))
    blocks.append(remarks("Before comparing.", [truncate(n, 400) for n in result.notes]))
    if picture := pictures(result.folder, (FIGURE,)).get(FIGURE):
        alt = "Medians and 90 % intervals of every specimen, one panel per quantity, ordered by "
        caption = (
            "Medians with 90 % intervals. Filled symbols: the run has converged. H is the share of "
            "the fibres along each axis (structure tensor), c the stiffness at small strain; both "
            "are often known although parameters are correlated."
        )
        alt += "group; the numbers are in the table below."
        blocks.append(captioned(picture, alt, caption, "all specimens"))
    return blocks


# --- the files of a study: tables, figure and page -----------------------------------------------


TABLE, PAGE = "study", "study.html"
FILES = {
    "table": ("study.csv", "one row per specimen and quantity"),
    "group_contrasts": ("study-group-contrasts.csv", "how the groups differ"),
    "groups": ("study-groups.csv", "summaries of layers, donors and groups"),
}
"""File and content of each table of a result."""


def write_study(result: StudyResult) -> None:
    """Write the files of a study into its folder; ``study.parquet`` if pyarrow is installed."""
    folder, files = result.folder, []
    for name, (file, content) in FILES.items():
        path, table = folder / file, getattr(result, name)
        if table.empty and name != "table":
            path.unlink(missing_ok=True)
            continue
        write_csv(path, table, digits=8)
        files.append((file, content))
    if find_spec("pyarrow"):
        buffer = io.BytesIO()
        result.table.convert_dtypes().to_parquet(buffer, engine="pyarrow", index=False)
        atomic_write_bytes(folder / f"{TABLE}.parquet", buffer.getvalue())
    has_numbers = bool(np.isfinite(result.table["q50"].astype(float)).any())
    figure = study_figure(result.table, result.group_of) if has_numbers else None
    save_pictures(figure, folder, FIGURE)
    atomic_write_text(folder / PAGE, study_page(result, files))


def closing_message(result: StudyResult) -> str:
    """What has not converged, how groups differ, what the law misses, where the numbers are."""
    counts = ", ".join(f"{n} {state}" for state, n in result.states.items())
    lines = [f"{plural(len(result.specimens), 'specimen')}: {counts}"]
    sampled = zip(result.specimens["specimen"], result.specimens["state"], strict=True)
    lines += [
        f"{printable(k)}: {state}" for k, state in sampled if state not in ("converged", FAILED)
    ]
    for answered, table in group_differences(result.group_contrasts):
        lines += ["", printable(table.label)]
        lines += [f"  {printable(text)}" for text in answered or [TOO_FEW]]
    missed = [f"{printable(k)}: {printable(v)}" for k, v in result.missed.items()]
    lines += ["", *missed] if missed else []
    lines += [f"note: {printable(note)}" for note in result.notes]
    lines.append(f"open {result.folder / 'study.html'}; all numbers are in study.csv beside it")
    return "\n".join(lines)
