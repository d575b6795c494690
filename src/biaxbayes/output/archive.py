"""posterior.nc: the draws as an xarray DataTree that ArviZ reads.

Chains are ensembles; within a chain the draws run walker after walker, each walker's steps in
order, so that the autocorrelation that ArviZ sees is that of a walker.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from biaxbayes.errors import RunError
from biaxbayes.findings.curves import Curves
from biaxbayes.inference.posterior import Posterior
from biaxbayes.inference.sampler import Draws
from biaxbayes.specimens.text_file import atomic_write_bytes

__all__ = ["FORMAT", "flatten", "read_archive", "units", "write_archive"]

FORMAT = 1
POINTWISE_DRAWS = 500
"""Draws of each chain that carry pointwise likelihoods and predictions."""


def units(unit: str) -> dict[str, str]:
    """Unit of each natural quantity, by the stem of its name; ``unit`` is the file's own."""
    return {
        "C1": "kPa",
        "k1": "kPa",
        "k2": "1",
        "alpha": "deg",
        "kappa": "1",
        "mounting_stretch_x": "1",
        "mounting_stretch_y": "1",
        "mounting_force_x": unit,
        "mounting_force_y": unit,
        "noise_sd": unit,
        "noise_growth": "1",
        "edge_x": "1",
        "edge_y": "1",
        "thickness": "1",
        "load_offset_x": unit,
        "load_offset_y": unit,
    }


def unit_of(name: str, unit: str) -> str:
    """Unit of one quantity, its protocol label disregarded."""
    return units(unit).get(name.split("[", 1)[0], "1")


def flatten(values: np.ndarray) -> np.ndarray:
    """(ensembles, steps, walkers) to (chain, draw), walker after walker."""
    return values.transpose(0, 2, 1).reshape(values.shape[0], -1)


def write_archive(
    path: Path, posterior: Posterior, draws: Draws, attributes: dict[str, Any], seed: int
) -> None:
    """Write posterior.nc whole.

    Groups: posterior, sample_stats, log_likelihood (untempered, pointwise), posterior_predictive,
    observed_data, constant_data.
    """
    tree = build_tree(posterior, draws, attributes, seed)
    # DataTree writes to a path; the bytes are then put in place atomically.
    temporary = path.with_name(f".{path.name}.building")
    try:
        tree.to_netcdf(temporary, engine="h5netcdf")
        data = temporary.read_bytes()
    except OSError as error:
        raise RunError(f"{path}: cannot be written ({error.strerror or error})") from None
    finally:
        temporary.unlink(missing_ok=True)
    atomic_write_bytes(path, data)


def build_tree(
    posterior: Posterior, draws: Draws, attributes: dict[str, Any], seed: int
) -> xr.DataTree:
    """The DataTree of a run."""
    specimen = posterior.specimen
    ensembles, steps, walkers, _ = draws.chain.shape
    coords = {
        "chain": np.arange(ensembles),
        "draw": np.arange(steps * walkers),
        "walker": ("draw", np.repeat(np.arange(walkers), steps)),
        "step": ("draw", np.tile(np.arange(steps) * draws.thin, walkers)),
    }
    flat = {name: flatten(v) for name, v in draws.quantities.items()}
    variables = {
        name: (("chain", "draw"), flat[name], {"units": unit_of(name, specimen.unit)})
        for name in posterior.parameter_names
    }
    stats = {
        "lp": (("chain", "draw"), flat["lp"]),
        "tempered_log_likelihood": (("chain", "draw"), flat["log_likelihood"]),
    }
    pick = _spread_indices(steps * walkers, POINTWISE_DRAWS)
    curves = Curves.of(posterior)
    natural = {name: flat[name][:, pick].ravel() for name in posterior.parameter_names}
    model, sd = curves.model(natural), curves.noise(natural)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(99,)))
    predicted = curves.with_noise(model, sd, rng)
    few = (len(pick),)
    point_coords = {
        "chain": np.arange(ensembles),
        "draw": pick,
        "row": np.arange(curves.rows),
        "direction": ["x", "y"],
    }
    dims = ("chain", "draw", "row", "direction")
    shape = (ensembles, *few, curves.rows, 2)
    logs = curves.log_likelihood(model, sd).reshape(shape).astype(np.float32)
    unit = {"units": specimen.unit}
    groups = {
        "/posterior": xr.Dataset(variables, coords),
        "/sample_stats": xr.Dataset(stats, coords),
        "/log_likelihood": xr.Dataset({"load": (dims, logs)}, point_coords),
        "/posterior_predictive": xr.Dataset(
            {
                "load": (dims, predicted.reshape(shape).astype(np.float32), unit),
                "model_load": (dims, model.reshape(shape).astype(np.float32), unit),
            },
            point_coords,
        ),
        "/observed_data": xr.Dataset(
            {"load": (("row", "direction"), curves.measured, unit)},
            {"row": np.arange(curves.rows), "direction": ["x", "y"]},
        ),
        "/constant_data": xr.Dataset(
            {
                "stretch": (("row", "direction"), curves.stretch, {"units": "1"}),
                "protocol": (("row",), curves.protocol),
                "mounting_reading": (("mount", "direction"), curves.mounting_reading, unit),
                "mounting_reading_sd": (("mount", "direction"), curves.mounting_reading_sd, unit),
            },
            {"row": np.arange(curves.rows), "direction": ["x", "y"]},
        ),
    }
    for dataset in groups.values():
        dataset.attrs.update(attributes)
    tree = xr.DataTree.from_dict(groups)
    tree.attrs.update(attributes)
    return tree


def read_archive(path: Path) -> xr.DataTree:
    """Read posterior.nc into memory.

    Raises
    ------
    RunError
        If it is missing or damaged.
    """
    if not path.is_file():
        raise RunError(f"{path}: no such file; is this a run folder?")
    try:
        with xr.open_datatree(path, engine="h5netcdf") as tree:
            loaded = tree.load()
            for group in ("posterior", "sample_stats"):
                _ = loaded[group]
            return loaded
    except (OSError, ValueError, KeyError, RuntimeError, TypeError, AttributeError) as error:
        raise RunError(f"{path}: cannot be read as a posterior ({type(error).__name__})") from None


def _spread_indices(count: int, most: int) -> np.ndarray:
    """At most so many indices, spread evenly."""
    if count <= most:
        return np.arange(count)
    return np.linspace(0, count - 1, most).round().astype(int)
