"""Machine exports to one specimen, and what was taken from each of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.machines.raw_file import read_raw_tables
from biaxbayes.machines.recording import Choice, Reader, Recording, shear_angle_deg
from biaxbayes.specimens.specimen import Protocol, Specimen, rest_rows

__all__ = ["Choice", "Conversion", "convert"]


@dataclass(frozen=True)
class Conversion:
    """A specimen with stretches as measured, and the recordings that it was made from."""

    specimen: Specimen
    recordings: tuple[Recording, ...]
    geometry_stated: bool

    def __repr__(self) -> str:
        sources = ", ".join(r.source for r in self.recordings)
        return f"Conversion({self.specimen!r} from {sources})"


def convert(
    paths: Sequence[Path],
    choice: Choice,
    *,
    header: Mapping[str, float | str],
    protocol_names: Sequence[str] = (),
) -> Conversion:
    """Read machine exports as the protocols of one specimen.

    Parameters
    ----------
    paths : sequence of Path
    choice : Choice
    header : mapping
        Header values by their key in a specimen file (``edge_x_mm``, ``geometry``,
        ``load_noise_N``, ``layer`` ...).
    protocol_names : sequence of str
        One a protocol; from the names of the files (and of their sets or protocols) where empty.

    Returns
    -------
    Conversion

    Raises
    ------
    InputError
        For files, columns and options that do not fit together.
    """
    recordings: list[Recording] = []
    for path in paths:
        found = _recordings(path, choice, header)
        recordings += [
            replace(r, name=_default_name(path, r.name, len(paths), len(found))) for r in found
        ]
    pairs = {r.stress_pair for r in recordings}
    if len(pairs) > 1:
        raise InputError(
            f"the files hold different stress pairs ({', '.join(sorted(pairs))})",
            remedy="convert them with the same columns",
        )
    recordings = _named(recordings, protocol_names)
    specimen = _specimen(recordings, paths, choice, header)
    return Conversion(specimen, tuple(recordings), "geometry" in header)


def _recordings(path: Path, choice: Choice, header: Mapping[str, float | str]) -> list[Recording]:
    tables = read_raw_tables(path, choice.sheets)
    edges = None
    if "edge_x_mm" in header and "edge_y_mm" in header:
        edges = (float(header["edge_x_mm"]), float(header["edge_y_mm"]))
    read: Reader = import_module(f"biaxbayes.machines.{choice.machine}").recordings
    found = []
    for sheet, table in tables.items():
        of_sheet = read(table, choice, edges)
        if len(tables) > 1:
            of_sheet = [replace(r, name=f"{sheet} {r.name}".rstrip()) for r in of_sheet]
        found += of_sheet
    for recording in found:
        limit = header.get("stress_limit_kPa")
        recording.check(path, _sections(recording, header), None if limit is None else float(limit))
    return found


def _sections(
    recording: Recording, header: Mapping[str, float | str]
) -> tuple[float, float] | None:
    """Sections under the force in x and y, mm^2; None for stresses."""
    if recording.stress_pair != "force":
        return None
    needed = ("edge_x_mm", "edge_y_mm", "thickness_mm", "geometry")
    missing = [key for key in needed if key not in header]
    if missing:
        options = ["--" + key.replace("_", "-") for key in missing]
        state = " unloaded|mounted, the state it was measured in" if "geometry" in missing else ""
        raise InputError(
            f"forces need {', '.join(missing)}", remedy=f"give {', '.join(options)}{state}"
        )
    thickness = float(header["thickness_mm"])
    return float(header["edge_y_mm"]) * thickness, float(header["edge_x_mm"]) * thickness


def _default_name(path: Path, name: str, files: int, of_file: int) -> str:
    if of_file == 1:
        return path.stem
    return name if files == 1 else f"{path.stem} {name}"


def _named(recordings: list[Recording], names: Sequence[str]) -> list[Recording]:
    if names and len(names) != len(recordings):
        raise InputError(
            f"{len(names)} protocol names for {len(recordings)} protocols",
            remedy=f"the protocols are {', '.join(r.source for r in recordings)[:300]}",
        )
    chosen = list(names) or [r.name for r in recordings]
    for name in chosen:
        if not name.strip() or chosen.count(name) > 1:
            raise InputError(
                f"protocol name {name[:40]!r} is empty or there twice",
                remedy="give --protocol-names NAME,NAME,...",
            )
    return [replace(r, name=name) for r, name in zip(recordings, chosen, strict=True)]


def _specimen(
    recordings: Sequence[Recording],
    paths: Sequence[Path],
    choice: Choice,
    header: Mapping[str, float | str],
) -> Specimen:
    unit = "N" if recordings[0].stress_pair == "force" else "kPa"
    metadata: dict[str, float | str] = {
        key: header[key]
        for key in header
        if key not in _FIELDS and not key.startswith("load_noise")
    }
    metadata["source"] = f"{choice.machine}: " + ", ".join(path.name for path in paths)
    cycles = [r.cycle for r in recordings]
    if any(cycles):
        metadata["cycle"] = ", ".join(dict.fromkeys(c or "the only one" for c in cycles))
    metadata["branch"] = choice.branch
    metadata.update(_shear(recordings))
    timed = all(r.time_s is not None for r in recordings)
    noise = header.get(f"load_noise_{unit}")
    wrong = "kPa" if unit == "N" else "N"
    if f"load_noise_{wrong}" in header:
        raise InputError(
            f"--load-noise-{wrong} does not fit: the columns are in {unit}",
            remedy=f"give --load-noise-{unit}",
        )
    return Specimen(
        name=str(header.get("specimen", paths[0].stem)),
        protocols=tuple(_protocol(r, timed) for r in recordings),
        stress_pair=recordings[0].stress_pair,
        geometry=str(header.get("geometry", "unloaded")),
        load_noise=None if noise is None else float(noise),
        metadata=metadata,
        **{key: header[key] for key in _FIELDS if key in header and key not in _RENAMED},  # type: ignore[arg-type]
    )


_RENAMED = ("specimen", "geometry")
_FIELDS = (*_RENAMED, "layer", "axis_x", "axis_y", "edge_x_mm", "edge_y_mm", "thickness_mm")


def _protocol(recording: Recording, timed: bool) -> Protocol:
    """The rows as measured; the reader divides by the stretch at rest, and can tell the drift."""
    x, y = recording.stretch.T
    fx, fy = recording.load.T
    time = recording.time_s if timed else None
    return Protocol(recording.name, x, y, fx, fy, time, rest_rows(x, y))


def _shear(recordings: Sequence[Recording]) -> dict[str, float]:
    gradients = [r.gradient for r in recordings if r.gradient is not None]
    if not gradients:
        return {}
    gradient = np.concatenate(gradients)
    # Rounded: a word of caution, not a measurement.
    return {
        "largest_shear": float(f"{np.abs(gradient[:, [0, 1], [1, 0]]).max():.3g}"),
        "largest_shear_angle_deg": float(f"{np.abs(shear_angle_deg(gradient)).max():.3g}"),
    }
