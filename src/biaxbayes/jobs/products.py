"""What a run folder holds besides the draws: figures, verdicts, a page to explore."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from biaxbayes.executors.beside import Begin, Beside, Standby, when_asked
from biaxbayes.executors.memory import own_garbage, return_memory
from biaxbayes.figures.run import DRAWING_MODULES
from biaxbayes.figures.style import PRINT_AND_SCREEN, figure_bytes
from biaxbayes.identifiability.held_edges import held_edges
from biaxbayes.identifiability.identify import Identifiability, RecordFits, identify_draws
from biaxbayes.jobs.identified import said_of, with_curves, write_tables
from biaxbayes.laws import DEFAULT_LAW, law_named
from biaxbayes.model.posterior import Posterior
from biaxbayes.reports.page import TEMPLATE, page_template
from biaxbayes.runs.archive import draw_table
from biaxbayes.runs.said import IDENTIFIED, write_said
from biaxbayes.sampling.sampler import Draws
from biaxbayes.text_files import atomic_write_bytes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["drawing_beside", "write_products"]

Task = tuple[str, tuple[Any, ...]]
"""What is drawn, by the stem of its files, and what of."""

_drawing: ContextVar[Standby[Task, dict[str, bytes]] | None] = ContextVar("drawing", default=None)


@contextlib.contextmanager
def drawing_beside(workers: int) -> Iterator[None]:
    """Have a process get ready to draw the figures of a run that is sampled within.

    It imports matplotlib, which this process then never holds.

    Parameters
    ----------
    workers : int
        Processors that may be used; with one the figures are drawn here.
    """
    with Standby(_ready, _drawn, workers) as process:
        token = _drawing.set(process)
        try:
            yield
        finally:
            _drawing.reset(token)


def write_products(
    folder: Path,
    posterior: Posterior,
    draws: Draws,
    fits: Beside[RecordFits],
    *,
    meanwhile: Callable[[], None],
    begin: Begin = when_asked,
    workers: int = 1,
) -> Identifiability:
    """Write the products of a run into its folder; the verdicts.

    What ``identify`` says of the run is kept for it. Unusable draws get the traces that show why,
    and no figure of a posterior that is none. With two ``workers`` the figures are drawn beside the
    verdicts, the corner, which takes as long as the others, beside these, and the ``fits`` to the
    record were made beside the sampling. ``meanwhile`` is called while the figures are drawn;
    ``begin`` as in :func:`.evidence.evidence_of_draws`.
    """
    state = draws.convergence.state
    table = draw_table(draws.quantities)
    known = posterior.quantities
    return_memory()
    with contextlib.ExitStack() as stack:
        drawing = _drawing.get() or stack.enter_context(Standby(_ready, _drawn, workers))
        if state != "unusable":  # the largest figure first
            drawing.begin(("corner", (table, known)))
            drawing.begin(("stress-bands", (posterior.specimen, table, posterior.settings)))
            drawing.begin(("explore", (posterior, table, state)))
        if state != "converged":
            drawing.begin(("trace", (draws.quantities, posterior.specimen.unit, known)))
        meanwhile()
        if state == "converged":
            laws, parts = fits.result()
            found = identify_draws(
                posterior, table, state, fits=laws, refits=lambda _: parts, begin=begin
            )
        else:
            found = identify_draws(posterior, table, state, begin=begin)
        found = found.with_held(held_edges(posterior, found.open_edges()))
        if state != "unusable":
            drawing.begin(("identifiability", (found,)))
        judged = with_curves(found, posterior, table)
        write_tables(judged, posterior, folder)
        if state != "unusable":  # what identify says of the run is known now
            write_said(folder, IDENTIFIED, said_of(judged))
        page_template(TEMPLATE)  # which the report needs next
        for files in drawing.results():
            for name, content in files.items():
                atomic_write_bytes(folder / name, content)
    return found


def _ready() -> None:
    """Import what all figures need, and do with a small one what is done once in a process."""
    for name in DRAWING_MODULES:
        import_module(name)
    _drawn(("corner", (_example(), None)))


def _example() -> pd.DataFrame:
    """Draws for a small corner plot."""
    names = [parameter.name for parameter in law_named(DEFAULT_LAW).parameters]
    random = np.random.default_rng(0)
    return pd.DataFrame({name: random.uniform(0.4, 0.6, 400) for name in names[:3]})


def _drawn(task: Task) -> dict[str, bytes]:
    """The files of a task, by their names."""
    stem, of = task
    if stem == "explore":
        from biaxbayes.reports.explore import EXPLORE, can_be_explored, explore_page
        from biaxbayes.reports.page import NAME

        posterior, table, state = of
        if not can_be_explored(posterior.quantities, table):
            return {}
        return {EXPLORE: explore_page(posterior, table, state, report=NAME).encode()}
    with own_garbage():
        figure = _figure(stem, *of)
        pictures = {f"{stem}.{suffix}": figure_bytes(figure, suffix) for suffix in PRINT_AND_SCREEN}
        del figure
    return pictures


def _figure(stem: str, *of: Any) -> Figure:
    """The figure with this stem of a run."""
    if stem == "corner":
        from biaxbayes.figures.run.corner import corner_figure

        return corner_figure(of[0], known=of[1])
    if stem == "stress-bands":
        from biaxbayes.figures.run.bands import bands_figure

        return bands_figure(of[0], of[1], settings=of[2])
    if stem == "trace":
        from biaxbayes.figures.run.trace import trace_figure

        return trace_figure(of[0], unit=of[1], known=of[2])
    from biaxbayes.figures.run.identifiability import identifiability_figure

    return identifiability_figure(*of)
