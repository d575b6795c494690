"""Files of data that this program wrote, or somebody else: JSON, netCDF and archives of arrays.

They are read with limits: nothing in them is executed or unpickled, leads to another file, or
takes more memory than the file has room for.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import zipfile
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args, get_origin, get_type_hints

import numpy as np

from biaxbayes.errors import InputError, RunError
from biaxbayes.tasks import kept_warning_filters
from biaxbayes.text_files import read_bytes

if TYPE_CHECKING:
    import h5py
    import xarray as xr


# --- JSON ----------------------------------------------------------------------------------------


MAX_JSON_BYTES = 50_000_000


def json_text(record: Any) -> str:
    """A record as JSON text."""
    return json.dumps(record, indent=2, ensure_ascii=False, allow_nan=True, default=str) + "\n"


def read_json(path: Path) -> Any:
    """Values of a JSON file; InputError if it cannot be read, is too large or not JSON."""
    try:
        return json.loads(read_bytes(path, limit=MAX_JSON_BYTES), parse_int=_whole)
    except (ValueError, RecursionError):
        raise InputError("is damaged (not JSON)", file=path) from None


def _whole(text: str) -> int:
    """An integer of 64 bits; printing a longer one can fail."""
    value = int(text)
    if abs(value) >= 2**63:
        raise ValueError("too large")
    return value


def read_object(path: Path) -> dict[str, Any]:
    """The object in a JSON file; empty where there is none."""
    try:
        record = read_json(path)
    except InputError:
        return {}
    return record if isinstance(record, dict) else {}


JSON_DIGITS = 12
"""Significant digits of numbers. Sums of the same draws differ in the last digit with where an
array lies in memory."""


def json_values(value: Any) -> Any:
    """JSON values of dataclasses, tables and numbers; NaN and infinity become null."""
    import pandas as pd

    if isinstance(value, pd.DataFrame):
        value = value.to_dict("records")
    elif is_dataclass(value) and not isinstance(value, type):
        value = vars(value)
    if isinstance(value, Mapping):
        return {str(k): json_values(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [json_values(v) for v in value]
    number = value.item() if isinstance(value, np.generic) else value
    if not isinstance(number, float):
        return number
    return float(f"{number:.{JSON_DIGITS}g}") if math.isfinite(number) else None


def from_json(kind: Any, value: Any) -> Any:
    """Inverse of :func:`json_values` for a type; KeyError, TypeError or ValueError for others."""
    import pandas as pd

    origin, of = get_origin(kind), get_args(kind)
    if isinstance(kind, type) and is_dataclass(kind):
        if isinstance(value, kind):
            return value
        types = get_type_hints(kind)
        return kind(**{f.name: from_json(types[f.name], value[f.name]) for f in fields(kind)})
    if kind is pd.DataFrame:
        table = pd.DataFrame(list(value))
        empty = [column for column in table if table[column].isna().all()]
        return table.astype(dict.fromkeys(empty, float))
    if origin is tuple:  # of any length
        return tuple(from_json(of[0], v) for v in from_json(list, value))
    if origin is dict:
        return {str(k): from_json(of[1], v) for k, v in from_json(dict, value).items()}
    if kind is float:
        return math.nan if value is None else float(value)
    if kind is not Any and not isinstance(value, kind):
        raise TypeError(f"{str(value)[:40]!r} is not {kind.__name__}")
    return value


# --- netCDF --------------------------------------------------------------------------------------


MAX_OBJECTS = 2_000
MAX_BYTES_CLAIMED = 2_000_000_000
MAX_COMPRESSION = 50
"""Measured or drawn numbers are not compressed further."""


def netcdf_bytes(groups: Mapping[str, xr.Dataset], attributes: Mapping[str, Any]) -> bytes:
    """Make a netCDF file in memory: on a full disk HDF5 can crash the process on closing."""
    import h5netcdf
    from xarray.backends import H5NetCDFStore  # takes half a second

    whole = io.BytesIO()
    with h5netcdf.File(whole, "w") as file:
        file.attrs.update(attributes)
        for name, group in groups.items():
            group.dump_to_store(H5NetCDFStore(file, group=name, mode="a"))
    return whole.getvalue()


def read_netcdf(path: Path) -> xr.DataTree:
    """A netCDF file in memory; RunError if it is missing, damaged or not a file of draws."""
    if not path.is_file():
        raise RunError(f"{path}: no such file; was the folder copied completely?")
    try:
        import xarray as xr

        problem = _hdf5_problem(path)
        if not problem:
            with kept_warning_filters(), xr.open_datatree(path, engine="h5netcdf") as opened:
                return opened.load()
    except Exception as error:  # two libraries may raise whatever they like on foreign bytes
        problem = f"{type(error).__name__}: it is damaged, or of another program"
    raise RunError(f"{path}: cannot be read as a posterior ({problem})")


def _hdf5_problem(path: Path) -> str:
    """Why an HDF5 file must not be read: it links outside, loops, or claims too much; or empty."""
    import h5py

    most = min(MAX_BYTES_CLAIMED, MAX_COMPRESSION * path.stat().st_size)
    seen: set[int] = set()
    claimed = 0
    with h5py.File(path, "r") as file:
        waiting: list[h5py.Group] = [file]
        while waiting:
            group = waiting.pop()
            for name in group:
                if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                    return "it links to other data"
                item = group[name]
                address = h5py.h5o.get_info(item.id).addr
                if address in seen:
                    return "its groups loop"
                seen.add(address)
                if isinstance(item, h5py.Group):
                    waiting.append(item)
                elif isinstance(item, h5py.Dataset):
                    if item.is_virtual or item.external:
                        return "its data are in another file"
                    claimed += int(item.size or 0) * int(item.dtype.itemsize)
                if claimed > most or len(seen) > MAX_OBJECTS:
                    return "it claims more data than it can hold"
    return ""


# --- archives of arrays --------------------------------------------------------------------------


MAX_ARCHIVE_BYTES = 1_000_000_000


class DamagedArchive(Exception):
    """The bytes of an archive are damaged."""


def pack_record(record: Any) -> bytes:
    """Nested dicts and lists of arrays and plain values as one archive, behind its checksum."""
    arrays: dict[str, np.ndarray] = {}

    def plain(value: Any, path: str) -> Any:
        if isinstance(value, np.ndarray):
            arrays[path] = value
            return {"array": path}
        if isinstance(value, Mapping):
            return {name: plain(v, f"{path}.{name}") for name, v in value.items()}
        if isinstance(value, list | tuple):
            return [plain(v, f"{path}.{k}") for k, v in enumerate(value)]
        return value

    text = json.dumps({name: plain(v, name) for name, v in record.items()}, default=int)
    buffer = io.BytesIO()
    np.savez(buffer, **arrays, text=np.frombuffer(text.encode(), dtype=np.uint8))  # type: ignore
    data = buffer.getvalue()
    return hashlib.sha256(data).digest() + data


def unpack_record(data: bytes) -> dict[str, Any]:
    """Inverse of :func:`pack_record`; no array is larger than the archive itself."""
    digest, body = data[:32], data[32:]
    if hashlib.sha256(body).digest() != digest:
        raise DamagedArchive("is damaged (its checksum is wrong)")
    try:
        with zipfile.ZipFile(io.BytesIO(body)) as entries:
            if any(e.compress_type != zipfile.ZIP_STORED for e in entries.infolist()):
                raise ValueError("compressed")
        with np.load(io.BytesIO(body), allow_pickle=False) as archive:
            arrays = {key: archive[key] for key in archive.files}
        if not all(isinstance(a, np.ndarray) and a.nbytes <= len(body) for a in arrays.values()):
            raise ValueError("not arrays")

        def array_or_dict(value: dict[str, Any]) -> Any:
            return arrays[value["array"]] if value.keys() == {"array"} else value

        record = json.loads(arrays["text"].tobytes().decode(), object_hook=array_or_dict)
        return dict(record)
    except Exception as error:  # three parsers of foreign bytes may raise whatever they like
        raise DamagedArchive(f"is damaged ({type(error).__name__})") from None


def read_record(path: Path) -> dict[str, Any]:
    """The record of an archive; DamagedArchive if there is none."""
    try:
        return unpack_record(read_bytes(path, limit=MAX_ARCHIVE_BYTES))
    except InputError as error:
        raise DamagedArchive(error.problem) from None
