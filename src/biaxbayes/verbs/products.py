"""The products of a run besides its draws: result, figures, a page to explore."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from biaxbayes.figures.run.bands import bands_figure
from biaxbayes.figures.run.corner import corner_figure
from biaxbayes.figures.run.identifiability import identifiability_figure
from biaxbayes.figures.run.trace import trace_figure
from biaxbayes.figures.style import save_pictures
from biaxbayes.identifiability.identify import identify_run
from biaxbayes.model.posterior import Posterior
from biaxbayes.reports.explore import can_be_explored, explore_page
from biaxbayes.reports.page import EXPLORE, NAME
from biaxbayes.runs.archive import draw_table
from biaxbayes.runs.result import RunResult, run_result, write_result
from biaxbayes.sampling.sampler import Draws
from biaxbayes.text_files import atomic_write_text


def write_products(
    folder: Path,
    posterior: Posterior,
    draws: Draws,
    summary: pd.DataFrame,
    convergence: Mapping[str, Any],
    findings: Sequence[str],
) -> RunResult:
    """Write result and figures of a run into its folder.

    Unusable draws get only the traces, which show why.
    """
    state, known = draws.convergence.state, posterior.quantities
    table = draw_table(draws.quantities)
    judged = identify_run(posterior, table, state)
    result = run_result(judged, posterior, table, summary, convergence, findings)
    write_result(result, folder)
    if state != "converged":
        save_pictures(
            trace_figure(draws.quantities, unit=posterior.specimen.unit, known=known),
            folder,
            "trace",
        )
    if state == "unusable":
        return result
    bands = bands_figure(posterior.specimen, table, settings=posterior.settings)
    save_pictures(corner_figure(table, known=known, law=posterior.law.called), folder, "corner")
    save_pictures(bands, folder, "stress-bands")
    save_pictures(identifiability_figure(judged, result.rows), folder, "identifiability")
    if can_be_explored(known, table):
        page = explore_page(posterior, table, state, rows=result.rows, report=NAME)
        atomic_write_text(folder / EXPLORE, page)
    return result
