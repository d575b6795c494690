"""Machine exports to one specimen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.machines.choice import Choice
from biaxbayes.machines.recording import Gauge, Recording
from biaxbayes.specimens.keys import ARGUMENT_KEYS, DIMENSIONS
from biaxbayes.specimens.plausibility import NEGATIVE, check_load
from biaxbayes.specimens.protocol import CURVES, LOAD_ROWS, Protocol, ReadingError
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.tables.table import read_tables

Header = Mapping[str, float | str]
"""Values by their key in a specimen file."""


@dataclass(frozen=True)
class Conversion:
    """A specimen, its recordings, and its protocols with the stretches as measured.

    ``geometry_given`` is True if the user stated the geometry.
    """

    specimen: Specimen
    recordings: tuple[Recording, ...]
    protocols_as_measured: tuple[Protocol, ...]
    geometry_given: bool

    def __repr__(self) -> str:
        sources = ", ".join(r.source for r in self.recordings)
        return f"Conversion({self.specimen!r} from {sources})"


def convert(
    paths: Sequence[Path],
    choice: Choice,
    *,
    header: Header,
    protocol_names: Sequence[str] = (),
) -> Conversion:
    """Read machine exports as one specimen, as :func:`biaxbayes.convert` does."""
    recordings = _named_recordings(paths, choice, header, protocol_names)
    # stretches as measured: `Specimen` divides them by those at rest, and `check` reports the drift
    timed = all(r.time_s is not None for r in recordings)
    protocols = []
    for r in recordings:
        (x, y), (load_x, load_y) = r.stretch.T, r.load.T
        protocols.append(Protocol(r.name, x, y, load_x, load_y, r.time_s if timed else None))
    stress_pair = recordings[0].stress_pair
    unit, other = ("N", "kPa") if stress_pair == "force" else ("kPa", "N")
    if f"load_noise_{other}" in header:
        raise InputError(
            f"`load_noise_{other}` does not fit: the columns are in {unit}",
            remedy=f"give `load_noise_{unit}`",
        )
    noise = header.get(f"load_noise_{unit}")
    specimen = Specimen(
        name=str(header.get("specimen", paths[0].stem)),
        protocols=tuple(protocols),
        stress_pair=stress_pair,
        geometry=str(header.get("geometry", "unloaded")),
        load_noise=None if noise is None else float(noise),
        metadata=_metadata(recordings, paths, choice, header),
        **{key: header[key] for key in ARGUMENT_KEYS if key in header},  # type: ignore[arg-type]
    )
    return Conversion(specimen, tuple(recordings), tuple(protocols), "geometry" in header)


def _named_recordings(
    paths: Sequence[Path], choice: Choice, header: Header, protocol_names: Sequence[str]
) -> list[Recording]:
    """Recordings of all files with the given names, or those of files, sheets and protocols."""
    recordings: list[Recording] = []
    for path in paths:
        in_file = _recordings(path, choice, header)
        for r in in_file:
            name = r.name if len(paths) == 1 else f"{path.stem} {r.name}"
            recordings.append(replace(r, name=path.stem if len(in_file) == 1 else name))
    pairs = {r.stress_pair for r in recordings}
    if len(pairs) > 1:
        raise InputError(
            f"the files hold different stress pairs ({', '.join(sorted(pairs))})",
            remedy="convert them with the same columns",
        )
    if protocol_names and len(protocol_names) != len(recordings):
        raise InputError(
            f"{len(protocol_names)} protocol names for {len(recordings)} protocols",
            remedy=f"the protocols are {', '.join(r.source for r in recordings)[:300]}",
        )
    names = list(protocol_names) or [r.name for r in recordings]
    for name in names:
        if not name.strip() or names.count(name) > 1:
            raise InputError(
                f"protocol name {name[:40]!r} is empty or duplicated",
                remedy="give `protocol_names`, one per protocol",
            )
    return [replace(r, name=name) for r, name in zip(recordings, names, strict=True)]


def _recordings(path: Path, choice: Choice, header: Header) -> list[Recording]:
    """Checked recordings of all tables of a file; sheets without the columns are left out."""
    tables, skipped = read_tables(path, choice.sheets)
    edges = None
    if "edge_x_mm" in header and "edge_y_mm" in header:
        edges = (float(header["edge_x_mm"]), float(header["edge_y_mm"]))
    geometry = str(header.get("geometry", "unloaded"))
    gauge = Gauge((choice.gauge_x_mm, choice.gauge_y_mm), edges, geometry, choice.gauge_at or "")
    reader = import_module(f"biaxbayes.machines.{choice.machine}")
    recordings: list[Recording] = []
    for sheet, table in tables.items():
        if len(tables) > 1 and not reader.recognises(table, choice):
            skipped[sheet] = "has none of the columns"
            continue
        for r in reader.recordings(table, choice, gauge):
            name = f"{sheet} {r.name}".rstrip() if len(tables) > 1 else r.name
            recordings.append(replace(r, name=name))
    if not recordings:
        remedy = next(iter(tables.values())).listing
        raise InputError("no sheet has the columns", file=path, remedy=remedy)
    if skipped:
        note = "sheets left out: " + ", ".join(f"{k} ({why})" for k, why in skipped.items())
        recordings = [replace(r, notes=(*r.notes, note)) for r in recordings]
    if choice.tension_negative:
        signs = [-1.0 if axis in choice.tension_negative else 1.0 for axis in "xy"]
        note = f"the sign of the load in {' and '.join(choice.tension_negative)} is reversed"
        recordings = [
            replace(r, load=r.load * signs, assumptions=(*r.assumptions, note)) for r in recordings
        ]
    for r in recordings:
        _check(r, path, header)
    _check_signs(recordings, path)
    return recordings


def _check(r: Recording, file: Path, header: Header) -> None:
    """Refuse a recording whose numbers cannot be what their columns say."""
    if len(r.lines) < 2:
        rows = "no row is" if len(r.lines) == 0 else "only 1 row is"
        problem = f"{rows} left of the {r.branch} branch"
        raise InputError(problem, file=file, remedy="choose another `cycle` or `branch`")
    sections: tuple[float | None, float | None] = (None, None)
    if r.stress_pair == "force":
        missing = [key for key in (*DIMENSIONS, "geometry") if key not in header]
        if missing:
            options = [f"`{key}`" for key in missing]
            state = ""
            if "geometry" in missing:
                state = " (unloaded or mounted: the state in which they were measured)"
            raise InputError(
                f"forces need {', '.join(missing)}", remedy=f"give {', '.join(options)}{state}"
            )
        edge_x, edge_y, thickness = (float(header[key]) for key in DIMENSIONS)
        sections = edge_y * thickness, edge_x * thickness
    limit = float(header["stress_limit_kPa"]) if "stress_limit_kPa" in header else None
    try:
        Protocol("", *r.stretch.T, *r.load.T)
        for name, load, section in zip(LOAD_ROWS, r.load.T, sections, strict=True):
            check_load(load, section, limit, argument=name)
    except ReadingError as error:
        raise error.at(file, r.lines, dict(zip(CURVES, r.columns, strict=True))) from None


def _check_signs(recordings: Sequence[Recording], file: object) -> None:
    """Refuse loads that fall where the stretch is largest, as from a cell with tension negative."""
    largest = max(float(np.ptp(r.load, axis=0).max()) for r in recordings)
    for k, axis in enumerate("xy"):
        recording = max(recordings, key=lambda r: float(np.ptp(r.stretch[:, k])))
        stretch, load = recording.stretch[:, k], recording.load[:, k]
        change = load[np.argmax(stretch)] - load[np.argmin(stretch)]
        if change >= -NEGATIVE * largest:
            continue
        strain = stretch - stretch[0]
        if load[np.abs(strain).argmax()] > load[0] and -strain.min() > strain.max():
            raise InputError(
                f"the load in {axis} rises by {-change:.3g} while the stretch in {axis} falls to "
                f"{stretch.min():.4g}: the machine may count extension as negative, or the strain "
                "may be inverse",
                file=file,
                column=recording.columns[k],
                remedy="multiply the column by -1 (a displacement) in the table, and convert again",
            )
        raise InputError(
            f"the load in {axis} falls by {-change:.3g} while the stretch in {axis} rises to "
            "its largest value: the load cell may count tension as negative",
            file=file,
            column=recording.columns[2 + k],
            remedy=f"reverse its sign with `tension_negative={axis}` (or xy for both)",
        )


def _metadata(
    recordings: Sequence[Recording], paths: Sequence[Path], choice: Choice, header: Header
) -> dict[str, float | str]:
    """Other header values, and the origin of the record."""
    arguments = (*ARGUMENT_KEYS, "specimen", "geometry", "load_noise_N", "load_noise_kPa")
    metadata = {key: value for key, value in header.items() if key not in arguments}
    metadata["source"] = f"{choice.machine}: " + ", ".join(path.name for path in paths)
    cycles = [r.cycle for r in recordings]
    if any(cycles):
        metadata["cycle"] = ", ".join(dict.fromkeys(c or "the only one" for c in cycles))
    metadata["branch"] = choice.branch
    assumptions = dict.fromkeys(note for r in recordings for note in r.assumptions)
    if assumptions:
        metadata["conversion"] = "; ".join(assumptions)
    gradients = [r.gradient for r in recordings if r.gradient is not None]
    if gradients:
        # rounded, as it is a caution and not a measurement
        gradient = np.concatenate(gradients)
        shear, angle = np.abs(gradient[:, [0, 1], [1, 0]]), np.abs(shear_angle_deg(gradient))
        metadata["largest_shear"] = float(f"{shear.max():.3g}")
        metadata["largest_shear_angle_deg"] = float(f"{angle.max():.3g}")
    return metadata


def shear_angle_deg(gradient: np.ndarray) -> np.ndarray:
    """Change of the right angle between the x and y axes by gradients of shape (n, 2, 2)."""
    # C = F^T F;  sin(gamma) = C12 / sqrt(C11 C22); a rotation has none
    C = np.einsum("nki,nkj->nij", gradient, gradient)
    sine = C[:, 0, 1] / np.sqrt(C[:, 0, 0] * C[:, 1, 1])
    return np.degrees(np.arcsin(np.clip(sine, -1.0, 1.0)))
