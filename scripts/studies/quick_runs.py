"""Runs without figures, verdicts and report, for trials by the hundred."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

from biaxbayes.identifiability.identify import Identifiability
from biaxbayes.identifiability.verdict import Thresholds
from biaxbayes.model.posterior import Posterior
from biaxbayes.sampling.sampler import Draws

__all__ = ["without_products"]


def _no_verdicts(folder: Path, posterior: Posterior, draws: Draws) -> Identifiability:
    del folder
    return Identifiability((), draws.convergence.state, 0, Thresholds(), posterior.law)


@contextmanager
def without_products() -> Iterator[None]:
    """Draws, summary and provenance alone are written by runs in this process and its forks."""
    with (
        mock.patch("biaxbayes.jobs.products.write_products", _no_verdicts),
        mock.patch("biaxbayes.reports.page.write_report", lambda *_: None),
    ):
        yield
