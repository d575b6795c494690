"""What a run folder holds besides the draws: figures, verdicts, a page to explore."""

from __future__ import annotations

from pathlib import Path

from biaxbayes.figures.run.bands import bands_figure
from biaxbayes.figures.run.corner import corner_figure
from biaxbayes.figures.run.identifiability import identifiability_figure
from biaxbayes.figures.run.trace import trace_figure
from biaxbayes.figures.style import save_pictures
from biaxbayes.identifiability.identify import Identifiability
from biaxbayes.model.posterior import Posterior
from biaxbayes.reports.explore import EXPLORE, can_be_explored, explore_page
from biaxbayes.reports.page import NAME
from biaxbayes.runs.archive import draw_table
from biaxbayes.sampling.sampler import Draws
from biaxbayes.text_files import atomic_write_text
from biaxbayes.verbs.identified import identified, write_tables


def write_products(folder: Path, posterior: Posterior, draws: Draws) -> Identifiability:
    """Write the products of a run into its folder; the verdicts.

    Unusable draws get the traces that show why, and no figure of a posterior that is none.
    """
    state, known = draws.convergence.state, posterior.quantities
    table = draw_table(draws.quantities)
    result = identified(posterior, table, state)
    write_tables(result, posterior, folder)
    if state != "converged":
        save_pictures(
            trace_figure(draws.quantities, unit=posterior.specimen.unit, known=known),
            folder,
            "trace",
        )
    if state == "unusable":
        return result.verdicts
    bands = bands_figure(posterior.specimen, table, settings=posterior.settings)
    save_pictures(corner_figure(table, known=known), folder, "corner")
    save_pictures(bands, folder, "stress-bands")
    save_pictures(identifiability_figure(result.verdicts), folder, "identifiability")
    if can_be_explored(known, table):
        page = explore_page(posterior, table, state, report=NAME)
        atomic_write_text(folder / EXPLORE, page)
    return result.verdicts
