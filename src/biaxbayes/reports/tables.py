"""The parameter table of a run for a paper: Markdown or LaTeX."""

from __future__ import annotations

from biaxbayes.reports.facts import missed_paths, state_words
from biaxbayes.reports.methods import methods
from biaxbayes.reports.names import as_latex, as_markdown, latex_text, markdown_text
from biaxbayes.reports.parameters import Row, parameter_rows
from biaxbayes.runs.run import Run

__all__ = ["STATED", "latex_table", "markdown_table"]

STATED = "stated of the tissue"
"""Head of what is stated of a mounting stretch."""


def markdown_table(run: Run) -> str:
    """Table, paths that the model misses, verdicts and methods paragraph as Markdown."""
    rows = parameter_rows(run)
    more = any(row.stated for row in rows)
    lines = [
        f"# {markdown_text(run.specimen.name)}",
        "",
        markdown_text(" ".join(state_words(run)).strip(), 500),
        "",
        *_missed_markdown(run),
        f"| parameter | unit | median | 90 % interval |{f' {STATED} |' if more else ''} verdict |",
        f"|---|---|--:|--:|{'---|' if more else ''}---|",
    ]
    for row in rows:
        stated = (row.stated,) if more else ()
        cells = (as_markdown(row.name), row.unit, row.median, row.interval, *stated, row.verdict)
        lines.append(f"| {' | '.join(cells)} |")
    words = [f"- {as_markdown(r.name)}: {markdown_text(r.words, 500)}" for r in rows if r.words]
    if words:
        lines += ["", "## Verdicts", "", *words]
    lines += ["", "## Methods", "", markdown_text(methods(run, rows), 20_000), ""]
    return "\n".join(lines)


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


def _missed_markdown(run: Run) -> list[str]:
    missed = missed_paths(run)
    if not missed:
        return []
    return [
        "**The model misses some paths.**",
        "",
        *(f"- {markdown_text(text, 500)}" for text in missed),
        "",
    ]


def _latex_row(row: Row, *, stated: bool) -> str:
    interval = row.interval.replace(" to ", "--") if row.interval[:1] != "f" else row.interval
    cells = (as_latex(row.quantity), latex_text(row.unit), latex_text(row.median))
    of_tissue = (latex_text(row.stated.replace(" to ", "--")),) if stated else ()
    rest = (latex_text(interval).replace("–", "--"), *of_tissue, latex_text(row.verdict))
    return f"    {' & '.join((*cells, *rest))} \\\\"
