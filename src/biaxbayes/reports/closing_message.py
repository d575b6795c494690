"""The closing message of a run: what to report, and how far to trust it, on one screen."""

from __future__ import annotations

from typing import Any

from biaxbayes.errors import printable
from biaxbayes.identifiability.reported import row_lines
from biaxbayes.reports.text import cut
from biaxbayes.runs.run import Run

MOST_LINES = 12


def closing_message(run: Run) -> str:
    """The result of a run as plain text of at most twelve lines."""
    record, result = run.provenance, run.result
    name = str(record["specimen"])
    if record.get("layer"):
        name += f" ({record['layer']})"
    lines = [f"{printable(cut(name, 80))}: {_verdict(record['convergence'])}"]
    if isinstance(grips := record.get("grips"), dict):
        lines.append(printable(cut(grips.get("in_words", ""), 200)))
    serious = [f for f in record.get("findings") or [] if f["severity"] == "error"]
    lines += [printable(cut(f["message"], 400)) for f in serious[:1]]
    advice = "; ".join(filter(None, (result.little_determined, result.advice)))
    rest = [printable(text) for text in (result.fit, advice) if text]
    rest += [printable(text) for text in result.warnings[:1]]
    rest.append(f"report: {run.path}/report.html")
    lines += row_lines(result.rows, MOST_LINES - len(lines) - len(rest))
    return "\n".join([*lines, *rest])


def _verdict(convergence: dict[str, Any]) -> str:
    if convergence["state"] == "converged":
        return (
            f"converged (R-hat {convergence['worst_rhat']:.4f}, at least "
            f"{convergence['worst_ess']:.0f} effective draws of every quantity)"
        )
    state = "TENTATIVE" if convergence["state"] == "tentative" else "NOT USABLE"
    return f"{state}, not converged: {convergence['reason']}"
