"""What stands beside the posterior of a run: other laws, and edges of the range as hypotheses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from biaxbayes.csv_tables import read_csv
from biaxbayes.errors import InputError
from biaxbayes.identifiability.held_edges import EDGES, HeldEdge, held_from
from biaxbayes.identifiability.law_range import LAW_FITS
from biaxbayes.identifiability.stated import cure
from biaxbayes.parameters import STRETCH, Quantity, mounting_names
from biaxbayes.reports.names import cut
from biaxbayes.runs.run import Run

__all__ = ["HeldRow", "held_rows", "kept_edges", "law_rows", "mounting_cure"]


def kept_edges(run: Run) -> tuple[HeldEdge, ...]:
    """The edges that a run was drawn with held, from its ``edges.csv``; none without it."""
    try:
        return held_from(read_csv(run.path / EDGES), run.quantities)
    except (OSError, InputError, KeyError, ValueError):
        return ()


@dataclass(frozen=True)
class HeldRow:
    """A parameter with another one held at an end of its range, as text.

    Attributes
    ----------
    condition : str
    quantity : Quantity
    interval, unit : str
    """

    condition: str
    quantity: Quantity
    interval: str
    unit: str


def held_rows(run: Run) -> list[HeldRow]:
    """The law's parameters and the mounting stretches under every hypothesis of an edge."""
    out = []
    for held in kept_edges(run):
        for name, (low, _, high) in held.intervals.items():
            quantity = run.quantities[name]
            p = quantity.parameter
            if name in run.law.names or p.kind == STRETCH:
                interval = f"{p.number(low)} to {p.number(high)}"
                out.append(
                    HeldRow(held.condition, quantity, interval, p.unit_symbol(quantity.load_unit))
                )
    return out


def law_rows(run: Run) -> list[dict[str, Any]]:
    """Least squares of every law under the same mounting constraint, from ``law-fits.csv``."""
    try:
        table = read_csv(run.path / LAW_FITS)
        names = [q.name for q in run.quantities.of_kind(STRETCH) if q.name in table]
        return [
            {
                "law": cut(row["law"], 30),
                "rms": f"{float(row['rms']):.3g}",
                "alike": "yes" if row["alike"] else "no",
                "mounting": [
                    f"{run.quantities[n].parameter.number(float(row[n]))} ± "
                    f"{float(row[f'{n}_sd']):.2g}"
                    for n in names
                ],
            }
            for row in table.to_dict("records")
        ]
    except (OSError, InputError, KeyError, ValueError, TypeError):
        return []


def mounting_cure(run: Run) -> str:
    """What to do about mounting stretches that are not stated as values; empty where all are."""
    axes = {run.quantities[n].axis for n, stated in run.stated.items() if not stated.is_value}
    names = mounting_names("stretch")
    return cure([names[axis] for axis in (0, 1) if axis in axes]) if axes else ""
