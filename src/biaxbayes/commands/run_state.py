"""Opening a run for what builds on it: unreliable draws are refused, or used with a word."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from biaxbayes.errors import NotConverged, RunError

if TYPE_CHECKING:
    from biaxbayes.output.run import Run

__all__ = ["open_usable_run", "uses_fibre_switch"]

RANGES = {
    "C1": (0.0, float("inf")),
    "k1": (0.0, float("inf")),
    "k2": (0.0, float("inf")),
    "alpha": (0.0, 90.0),
    "kappa": (0.0, 1.0 / 3.0 + 1e-12),
    "noise_sd": (0.0, float("inf")),
}


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
        If the folder is no run, or its draws are not those of a GOH posterior.
    NotConverged
        If its draws are unusable and ``anyway`` is not given.
    """
    run = _open(path)
    _check_draws(run)
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


def uses_fibre_switch(run: Run) -> bool:
    """Whether the fibres of the run's model carry no compression."""
    return run.provenance["settings"].get("fibre_switch") is True


def _check_draws(run: Run) -> None:
    """A folder may come from anywhere: what is computed with has to be a posterior's."""
    import numpy as np

    for name, (low, high) in RANGES.items():
        values = run.draws[name].to_numpy(dtype=float) if name in run.draws else np.empty(0)
        if not (
            values.size and np.isfinite(values).all() and ((low <= values) & (values <= high)).all()
        ):
            raise RunError(f"{run.path}: its draws of {name} are missing or out of range")
    for column in map(str, run.draws):
        if column.startswith("mounting_stretch"):
            values = run.draws[column].to_numpy(dtype=float)
            if not (np.isfinite(values).all() and (values > 0.0).all()):
                raise RunError(f"{run.path}: its draws of {column} are out of range")
