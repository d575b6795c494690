"""Text of a run: paragraphs of methods and results, LaTeX table, and its closing message."""

from __future__ import annotations

from biaxbayes.errors import listed, printable
from biaxbayes.identifiability import verdict
from biaxbayes.model.priors import prior_text
from biaxbayes.report_table import latex_text, truncate
from biaxbayes.reports.page import page_template
from biaxbayes.reports.text import CONVERGENCE_TEXTS, capital
from biaxbayes.runs.run import Run
from biaxbayes.runs.run_result import RunResult
from biaxbayes.text_files import MADE_HERE


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
        return "The chains have not converged: no result to report." if run.result.reported else ""
    sentences = []
    for row in run.result.reported:
        known = f"{row.text} ({row.interval_with_unit}, 90 % interval)"
        found = {
            verdict.IDENTIFIED: f"identified: {known}",
            verdict.MEASURED: f"measured ({row.reason}): {known}",
            verdict.BOUNDED: f"bounded: {row.interval_with_unit} (95 % bound)",
            verdict.COMBINATION: f"identified {row.verdict} with {listed(row.partners)}: {known}",
        }
        if row.verdict in found:
            words = row.quantity.parameter.words
            sentences.append(f"{row.name} ({words}) was {found[row.verdict]}.")
    left = [row.name for row in run.result.reported if row.verdict == verdict.NOT_IDENTIFIED]
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
    lines = [
        f"% {MADE_HERE}; needs \\usepackage{{booktabs}}",
        f"% Methods: {methods(run)}",
        f"% Results: {results_paragraph(run)}",
        "\\begin{table}\n  \\centering",
        f"  \\caption{{{caption}}}",
        *(f"  {line}" for line in run.result.table.latex()),
        *(f"  \\par\\smallskip\\footnotesize {latex_text(t, 500)}" for t in run.result.warnings),
    ]
    return "\n".join([*lines, "\\end{table}\n"])


# --- in the terminal -----------------------------------------------------------------------------


def closing_message(run: Run) -> str:
    """The result of a run as plain text."""
    record, result = run.provenance, run.result
    name = str(record["specimen"])
    if record.get("layer"):
        name += f" ({record['layer']})"
    convergence = record["convergence"]
    state = "TENTATIVE" if run.state == "tentative" else "NOT USABLE"
    how = f"{state}, not converged: {convergence['reason']}"
    if run.state == "converged":
        how = (
            f"converged (R-hat {convergence['worst_rhat']:.4f}, at least "
            f"{convergence['worst_ess']:.0f} effective draws of every quantity)"
        )
    lines = [f"{printable(truncate(name, 80))}: {how}"]
    if grips := record.get("grips"):
        lines.append(printable(truncate(grips["in_words"], 200)))
    serious = [f for f in record.get("findings") or [] if f["severity"] == "error"]
    lines += [printable(truncate(f["message"], 400)) for f in serious[:1]]
    return "\n".join([*lines, *result_lines(result), f"report: {run.path}/report.html"])


def result_lines(result: RunResult) -> list[str]:
    """What is known, the parameters, and the sentences on them, as plain text."""
    lines = []
    if known := result.known:
        lines = ["", f"{known.label}: medians and 90 % intervals", *known.lines()]
        lines += ["", "Parameters"]
    lines += result.table.lines(heads=False)
    texts = [*result.pieces, result.fit, *result.warnings[:1], result.low_information]
    texts += [result.better_law, result.advice]
    return [*lines, *(capital(printable(text)) for text in texts if text)]
