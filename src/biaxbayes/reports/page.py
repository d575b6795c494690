"""The report of a run: one page that opens anywhere, and its table for a paper."""

from __future__ import annotations

import base64
import struct
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from biaxbayes.identifiability.reported import ReportRow
from biaxbayes.options import REPORTS
from biaxbayes.prediction.predictive_checks import checks_in_words, misfit_in_words
from biaxbayes.reports.facts import (
    citations,
    fixed_rows,
    law_rows,
    narrowing_rows,
    settings_facts,
    specimen_facts,
    state_words,
    test_rows,
    version_facts,
)
from biaxbayes.reports.parameters import convergence_rows, determined_rows, methods
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
    result = run.result
    verdict, reason = state_words(run)
    noise, sampler = run.provenance["noise"], run.provenance["sampler"]
    return page_template(TEMPLATE).render(
        name=cut(run.specimen.name),
        state=run.state,
        explore=EXPLORE if explore else "",
        verdict=verdict,
        reason=reason,
        findings=result.findings,
        warnings=result.warnings,
        fit=result.fit,
        advice=result.advice,
        facts=specimen_facts(run),
        tests=test_rows(run),
        unit=run.specimen.unit,
        load="force" if run.specimen.stress_pair == "force" else "nominal stress",
        rows=result.rows,
        convergence_rows=convergence_rows(run),
        narrowing=narrowing_rows(run),
        directions=[result.directions[0]["in_words"], result.same_curves_in_words]
        if result.directions
        else [],
        figures=pictures(run.path, FIGURES),
        determined=determined_rows(run),
        noise=noise,
        beta=run.beta,
        sampler=sampler,
        convergence=run.provenance["convergence"],
        misfit=_misfit(run),
        notes=[cut(n, 400) for n in (*run.provenance["notes"], sampler["message"]) if n],
        settings_facts=settings_facts(run),
        version_facts=version_facts(run),
        citations=citations(run),
        methods=methods(run),
        fixed=fixed_rows(run),
        laws=law_rows(run),
        better_law=result.better_law,
        glossary=list(GLOSSARY.items()),
    )


def _misfit(run: Run) -> dict[str, Any]:
    """The posterior predictive check in words and as a table."""
    if run.state == "unusable":
        return {"words": [], "rows": []}
    table = run.result.checks
    words = dict.fromkeys(
        [*checks_in_words(table, run.specimen.unit, run.law.name), *misfit_in_words(table)]
    )
    rows = [row | {"protocol": cut(row["protocol"], 60)} for row in table.to_dict("records")]
    return {"words": [cut(text, 400) for text in words], "rows": rows}


# --- the reported table of a run for a paper, as LaTeX -------------------------------------------


def latex_table(run: Run) -> str:
    """A floating table with booktabs rules, as LaTeX; the methods paragraph as a comment.

    Protocols that the law misses stand below the table.
    """
    name = latex_text(run.specimen.name)
    caption = f"{name}: reported 90\\,\\% intervals and 95\\,\\% bounds."
    if run.state != "converged":
        caption += f" {latex_text(state_words(run)[0])}"
    return "\n".join(
        [
            "% needs \\usepackage{booktabs}",
            f"% {methods(run)}",
            "\\begin{table}",
            "  \\centering",
            f"  \\caption{{{caption}}}",
            "  \\begin{tabular}{lllll}",
            "    \\toprule",
            "    Parameter & Interval & Unit & Verdict & Reason \\\\",
            "    \\midrule",
            *[_latex_row(row) for row in run.result.rows],
            "    \\bottomrule",
            "  \\end{tabular}",
            *[
                f"  \\par\\smallskip\\footnotesize {latex_text(t, 500)}"
                for t in run.result.warnings
            ],
            "\\end{table}",
            "",
        ]
    )


def _latex_row(row: ReportRow) -> str:
    text = [latex_text(t, 300) for t in (row.interval, row.unit, row.verdict, row.reason)]
    return f"    {' & '.join((as_latex(row.quantity), *text))} \\\\"
