"""The closing message of a run: one screen that says what to trust."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from biaxbayes.runs.run import Run

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["closing_message"]


def closing_message(run: Run) -> str:
    """What a run found, as plain text of at most one screen."""
    record = run.provenance
    name = (
        record["specimen"]
        if not record.get("layer")
        else (f"{record['specimen']} ({record['layer']})")
    )
    lines = [f"{_plain(name)}: {_verdict(record)}", *_found(run), ""]
    lines += _table(run)
    lines += ["", _readings(record)]
    lines += _thinning(record)
    lines += _identifiability(run)
    lines += _held(run)
    lines += _stated(run)
    lines += _misses(run)
    lines += [_plain(f"note: {note}") for note in record["notes"][:3]]
    if record["sampler"]["message"]:
        lines.append(f"note: {record['sampler']['message']}")
    lines += ["", f"open {run.path}/report.html; tables, figures and draws are beside it"]
    return "\n".join(lines)


def _found(run: Run) -> list[str]:
    """What was odd about the record before it was sampled."""
    from biaxbayes.reports.facts import record_findings

    return [_plain(text) for text in record_findings(run)]


def _verdict(record: dict[str, Any]) -> str:
    convergence = record["convergence"]
    if convergence["state"] == "converged":
        return (
            f"converged (R-hat {convergence['worst_rhat']:.4f}, at least "
            f"{convergence['worst_ess']:.0f} effective draws of every quantity)"
        )
    if convergence["state"] == "tentative":
        return f"TENTATIVE, not converged: {convergence['reason']}"
    return f"NOT USABLE, not converged: {convergence['reason']}"


def _table(run: Run) -> list[str]:
    lines = [f"{'parameter':<26}{'unit':<6}{'median':>10}{'5 %':>10}{'95 %':>10}"]
    refits = _refits(run)
    for row in run.summary.itertuples():
        name = str(row.parameter)
        ends = refits.get(name, (row.q05, row.q95))
        cells = "".join(f"{_number(float(str(v))):>10}" for v in (row.q50, *ends))
        cells += "  not identified: range of refits" if name in refits else ""
        lines.append(f"{_plain(str(row.parameter))[:25]:<26}{row.unit:<6}{cells}")
    if len(lines) > 24:
        hidden = len(lines) - 22
        lines = [*lines[:22], f"... and {hidden} more rows in summary.csv"]
    return lines


def _refits(run: Run) -> dict[str, tuple[float, float]]:
    """Ranges that stand in place of an interval which the data contradict."""
    table = _verdicts(run)
    if table is None or "refit_low" not in table:
        return {}
    lost = table[table["verdict"] == "not identified"]
    return {
        str(r.parameter): (float(str(r.refit_low)), float(str(r.refit_high)))
        for r in lost.itertuples()
    }


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.4g}"


def _readings(record: dict[str, Any]) -> str:
    noise = record["noise"]
    if noise["effective_readings"] is None:
        return (
            f"{noise['readings']} readings taken as independent; if the model misses smoothly, "
            "the intervals are too narrow (--noise effective)"
        )
    return (
        f"your {noise['readings']} readings carry as much information as "
        f"{noise['effective_readings']:.0f} independent ones"
    )


def _thinning(record: dict[str, Any]) -> list[str]:
    noise = record["noise"]
    rows, used = noise.get("rows"), noise.get("rows_used")
    if not rows or not used or used >= rows:
        return []
    return [
        f"{rows:,} rows were averaged to {used:,} along the path; the answer does not "
        "depend on it (--thin none)"
    ]


def _identifiability(run: Run) -> list[str]:
    table = _verdicts(run)
    if table is None:
        return []
    loose = [f"{r.parameter}: {r.verdict}" for r in table.itertuples() if r.verdict != "identified"]
    if not loose:
        return ["every parameter is identified"]
    said = ["not determined on its own: " + "; ".join(_plain(t) for t in loose)]
    if _refits(run):
        said.append(
            "the mounting stretch rests on the toe of the model, which these data contradict; "
            "nominal stresses at measured stretches (report.html) do not"
        )
    return said


def _stated(run: Run) -> list[str]:
    """What is stated of the mounting stretch of the tissue, and a law that fits better."""
    from biaxbayes.reports.other_fits import mounting_cure

    lines = []
    for name, stated in run.stated.items():
        said = stated.in_words(run.quantities[name].parameter)
        lines.append(_plain(f"{name} of the tissue: {said}; {stated.reason}"))
    cure = mounting_cure(run)
    lines += [_plain(cure)] if cure else []
    better = run.provenance.get("identifiability", {}).get("better_law", "")
    return [*lines, *([_plain(better)] if better else [])]


def _held(run: Run) -> list[str]:
    """What holds with a parameter at an end of its range that the data do not exclude."""
    from biaxbayes.reports.other_fits import kept_edges

    return [_plain(held.summary(run.law.names, run.quantities)) for held in kept_edges(run)]


def _verdicts(run: Run) -> pd.DataFrame | None:
    path = run.path / "identifiability.csv"
    if not path.is_file():
        return None
    from biaxbayes.csv_tables import read_csv

    return read_csv(path)


def _misses(run: Run) -> list[str]:
    """Paths that the model must not be used for, two at most."""
    from biaxbayes.reports.facts import missed_paths

    said = missed_paths(run)
    more = [f"... and {len(said) - 2} more protocols (report.html)"] if len(said) > 2 else []
    return [_plain(text) for text in said[:2]] + more


def _plain(text: str) -> str:
    return "".join(c if c.isprintable() else " " for c in text)
