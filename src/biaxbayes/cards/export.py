"""Posterior draws, and new specimens of a population, to a folder of material cards."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes import __version__
from biaxbayes.cards import abaqus, febio
from biaxbayes.cards.card import UNIT_SYSTEMS, Card, exportable, safe_label
from biaxbayes.cards.febio import MIXTURES
from biaxbayes.errors import InputError, NotConverged
from biaxbayes.laws import law_named
from biaxbayes.laws.law import Law
from biaxbayes.laws.materials import MaterialResponse
from biaxbayes.parameters import mounting_names
from biaxbayes.populations.archive import new_materials
from biaxbayes.prediction.draws import chosen_draws, common_states, mounting_labels, with_free_sides
from biaxbayes.prediction.nearest_law import TO_READINGS, TO_TISSUE
from biaxbayes.specimens.protocol import Protocol
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.text_files import atomic_write_all, csv_text, make_folder

PROGRAMS: dict[str, tuple[Callable[[Card, str], str], str]] = {
    "abaqus": (abaqus.write_abaqus, abaqus.SUFFIX),
    "febio": (febio.write_febio, febio.SUFFIX),
}
"""Writer and file ending of each program."""

MANIFEST = "manifest.csv"
DEFAULT_NEW_SPECIMENS = 20
"""Cards of a population where no number is given."""
MEAN_CURVE = "mean-curve"
BULK_RATIO = 1000.0  # FEBio's material is nearly incompressible, never exactly
CARD_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*-\d{4,}\.(inp|feb)")


def export_cards(
    draws: pd.DataFrame, specimen: Specimen, law: Law, rows: Sequence[int], out: Path, **how: Any
) -> pd.DataFrame:
    """Write the cards and the manifest of :func:`made_cards`."""
    manifest, files = made_cards(draws, specimen, law, rows, out, **how)
    write_cards(files)
    return manifest


def made_cards(
    draws: pd.DataFrame,
    specimen: Specimen,
    law: Law,
    rows: Sequence[int],
    out: Path,
    *,
    program: str,
    units: str = "kPa-mm",
    bulk_ratio: float | None = None,
    origin: str = "posterior draw",
    overwrite: bool = False,
) -> tuple[pd.DataFrame, dict[Path, bytes]]:
    """A card for each row of the draws, equally weighted, and their manifest.

    Returns the manifest and the content of all files, its own included; nothing is written.

    ``bulk_ratio`` is the bulk modulus over the larger of the matrix's shear modulus and the largest
    stress in the tested range; the change of volume at that stress is about its inverse. Default:
    incompressible for Abaqus, 1000 for FEBio. ``origin`` describes the draws in the header. Where
    the draws have the distances of :mod:`.nearest_law`, header and manifest state them.
    """
    _check_law(law, program)
    if bulk_ratio is not None and not 0.0 < bulk_ratio < np.inf:
        raise InputError(f"a bulk ratio of {bulk_ratio:g} is not a positive number")
    if bulk_ratio is None and program == "febio":
        bulk_ratio = BULK_RATIO
    try:
        earlier = out.exists() and (_cards_in(out) or (out / MANIFEST).exists())
    except OSError as error:
        raise InputError(f"cannot be used ({error.strerror})", file=out) from None
    if earlier and not overwrite:  # never are two exports mixed
        remedy = "name another folder with `out`, or remove them with `overwrite=True`"
        raise InputError("holds the cards of an earlier export", file=out, remedy=remedy)
    stem, digits = safe_label(specimen.name), max(4, len(str(len(draws))))
    weight = 1.0 / len(rows)
    records, files = [], {}
    for row in rows:
        draw = draws.iloc[[int(row)]]
        states = np.vstack(common_states(draw, with_free_sides(draw, specimen, law)))
        values = [float(draw.iloc[0][name]) for name in law.names]
        fitted, written, shear_kPa, notes, columns = _exported(law, values, states)
        bulk_kPa = None
        if bulk_ratio is not None:
            peak = float(np.abs(fitted.cauchy(*states.T)).max())
            bulk_kPa = bulk_ratio * max(shear_kPa, peak)
        distances = {k: float(draw.iloc[0][k]) for k in (TO_TISSUE, TO_READINGS) if k in draw}
        card = Card(
            f"{stem}_{row:0{digits}d}",
            written,
            UNIT_SYSTEMS[units],
            bulk_kPa,
            specimen.name,
            f"{origin}; row {row} of {len(draws)} draws, weight {weight:.6g}",
            bool(mounting_labels(draws, specimen)),
            (*notes, *_distance_note(distances)),
        )
        write, suffix = PROGRAMS[program]
        file = f"{stem}-{row:0{digits}d}{suffix}"
        files[out / file] = write(card, __version__).encode("utf-8")
        labels = [p.label for p in written.law.parameters]
        records.append(
            {"card": card.label, "file": file, "draw": int(row), "weight": weight}
            | dict(zip(labels, written.values, strict=True))
            | {"bulk_modulus_kPa": np.nan if bulk_kPa is None else bulk_kPa}
            | {"program": program, "units": units}
            | columns
            | distances
        )
    manifest = pd.DataFrame(records)
    files[out / MANIFEST] = csv_text(manifest).encode("utf-8")
    return manifest, files


def _distance_note(distances: Mapping[str, float]) -> tuple[str, ...]:
    """What the card's stresses are off the readings."""
    if not distances:
        return ()
    off = f"{100.0 * distances[TO_READINGS]:.2g} %"
    if np.isnan(distances[TO_TISSUE]):
        return (
            f"Distance: on the tested paths this drawn law, without its misfit, is off the "
            f"readings by {off} (relative root mean square).",
        )
    near = f"{100.0 * distances[TO_TISSUE]:.2g} %"
    return (
        f"Distance: on the tested paths this law is off the drawn tissue by {near}, and off the "
        f"readings by {off} (relative root mean square).",
    )


def _check_law(law: Law, program: str) -> None:
    """Refuse a program that does not have the law."""
    is_goh = type(law).as_goh is not Law.as_goh
    if is_goh or (law.name in MIXTURES and program == "febio"):
        return
    message = f"there is no card of the law {law.name} for {program}"
    if law.name == "fung":
        message += ": Abaqus' Fung form has no neo-Hookean part, and c0 is above zero here"
    elsewhere = "export it to febio" if law.name in MIXTURES else "export a run of `law` goh or hgo"
    raise InputError(message, remedy=elsewhere)


def _exported(
    law: Law, values: Sequence[float], states: np.ndarray
) -> tuple[MaterialResponse, MaterialResponse, float, tuple[str, ...], dict[str, float]]:
    """Material of a draw, the same as written, shear modulus of its matrix, notes, and columns."""
    goh = law.as_goh(values)
    if goh is None:
        material = law.material_at(values)
        (_, matrix, _), *_ = MIXTURES[law.name].parts(dict(zip(law.names, values, strict=True)))
        shear = 2.0 * matrix["c1"]
        return material, material, shear, (), {"switch_changes_stress_kPa": 0.0}
    written, changed = exportable(goh)
    X, Y = np.square(states.T)
    Hx, Hy, Hz = goh.structure_tensor()
    smallest = float((Hx * X + Hy * Y + Hz / (X * Y)).min()) - 1.0
    switch = (
        "Fibre switch: fibres carry no load at E < 0, neither in this program nor in the fit."
        if goh.fibre_switch
        else "Fibre switch: this program drops the fibre term at E < 0; the fit does not "
        "(Eq. 5 of its paper has no switch)."
    )
    change, notes = 0.0, [*changed, switch]
    if smallest >= 0.0:
        notes[-1] += " Over the tested states E >= 0, so the two agree there."
    elif not goh.fibre_switch:
        switched = replace(goh, fibre_switch=True).cauchy(*states.T)
        change = float(np.abs(np.subtract(switched, goh.cauchy(*states.T))).max())
        notes.append(
            f"WARNING: E falls to {smallest:.3g} in the tested states, where the switch changes "
            f"the stress by up to {change:.3g} kPa; sample with --fibre-switch for a consistent "
            "material."
        )
    columns = {"smallest_fibre_strain": smallest, "switch_changes_stress_kPa": change}
    return goh, written, 2.0 * goh.C1_kPa, tuple(notes), columns


def export_population_cards(
    folder: Path,
    group: str,
    out: Path,
    *,
    count: int | None = None,
    seed: int = 0,
    anyway: bool = False,
    **how: Any,
) -> pd.DataFrame:
    """Write cards of new specimens of a group; ``mean-curve`` has the one nearest the median."""
    table, attributes = new_materials(folder, group)
    if attributes["convergence"] == "unusable" and not anyway:
        raise NotConverged(
            f"{folder}: the chains of this population have not converged; sample longer, or add "
            "`anyway=True` to use them nevertheless"
        )
    law = law_named(str(attributes["law"]), fibre_switch=bool(attributes["fibre_switch"]))
    # Median equibiaxial curves of the group as a specimen.
    stretch = np.linspace(1.0, float(attributes["largest_stretch"]), 61)
    with np.errstate(over="ignore", invalid="ignore"):
        stress = law.material(table).cauchy(stretch[None], stretch[None])
    x, y = (np.median(np.nan_to_num(s, nan=np.inf), axis=0) for s in stress)
    curves = Protocol("equibiaxial", stretch, stretch, x, y)
    specimen = Specimen(group, (curves,), "cauchy", "unloaded")
    # Stretches are total ones: the unloaded state is the reference.
    table = table.assign(**dict.fromkeys(mounting_names("stretch"), 1.0))
    mean, _ = chosen_draws(table, specimen, law, at="median")
    count = min(count or DEFAULT_NEW_SPECIMENS, len(table))
    rows, _ = chosen_draws(table, specimen, law, count=count, seed=seed)
    origin = f"new specimen of {group}"
    manifest, files = made_cards(table, specimen, law, rows, out, origin=origin, **how)
    origin += " with the curves nearest the median curves"
    curve = out / MEAN_CURVE
    _, of_the_mean = made_cards(table, specimen, law, mean, curve, origin=origin, **how)
    write_cards(files | of_the_mean)
    return manifest


def write_cards(files: Mapping[Path, bytes]) -> None:
    """Write the files of an export, and remove those of an earlier one that are not among them."""
    folders = {path.parent for path in files}
    for folder in folders:
        make_folder(folder)
    atomic_write_all(files)
    for folder in folders:
        for path in _cards_in(folder):
            if path not in files:
                path.unlink(missing_ok=True)


def _cards_in(folder: Path) -> list[Path]:
    return [path for path in folder.iterdir() if CARD_NAME.fullmatch(path.name)]
