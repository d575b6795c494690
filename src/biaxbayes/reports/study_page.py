"""study.html, all specimens of a study on one page, and its tables and figure."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

import numpy as np
import pandas as pd
from markupsafe import Markup

from biaxbayes.comparison.compare import WARNING
from biaxbayes.errors import listed, printable
from biaxbayes.figures.population import study_figure
from biaxbayes.figures.quantities import number
from biaxbayes.figures.style import save_pictures
from biaxbayes.identifiability.reported import COARSE_RATIO, DASH, quantile_texts
from biaxbayes.identifiability.verdict import FIXED
from biaxbayes.laws import all_parameters
from biaxbayes.parameters import DIMENSION, LOAD, MATERIAL, STRETCH, Quantities, Quantity
from biaxbayes.populations.text import three_digits
from biaxbayes.reports.templates import Cell, Row, page_template, pictures
from biaxbayes.reports.text import as_html, derived_text, truncate
from biaxbayes.studies.groups import LEAST_DONORS, OPEN
from biaxbayes.studies.result import StudyResult
from biaxbayes.text_files import aligned, atomic_write_bytes, atomic_write_text, write_csv

FIGURE = "study-specimens"
KNOWN_QUANTITIES = Quantities(all_parameters())
"""Symbol, unit and range by the names in the tables of a study."""


def study_page(result: StudyResult, files: Sequence[tuple[str, str]] = ()) -> str:
    """The page as HTML, with its files and their content: no scripts, no network.

    The links lead to the reports of the runs.
    """
    states = result.states
    assessed = [
        q for q in KNOWN_QUANTITIES.assessed() if (result.table["quantity"] == q.name).any()
    ]
    columns: list[str | Markup] = ["Specimen, layer, donor"]
    columns += [Markup.escape(truncate(name, 40)) for name in result.own_columns]
    columns += ["State", *(Markup(">") + with_unit(q.name, q.unit) for q in assessed)]
    return page_template("study.html.jinja").render(
        name=truncate(result.name),
        total=sum(states.values()),
        converged=states.get("converged", 0),
        states=[(k, v) for k, v in states.items() if k != "converged"],
        failures=[(truncate(k), truncate(v, 300)) for k, v in result.failures.items()],
        columns=columns,
        specimens=_specimens(result, [q.name for q in assessed]),
        figures=pictures(result.folder, (FIGURE,)),
        groups=_groups(result.groups, "all" if result.own_columns else "layer"),
        differences=[
            (d, [(named(name), *cells) for name, *cells in d.rows])
            for d in group_differences(result.group_contrasts)
        ],
        missed=[f"{truncate(k)}: {truncate(v, 300)}" for k, v in result.missed.items()],
        files=files,
        contrasts=_contrasts(result.contrasts),
        warning=WARNING,
        notes=[truncate(n, 400) for n in result.notes],
    )


def unit_text(text: object) -> str:
    """A unit of a table as the page prints it."""
    return {"deg": "°", "1": ""}.get(str(text), str(text))


def named(name: object) -> Quantity | str:
    """A quantity by its name, or text for a derived one."""
    return KNOWN_QUANTITIES.get(str(name)) or derived_text(str(name))


def with_unit(name: str, unit: object) -> Markup:
    """A quantity with its unit in brackets."""
    text = unit_text(unit)
    return as_html(named(name)) + (Markup(" ({})").format(text) if text else Markup(""))


def _specimens(result: StudyResult, names: list[str]) -> list[Row]:
    """One row per specimen: columns of the study file, state, and the reported table."""
    table = {(str(r["specimen"]), str(r["quantity"])): r for r in result.table.to_dict("records")}
    rows: list[Row] = []
    for s in result.specimens.to_dict("records"):
        label, page = truncate(s["specimen"], 60), f"{s['folder']}/report.html"
        if (result.folder / page).is_file():
            label = Markup('<a href="{}">{}</a>').format(quote(page), label)
        origin = ", ".join(truncate(s[k], 40) for k in ("layer", "donor") if s[k])
        cells_of_specimen = [truncate(s[name], 40) for name in result.own_columns]
        cells = [_cell(table.get((str(s["specimen"]), n))) for n in names]
        rows.append(((label, origin), *cells_of_specimen, s["state"], *cells))
    return rows


def _cell(row: dict[Any, Any] | None) -> Cell:
    """The median, the reported interval and the verdict."""
    if row is None:
        return DASH
    if row["verdict"] == FIXED:
        return (f"{float(row['q50']):.4g}", FIXED)
    interval, verdict = (row[k] if isinstance(row[k], str) else "" for k in ("reported", "verdict"))
    if interval in ("", DASH):
        return (DASH, verdict)
    parameter = KNOWN_QUANTITIES[str(row["quantity"])].parameter
    median, _, _ = quantile_texts(row["q50"], row["q05"], row["q95"], parameter)
    return (median, interval, verdict)


def _groups(groups: pd.DataFrame, by: str) -> list[dict[str, Any]]:
    """Tables of the groups, with the quantities that a specimen of the group identifies."""
    out = []
    for group, part in groups[groups["group_by"] == by].groupby("group", sort=False):
        first = part.iloc[0]
        rows = [
            _group_row(r)
            for r in part.to_dict("records")
            if r["identified"] > 0 and _of_tissue(str(r["quantity"]))
        ]
        counts = {k: int(first[k]) for k in ("specimens", "converged")}
        out.append({"name": truncate(group, 60), "rows": rows, **counts})
    return out


def _group_row(r: dict[Any, Any]) -> Row:
    low, centre, high = (float(r[k]) for k in ("lowest", "centre", "highest"))
    log = low > 0.0 and high / low > COARSE_RATIO
    mean, first, last = (number(v, low, high, log=log) for v in (centre, low, high))
    between = float(r["sd_between"])
    spread = f"factor {math.exp(between):.2f}" if r["scale"] == "log" else f"{between:.2g}"
    return (
        named(r["quantity"]),
        unit_text(r["unit"]),
        f"{r['identified']} of {r['converged']}",
        mean,
        f"{first} to {last}" if low < high else DASH,
        DASH if math.isnan(between) else spread,
    )


def _of_tissue(name: str) -> bool:
    """True for properties of the tissue, which groups are summarised in; not errors and loads."""
    quantity = KNOWN_QUANTITIES.get(name)
    return quantity is None or (
        quantity.parameter.kind in (MATERIAL, STRETCH, DIMENSION)
        and quantity.parameter.unit != LOAD
    )


class GroupDifferences(NamedTuple):
    """How group b differs from group a, as a table; ``without``: a sentence on what it lacks."""

    a: str
    b: str
    heads: list[str]
    rows: list[tuple[str, ...]]
    without: str


def group_differences(contrasts: pd.DataFrame) -> list[GroupDifferences]:
    """The contrasts of the groups of a study as text, the same on the page and in a terminal."""
    out = []
    for (a, b), part in contrasts.groupby(["group_a", "group_b"], sort=False):
        rows, others = [], []
        for r in part.to_dict("records"):
            name = str(r["quantity"])
            if not isinstance(r["direction"], str):
                others.append(derived_text(name))
                continue
            log = r["scale"] == "log"
            low, high = (three_digits(r[f"difference_{end}"]) for end in ("low", "high"))
            words = f"includes {1 if log else 0}" if r["direction"] == OPEN else r["direction"]
            means = (f"{three_digits(r[f'mean_{k}'])} (n={r[f'donors_{k}']})" for k in "ab")
            apart = f"{'ratio ' if log else ''}{three_digits(r['difference'])}"
            unit = unit_text(r["unit"])
            rows.append((name, unit, *means, apart, f"{low} to {high}", words))
        a, b = truncate(a, 40), truncate(b, 40)
        heads = ["Quantity", "Unit", f"Mean, {a}", f"Mean, {b}", "Difference", "90 % interval"]
        without = f"Not identified in {LEAST_DONORS} donors of each group: {listed(others)}."
        table = [*heads, f"In {b}"], rows, without if others else ""
        out.append(GroupDifferences(a, b, *table))
    return out


def _contrasts(contrasts: pd.DataFrame) -> list[tuple[str, str, list[Row]]]:
    """Both layers and the rows of their differences."""
    out = []
    for (a, b), part in contrasts.groupby(["layer_a", "layer_b"], sort=False):
        rows: list[Row] = []
        for r in part.to_dict("records"):
            head = (named(r["quantity"]), unit_text(r["unit"]))
            counts = f"{r['identified']} of {r['pairs']}"
            if r["identified"] == 0:
                rows.append((*head, counts, DASH, DASH, DASH, DASH))
                continue
            low, mean, high = (float(r[f"{k}_difference"]) for k in ("lowest", "mean", "highest"))
            middle, first, last = (number(v, low, high) for v in (mean, low, high))
            ends = f"{first} to {last}" if low < high else DASH
            signs = (str(r["b_greater"]), str(r["b_less"]))
            rows.append((*head, counts, *signs, middle, ends))
        out.append((truncate(a, 40), truncate(b, 40), rows))
    return out


# --- the files of a study: tables, figure and page -----------------------------------------------


TABLE, PAGE = "study", "study.html"
FILES = {
    "table": ("study.csv", "one row per specimen and quantity"),
    "group_contrasts": ("study-group-contrasts.csv", "how the groups differ"),
    "groups": ("study-groups.csv", "summaries of layers, donors and groups"),
    "contrasts": ("study-contrasts.csv", "layers of a donor compared, over all donors"),
    "distances": ("study-distances.csv", "the same, donor by donor"),
}
"""File and content of each table of a result."""


def write_study(result: StudyResult) -> list[Path]:
    """Write the files of a study into its folder; ``study.parquet`` if pyarrow is installed."""
    folder = result.folder
    written, files = [], []
    for name, (file, content) in FILES.items():
        path, table = folder / file, getattr(result, name)
        if table.empty and name != "table":
            path.unlink(missing_ok=True)
            continue
        write_csv(path, table, digits=8)
        written.append(path)
        files.append((file, content))
    if find_spec("pyarrow"):
        buffer = io.BytesIO()
        result.table.convert_dtypes().to_parquet(buffer, engine="pyarrow", index=False)
        path = folder / f"{TABLE}.parquet"
        atomic_write_bytes(path, buffer.getvalue())
        written.append(path)
    has_numbers = bool(np.isfinite(result.table["q50"].astype(float)).any())
    figure = study_figure(result.table, result.group_of) if has_numbers else None
    written += save_pictures(figure, folder, FIGURE)
    page = folder / PAGE
    atomic_write_text(page, study_page(result, files))
    return [*written, page]


def closing_message(result: StudyResult) -> str:
    """One line per specimen, how groups differ, what the law misses, and where the numbers are."""
    heads = ["specimen", "donor", "layer", *result.own_columns, "state"]
    specimens = result.specimens.to_dict("records")
    lines = aligned([heads, *([printable(str(s[k])) for k in heads] for s in specimens)])
    counts = ", ".join(f"{n} {state}" for state, n in result.states.items())
    lines += ["", f"{len(result.specimens)} specimens: {counts}"]
    for d in group_differences(result.group_contrasts):
        a, b = printable(d.a), printable(d.b)
        lines += ["", f"{b} compared with {a}"]
        if d.rows:
            table = [d.heads, *d.rows]
            lines += aligned([[printable(cell) for cell in row] for row in table])
        else:
            lines.append("this study does not show whether they differ")
        lines += [printable(d.without)] if d.without else []
    missed = [f"{printable(k)}: {printable(v)}" for k, v in result.missed.items()]
    lines += ["", *missed] if missed else []
    lines.append(f"open {result.folder / 'study.html'}; all numbers are in study.csv beside it")
    return "\n".join(lines)
