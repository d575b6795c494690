"""Text of a run: paragraphs of methods and results, LaTeX table, and its closing message."""

from __future__ import annotations

from biaxbayes.errors import listed, printable
from biaxbayes.identifiability.reported import row_lines
from biaxbayes.identifiability.verdict import BOUNDED, COMBINATION, IDENTIFIED, NOT_IDENTIFIED
from biaxbayes.model.priors import prior_text
from biaxbayes.reports.templates import page_template
from biaxbayes.reports.text import (
    CONVERGENCE_TEXTS,
    as_latex,
    capital,
    latex_tabular,
    latex_text,
    truncate,
)
from biaxbayes.runs.run import Run


def methods(run: Run) -> str:
    """The methods section as one paragraph of plain text, without results."""
    text = page_template("methods.txt.jinja").render(run=run, priors=prior_texts(run))
    return " ".join(text.split())


def prior_texts(run: Run) -> dict[str, str]:
    """Priors of a run as text, by the names of their quantities."""
    words = {}
    for name, prior in run.provenance["priors"].items():
        known = run.quantities.get(name)
        words[truncate(name, 40)] = truncate(prior_text(prior, "" if known is None else known.unit))
    return words


def results_paragraph(run: Run) -> str:
    """The reported table as a paragraph of plain text, with no other interval."""
    if run.state != "converged":
        return "" if not run.result.rows else "The chains have not converged: no result to report."
    sentences = []
    for row in run.result.rows:
        name = f"{row.name} ({row.quantity.parameter.words})"
        if row.verdict == IDENTIFIED:
            sentences.append(
                f"{name} was identified: {row.median} ({row.interval_with_unit}, 90 % interval)."
            )
        elif row.verdict == BOUNDED:
            sentences.append(f"{name} was bounded: {row.interval_with_unit} (95 % bound).")
        elif row.verdict == COMBINATION:
            sentences.append(
                f"{name} was identified {row.verdict} with {listed(row.partners)}: "
                f"{row.median} ({row.interval_with_unit}, 90 % interval)."
            )
    left = [row.name for row in run.result.rows if row.verdict == NOT_IDENTIFIED]
    if left:
        sentences.append(f"The test did not identify {listed(left)}.")
    sentences += [f"{capital(text)}." for text in run.result.pieces]
    fit = run.result.fit
    return " ".join([*sentences, f"{capital(fit)}." if fit else ""]).strip()


def latex_table(run: Run) -> str:
    """The reported table with booktabs rules; both paragraphs as comments."""
    name = latex_text(run.specimen.name)
    caption = f"{name}: medians with 90\\,\\% intervals, or 95\\,\\% bounds."
    if run.state != "converged":
        caption += f" {latex_text(CONVERGENCE_TEXTS[run.state])}"
    rows = []
    for row in run.result.rows:
        texts = (row.median, row.interval, row.unit, row.verdict, row.reason)
        rows.append([as_latex(row.quantity), *(latex_text(t, 300) for t in texts)])
    heads = ("Parameter", "Median", "Interval", "Unit", "Verdict", "Reason")
    footnotes = [
        f"  \\par\\smallskip\\footnotesize {latex_text(t, 500)}" for t in run.result.warnings
    ]
    return "\n".join(
        [
            "% needs \\usepackage{booktabs}",
            f"% Methods: {methods(run)}",
            f"% Results: {results_paragraph(run)}",
            "\\begin{table}",
            "  \\centering",
            f"  \\caption{{{caption}}}",
            *(f"  {line}" for line in latex_tabular(heads, rows)),
            *footnotes,
            "\\end{table}",
            "",
        ]
    )


# --- in the terminal -----------------------------------------------------------------------------


def closing_message(run: Run) -> str:
    """The result of a run as plain text."""
    record, result = run.provenance, run.result
    name = str(record["specimen"])
    if record.get("layer"):
        name += f" ({record['layer']})"
    convergence = record["convergence"]
    state = "TENTATIVE" if run.state == "tentative" else "NOT USABLE"
    verdict = f"{state}, not converged: {convergence['reason']}"
    if run.state == "converged":
        verdict = (
            f"converged (R-hat {convergence['worst_rhat']:.4f}, at least "
            f"{convergence['worst_ess']:.0f} effective draws of every quantity)"
        )
    lines = [f"{printable(truncate(name, 80))}: {verdict}"]
    if grips := record.get("grips"):
        lines.append(printable(truncate(grips["in_words"], 200)))
    serious = [f for f in record.get("findings") or [] if f["severity"] == "error"]
    lines += [printable(truncate(f["message"], 400)) for f in serious[:1]]
    advice = "; ".join(filter(None, (result.low_information, result.advice)))
    rest = [printable(text) for text in (*result.pieces, result.fit, advice) if text]
    if not result.better_law:  # else no parameter is reported that could be used
        rest += [printable(text) for text in result.warnings[:1]]
    rest.append(f"report: {run.path}/report.html")
    lines += row_lines(result.rows)
    return "\n".join([*lines, *rest])
