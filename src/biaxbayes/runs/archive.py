"""posterior.nc: the draws as an xarray DataTree that ArviZ reads, looked at before it is opened.

Looking at an HDF5 file before its data are read.

HDF5 can point to other files, keep data in them, loop, and claim more numbers than it holds.
No run of this program does any of that.

posterior.nc: the draws as an xarray DataTree that ArviZ reads.

Chains are ensembles; within a chain the draws run walker after walker, each walker's steps in
order, so that the autocorrelation that ArviZ sees is that of a walker.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import xarray as xr

from biaxbayes.errors import RunError
from biaxbayes.model.curves import Curves
from biaxbayes.model.posterior import Posterior
from biaxbayes.sampling.sampler import Draws
from biaxbayes.text_files import atomic_write_bytes

__all__ = [
    "FORMAT",
    "SuspiciousArchive",
    "check_archive",
    "flatten",
    "read_archive",
    "write_archive",
]


# --- looking at an HDF5 file before its data are read --------------------------------------------


MOST_OBJECTS = 2_000
MOST_BYTES = 2_000_000_000
BYTES_A_BYTE = 50
"""Compression beyond this is not that of numbers that were measured or drawn."""


class SuspiciousArchive(Exception):
    """The file does what no archive of a run does."""


def check_archive(path: Path) -> None:
    """Walk through an HDF5 file without reading its data.

    Raises
    ------
    SuspiciousArchive
        If it leads outside itself, loops, or claims more data than it could hold.
    """
    most = min(MOST_BYTES, BYTES_A_BYTE * path.stat().st_size)
    seen: set[int] = set()
    claimed = 0
    with h5py.File(path, "r") as file:
        waiting: list[h5py.Group] = [file]
        while waiting:
            group = waiting.pop()
            for name in group:
                item = _inside(group, name)
                address = h5py.h5o.get_info(item.id).addr
                if address in seen:
                    raise SuspiciousArchive("its groups loop")
                seen.add(address)
                if isinstance(item, h5py.Group):
                    waiting.append(item)
                elif isinstance(item, h5py.Dataset):
                    claimed += _claimed_bytes(item)
                if claimed > most or len(seen) > MOST_OBJECTS:
                    raise SuspiciousArchive("it claims more data than it can hold")


def _inside(group: h5py.Group, name: str) -> h5py.HLObject:
    if not isinstance(group.get(name, getlink=True), h5py.HardLink):
        raise SuspiciousArchive("it links to other data")
    return group[name]


def _claimed_bytes(dataset: h5py.Dataset) -> int:
    if dataset.is_virtual or dataset.external:
        raise SuspiciousArchive("its data are in another file")
    return int(dataset.size or 0) * int(dataset.dtype.itemsize)


# --- posterior.nc: the draws as an xarray DataTree that ArviZ reads ------------------------------


FORMAT = 1
POINTWISE_DRAWS = 500
"""Draws of each chain that carry pointwise likelihoods and predictions."""


SLASH = "\N{DIVISION SLASH}"


def stored_name(name: str) -> str:
    """Name of a quantity in the archive, where a slash would be a path (protocol ``1/1``)."""
    return name.replace("/", SLASH)


def quantity_name(stored: object) -> str:
    """Name of a quantity from that in the archive."""
    return str(stored).replace(SLASH, "/")


def flatten(values: np.ndarray) -> np.ndarray:
    """(ensembles, steps, walkers) to (chain, draw), walker after walker."""
    return values.transpose(0, 2, 1).reshape(values.shape[0], -1)


def write_archive(
    path: Path, posterior: Posterior, draws: Draws, attributes: dict[str, Any], seed: int
) -> None:
    """Write posterior.nc whole.

    Groups: posterior, sample_stats, log_likelihood (pointwise, weighted as it was sampled, which
    is what ``arviz.loo`` must take), log_likelihood_unweighted, posterior_predictive,
    observed_data, constant_data.
    """
    tree = build_tree(posterior, draws, attributes, seed)
    # In memory: on a full disk the HDF5 library can crash the process while it closes a file.
    whole = io.BytesIO()
    tree.to_netcdf(whole, engine="h5netcdf")
    try:
        atomic_write_bytes(path, whole.getvalue())
    except OSError as error:
        raise RunError(f"{path}: cannot be written ({error.strerror or error})") from None


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
        stored_name(name): (
            ("chain", "draw"),
            flat[name],
            {"units": posterior.quantities[name].unit},
        )
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
    exact = curves.log_likelihood(model, sd).reshape(shape)
    logs = exact.astype(np.float32)
    unit = {"units": specimen.unit}
    groups = {
        "/posterior": xr.Dataset(variables, coords),
        "/sample_stats": xr.Dataset(stats, coords),
        "/log_likelihood": xr.Dataset(
            {"load": (dims, (posterior.beta * exact).astype(np.float32))}, point_coords
        ),
        "/log_likelihood_unweighted": xr.Dataset({"load": (dims, logs)}, point_coords),
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
    weight = f"n_eff / n = {posterior.beta:.6g}"
    groups["/log_likelihood"].attrs["weighting"] = (
        f"weighted: pointwise log likelihood times {weight}, as the posterior was sampled"
    )
    groups["/log_likelihood_unweighted"].attrs["weighting"] = (
        f"unweighted: pointwise log likelihood of independent readings, without the {weight} that "
        "the posterior was sampled with; not for arviz.loo"
    )
    tree = xr.DataTree.from_dict(groups)
    tree.attrs.update(attributes)
    return tree


def read_archive(path: Path, parameters: Sequence[str]) -> xr.DataTree:
    """Read posterior.nc into memory.

    Parameters
    ----------
    path : Path
    parameters : sequence of str
        What it must hold: the parameters of the run's law.

    Raises
    ------
    RunError
        If it is missing or damaged.
    """
    if not path.is_file():
        raise RunError(f"{path}: no such file; is this a run folder?")
    try:
        check_archive(path)
        with xr.open_datatree(path, engine="h5netcdf") as tree:
            loaded = tree.load()
        problem = _misfit(loaded, parameters)
    except SuspiciousArchive as error:
        raise RunError(f"{path}: is not the posterior of a run ({error})") from None
    except Exception as error:  # three libraries may raise whatever they like on foreign bytes
        raise RunError(
            f"{path}: cannot be read as a posterior ({type(error).__name__}); it is damaged or of "
            "another program"
        ) from None
    if problem:
        raise RunError(f"{path}: is not the posterior of a run ({problem})")
    return loaded


def _misfit(tree: xr.DataTree, parameters: Sequence[str]) -> str:
    """What an archive lacks that every run has; empty when it is one."""
    posterior, stats = tree["posterior"].to_dataset(), tree["sample_stats"].to_dataset()
    dims = ("chain", "draw")
    for dataset, needed in (
        (posterior, parameters),
        (stats, ("lp", "tempered_log_likelihood")),
    ):
        for name in needed:
            if name not in dataset:
                return f"no {name}"
        for key, values in dataset.data_vars.items():
            if values.dims != dims or values.dtype.kind != "f":
                return f"{str(key)[:40]} is not numbers by chain and draw"
            if not np.isfinite(values.to_numpy()).all():
                return f"{str(key)[:40]} has values that are not finite"
    walker = posterior.coords.get("walker")
    draws = posterior.sizes["draw"]
    if walker is None or walker.dims != ("draw",) or walker.dtype.kind not in "iu" or not draws:
        return "no walkers"
    # Walker after walker, all of the same length.
    walkers = int(walker.to_numpy().max()) + 1
    if draws % walkers or (walker.to_numpy() != np.arange(draws) // (draws // walkers)).any():
        return "its walkers are out of order"
    return "" if stats.sizes == posterior.sizes else "its groups differ in size"


def _spread_indices(count: int, most: int) -> np.ndarray:
    """At most so many indices, spread evenly."""
    if count <= most:
        return np.arange(count)
    return np.linspace(0, count - 1, most).round().astype(int)
