"""A run folder, opened again, and its summary.csv."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from biaxbayes.errors import RunError
from biaxbayes.fitting.fit_result import fit_from_record
from biaxbayes.laws.law import Law
from biaxbayes.model.misfit import Terms
from biaxbayes.model.posterior import Posterior
from biaxbayes.options import Settings
from biaxbayes.parameters import NOISE_SD, Quantities
from biaxbayes.prediction.percentiles import quantiles
from biaxbayes.runs.archive import quantity_name, read_archive
from biaxbayes.runs.folder import PROVENANCE, open_folder, piece_files, read_run_json, trusted_path
from biaxbayes.runs.provenance import parse_options, read_record, stored_law
from biaxbayes.sampling.convergence import Convergence, assess
from biaxbayes.specimens.check import Finding
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.specimen_file import read_specimen
from biaxbayes.tasks import kept_warning_filters
from biaxbayes.text_files import as_path, one_line

if TYPE_CHECKING:
    import xarray as xr

    from biaxbayes.identifiability.identify import Identifiability
    from biaxbayes.runs.run_result import RunResult


# --- summary.csv: ArviZ's summary of the draws ---------------------------------------------------

SUMMARY_COLUMNS = (
    *("parameter", "unit", "mean", "sd", "q05", "q50", "q95", "ess_bulk", "ess_tail", "rhat"),
)


def summarise(
    quantities: dict[str, np.ndarray],
    names: tuple[str, ...],
    known: Quantities,
    convergence: Convergence,
) -> pd.DataFrame:
    """ArviZ's summary of the draws; ``report.csv`` has the same quantiles with their verdicts.

    ``quantities`` are arrays (ensembles, steps, walkers) by name, ``names`` the rows. Where the
    chains are ``tentative`` the effective sample sizes are left empty, where they are ``unusable``
    every number but R-hat is.
    """
    position = {name: i for i, name in enumerate(convergence.names)}
    rows = []
    for name in names:
        draws = quantities[name]
        row: dict[str, object] = dict.fromkeys(SUMMARY_COLUMNS, np.nan)
        row |= {"parameter": name, "unit": known[name].unit}
        i = position.get(name)
        if convergence.state != "unusable" and draws.size:
            q05, q50, q95 = quantiles(draws)
            sd = draws.std(ddof=1) if i is not None else 0.0
            row |= {"mean": draws.mean(), "sd": sd, "q05": q05, "q50": q50, "q95": q95}
        if i is not None:
            row["rhat"] = convergence.rhat[i]
            if convergence.state == "converged":
                row["ess_bulk"] = np.floor(convergence.ess_bulk[i])
                row["ess_tail"] = np.floor(convergence.ess_tail[i])
        rows.append(row)
    return pd.DataFrame(rows, columns=list(SUMMARY_COLUMNS))


# --- the run -------------------------------------------------------------------------------------

MAX_FINDINGS, MAX_FINDING_LENGTH = 8, 400


@dataclass(frozen=True)
class Run:
    """A finished run folder, read on demand.

    Attributes
    ----------
    provenance : dict
        Input hash, settings, seed, versions, convergence, timings.
    """

    path: Path
    provenance: dict[str, Any]

    def __repr__(self) -> str:
        return f"Run({str(self.path)!r}, {self.provenance['specimen']!r}, {self.state})"

    @cached_property
    def specimen(self) -> Specimen:
        """The specimen as it was sampled."""
        names = piece_files(len(self.provenance["pieces"]))
        paths = (trusted_path(self.path, name, self.provenance) for name in names)
        first, *others = (read_specimen(path) for path in paths)
        return first.with_pieces(others)

    @cached_property
    def tree(self) -> xr.DataTree:
        """posterior.nc in memory."""
        path = trusted_path(self.path, "posterior.nc", self.provenance)
        noise = () if self.settings.has_misfit else (NOISE_SD.name,)
        return read_archive(path, [*self.law.names, *noise])

    @property
    def arviz(self) -> Any:
        """posterior.nc as ArviZ reads it: ``InferenceData``, or a ``DataTree`` with ArviZ 1."""
        import arviz

        _ = self.tree  # the file passes its checks
        with kept_warning_filters():
            opened = arviz.from_netcdf(self.path / "posterior.nc")
            read = opened.load()
        # closed, as others may want to replace the file
        names = opened.groups() if callable(opened.groups) else opened.groups  # ArviZ 0.2x or 1
        for name in names:
            opened[name].close()
        return read

    def with_draws(self, draws: pd.DataFrame) -> Run:
        """The same run with its :attr:`draws` at hand, which are not read then."""
        run = Run(self.path, self.provenance)
        vars(run)["draws"] = draws
        return run

    @cached_property
    def draws(self) -> pd.DataFrame:
        """One row per draw: natural quantities, ``log_likelihood`` and ``lp``."""
        quantities, stats = self.tree["posterior"].data_vars, self.tree["sample_stats"]
        columns = {quantity_name(k): v.to_numpy().ravel() for k, v in quantities.items()}
        columns["log_likelihood"] = stats["log_likelihood"].to_numpy().ravel()
        columns["lp"] = stats["lp"].to_numpy().ravel()
        return pd.DataFrame(columns)

    @cached_property
    def chains(self) -> dict[str, np.ndarray]:
        """Quantities as arrays of shape (ensembles, steps, walkers)."""
        posterior = self.tree["posterior"]
        shape = (posterior.sizes["chain"], int(posterior["walker"].max()) + 1, -1)
        return {
            quantity_name(name): variable.to_numpy().reshape(shape).transpose(0, 2, 1)
            for name, variable in posterior.data_vars.items()
        }

    @cached_property
    def result(self) -> RunResult:
        """The result, from ``results.json``."""
        from biaxbayes.runs.run_result import RESULTS, result_from_record

        path = trusted_path(self.path, RESULTS, self.provenance)
        return result_from_record(read_run_json(path), self.law, self.quantities, path)

    def analyse(self) -> tuple[RunResult, Identifiability]:
        """The result, and the verdicts with their densities, computed from the draws."""
        from biaxbayes.identifiability.identify import identify_run
        from biaxbayes.runs.run_result import run_result

        posterior = self.posterior()
        missing = [name for name in posterior.parameter_names if name not in self.draws]
        if missing:
            raise RunError(f"{self.path / 'posterior.nc'}: holds no draws of {missing[0]:.60}")
        # In the order in which the chains were summed when they were drawn.
        chains = {name: np.ascontiguousarray(v) for name, v in self.chains.items()}
        names = tuple(n for n in posterior.parameter_names if n in chains)
        convergence = replace(assess(chains, target_ess=0.0), state=self.state)
        summary = summarise(chains, names, self.quantities, convergence)
        verdicts = identify_run(posterior, self.draws, self.state)
        return run_result(
            verdicts, posterior, self.draws, summary, self.provenance["convergence"], self.findings
        ), verdicts

    @property
    def summary(self) -> pd.DataFrame:
        """Quantiles of every quantity, as in summary.csv: ``run.summary.loc["C1", "q50"]``."""
        table = self.result.summary
        return table.set_axis(table["parameter"].to_list(), axis="index")

    @property
    def findings(self) -> list[str]:
        """Findings of the specimen before it was sampled, one sentence each."""
        stored, out = self.provenance.get("findings"), []
        for finding in stored if isinstance(stored, list) else []:
            with contextlib.suppress(TypeError):  # the file of another program
                out.append(one_line(str(Finding(**finding)))[:MAX_FINDING_LENGTH])
        return out[:MAX_FINDINGS]

    @cached_property
    def fit(self) -> list[dict[str, Any]]:
        """The deterministic fit that the run started from."""
        return read_run_json(trusted_path(self.path, "fit.json", self.provenance))

    @property
    def state(self) -> str:
        """``converged``, ``tentative`` or ``unusable``."""
        return str(self.provenance["convergence"]["state"])

    @cached_property
    def settings(self) -> Settings:
        """The settings of the statistical model."""
        return Settings(**parse_options(self.provenance["settings"]))

    @property
    def law(self) -> Law:
        """The material law of the run."""
        return stored_law(self.provenance["settings"])

    @cached_property
    def quantities(self) -> Quantities:
        """Symbol, unit and range by name."""
        return self.specimen.quantities(self.law.parameters, shared=self.settings.shared)

    def posterior(self) -> Posterior:
        """The posterior that was sampled, rebuilt from the stored settings."""
        specimen = self.specimen
        try:
            (record,) = self.fit
            fit = fit_from_record(record, self.law, len(self.quantities.states))
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            problem = f"is not the fit of this run ({error})"
            raise RunError(f"{self.path / 'fit.json'}: {problem}") from None
        # the terms of the smooth misfit that the run summed, by piece
        stored = self.provenance["misfit"]["terms"]
        pieces = specimen.pieces if self.settings.has_misfit else ()
        counts = [len(Terms.every(len(p.protocols), self.settings.toe).toe) for p in pieces]
        if len(stored) != len(counts) or not all(
            isinstance(own, list) and own and all(type(i) is int and 0 <= i < n for i in own)
            for own, n in zip(stored, counts, strict=True)
        ):
            raise RunError(f"{self.path / PROVENANCE}: is not the record of a run (misfit: terms)")
        return Posterior(
            specimen,
            **parse_options(self.provenance["settings"]),
            misfit_fit=fit,
            terms=[np.array(own) for own in stored] or None,
        )

    def _repr_html_(self) -> str:
        """State and reported table for notebooks."""
        head = f"<p>{escape(str(self.provenance['specimen']))}: {escape(self.state)}</p>"
        return head + self.result._repr_html_()


def open_run(path: str | Path) -> Run:
    """Open a run folder.

    Raises
    ------
    RunError
        If the folder is not a finished run.
    """
    path = as_path(path, "run")
    open_folder(path, PROVENANCE)
    return Run(path, read_record(path))
