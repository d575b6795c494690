"""Opening a run for what builds on it: unreliable draws are refused, or used with a word."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from biaxbayes.errors import NotConverged

if TYPE_CHECKING:
    from biaxbayes.output.run import Run

__all__ = ["open_usable_run"]


def open_usable_run(path: Path, *, anyway: bool) -> Run:
    """Open a run folder.

    Parameters
    ----------
    path : Path
    anyway : bool
        Take draws that the run itself calls unusable.

    Raises
    ------
    RunError
        If the folder is no run.
    NotConverged
        If its draws are unusable and ``anyway`` is not given.
    """
    run = _open(path)
    if run.state == "unusable":
        if not anyway:
            raise NotConverged(
                f"{path}: the chains of this run have not converged, so its draws say nothing; "
                "sample longer, or add --anyway to use them all the same"
            )
        click.echo("warning: the chains of this run have not converged", err=True)
    elif run.state == "tentative":
        click.echo("note: this run is tentative: few effective draws", err=True)
    return run


def _open(path: Path) -> Run:
    from biaxbayes.output.run import open_run

    return open_run(path)
