"""MATLAB files, version 5 to 7.2 through scipy, 7.3 through h5py; and arrays of NumPy (.npz).

Arrays of one length are the columns of a sheet, those of a matrix as NAME_1, NAME_2 ... A struct is
a sheet of its own, and so is each element of a cell or of an array of structs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.tables.worksheet import Worksheet, sheet_from

LEAST_ROWS = 3
TOP = "variables"
"""Name of the sheet of arrays that are in no struct or cell."""


def sheets(path: Path) -> dict[str, Worksheet]:
    """Numeric variables of a file, those of each struct and length as a sheet."""
    with path.open("rb") as file:
        first = file.read(10)
    if first.startswith(b"PK"):
        with np.load(path, allow_pickle=False) as arrays:
            variables = dict(arrays)
    elif first == b"MATLAB 7.3":
        variables = _hdf5_variables(path)
    else:
        import scipy.io

        variables = scipy.io.loadmat(path, simplify_cells=True)
        variables = {k: v for k, v in variables.items() if not k.startswith("__")}
    groups: dict[tuple[str, int], dict[str, np.ndarray]] = {}
    for sheet, name, array in _arrays("", "", variables):
        columns = {name: array}
        if array.ndim == 2:
            columns = {f"{name}_{i}": column for i, column in enumerate(array.T, start=1)}
        groups.setdefault((sheet, len(array)), {}).update(columns)
    groups = {key: columns for key, columns in groups.items() if len(columns) > 1}
    if not groups:
        remedy = "a MATLAB table or timetable: save it with writetable(T, 'name.csv')"
        raise InputError("holds no numeric vectors or matrices", file=path, remedy=remedy)
    by_name = {}
    for (sheet, length), columns in groups.items():
        alone = sum(other == sheet for other, _ in groups) == 1
        name = (sheet or TOP) + ("" if alone else f" of {length} rows")
        numbers = np.column_stack([column.astype(float) for column in columns.values()])
        by_name[name] = sheet_from([list(columns), *numbers.tolist()], name)
    return by_name


def _arrays(sheet: str, name: str, value: Any) -> Iterator[tuple[str, str, np.ndarray]]:
    """Vectors and matrices with the struct or cell that holds them; the longer side is the rows."""
    path = f"{sheet}.{name}" if sheet and name else sheet or name
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _arrays(path, key, item)
    elif isinstance(value, list) or (isinstance(value, np.ndarray) and value.dtype == object):
        for number, item in enumerate(np.asarray(value, dtype=object).flat, start=1):
            of_item = "" if isinstance(item, Mapping) else name
            yield from _arrays(f"{path}({number})", of_item, item)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiu":
        array = np.squeeze(value)
        if array.ndim in (1, 2) and array.size and max(array.shape) >= LEAST_ROWS:
            yield sheet, name, array if array.shape[0] == max(array.shape) else array.T


def _hdf5_variables(path: Path) -> dict[str, Any]:
    """Arrays of a file and its groups, transposed as in MATLAB; links out are not followed."""
    import h5py

    def read(item: Any) -> Any:
        if isinstance(item, h5py.Group):
            return {
                name: read(item[name])
                for name in item
                if not name.startswith("#")
                and isinstance(item.get(name, getlink=True), h5py.HardLink)
            }
        if item.is_virtual or item.external or "MATLAB_empty" in item.attrs:
            return None
        if item.dtype == h5py.ref_dtype:
            return [read(item.file[reference]) for reference in item[()].T.flat]
        return item[()].T if item.dtype.kind in "fiu" and item.ndim else None

    with h5py.File(path, "r") as file:
        return read(file)
