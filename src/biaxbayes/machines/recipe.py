"""The answers of a conversion as a file, which the next hundred exports are converted with."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from biaxbayes.errors import InputError
from biaxbayes.machines.choice import Choice
from biaxbayes.machines.outcome import Conversion
from biaxbayes.specimens.keys import KEYS
from biaxbayes.text_files import read_toml

OF_ONE_FILE = ("rows", "specimen")
"""Answers that hold for one file only."""
OF_A_LAB = (
    "geometry", "reference", "load_noise_N", "load_noise_kPa", "axial_force_noise_N",
    "stress_limit_kPa",
)  # fmt: skip
"""Header keys that hold for all specimens of a lab; edges and thickness do not."""
FOUND = "found"
"""Table of what the first export held."""


def recipe_text(result: Conversion) -> str:
    """The recipe of a conversion."""
    choice, header = result.choice, result.header
    lines = ["# Answers for 'biaxbayes convert FILE --recipe': one line an option"]
    for f in fields(choice):
        value = getattr(choice, f.name)
        if f.name not in OF_ONE_FILE and value != f.default:
            lines.append(f"{f.name} = {_toml(value)}")
    header_lines = [f"{key} = {_toml(header[key])}" for key in OF_A_LAB if key in header]
    if header_lines:
        lines += ["", "[header]", *header_lines]
    lines += ["", "# A file that holds others does not fit", f"[{FOUND}]"]
    lines += [f"{key} = {_toml(value)}" for key, value in _found(result).items()]
    return "\n".join(lines) + "\n"


def _toml(value: Any) -> str:
    return json.dumps(list(value) if isinstance(value, tuple) else value, ensure_ascii=False)


def _found(result: Conversion) -> dict[str, Any]:
    """What a file of the same kind holds, too."""
    columns = dict.fromkeys(name for r in result.recordings for name in r.record.columns if name)
    return {
        "columns": list(columns),
        "loads": result.specimen.loads,
        "protocols": len(result.recordings),
    }


def read_recipe(path: Path) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Options, header values, and what a file has to hold."""
    table = read_toml(path)
    header, found = table.pop("header", {}), table.pop(FOUND, {})
    known = {f.name for f in fields(Choice)} - set(OF_ONE_FILE)
    for name in table:
        if name not in known:
            remedy = f"options are {', '.join(sorted(known))}"
            raise InputError(f"no option {name[:60]!r}", file=path, remedy=remedy)
    if not isinstance(header, dict) or not isinstance(found, dict) or set(header) - set(KEYS):
        problem = f"[header] and [{FOUND}] must be tables, of header keys and of what was found"
        raise InputError(problem, file=path, remedy=f"keys are {', '.join(KEYS)}")
    options = {k: tuple(v) if isinstance(v, list) else v for k, v in table.items()}
    return options, header, found


def refuse_other_content(found: Mapping[str, Any], result: Conversion, recipe: Path) -> None:
    """Refuse a file that holds other columns or protocols than the recipe was made from."""
    here = _found(result)
    for key in here:
        if key in found and found[key] != here[key]:
            raise InputError(
                f"does not fit the recipe {recipe}: its {key} are {_toml(here[key])}, those of "
                f"the recipe {_toml(found[key])}",
                file=result.recordings[0].record.path,
                remedy="convert it without the recipe, and answer what is asked",
            )
