"""posterior.nc: the draws as an xarray DataTree that ArviZ reads.

Chains are ensembles; within a chain the draws run walker after walker, each walker's steps in
order, so that the autocorrelation that ArviZ sees is that of a walker.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from biaxbayes.errors import RunError
from biaxbayes.evenly import evenly_chosen
from biaxbayes.model.posterior import Posterior
from biaxbayes.normal_errors import simulate
from biaxbayes.parameters import name_of
from biaxbayes.prediction.tissue import Tissue
from biaxbayes.sampling.sampler import Draws
from biaxbayes.stored_data import netcdf_bytes, read_netcdf
from biaxbayes.text_files import atomic_write_bytes

if TYPE_CHECKING:
    import xarray as xr


SLASH = "\N{DIVISION SLASH}"
"""In place of a slash in names, where it would be a path (protocol ``1/1``)."""


def quantity_name(stored: object) -> str:
    """Name of a quantity from that in the archive."""
    return str(stored).replace(SLASH, "/")


def flatten(values: np.ndarray) -> np.ndarray:
    """(ensembles, steps, walkers) to (chain, draw), walker after walker."""
    return values.transpose(0, 2, 1).reshape(values.shape[0], -1)


def draw_table(quantities: Mapping[str, np.ndarray]) -> pd.DataFrame:
    """One row per draw, in the order of :func:`flatten`, of arrays (ensembles, steps, walkers)."""
    return pd.DataFrame({name: flatten(values).ravel() for name, values in quantities.items()})


def write_archive(
    path: Path, posterior: Posterior, draws: Draws, attributes: dict[str, Any], seed: int
) -> None:
    """Write posterior.nc.

    ``posterior_predictive`` has new readings of the tissue at the measured states, for 500 draws of
    each chain, and the loads of the law. There is no pointwise log likelihood, as a smooth misfit
    makes the readings dependent.
    """
    groups = _groups(posterior, draws, seed)
    for group in groups.values():
        group.attrs = attributes
    atomic_write_bytes(path, netcdf_bytes(groups, attributes))


def _groups(posterior: Posterior, draws: Draws, seed: int) -> dict[str, xr.Dataset]:
    """Groups of the archive by name."""
    import xarray as xr

    ensembles, steps, walkers, _ = draws.chain.shape
    count = steps * walkers
    coords = {
        "chain": np.arange(ensembles),
        "draw": np.arange(count),
        "walker": ("draw", np.repeat(np.arange(walkers), steps)),
        "step": ("draw", np.tile(np.arange(steps) * draws.thin, walkers)),
    }
    flat = {name: flatten(values) for name, values in draws.quantities.items()}
    by_draw = ("chain", "draw")
    parameters = {
        name.replace("/", SLASH): (by_draw, flat[name], {"units": posterior.quantities[name].unit})
        for name in posterior.parameter_names
    }
    stats = {name: (by_draw, flat[name]) for name in ("lp", "log_likelihood")}
    pick = evenly_chosen(count, 500)
    thinned = {name: flat[name][:, pick] for name in posterior.parameter_names}
    thinned_coords = {"chain": coords["chain"], "draw": pick}
    observed: dict[str, Any] = {}
    constant: dict[str, Any] = {}
    predictive: dict[str, Any] = {}
    rows: dict[str, Any] = {"direction": ["x", "y"]}
    for i, piece in enumerate(posterior.pieces):

        def of_piece(name: str, label: str = piece.labels.label) -> str:
            return name_of(name, label).replace("/", SLASH)

        unit = {"units": ", ".join(dict.fromkeys(piece.specimen.units))}
        row, mount = of_piece("row"), of_piece("mount")
        rows[row] = np.arange(len(piece.rows.load))
        observed[of_piece("load")] = ((row, "direction"), piece.rows.load, unit)
        readings = piece.specimen.mounting_readings(shared=posterior.settings.shared)
        constant |= {
            of_piece("stretch"): ((row, "direction"), piece.rows.stretch, {"units": "1"}),
            of_piece("protocol"): (row, np.asarray(piece.rows.protocol)),
            of_piece("mounting_reading"): ((mount, "direction"), readings[0], unit),
            of_piece("mounting_reading_sd"): ((mount, "direction"), readings[1], unit),
        }
        for name, values in _predictive(posterior, i, thinned, seed).items():
            predictive[of_piece(name)] = ((*by_draw, row, "direction"), values, unit)
    return {
        "posterior": xr.Dataset(parameters, coords),
        "sample_stats": xr.Dataset(stats, coords),
        "posterior_predictive": xr.Dataset(predictive, thinned_coords | rows),
        "observed_data": xr.Dataset(observed, rows),
        "constant_data": xr.Dataset(constant, rows),
    }


def _predictive(
    posterior: Posterior, piece: int, natural: Mapping[str, np.ndarray], seed: int
) -> dict[str, np.ndarray]:
    """New readings and loads of the law at the rows, for each draw, in single precision."""
    chains, draws = next(iter(natural.values())).shape
    table = pd.DataFrame({k: v.ravel() for k, v in natural.items()})
    tissue = Tissue(posterior, table, seed, piece)
    law, readings = [], []
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(99, piece)))
    for i, p in enumerate(posterior.pieces[piece].rows.pieces[0].protocols):
        loads = tissue.tested(i, p.stretch, np.arange(p.rest_rows, p.rows))
        law.append(loads.law)
        readings.append(simulate(loads.reading, loads.reading_sd, rng))

    def by_draw(parts: list[np.ndarray]) -> np.ndarray:
        return np.concatenate(parts, axis=1).reshape(chains, draws, -1, 2).astype(np.float32)

    return {"load": by_draw(readings), "model_load": by_draw(law)}


def read_archive(path: Path, parameters: Sequence[str]) -> xr.DataTree:
    """Read posterior.nc into memory; RunError if it is damaged or lacks one of the `parameters`."""
    tree = read_netcdf(path)
    try:
        problem = _schema_error(tree["posterior"], tree["sample_stats"], parameters)
    except KeyError as error:
        problem = f"no group {error}"
    if problem:
        raise RunError(f"{path}: is not the posterior of a run ({problem})")
    return tree


def _schema_error(posterior: Any, stats: Any, parameters: Sequence[str]) -> str:
    """Why these groups are not those of a run; empty if they are."""
    for group, needed in ((posterior, parameters), (stats, ("lp", "log_likelihood"))):
        for name in needed:
            if name not in group.data_vars:
                return f"no {name}"
        for name, variable in group.data_vars.items():
            if variable.dims != ("chain", "draw") or variable.dtype.kind != "f":
                return f"{str(name)[:40]} is not numbers by chain and draw"
            if not np.isfinite(variable).all():
                return f"{str(name)[:40]} has values that are not finite"
    walker, draws = posterior.coords.get("walker"), posterior.sizes["draw"]
    if walker is None or walker.dims != ("draw",) or walker.dtype.kind not in "iu" or not draws:
        return "no walkers"
    # Walker after walker, all of the same length.
    walkers = int(walker.max()) + 1
    if draws % walkers or (walker.to_numpy() != np.arange(draws) // (draws // walkers)).any():
        return "its walkers are out of order"
    sizes = [(group.sizes["chain"], group.sizes["draw"]) for group in (posterior, stats)]
    return "" if sizes[0] == sizes[1] else "its groups differ in size"
