"""posterior.nc: the draws as an xarray DataTree that ArviZ reads, looked at before it is opened.

HDF5 can point to other files, keep data in them, loop, and claim more numbers than it holds.
No run of this program does any of that.

Chains are ensembles; within a chain the draws run walker after walker, each walker's steps in
order, so that the autocorrelation that ArviZ sees is that of a walker. The file is written and its
draws are read by h5netcdf itself: xarray, which takes longer to import than to do either, is there
for whoever asks for the whole tree.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import h5netcdf
import h5py
import numpy as np
import pandas as pd
from numpy.random import Generator

from biaxbayes.errors import RunError
from biaxbayes.model.curves import Curves
from biaxbayes.model.posterior import Posterior
from biaxbayes.sampling.sampler import Draws
from biaxbayes.text_files import atomic_write_bytes

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "FORMAT",
    "StoredDraws",
    "SuspiciousArchive",
    "check_archive",
    "draw_table",
    "flatten",
    "read_archive",
    "read_draws",
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


def draw_table(quantities: Mapping[str, np.ndarray]) -> pd.DataFrame:
    """One row a draw, in the order of :func:`flatten`, of arrays (ensembles, steps, walkers)."""
    return pd.DataFrame({name: flatten(values).ravel() for name, values in quantities.items()})


def write_archive(
    path: Path, posterior: Posterior, draws: Draws, attributes: dict[str, Any], seed: int
) -> None:
    """Write posterior.nc whole.

    Groups: posterior, sample_stats, log_likelihood (pointwise, weighted as it was sampled, which
    is what ``arviz.loo`` must take), log_likelihood_unweighted, posterior_predictive,
    observed_data, constant_data.
    """
    # In memory: on a full disk the HDF5 library can crash the process while it closes a file.
    whole = io.BytesIO()
    with h5netcdf.File(whole, "w") as file:
        file.attrs.update(attributes)
        for name, group in _groups(posterior, draws, seed).items():
            _write_group(file.create_group(name), group, attributes | _weighting(name, posterior))
    try:
        atomic_write_bytes(path, whole.getbuffer())
    except OSError as error:
        raise RunError(f"{path}: cannot be written ({error.strerror or error})") from None


def _weighting(group: str, posterior: Posterior) -> dict[str, str]:
    """What the two groups of log likelihoods say of themselves."""
    weight = f"n_eff / n = {posterior.beta:.6g}"
    told = {
        "log_likelihood": (
            f"weighted: pointwise log likelihood times {weight}, as the posterior was sampled"
        ),
        "log_likelihood_unweighted": (
            f"unweighted: pointwise log likelihood of independent readings, without the {weight} "
            "that the posterior was sampled with; not for arviz.loo"
        ),
    }
    return {"weighting": told[group]} if group in told else {}


class _Stored(NamedTuple):
    """A variable of the archive."""

    dims: tuple[str, ...]
    values: np.ndarray
    unit: str = ""


Group = dict[str, _Stored]
"""Variables by name; those named like a dimension are its coordinates."""
LABELS = ("step", "walker")
"""Coordinates of a draw beside its number."""


def _groups(posterior: Posterior, draws: Draws, seed: int) -> dict[str, Group]:
    """Everything that the archive of a run holds."""
    unit = posterior.specimen.unit
    ensembles, steps, walkers, _ = draws.chain.shape
    coords = {
        "chain": _Stored(("chain",), np.arange(ensembles)),
        "draw": _Stored(("draw",), np.arange(steps * walkers)),
        "walker": _Stored(("draw",), np.repeat(np.arange(walkers), steps)),
        "step": _Stored(("draw",), np.tile(np.arange(steps) * draws.thin, walkers)),
    }
    each = ("chain", "draw")
    flat = {name: flatten(v) for name, v in draws.quantities.items()}
    variables = {
        stored_name(name): _Stored(each, flat[name], posterior.quantities[name].unit)
        for name in posterior.parameter_names
    }
    stats = {
        "lp": _Stored(each, flat["lp"]),
        "tempered_log_likelihood": _Stored(each, flat["log_likelihood"]),
    }
    pick = _spread_indices(steps * walkers, POINTWISE_DRAWS)
    curves = Curves.of(posterior)
    natural = {name: flat[name][:, pick] for name in posterior.parameter_names}
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(99,)))
    of_rows = _of_rows(posterior, curves, natural, rng)
    rows = {
        "row": _Stored(("row",), np.arange(curves.rows)),
        "direction": _Stored(("direction",), np.array(["x", "y"], dtype=object)),
    }
    chosen = {"chain": coords["chain"], "draw": _Stored(("draw",), pick)} | rows
    plane = ("row", "direction")

    reading = ("mount", "direction")
    return {
        "posterior": variables | coords,
        "sample_stats": stats | coords,
        **{name: group | chosen for name, group in of_rows.items()},
        "observed_data": {"load": _Stored(plane, curves.measured, unit)} | rows,
        "constant_data": {
            "stretch": _Stored(plane, curves.stretch, "1"),
            "protocol": _Stored(("row",), np.asarray(curves.protocol)),
            "mounting_reading": _Stored(reading, curves.mounting_reading, unit),
            "mounting_reading_sd": _Stored(reading, curves.mounting_reading_sd, unit),
        }
        | rows,
    }


def _of_rows(
    posterior: Posterior, curves: Curves, natural: Mapping[str, np.ndarray], rng: Generator
) -> dict[str, Group]:
    """Groups with a number for each draw and reading, in single precision as they are stored."""
    chains, draws = next(iter(natural.values())).shape
    values = {name: of_draws.ravel() for name, of_draws in natural.items()}
    model, sd = curves.model(values), curves.noise(values)

    def stored(values: np.ndarray, unit: str = "") -> _Stored:
        of_draws = values.reshape(chains, draws, curves.rows, 2)
        return _Stored(("chain", "draw", "row", "direction"), of_draws.astype(np.float32), unit)

    unit = posterior.specimen.unit
    predicted = stored(curves.with_noise(model, sd, rng), unit)
    exact = curves.log_likelihood(model, sd)
    return {
        "log_likelihood": {"load": stored(posterior.beta * exact)},
        "log_likelihood_unweighted": {"load": stored(exact)},
        "posterior_predictive": {"load": predicted, "model_load": stored(model, unit)},
    }


def _write_group(group: Any, variables: Group, attributes: Mapping[str, Any]) -> None:
    """Write variables by the conventions of netCDF that xarray reads."""
    group.attrs.update(attributes)
    for stored in variables.values():
        for dim, size in zip(stored.dims, stored.values.shape, strict=True):
            if dim not in group.dimensions:
                group.dimensions[dim] = size
    labels = [name for name in LABELS if name in variables]
    for name, stored in variables.items():
        values = stored.values
        text, number = values.dtype == object, values.dtype.kind == "f"
        variable = group.create_variable(
            name,
            stored.dims,
            dtype=h5py.string_dtype() if text else values.dtype,
            data=values,
            fillvalue=values.dtype.type(np.nan) if number else None,
        )
        if stored.unit:
            variable.attrs["units"] = stored.unit
        if labels and "draw" in stored.dims and name not in (*LABELS, *stored.dims):
            variable.attrs["coordinates"] = " ".join(labels)


class StoredDraws(NamedTuple):
    """The draws of an archive.

    Attributes
    ----------
    quantities, stats : dict of ndarray, shape (chains, draws)
        By their names in the archive.
    walkers : int
        Of a chain, one after the other, all with as many draws.
    """

    quantities: dict[str, np.ndarray]
    stats: dict[str, np.ndarray]
    walkers: int


def read_draws(path: Path, parameters: Sequence[str]) -> StoredDraws:
    """Read the draws of posterior.nc.

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
        with h5netcdf.File(path, "r") as file:
            posterior, stats = (_stored(file[name]) for name in ("posterior", "sample_stats"))
        problem = _misfit(posterior, stats, parameters)
    except SuspiciousArchive as error:
        raise RunError(f"{path}: is not the posterior of a run ({error})") from None
    except Exception as error:  # two libraries may raise whatever they like on foreign bytes
        raise RunError(
            f"{path}: cannot be read as a posterior ({type(error).__name__}); it is damaged or of "
            "another program"
        ) from None
    if problem:
        raise RunError(f"{path}: is not the posterior of a run ({problem})")
    quantities, others = ({k: v.values for k, v in _data(g).items()} for g in (posterior, stats))
    return StoredDraws(quantities, others, int(posterior["walker"].values.max()) + 1)


def read_archive(path: Path, parameters: Sequence[str]) -> xr.DataTree:
    """Read all of posterior.nc into memory; arguments and errors as of :func:`read_draws`."""
    import xarray as xr

    read_draws(path, parameters)
    try:
        with xr.open_datatree(path, engine="h5netcdf") as tree:
            return tree.load()
    except Exception as error:
        raise RunError(f"{path}: cannot be read as a posterior ({type(error).__name__})") from None


def _stored(group: Any) -> Group:
    return {
        name: _Stored(tuple(variable.dimensions), np.asarray(variable[...]))
        for name, variable in group.variables.items()
    }


def _data(group: Group) -> Group:
    """Variables that are no coordinates."""
    return {k: v for k, v in group.items() if k not in ("chain", "draw", *LABELS)}


def _misfit(posterior: Group, stats: Group, parameters: Sequence[str]) -> str:
    """What an archive lacks that every run has; empty when it is one."""
    for group, needed in (
        (posterior, parameters),
        (stats, ("lp", "tempered_log_likelihood")),
    ):
        for name in needed:
            if name not in group:
                return f"no {name}"
        for key, stored in _data(group).items():
            if stored.dims != ("chain", "draw") or stored.values.dtype.kind != "f":
                return f"{key[:40]} is not numbers by chain and draw"
            if not np.isfinite(stored.values).all():
                return f"{key[:40]} has values that are not finite"
    chains, draws = posterior[parameters[0]].values.shape
    walker = posterior.get("walker")
    of_draws = walker is not None and walker.dims == ("draw",) and walker.values.dtype.kind in "iu"
    if walker is None or not of_draws or not draws:
        return "no walkers"
    # Walker after walker, all of the same length.
    walkers = int(walker.values.max()) + 1
    if draws % walkers or (walker.values != np.arange(draws) // (draws // walkers)).any():
        return "its walkers are out of order"
    shapes = {
        stored.values.shape for group in (posterior, stats) for stored in _data(group).values()
    }
    return "" if shapes == {(chains, draws)} else "its groups differ in size"


def _spread_indices(count: int, most: int) -> np.ndarray:
    """At most so many indices, spread evenly."""
    if count <= most:
        return np.arange(count)
    return np.linspace(0, count - 1, most).round().astype(int)
