"""Runs without figures, verdicts and report, for trials by the hundred."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

from biaxbayes.executors.beside import Begin, Beside, when_asked
from biaxbayes.identifiability.identify import Identifiability, RecordFits
from biaxbayes.identifiability.verdict import Thresholds
from biaxbayes.model.posterior import Posterior
from biaxbayes.sampling.sampler import Draws

__all__ = ["without_products"]


def _no_verdicts(
    folder: Path,
    posterior: Posterior,
    draws: Draws,
    fits: Beside[RecordFits],
    *,
    meanwhile: Callable[[], None],
    begin: Begin = when_asked,
    workers: int = 1,
) -> Identifiability:
    del folder, fits, begin, workers
    meanwhile()
    return Identifiability((), draws.convergence.state, 0, Thresholds(), posterior.law)


@contextmanager
def without_products() -> Iterator[None]:
    """Draws, summary and provenance alone are written by runs in this process and its forks."""
    with (
        mock.patch("biaxbayes.jobs.products.write_products", _no_verdicts),
        mock.patch("biaxbayes.reports.page.write_report", lambda *_: None),
    ):
        yield
