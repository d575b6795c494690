"""True values of virtual specimens: a file of their own, which no fit reads."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from biaxbayes.errors import InputError
from biaxbayes.laws import all_parameters
from biaxbayes.parameters import mounting_names
from biaxbayes.stored_data import read_json
from biaxbayes.text_files import atomic_write_text

MOUNTING_NAMES = (*mounting_names("stretch"), *mounting_names("force"))
REMEDY = 'write values by the names of summary.csv, such as {"C1": 2.98, "kappa": 0.0}'


@dataclass(frozen=True, kw_only=True)
class Truth:
    """True values behind a record, and how its readings were disturbed."""

    specimen: str
    material: dict[str, float | bool | str]
    mounting_stretch_x: float = 1.0
    mounting_stretch_y: float = 1.0
    unit: str  # of the record: N, or kPa over the section of its geometry
    mounting_force_x: float = 0.0  # of the material at the true mounting stretch
    mounting_force_y: float = 0.0
    # by protocol, on the cells before their noise: with the misfit of the first row, over all hooks
    disturbed_mounting_force: dict[str, tuple[float, float]] = field(default_factory=dict)
    unloaded_dimensions: dict[str, float]
    load_noise_N: float
    misfit: float
    misfit_length: float
    seed: int
    source: str
    grips: dict[str, float] | None = None  # None for a homogeneous specimen

    def __repr__(self) -> str:
        values = ", ".join(
            f"{k}={v:.4g}" if isinstance(v, float) else f"{k}={v}" for k, v in self.material.items()
        )
        stretch = f"{self.mounting_stretch_x:g}, {self.mounting_stretch_y:g}"
        return f"Truth({self.specimen!r}: {values}, mounting stretch {stretch})"


def write_truth(truths: Sequence[Truth], path: str | os.PathLike) -> None:
    """Write truths as JSON, one object per specimen under its name."""
    text = json.dumps({truth.specimen: asdict(truth) for truth in truths}, indent=2)
    atomic_write_text(Path(path), text + "\n")


def truth_file(out: Path) -> Path:
    """Path of the true values of a virtual specimen."""
    return out.with_name(f"{out.stem}.truth.json")


def read_truth(path: Path | str, specimen: str) -> dict[str, float]:
    """Known values by the names of ``summary.csv``, as ``simulate`` writes them or as a table."""
    path = Path(path)
    content = read_json(path)
    if not isinstance(content, dict) or not content:
        raise InputError("is not a JSON object of known values", file=path, remedy=REMEDY)
    if "material" not in content and all(isinstance(v, dict) for v in content.values()):
        if specimen not in content:
            raise InputError(f"has no entry for specimen {specimen!r}", file=path)
        content = content[specimen]
    if isinstance(content.get("material"), dict):
        material = content["material"]
        labels = {p.name: p.label for p in all_parameters()}
        known = {name: material[label] for name, label in labels.items() if label in material}
        known |= {name: content[name] for name in MOUNTING_NAMES if name in content}
    else:
        known = content
    for name, value in known.items():
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not number or not math.isfinite(value):
            raise InputError(f"{str(name)[:60]} is not a finite number", file=path, remedy=REMEDY)
    return {str(name): float(value) for name, value in known.items()}
