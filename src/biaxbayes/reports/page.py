"""The report of a run: one page that opens anywhere, and its table for a paper."""

from __future__ import annotations

import base64
import struct
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from biaxbayes.options import REPORTS
from biaxbayes.reports.facts import (
    citations,
    held_rows,
    law_rows,
    missed_paths,
    mounting_cure,
    not_inferred,
    record_findings,
    settings_facts,
    specimen_facts,
    state_words,
    test_rows,
    version_facts,
)
from biaxbayes.reports.parameters import Row, methods, parameter_rows, percent_stretch
from biaxbayes.reports.words import (
    GLOSSARY,
    as_html,
    as_latex,
    cut,
    latex_text,
)
from biaxbayes.runs.run import Run, open_run
from biaxbayes.text_files import atomic_write_text

if TYPE_CHECKING:
    from jinja2 import Template

# --- the templates of the pages; text that is put into them is escaped ---------------------------


TEMPLATE = "template.html.jinja"
"""Of the report of a run."""


@cache
def page_template(name: str) -> Template:
    """The template of a file beside this one."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("biaxbayes.reports", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["symbol"] = as_html
    return environment.get_template(name)


# --- figures of a run folder as data URIs, so that the page needs nothing beside itself ----------


MAGIC = b"\x89PNG\r\n\x1a\n"
TOTAL_BYTES = 3_300_000
"""Of the files; a third more once encoded. The page stays below 5 MB."""


@dataclass(frozen=True)
class Picture:
    """A PNG of the run folder.

    Attributes
    ----------
    uri : str
    width, height : int
        Pixels.
    """

    uri: str
    width: int
    height: int


def pictures(folder: Path, stems: tuple[str, ...]) -> dict[str, Picture]:
    """Figures that are there, by stem; the first ones are kept where all would be too large."""
    left, out = TOTAL_BYTES, {}
    for stem in stems:
        path = folder / f"{stem}.png"
        try:
            if path.is_symlink() or not path.is_file() or path.stat().st_size > left:
                continue
            data = path.read_bytes()
        except OSError:
            continue
        if data[:8] != MAGIC or data[12:16] != b"IHDR" or len(data) > left:
            continue
        left -= len(data)
        out[stem] = embedded(data)
    return out


def embedded(data: bytes) -> Picture:
    """A PNG as a part of a page."""
    width, height = struct.unpack(">II", data[16:24])
    uri = "data:image/png;base64," + base64.b64encode(data).decode("ascii")
    return Picture(uri, width, height)


# --- report.html: a run on one page, for somebody who has two minutes ----------------------------


NAME, EXPLORE = REPORTS["html"], REPORTS["explore"]
FIGURES = ("stress-bands", "corner", "identifiability", "trace", "ledger")


def write_report(folder: Path | str, run: Run | None = None) -> Path:
    """Write the report of a finished run into its folder.

    Parameters
    ----------
    folder : path-like
    run : Run, optional
        The same run where it is open already; else it is opened.

    Returns
    -------
    Path
        Of the page.

    Raises
    ------
    RunError
        If the folder is not a run.
    """
    folder = Path(folder)
    page = report_page(run or open_run(folder), explore=(folder / EXPLORE).is_file())
    path = folder / NAME
    atomic_write_text(path, page)
    return path


def report_page(run: Run, *, explore: bool = False) -> str:
    """The page as HTML: no scripts, no network, figures of the folder inside.

    Parameters
    ----------
    run : Run
    explore : bool
        Whether explore.html stands beside it, to point to.
    """
    rows = parameter_rows(run)
    verdict, reason = state_words(run)
    noise, sampler = run.provenance["noise"], run.provenance["sampler"]
    return page_template(TEMPLATE).render(
        name=cut(run.specimen.name),
        state=run.state,
        explore=EXPLORE if explore else "",
        verdict=verdict,
        reason=reason,
        findings=record_findings(run),
        facts=specimen_facts(run),
        tests=test_rows(run),
        unit=run.specimen.unit,
        load="force" if run.specimen.stress_pair == "force" else "nominal stress",
        rows=rows,
        words=[row for row in rows if row.words],
        mounting=percent_stretch(rows, run),
        not_inferred=not_inferred(run),
        figures=pictures(run.path, FIGURES),
        determined=_determined(run),
        noise=noise,
        beta=run.beta,
        sampler=sampler,
        convergence=run.provenance["convergence"],
        misfit=_misfit(run),
        notes=[cut(n, 400) for n in (*run.provenance["notes"], sampler["message"]) if n],
        settings_facts=settings_facts(run),
        version_facts=version_facts(run),
        citations=citations(run),
        methods=methods(run, rows),
        held=held_rows(run),
        laws=law_rows(run),
        better_law=run.provenance.get("identifiability", {}).get("better_law", ""),
        cure=mounting_cure(run),
        glossary=list(GLOSSARY.items()),
    )


def _determined(run: Run) -> list[dict[str, str]]:
    if run.state == "unusable":
        return []
    from biaxbayes.reports.parameters import determined_rows

    return determined_rows(run)


def _misfit(run: Run) -> dict[str, Any]:
    """The posterior predictive check in words and as a table."""
    if run.state == "unusable":
        return {"words": [], "rows": [], "warnings": []}
    from biaxbayes.prediction.predictive_checks import (
        checks_in_words,
        misfit_in_words,
        path_warnings,
    )
    from biaxbayes.reports.facts import model_checks

    table, unit = model_checks(run), run.specimen.unit
    words = dict.fromkeys([*checks_in_words(table, unit, run.law.name), *misfit_in_words(table)])
    return {
        "words": list(words),
        "rows": table.to_dict("records"),
        "warnings": path_warnings(table, unit, run.law.name),
    }


# --- the parameter table of a run for a paper, as LaTeX ------------------------------------------

STATED = "stated of the tissue"
"""Head of what is stated of a mounting stretch."""


def latex_table(run: Run) -> str:
    """A floating table with booktabs rules, as LaTeX; the methods paragraph as a comment.

    Paths that the model misses stand below the table.
    """
    rows = parameter_rows(run)
    name = latex_text(run.specimen.name)
    more = any(row.stated for row in rows)
    within = f" within the law; {STATED}: whatever its law" if more else ""
    caption = f"{name}: posterior median and central 90\\,\\% interval{within}."
    if run.state != "converged":
        caption += f" {latex_text(state_words(run)[0])}"
    body = [_latex_row(row, stated=more) for row in rows]
    text = methods(run, rows)
    return "\n".join(
        [
            "% needs \\usepackage{booktabs}",
            f"% {text}",
            "\\begin{table}",
            "  \\centering",
            f"  \\caption{{{caption}}}",
            f"  \\begin{{tabular}}{{llrl{'l' if more else ''}l}}",
            "    \\toprule",
            "    Parameter & Unit & Median & 90\\,\\% interval & "
            f"{f'{STATED.capitalize()} & ' if more else ''}Verdict \\\\",
            "    \\midrule",
            *body,
            "    \\bottomrule",
            "  \\end{tabular}",
            *[f"  \\par\\smallskip\\footnotesize {latex_text(t, 500)}" for t in missed_paths(run)],
            "\\end{table}",
            "",
        ]
    )


def _latex_row(row: Row, *, stated: bool) -> str:
    interval = row.interval.replace(" to ", "--") if row.interval[:1] != "f" else row.interval
    cells = (as_latex(row.quantity), latex_text(row.unit), latex_text(row.median))
    of_tissue = (latex_text(row.stated.replace(" to ", "--")),) if stated else ()
    rest = (latex_text(interval).replace("–", "--"), *of_tissue, latex_text(row.verdict))
    return f"    {' & '.join((*cells, *rest))} \\\\"
