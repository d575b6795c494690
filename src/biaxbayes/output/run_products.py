"""What a run folder holds besides the draws: figures, verdicts, report."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from biaxbayes.findings.identifiability import identify_draws
from biaxbayes.inference.posterior import Posterior
from biaxbayes.inference.sampler import Draws
from biaxbayes.output.archive import flatten
from biaxbayes.output.identifiability_file import write_identifiability
from biaxbayes.output.style import save_figure

__all__ = ["write_products"]

FORMATS = ("pdf", "png")


def write_products(folder: Path, posterior: Posterior, draws: Draws) -> None:
    """Write the products of a run into its folder.

    Unusable draws get the traces that show why, and no figure of a posterior that is none.
    """
    from biaxbayes.output.figures.bands import bands_figure
    from biaxbayes.output.figures.corner import corner_figure
    from biaxbayes.output.figures.identifiability import identifiability_figure
    from biaxbayes.output.figures.trace import trace_figure

    state = draws.convergence.state
    table = pd.DataFrame({name: flatten(v).ravel() for name, v in draws.quantities.items()})
    found = identify_draws(posterior, table, state)
    write_identifiability(found, folder / "identifiability.csv")
    if state != "reliable":
        _save(folder, "trace", trace_figure(draws.quantities, unit=posterior.specimen.unit))
    if state == "unusable":
        return
    _save(folder, "corner", corner_figure(table))
    _save(
        folder,
        "stress-bands",
        bands_figure(posterior.specimen, table, settings=posterior.settings),
    )
    _save(folder, "identifiability", identifiability_figure(found))


def _save(folder: Path, stem: str, figure) -> None:
    for suffix in FORMATS:
        save_figure(figure, folder / f"{stem}.{suffix}")
