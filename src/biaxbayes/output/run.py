"""A run: sampled into a folder, and opened again from it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.errors import RunError
from biaxbayes.inference.posterior import Posterior
from biaxbayes.output.archive import quantity_name, read_archive
from biaxbayes.output.lock import folder_lock
from biaxbayes.output.provenance import parse_options
from biaxbayes.output.record import read_json, read_record, trusted_path
from biaxbayes.output.staging import READY, finish_moving
from biaxbayes.output.summary import read_summary
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.specimen_file import read_specimen

__all__ = ["Run", "open_run", "sample"]


@dataclass(frozen=True)
class Run:
    """A finished run folder, read on demand.

    Attributes
    ----------
    path : Path
    provenance : dict
        Input hash, settings, seed, versions, convergence, timings.
    """

    path: Path
    provenance: dict[str, Any]

    @cached_property
    def specimen(self) -> Specimen:
        """The specimen as it was sampled."""
        return read_specimen(trusted_path(self.path, "specimen.csv", self.provenance))

    @cached_property
    def tree(self) -> Any:
        """The whole archive, an ``xarray.DataTree``."""
        return read_archive(trusted_path(self.path, "posterior.nc", self.provenance))

    @cached_property
    def draws(self) -> pd.DataFrame:
        """One row a draw: natural quantities, ``log_likelihood`` (tempered) and ``lp``."""
        posterior = self.tree["posterior"]
        columns = {quantity_name(k): v.to_numpy().ravel() for k, v in posterior.items()}
        stats = self.tree["sample_stats"]
        columns["log_likelihood"] = stats["tempered_log_likelihood"].to_numpy().ravel()
        columns["lp"] = stats["lp"].to_numpy().ravel()
        return pd.DataFrame(columns)

    @cached_property
    def chains(self) -> dict[str, np.ndarray]:
        """Quantities as arrays of shape (ensembles, steps, walkers)."""
        posterior = self.tree["posterior"]
        walkers = int(posterior["walker"].to_numpy().max()) + 1
        out = {}
        for name, values in posterior.items():
            flat = values.to_numpy()
            out[quantity_name(name)] = flat.reshape(flat.shape[0], walkers, -1).transpose(0, 2, 1)
        return out

    @cached_property
    def summary(self) -> pd.DataFrame:
        """summary.csv as a table."""
        return read_summary(trusted_path(self.path, "summary.csv", self.provenance))

    @cached_property
    def fit(self) -> list[dict[str, Any]]:
        """The deterministic fit that the run started from."""
        return read_json(self.path, "fit.json")

    @property
    def state(self) -> str:
        """``reliable``, ``tentative`` or ``unusable``."""
        return str(self.provenance["convergence"]["state"])

    @property
    def beta(self) -> float:
        """Weight n_eff / n of the log likelihood."""
        return float(self.provenance["noise"]["beta"])

    def posterior(self) -> Posterior:
        """The posterior that was sampled, rebuilt from the stored settings."""
        return Posterior(
            self.specimen, **parse_options(self.provenance["settings"]), beta=self.beta
        )

    def _repr_html_(self) -> str:
        """State and summary table for notebooks."""
        head = f"<p>{escape(str(self.provenance['specimen']))}: {escape(self.state)}</p>"
        table = self.summary.to_html(index=False, float_format=lambda v: f"{v:.4g}", na_rep="–")
        return head + table


def open_run(path: str | Path) -> Run:
    """Open a run folder.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    Run

    Raises
    ------
    RunError
        If the folder is not a finished run.
    """
    path = Path(path)
    try:
        if not path.is_dir():
            raise RunError(f"{path}: is not a run folder; make one with 'biaxbayes sample'")
        if (path / READY).is_dir():
            # A crash came between two renames of finished files: nothing is missing.
            with folder_lock(path):
                finish_moving(path)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise RunError(f"{path}: cannot be opened ({reason})") from None
    return Run(path, read_record(path))


def sample(
    specimen: Specimen | str | Path,
    *,
    out: str | Path | None = None,
    seed: int = 1,
    mounting: str = "noisy",
    noise: str = "effective",
    mounting_stretch: str = "shared",
    noise_growth: bool = False,
    fibre_switch: bool = False,
    thin: int | str = "auto",
    priors: Mapping[str, Any] | None = None,
    ess: float = 2000.0,
    max_steps: int = 20_000,
    workers: int | None = None,
    resume: bool = False,
    progress: Callable[[Any], None] | None = None,
    stop: Callable[[], int] = lambda: False,
) -> Run:
    """Sample the posterior of a specimen into a run folder.

    Parameters
    ----------
    specimen : Specimen or path-like
        A specimen, or the CSV to read it from.
    out : path-like, optional
        The run folder; default ``<stem>-posterior`` beside where the command runs.
    seed : int
        The same seed gives the same draws, whatever ``workers`` is.
    mounting, noise, mounting_stretch, noise_growth, fibre_switch, thin, priors
        As in :class:`~biaxbayes.inference.posterior.Posterior`.
    ess : float
        Effective sample size asked for, for the worst quantity.
    max_steps : int
        Kept steps of each ensemble at which the sampler gives up.
    workers : int, optional
        Threads; default the number of processors, at most four.
    resume : bool
        Continue from the folder's checkpoint where there is one.
    progress, stop : callable, optional
        As in :func:`biaxbayes.inference.sampler.draw`.

    Returns
    -------
    Run
        Whatever its state is: look at ``run.state``.

    Raises
    ------
    InputError
        If the specimen or an option cannot be used.
    TaredSpecimen
        If the mounting force was zeroed and the mounting stretch is to be inferred.
    RunError
        If the folder is in use, cannot be written, or holds a checkpoint of something else.
    """
    from biaxbayes.output.sampling import Sampling

    sampling = Sampling.prepare(
        specimen,
        out=out,
        options={
            "mounting": mounting,
            "noise": noise,
            "mounting_stretch": mounting_stretch,
            "noise_growth": noise_growth,
            "fibre_switch": fibre_switch,
            "thin": thin,
            "priors": dict(priors or {}),
        },
        seed=seed,
        ess=ess,
        max_steps=max_steps,
        workers=workers,
    )
    return open_run(sampling.execute(resume=resume, progress=progress, stop=stop))
