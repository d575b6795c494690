"""The draws of a population, population.nc, and the new specimens in it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import biaxbayes
from biaxbayes.errors import InputError, RunError
from biaxbayes.populations.population_result import Population
from biaxbayes.runs.folder import POPULATION, open_folder, trusted_path
from biaxbayes.stored_data import netcdf_bytes, read_netcdf, read_object


def archive(result: Population) -> bytes:
    """population.nc: draws of means and spreads by chain and draw, and of the specimens."""
    import xarray as xr

    history, grouping, law = result.sampled.history, result.grouping, result.law
    names = [v.name for v in result.values]
    groups = list(grouping.groups)

    def flat(values: np.ndarray, *dims: str) -> tuple[tuple[str, ...], np.ndarray]:
        # (ensembles, sweeps, chains, ...) to (chain, draw, ...), chain after chain of an ensemble,
        # as in posterior.nc
        moved = np.moveaxis(values, 2, 1)
        return ("chain", "draw", *dims), moved.reshape(len(moved), -1, *moved.shape[3:])

    common = {
        "mean": flat(history.mu + result.centre, "group", "quantity"),
        "sd_donors": flat(history.sd[..., 0, :], "quantity"),
        "sd_specimens": flat(history.sd[..., 1:, :], "spread", "quantity"),
    }
    if history.partial.shape[-1]:
        common["partial_correlations_0"] = flat(history.partial, "of", "pair")
    own = {
        "values": flat(result.sampled.theta + result.centre, "specimen", "quantity"),
        "donor_effect": flat(history.effect, "donor", "quantity"),
    }
    coords = {
        "group": groups,
        "quantity": names,
        "spread": groups if history.sd.shape[3] > 2 else ["all"],
        "of": ["donors", "specimens"],
    }
    materials = np.array([table.to_numpy() for table in result.new_specimens().values()])
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
                "specimen": list(grouping.labels),
                "group_of": ("specimen", list(grouping.group)),
                "donor_of": ("specimen", list(grouping.donor)),
                "donor": list(grouping.donors),
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
    open_folder(folder, POPULATION)
    path = trusted_path(folder, "population.nc", read_object(folder / POPULATION))
    tree = read_netcdf(path)
    attributes = {str(k): v for k, v in tree.attrs.items()}
    try:
        materials = tree["new_specimens"]["material"]
        groups = [str(g) for g in materials["group"].to_numpy()]
        names = [str(n) for n in materials["parameter"].to_numpy()]
        values = materials.to_numpy()
    except KeyError as error:
        raise RunError(f"{path}: is not the posterior of a population (no {error})") from None
    if group not in groups:
        raise InputError(
            f"no group {group[:60]!r} in this population", remedy=f"groups are {', '.join(groups)}"
        )
    return pd.DataFrame(values[groups.index(group)], columns=names), attributes
