"""report.html: a run on one page, for somebody who has two minutes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from biaxbayes.output.report.citation import citations
from biaxbayes.output.report.facts import (
    settings_facts,
    specimen_facts,
    state_words,
    test_rows,
    version_facts,
)
from biaxbayes.output.report.methods import methods
from biaxbayes.output.report.names import cut
from biaxbayes.output.report.page_template import page_template
from biaxbayes.output.report.parameters import parameter_rows, percent_stretch
from biaxbayes.output.report.pictures import pictures
from biaxbayes.output.run import Run, open_run
from biaxbayes.specimens.text_file import atomic_write_text

__all__ = ["NAME", "report_page", "write_report"]

NAME = "report.html"
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
    page = report_page(run or open_run(folder))
    path = folder / NAME
    atomic_write_text(path, page)
    return path


def report_page(run: Run) -> str:
    """The page as HTML: no scripts, no network, figures of the folder inside.

    Parameters
    ----------
    run : Run
    """
    rows = parameter_rows(run)
    verdict, reason = state_words(run)
    noise, sampler = run.provenance["noise"], run.provenance["sampler"]
    return page_template("template.html.jinja").render(
        name=cut(run.specimen.name),
        state=run.state,
        verdict=verdict,
        reason=reason,
        facts=specimen_facts(run),
        tests=test_rows(run),
        unit=run.specimen.unit,
        load="force" if run.specimen.stress_pair == "force" else "nominal stress",
        rows=rows,
        words=[row for row in rows if row.words],
        mounting=percent_stretch(rows, run),
        settings=run.provenance["settings"],
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
    )


def _determined(run: Run) -> list[dict[str, str]]:
    if run.state == "unusable":
        return []
    from biaxbayes.output.report.determined import determined_rows

    return determined_rows(run)


def _misfit(run: Run) -> dict[str, Any]:
    """The posterior predictive check in words and as a table."""
    if run.state == "unusable":
        return {"words": [], "rows": [], "warnings": []}
    from biaxbayes.findings.misfit import misfit_in_words
    from biaxbayes.findings.predictive_checks import checks_in_words, path_warnings
    from biaxbayes.output.model_checks import model_checks

    table, unit = model_checks(run), run.specimen.unit
    words = dict.fromkeys([*checks_in_words(table, unit), *misfit_in_words(table)])
    return {
        "words": list(words),
        "rows": table.to_dict("records"),
        "warnings": path_warnings(table, unit),
    }
