"""The files of a population: those of its study, and its own."""

from __future__ import annotations

import json
import platform
from dataclasses import dataclass, field, replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import biaxbayes
from biaxbayes.errors import InputError, RunError
from biaxbayes.file_lock import folder_lock
from biaxbayes.parameters import MATERIAL
from biaxbayes.populations.result import Population
from biaxbayes.populations.tables import (
    bands_table,
    contradictions,
    contrasts_table,
    equibiaxial_records,
    groups_table,
    specimens_table,
)
from biaxbayes.reports.population import (
    BANDS,
    FIGURE_TEXTS,
    LATEX,
    PAGE,
    TABLES,
    population_latex,
    population_page,
)
from biaxbayes.runs.archive import SuspiciousArchive, check_archive, netcdf_bytes
from biaxbayes.runs.folder import (
    POPULATION,
    PROVENANCE,
    READY,
    RUNS,
    STUDY,
    finish_moving,
    manifest,
)
from biaxbayes.runs.result import json_values
from biaxbayes.tasks import kept_warning_filters
from biaxbayes.text_files import atomic_write_bytes, atomic_write_text, read_csv, write_csv

MAKE_POPULATION = "make one with 'biaxbayes population'"


# --- the specimens of a finished study -----------------------------------------------------------


@dataclass(frozen=True)
class StudyRun:
    """A specimen of a finished study."""

    label: str
    donor: str
    group: str
    folder: Path
    state: str
    reason: str = ""


def members_of_study(folder: Path) -> tuple[str, list[StudyRun]]:
    """Name and specimens of a finished study."""
    try:
        record = json.loads((folder / STUDY).read_text(encoding="utf-8"))
        table = read_csv(folder / "study.csv", dtype=str, keep_default_na=False)
        rows = table.drop_duplicates("specimen").to_dict("records")
        names = [str(r["specimen"]) for r in rows]
        columns = [str(c) for c in record.get("columns", [])]
        columns_of: dict[str, dict[str, str]] = record.get("values", {})
    except (OSError, ValueError, KeyError, AttributeError, RecursionError):
        raise InputError(
            "is not the folder of a finished study",
            file=folder,
            remedy="run 'biaxbayes batch' first, or give the study file",
        ) from None
    layers = any(str(r["layer"]) for r in rows)
    out = []
    for label, row in zip(names, rows, strict=True):
        own = {"layer": str(row["layer"]), "donor": str(row["donor"])} | columns_of.get(label, {})
        group = "all"
        if columns or layers:
            for column in columns or ["layer"]:
                if not own.get(column):
                    raise InputError(
                        f"{label} has no {column}, which defines its group",
                        file=folder,
                        remedy=f"give {column} in the study file, or name others in columns",
                    )
            group = ", ".join(own[column] for column in columns or ["layer"])
        run, state, reason = (str(row[key]) for key in ("folder", "state", "reason"))
        out.append(StudyRun(label, str(row["donor"]), group, folder / run, state, reason))
    return str(record.get("name", folder.name)), out


# --- what came out -------------------------------------------------------------------------------


@dataclass(frozen=True)
class PopulationResult:
    """Result of a population: state with reason, tables, and reasons by specimen left out."""

    name: str
    folder: Path
    state: str
    reason: str
    groups: pd.DataFrame = field(repr=False)
    specimens: pd.DataFrame = field(repr=False)
    contrasts: pd.DataFrame = field(repr=False)
    notes: list[str] = field(repr=False)
    left_out: dict[str, str] = field(repr=False)

    def __repr__(self) -> str:
        return f"PopulationResult({self.name!r}, {self.state}, {len(self.groups)} rows of groups)"

    def _repr_html_(self) -> str:
        """State and groups, for notebooks."""
        shown = self.groups[[c for c in self.groups if not str(c).startswith("new_")]]
        table = shown.to_html(index=False, float_format=lambda v: f"{v:.4g}", na_rep="–")
        return f"<p>{escape(self.name)}: {escape(self.state)}</p>{table}"


def population_state(folder: Path) -> str:
    """Convergence of a finished population."""
    if (folder / READY).is_dir():  # as in open_run
        with folder_lock(folder):
            finish_moving(folder, POPULATION)
    if not (folder / POPULATION).is_file():
        if not folder.exists():
            problem = f"does not exist; {MAKE_POPULATION}"
        elif (folder / PROVENANCE).exists():
            problem = "is a run's folder, not a population's; leave --population out"
        elif (folder / STUDY).is_file() and (folder / RUNS).is_dir():
            problem = f"is a study's folder, not a population's; {MAKE_POPULATION}"
        else:
            problem = f"is not the folder of a finished population; {MAKE_POPULATION}"
        raise RunError(f"{folder}: {problem}")
    try:
        record = json.loads((folder / POPULATION).read_text(encoding="utf-8"))
        return str(record["convergence"]["state"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise RunError(
            f"{folder}: its population cannot be read, a file is missing or damaged; copy the "
            f"folder again, or {MAKE_POPULATION}"
        ) from None


# --- files ---------------------------------------------------------------------------------------


def write_population(
    folder: Path, result: Population, identity: dict[str, Any]
) -> PopulationResult:
    """Write the files of a population, its record last."""
    specimens = specimens_table(result)
    result = replace(result, notes=[*result.notes, *contradictions(specimens)])
    tables = {
        "groups": groups_table(result),
        "specimens": specimens,
        "contrasts": contrasts_table(result),
    }
    for key, table in tables.items():
        write_csv(folder / TABLES[key][0], table, digits=8)
    atomic_write_bytes(folder / "population.nc", archive(result))
    if result.state != "unusable":
        draw_figures(folder, result, tables)
    convergence, labels = result.sampled.convergence, result.grouping.labels
    record = {
        "biaxbayes": biaxbayes.__version__,
        "python": platform.python_version(),
        "name": result.name,
        "convergence": {
            "state": convergence.state,
            "reason": convergence.reason,
            "worst_ess": convergence.worst_ess if convergence.names else None,
            "worst_rhat": convergence.worst_rhat if convergence.names else None,
            "kept_sweeps": convergence.steps,
        },
        "law": result.law.name,
        "pareto_k": dict(zip(labels, result.sampled.pareto_k.round(3).tolist(), strict=True)),
        "sampled_again": [labels[i] for i in result.sampled.sampled_again],
        "pooled": {
            v.name: {
                "scale": v.scale,
                "mean": v.mean_in_words(),
                "sd_donors": f"half-normal({v.donor_scale:.4g})",
                "sd_specimens": f"half-normal({v.specimen_scale:.4g})",
            }
            for v in result.values
        },
        "left_out": result.left_out,
        "notes": result.notes,
        "identity": identity,
    }
    atomic_write_text(folder / LATEX, population_latex(tables, record))
    atomic_write_text(folder / PAGE, population_page(folder, tables, record))
    record |= {name: json_values(table.to_dict("records")) for name, table in tables.items()}
    record["files"] = manifest(folder)
    atomic_write_text(folder / POPULATION, json.dumps(record, indent=2, ensure_ascii=False) + "\n")
    return PopulationResult(
        result.name,
        folder,
        result.state,
        result.reason,
        **tables,
        notes=result.notes,
        left_out=result.left_out,
    )


def draw_figures(folder: Path, result: Population, tables: dict[str, pd.DataFrame]) -> None:
    """Draw forest, pairs and stress bands."""
    from biaxbayes.figures.population import band_figure, forest_figure, pairs_figure
    from biaxbayes.figures.style import save_pictures

    specimen = result.sources[0].run.specimen
    parameters = [v.parameter for v in result.values]
    bands = bands_table(result)
    write_csv(folder / f"{BANDS}.csv", bands, digits=8)
    drawn = (
        forest_figure(tables["specimens"], tables["groups"], parameters),
        pairs_figure(
            result.new_specimens(),
            tables["specimens"],
            [p for p in parameters if p.kind == MATERIAL],
        ),
        band_figure(
            bands,
            equibiaxial_records(result),
            directions=(specimen.axis_x or "x", specimen.axis_y or "y"),
        ),
    )
    for stem, figure in zip(FIGURE_TEXTS, drawn, strict=True):
        save_pictures(figure, folder, stem)


def archive(result: Population) -> bytes:
    """population.nc: draws of means and spreads by chain and draw, and of the specimens."""
    import xarray as xr

    history = result.sampled.history
    names = [v.name for v in result.values]
    groups = list(result.grouping.groups)

    def flat(values: np.ndarray) -> np.ndarray:
        # (ensembles, sweeps, chains, ...) to (chain, draw, ...), chain after chain of an ensemble,
        # as in posterior.nc
        moved = np.moveaxis(values, 2, 1)
        return moved.reshape(moved.shape[0], moved.shape[1] * moved.shape[2], *moved.shape[3:])

    dims = ("chain", "draw")
    sets = groups if history.sd.shape[3] > 2 else ["all"]
    common = {
        "mean": ((*dims, "group", "quantity"), flat(history.mu) + result.centre),
        "sd_donors": ((*dims, "quantity"), flat(history.sd[..., 0, :])),
        "sd_specimens": ((*dims, "spread", "quantity"), flat(history.sd[..., 1:, :])),
    }
    if history.partial.shape[-1]:
        common["partial_correlations_0"] = ((*dims, "of", "pair"), flat(history.partial))
    coords = {"group": groups, "quantity": names, "spread": sets, "of": ["donors", "specimens"]}
    own = {
        "values": ((*dims, "specimen", "quantity"), flat(result.sampled.theta) + result.centre),
        "donor_effect": ((*dims, "donor", "quantity"), flat(history.effect)),
    }
    new = result.new_specimens()
    materials = np.array([table.to_numpy() for table in new.values()])
    law = result.law
    attributes = {
        "biaxbayes_version": biaxbayes.__version__,
        "law": law.key,
        "fibre_switch": int(law.fibre_switch),
        "largest_stretch": result.largest_stretch,
        "convergence": result.state,
        "scale": json.dumps({v.name: v.scale for v in result.values}),
    }
    datasets = {
        "posterior": xr.Dataset(common, coords),
        "specimens": xr.Dataset(
            own,
            {
                "specimen": list(result.grouping.labels),
                "group_of": ("specimen", list(result.grouping.group)),
                "donor_of": ("specimen", list(result.grouping.donor)),
                "donor": list(result.grouping.donors),
                "quantity": names,
            },
        ),
        "new_specimens": xr.Dataset(
            {"material": (("group", "draw", "parameter"), materials)},
            {"group": groups, "parameter": list(law.names)},
        ),
    }
    return netcdf_bytes(datasets, attributes)


def new_materials(folder: Path, group: str) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Materials of new specimens of a group, and the attributes of population.nc."""
    import xarray as xr

    path = folder / "population.nc"
    try:
        check_archive(path)
        with kept_warning_filters(), xr.open_datatree(path, engine="h5netcdf") as tree:
            materials = tree["new_specimens"]["material"].load()
            attributes = {str(k): v for k, v in tree.attrs.items()}
        groups = [str(g) for g in materials["group"].to_numpy()]
        names = [str(n) for n in materials["parameter"].to_numpy()]
        values = materials.to_numpy()
    except (OSError, KeyError, ValueError, SuspiciousArchive) as error:
        raise RunError(f"{path}: cannot be read as a population ({type(error).__name__})") from None
    if group not in groups:
        raise InputError(
            f"no group {group[:60]!r} in this population", remedy=f"groups are {', '.join(groups)}"
        )
    return pd.DataFrame(values[groups.index(group)], columns=names), attributes
