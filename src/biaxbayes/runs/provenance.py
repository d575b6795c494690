"""provenance.json: what a run is a run of, and how it was made; written, and read again."""

from __future__ import annotations

import contextlib
import hashlib
import platform
from collections.abc import Mapping
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import biaxbayes
from biaxbayes.errors import BiaxbayesError, RunError
from biaxbayes.evenly import evenly_chosen
from biaxbayes.laws import DEFAULT_LAW, law_named
from biaxbayes.model.priors import parse_priors, prior_value
from biaxbayes.options import Settings
from biaxbayes.runs.folder import PROVENANCE, read_run_json
from biaxbayes.sampling.convergence import STATES

if TYPE_CHECKING:
    from biaxbayes.laws.law import Law
    from biaxbayes.model.posterior import Posterior
    from biaxbayes.sampling.sampler import Draws, Plan
    from biaxbayes.specimens.specimen import Specimen


FORMAT = 3
"""Of run folders; those of another one are refused."""


def specimen_digest(specimen: Specimen) -> str:
    """SHA-256 of everything the posterior depends on in a specimen."""
    s, digest = specimen, hashlib.sha256()
    sizes = (s.edge_x_mm, s.edge_y_mm, s.thickness_mm)
    header = (s.test, s.loads, s.geometry, *sizes, s.load_noise, sorted(s.metadata.items()))
    for value in header:
        digest.update(repr(value).encode())
    for p in s.protocols:
        digest.update(repr((p.name, p.rest_rows)).encode())
        for column in (p.stretch_x, p.stretch_y, p.load_x, p.load_y):
            digest.update(column.tobytes())
    for further in s.further:
        digest.update(specimen_digest(further).encode())
    return digest.hexdigest()


def settings_table(posterior: Posterior) -> dict[str, Any]:
    """The settings as JSON values; :func:`parse_options` reads them back."""
    options = posterior.options()
    options["priors"] = {k: prior_value(v) for k, v in options["priors"].items()}
    return options


def parse_options(table: dict[str, Any]) -> dict[str, Any]:
    """Keyword arguments of :class:`Posterior` from a stored settings table."""
    priors = table.get("priors", {})
    max_rows = table.get("max_rows")
    known = set(table) <= set(Settings.__dataclass_fields__)
    if not (known and isinstance(priors, dict) and isinstance(max_rows, int) and max_rows >= 0):
        raise RunError("the settings are not those of a run")
    return table | {"max_rows": max_rows, "priors": parse_priors(priors, law=stored_law(table))}


def stored_law(table: Mapping[str, Any]) -> Law:
    """The law of stored settings."""
    name, switch = table.get("law", DEFAULT_LAW), table.get("fibre_switch") is True
    return law_named(str(name), fibre_switch=switch)


def identity(posterior: Posterior, plan: Plan) -> dict[str, Any]:
    """Values that must be equal for a run to be continued."""
    return {
        "specimen": specimen_digest(posterior.specimen),
        **{f"option {k}": v for k, v in settings_table(posterior).items()},
        "seed": plan.seed,
        "ensembles": plan.ensembles,
        "walkers": plan.walkers,
        "version": biaxbayes.__version__,
    }


def provenance(posterior: Posterior, plan: Plan, draws: Draws, source: str) -> dict[str, Any]:
    """Record of a run: input, settings, sampler, convergence, versions."""
    from biaxbayes.model.marginal_likelihood import marginal_likelihood_record

    specimen, convergence = posterior.specimen, draws.convergence
    converged = bool(convergence.names)
    rows = int(sum(p.rows - p.rest_rows for p in specimen.protocols))
    versions = {"python": platform.python_version()}
    for library in ("numpy", "scipy", "numba", "emcee", "h5netcdf", "matplotlib"):
        with contextlib.suppress(PackageNotFoundError):
            versions[library] = version(library)
    return {
        "format": FORMAT,
        "biaxbayes": biaxbayes.__version__,
        "specimen": specimen.name,
        "layer": specimen.layer,
        "source": source,
        "specimen_sha256": specimen_digest(specimen),
        "pieces": [piece.name for piece in specimen.pieces],
        "unit": specimen.unit,
        "notes": list(specimen.notes),
        "settings": settings_table(posterior),
        "priors": {k: prior_value(v) for k, v in posterior.priors.items()},
        "noise": {
            "rows": rows,
            "readings": len(specimen.experiment.axes) * rows,
            "readings_compared": len(posterior.readings.weight) - posterior.readings.mounting_count,
            "load_noise": specimen.noise_sd,
        },
        "misfit": _misfit(posterior, draws),
        "seed": plan.seed,
        "sampler": {
            "ensembles": plan.ensembles,
            "walkers": draws.chain.shape[2],
            "steps": draws.chain.shape[1] * draws.thin,
            "thinning": draws.thin,
            "target_ess": plan.ess,
            "evaluations": draws.evaluations,
            "acceptance": draws.acceptance,
            "adaptation_rounds": draws.warmup.rounds,
            "message": draws.warmup.message,
        },
        "convergence": {
            "state": convergence.state,
            "reason": convergence.reason,
            "worst_ess": convergence.worst_ess if converged else None,
            "worst_rhat": convergence.worst_rhat if converged else None,
            "interrupted": draws.interrupted,
        },
        "marginal_likelihood": marginal_likelihood_record(posterior, draws, plan.seed),
        "seconds": {k: round(v, 3) for k, v in draws.seconds.items()},
        "versions": versions,
    }


MISFIT_FOUND = ("amplitude", "toe", "friction")


def _misfit(posterior: Posterior, draws: Draws) -> dict[str, Any]:
    """The terms of the smooth misfit that were summed, and its posterior in the first piece."""
    out: dict[str, Any] = {"terms": [], "of": [], "left_out": 0.0} | dict.fromkeys(MISFIT_FOUND)
    if not posterior.settings.has_misfit:
        return out
    flat = {name: v.ravel() for name, v in draws.quantities.items()}
    rows = evenly_chosen(len(flat["lp"]), 400)
    chosen = {name: v[rows] for name, v in flat.items()}
    for i, misfit in enumerate(posterior.misfits):
        every, residual = replace(misfit, chosen=None), posterior.residuals(chosen, i)
        share = every.shares(residual)
        summed = np.arange(share.shape[1]) if misfit.chosen is None else misfit.chosen
        out["terms"].append(summed.tolist())
        out["of"].append(share.shape[1])
        left_out = float((1.0 - share[:, summed].sum(axis=1)).max())
        out["left_out"] = max(out["left_out"], left_out)
        if i == 0:
            mean = share.mean(axis=0)
            out["amplitude"] = float(mean @ every.terms.amplitude)
            out["toe"] = float(mean @ every.terms.toe)
            out["friction"] = float(mean @ (every.terms.friction > 0.0))  # its probability
    return out


# --- the record of a run folder, read as untrusted input ------------------------------------------


NUMBER = (int, float)
OPTIONAL_NUMBER = (*NUMBER, type(None))
REQUIRED_ENTRIES: dict[str, Any] = {
    "biaxbayes": str,
    "versions": dict,
    "priors": dict,
    "specimen": str,
    "unit": str,
    "notes": list,
    "pieces": list,
    "settings": dict,
    "seed": int,
    "noise": {"readings": NUMBER, "load_noise": NUMBER},
    "misfit": {"terms": list, "of": list, "left_out": NUMBER}
    | dict.fromkeys(MISFIT_FOUND, OPTIONAL_NUMBER),
    "sampler": {"message": str, "acceptance": NUMBER}
    | dict.fromkeys(("ensembles", "walkers", "steps"), int),
    "convergence": {"state": str, "reason": str}
    | dict.fromkeys(("worst_ess", "worst_rhat"), OPTIONAL_NUMBER),
}
"""Entries that the readers of a run rely on."""
OPTIONAL_ENTRIES = {
    "files": dict,
    "grips": {
        "in_words": str,
        "mesh_difference": NUMBER,
        "largest_sd_of_log_ratio": OPTIONAL_NUMBER,
    },
}
"""Entries that may be missing."""


def read_record(folder: Path) -> dict[str, Any]:
    """Read and check the provenance of a run folder."""
    record = read_run_json(folder / PROVENANCE)
    if isinstance(record, dict) and "biaxbayes" in record and record.get("format") != FORMAT:
        raise RunError(f"{folder}: made by an earlier version: sample again")
    wrong = _schema_error(record, REQUIRED_ENTRIES)
    wrong = wrong or _schema_error(
        record, {k: v for k, v in OPTIONAL_ENTRIES.items() if k in record}
    )
    if not wrong:
        state = record["convergence"]["state"]
        # A converged run has both numbers, any other run both or neither.
        has_ess, has_rhat = (
            record["convergence"][k] is not None for k in ("worst_ess", "worst_rhat")
        )
        if state not in STATES:
            wrong = "convergence: state"
        elif has_ess != has_rhat or (state == "converged" and not has_ess):
            wrong = "convergence: worst_ess, worst_rhat"
    problem = f"{folder / PROVENANCE}: is not the record of a run"
    if wrong:
        raise RunError(f"{problem} (entry {wrong!r})")
    try:
        Settings(**parse_options(record["settings"]))
    except (BiaxbayesError, TypeError) as error:
        raise RunError(f"{problem} (settings: {error})") from None
    return record


def _schema_error(record: object, needed: dict[str, Any]) -> str:
    """The first entry that is missing or of another type; empty when there is none."""
    if not isinstance(record, dict):
        return "the whole"
    for key, kind in needed.items():
        if key not in record:
            return key
        if isinstance(kind, dict):
            if inner := _schema_error(record[key], kind):
                return f"{key}: {inner}"
        elif not isinstance(record[key], kind) or isinstance(record[key], bool):
            return key
    return ""
