"""Known values of a virtual specimen, read to be drawn beside what was inferred."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from biaxbayes.errors import InputError
from biaxbayes.specimens.text_file import read_text

__all__ = ["read_truth"]

MATERIAL = {"C1": "C1_kPa", "k1": "k1_kPa", "k2": "k2", "alpha": "alpha_deg", "kappa": "kappa"}
MOUNTING = tuple(f"mounting_{kind}_{axis}" for kind in ("stretch", "force") for axis in "xy")


def read_truth(path: Path | str, specimen: str) -> dict[str, float]:
    """Known values by the names of ``summary.csv``.

    Parameters
    ----------
    path : path-like
        JSON: what :func:`biaxbayes.specimens.virtual_specimen.write_truth` writes, an entry of it,
        or one flat object such as ``{"C1": 2.98, "kappa": 0.0}``.
    specimen : str
        Name of the specimen whose entry is wanted, where there are several.

    Returns
    -------
    dict of str to float

    Raises
    ------
    InputError
        If the file cannot be read or has no such entry.
    """
    path = Path(path)
    text = read_text(path)
    try:
        held = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"is not JSON ({error})", file=path) from None
    if not isinstance(held, dict) or not held:
        raise InputError("is no JSON object of known values", file=path, remedy=_REMEDY)
    if "material" not in held and all(isinstance(v, dict) for v in held.values()):
        if specimen not in held:
            raise InputError(f"has no entry for specimen {specimen!r}", file=path)
        held = held[specimen]
    if isinstance(held.get("material"), dict):
        material = held["material"]
        found = {name: material[key] for name, key in MATERIAL.items() if key in material}
        found |= {name: held[name] for name in MOUNTING if name in held}
    else:
        found = held
    return {str(name): _number(value, str(name), path) for name, value in found.items()}


_REMEDY = 'write values by the names of summary.csv, such as {"C1": 2.98, "kappa": 0.0}'


def _number(value: Any, name: str, path: Path) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{name[:60]} is not a finite number", file=path, remedy=_REMEDY)
    return float(value)
