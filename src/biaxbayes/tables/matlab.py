"""MATLAB files: version 5 to 7.2 through scipy, 7.3 through h5py.

Vectors of equal length are the columns of one sheet; a matrix is a sheet with columns NAME_1,
NAME_2 ...; a struct of vectors is a sheet of the struct's name with its fields as columns.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.tables.sheets import MAX_CELLS, MAX_UNPACKED, Sheet, sheet_from, too_large

COMPRESSED = 15
"""Type of an element of version 5 that is packed by zlib."""


def sheets(raw: bytes, path: Path) -> dict[str, Sheet]:
    """Numeric variables of a MATLAB file as sheets."""
    if raw.startswith(b"MATLAB 7.3"):
        variables = _hdf5_variables(raw, path)
    else:
        variables = _version5_variables(raw, path)
    by_name = {}
    for name, columns in _tables(variables).items():
        numbers = np.column_stack([column.astype(float) for column in columns.values()])
        by_name[name] = sheet_from([list(columns), *numbers.tolist()], f"variables of {name}")
    if not by_name:
        remedy = "a MATLAB table or timetable: save it with writetable(T, 'name.csv')"
        raise InputError("holds no numeric vectors or matrices", file=path, remedy=remedy)
    return by_name


def _version5_variables(raw: bytes, path: Path) -> dict[str, Any]:
    import scipy.io

    order = "<" if raw[126:128] == b"IM" else ">"
    at, unpacked = 128, 0
    while at + 8 <= len(raw):
        kind, size = struct.unpack(f"{order}II", raw[at : at + 8])
        if kind == COMPRESSED:
            packed = zlib.decompressobj()
            rest = raw[at + 8 : at + 8 + size]
            while rest and unpacked <= MAX_UNPACKED:
                unpacked += len(packed.decompress(rest, 1_000_000))
                rest = packed.unconsumed_tail
        if unpacked > MAX_UNPACKED:
            raise too_large(f"unpacks to more than {MAX_UNPACKED // 1_000_000} MB", path)
        at += 8 + size
    return scipy.io.loadmat(io.BytesIO(raw), squeeze_me=False)


def _hdf5_variables(raw: bytes, path: Path) -> dict[str, Any]:
    """Arrays of a file and its groups, transposed as in MATLAB; links out are not followed."""
    import h5py

    cells = 0

    def variables_of(group: Any, depth: int) -> dict[str, Any]:
        nonlocal cells
        variables: dict[str, Any] = {}
        for name in group:
            if name.startswith("#") or not isinstance(group.get(name, getlink=True), h5py.HardLink):
                continue
            item = group[name]
            if isinstance(item, h5py.Group) and depth == 0:
                variables[name] = variables_of(item, depth + 1)
            elif isinstance(item, h5py.Dataset) and item.dtype.kind in "fiu":
                if item.is_virtual or item.external or "MATLAB_empty" in item.attrs:
                    continue
                cells += item.size
                if cells > MAX_CELLS:
                    raise too_large(f"holds more than {MAX_CELLS:,} numbers", path)
                variables[name] = item[()].T
        return variables

    with h5py.File(io.BytesIO(raw), "r") as file:
        return variables_of(file, 0)


def _tables(variables: Mapping[str, Any]) -> dict[str, dict[str, np.ndarray]]:
    """Columns by the name of the sheet."""
    vectors: dict[int, dict[str, np.ndarray]] = {}
    tables: dict[str, dict[str, np.ndarray]] = {}
    for name, value in variables.items():
        if name.startswith("__"):
            continue
        if isinstance(value, np.ndarray) and value.dtype.names and value.size == 1:
            value = {field: value[field].item() for field in value.dtype.names}
        if isinstance(value, Mapping):
            fields = {key: _vector(item) for key, item in value.items()}
            columns = {key: vector for key, vector in fields.items() if vector is not None}
            longest = max((vector.size for vector in columns.values()), default=0)
            tables[name] = {k: vector for k, vector in columns.items() if vector.size == longest}
            continue
        vector = _vector(value)
        if vector is not None:
            vectors.setdefault(vector.size, {})[name] = vector
        elif isinstance(value, np.ndarray) and value.ndim == 2 and value.dtype.kind in "fiu":
            tables[name] = {f"{name}_{i + 1}": column for i, column in enumerate(value.T)}
    for size, columns in vectors.items():
        tables["vectors" if len(vectors) == 1 else f"vectors of {size}"] = columns
    return {name: columns for name, columns in tables.items() if len(columns) > 1}


def _vector(value: Any) -> np.ndarray | None:
    """A vector of at least three numbers, from a row or a column; None for anything else."""
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiu" or value.size < 3:
        return None
    return value.ravel() if max(value.shape) == value.size else None
