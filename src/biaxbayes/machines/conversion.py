"""Machine exports to one specimen: what to take from them, and what was taken."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.machines import BRANCHES, DIRECTIONS, FORMATS, GAUGE_AT, STRETCH_SOURCES
from biaxbayes.specimens.plausibility import check_load
from biaxbayes.specimens.protocol import LOAD_ROWS, Protocol, ReadingError
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.tables.table import read_tables

# --- what to take from a raw file, and what was taken from it for one protocol -------------------


@dataclass(frozen=True)
class Choice:
    """What to take from a raw file.

    Attributes
    ----------
    machine : str
        One of :data:`biaxbayes.machines.FORMATS`.
    columns : tuple of str
        ``target=column[:unit]`` texts of the generic machine.
    cycle : str
        ``last`` or a number.
    branch : {"loading", "unloading", "both"}
    stretch_from : {"auto", "tracked", "rake"}
        Of a BioTester.
    sets : tuple of str
        Of a BioTester; the last where empty.
    sheets : tuple of str
        Of a workbook, one or more protocols each; ``all`` for every one that holds a table.
    gauge_x_mm, gauge_y_mm : float, optional
        Length between the marks or grips where their displacement is zero.
    gauge_at : {"", "zero", "start"}
        Whether that is where the displacement reads zero, or at the first row of the file; needed
        where the two differ.
    drop_missing : bool
        Leave out rows in which a reading is missing; else they are refused.
    tension_negative : {"", "x", "y", "xy"}
        Directions whose load cell counts tension negative.
    """

    machine: str
    columns: tuple[str, ...] = ()
    cycle: str = "last"
    branch: str = "loading"
    stretch_from: str = "auto"
    sets: tuple[str, ...] = ()
    sheets: tuple[str, ...] = ()
    gauge_x_mm: float | None = None
    gauge_y_mm: float | None = None
    gauge_at: str = ""
    drop_missing: bool = False
    tension_negative: str = ""

    def __post_init__(self) -> None:
        for name, value, allowed in (
            ("machine", self.machine, tuple(FORMATS)),
            ("branch", self.branch, BRANCHES),
            ("stretch_from", self.stretch_from, STRETCH_SOURCES),
            ("gauge_at", self.gauge_at, ("", *GAUGE_AT)),
            ("tension_negative", self.tension_negative, ("", *DIRECTIONS)),
        ):
            if value not in allowed:
                raise InputError(f"{name} must be one of {', '.join(allowed)}, not {value!r}")
        for axis in "xy":
            length = getattr(self, f"gauge_{axis}_mm")
            if length is not None and not 0.01 <= length <= 10_000.0:
                raise InputError(
                    f"a gauge length of {length:g} mm in {axis} cannot be",
                    remedy=f"give --gauge-{axis}-mm in mm, between 0.01 and 10000",
                )


@dataclass(frozen=True)
class Gauge:
    """Lengths in x and y between marks or grips that displacements and distances refer to.

    Attributes
    ----------
    stated_mm : (float or None, float or None)
        As the user gives them.
    edges_mm : (float, float) or None
        What is taken in place of a gauge length that is not stated.
    geometry : str
        State that the edges were measured in.
    at : {"", "zero", "start"}
        As ``gauge_at`` of :class:`Choice`.
    """

    stated_mm: tuple[float | None, float | None] = (None, None)
    edges_mm: tuple[float, float] | None = None
    geometry: str = "unloaded"
    at: str = ""

    def displaced(
        self, moved_mm: np.ndarray, first_mm: float, k: int, column: str, file: object
    ) -> tuple[np.ndarray, str]:
        """Stretches of a displacement whose first reading in the file is given, and a note."""
        axis, length = "xy"[k], self.stated_mm[k]
        if length is None and self.edges_mm is not None:
            length = self.edges_mm[k]
        if length is None:
            raise InputError(
                f"{column!r} is a displacement and needs the length between the marks or grips at "
                "displacement zero",
                file=file,
                column=column,
                remedy=f"give --gauge-{axis}-mm (or --edge-x-mm and --edge-y-mm, if the edges are "
                "all that is known)",
            )
        if not self.at and abs(first_mm) > 0.01 * length:
            raise InputError(
                f"{column!r} starts at {first_mm:g} mm, not at zero",
                file=file,
                column=column,
                remedy=f"say with --gauge-at whether the gauge length of {length:g} mm is that at "
                "displacement zero ('zero') or that of the first row ('start')",
            )
        origin = first_mm if self.at == "start" else 0.0
        # lambda = 1 + (d - d0) / L0
        stretch = 1.0 + (moved_mm - origin) / length
        formula = "displacement" if origin == 0.0 else f"(displacement - {origin:g} mm)"
        note = f"stretch {axis} is 1 + {formula} / {length:g} mm"
        if self.stated_mm[k] is not None:
            return stretch, f"{note}, the stated gauge length"
        if self.geometry == "mounted":
            return stretch, (
                f"{note}: no gauge length is stated, and the mounted edge is taken for it. If "
                f"marks or grips were another distance apart, give --gauge-{axis}-mm"
            )
        reached = float(stretch.max())
        return stretch, (
            f"{note}: no gauge length is stated, and the unloaded edge is taken for it. The length "
            f"when the test was zeroed is longer by the mounting stretch, so that the strain in "
            f"{axis} is too large by that factor (mounted at 1.05: {reached:.3f} is "
            f"{1.0 + (reached - 1.0) / 1.05:.3f}). Give --gauge-{axis}-mm"
        )

    def stretched(
        self, length_mm: np.ndarray, first_mm: float, k: int, column: str, file: object
    ) -> tuple[np.ndarray, str]:
        """Stretches of a distance between marks or grips, and a note."""
        if first_mm <= 0.0:
            raise InputError(
                f"{column!r} starts at {first_mm:g}, which is no length",
                file=file,
                column=column,
                remedy=f"for a displacement write stretch_{'xy'[k]}={column}:displacement_mm",
            )
        stated = self.stated_mm[k]
        reference = first_mm if stated is None else stated
        origin = "its first value" if stated is None else "the stated gauge length"
        note = f"stretch {'xy'[k]} is {column} over {origin}, {reference:g} mm"
        return length_mm / reference, note


@dataclass(frozen=True, eq=False)
class Recording:
    """Rows of one loading path, converted.

    Attributes
    ----------
    name : str
    source : str
        File (and set) that it comes from.
    stretch, load : ndarray, shape (n, 2)
        As measured: the stretch at rest need not be one. N or kPa.
    columns : tuple of str
        Raw columns that stretch x, y and load x, y come from.
    stress_pair : {"force", "piola", "cauchy"}
    time_s : ndarray, shape (n,), or None
    gradient : ndarray, shape (n, 2, 2), or None
        In-plane deformation gradient where the file has its off-diagonal components.
    lines : ndarray of int, shape (n,)
        Line of the raw file of each row.
    rows_in_file : int
    cycle : str or None
        Such as ``6 of 6``; None where the file holds one cycle only.
    branch : str
    notes : tuple of str
        How the file was read.
    assumptions : tuple of str
        What stretches and loads rest on; written into the specimen file.
    """

    name: str
    source: str
    stretch: np.ndarray
    load: np.ndarray
    columns: tuple[str, ...]
    stress_pair: str
    time_s: np.ndarray | None
    gradient: np.ndarray | None
    lines: np.ndarray
    rows_in_file: int
    cycle: str | None
    branch: str
    notes: tuple[str, ...] = ()
    assumptions: tuple[str, ...] = ()

    def check(
        self, file: object, sections: tuple[float, float] | None, limit_kPa: float | None = None
    ) -> None:
        """Refuse numbers that cannot be what their column says.

        Parameters
        ----------
        file : object
            For the message.
        sections : (float, float) or None
            Sections under the force in x and y, mm^2; None for stresses.
        limit_kPa : float, optional
        """
        if len(self.lines) < 2:
            raise InputError(
                f"{len(self.lines)} row left of the {self.branch} branch",
                file=file,
                remedy="choose another --cycle or --branch",
            )
        columns = dict(zip(("stretch_x", "stretch_y", *LOAD_ROWS), self.columns, strict=True))
        try:
            Protocol("", *self.stretch.T, *self.load.T)
            for k, name in enumerate(LOAD_ROWS):
                section = None if sections is None else sections[k]
                check_load(self.load[:, k], section, limit_kPa, argument=name)
        except ReadingError as error:
            raise error.at(file, self.lines, columns) from None


NEGATIVE = 0.3
"""Share of the largest change of load by which a load that falls has the wrong sign."""


def shear_angle_deg(gradient: np.ndarray) -> np.ndarray:
    """Change of the right angle between the x and y axes, degrees; a rotation has none.

    Parameters
    ----------
    gradient : ndarray, shape (n, 2, 2)
    """
    # C = F^T F;  sin(gamma) = C12 / sqrt(C11 C22)
    C = np.einsum("nki,nkj->nij", gradient, gradient)
    sine = C[:, 0, 1] / np.sqrt(C[:, 0, 0] * C[:, 1, 1])
    return np.degrees(np.arcsin(np.clip(sine, -1.0, 1.0)))


# --- machine exports to one specimen, and what was taken from each of them -----------------------


@dataclass(frozen=True)
class Conversion:
    """A specimen, and the recordings that it was made from.

    ``recorded`` are its protocols with stretches as measured, before they were divided.
    """

    specimen: Specimen
    recordings: tuple[Recording, ...]
    recorded: tuple[Protocol, ...]
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
    timed = all(r.time_s is not None for r in recordings)
    recorded = tuple(_protocol(r, timed) for r in recordings)
    specimen = _specimen(recordings, recorded, paths, choice, header)
    return Conversion(specimen, tuple(recordings), recorded, "geometry" in header)


def _recordings(path: Path, choice: Choice, header: Mapping[str, float | str]) -> list[Recording]:
    """Recordings of all tables of a file, checked; a sheet without the columns is left out."""
    tables, others = read_tables(path, choice.sheets)
    edges = None
    if "edge_x_mm" in header and "edge_y_mm" in header:
        edges = (float(header["edge_x_mm"]), float(header["edge_y_mm"]))
    gauge = Gauge(
        (choice.gauge_x_mm, choice.gauge_y_mm),
        edges,
        str(header.get("geometry", "unloaded")),
        choice.gauge_at,
    )
    reader = import_module(f"biaxbayes.machines.{choice.machine}")
    found: list[Recording] = []
    for sheet, table in tables.items():
        if len(tables) > 1 and reader.is_other_table(table, choice):
            others[sheet] = "has none of the columns"
            continue
        of_sheet: list[Recording] = reader.recordings(table, choice, gauge)
        if len(tables) > 1:
            of_sheet = [replace(r, name=f"{sheet} {r.name}".rstrip()) for r in of_sheet]
        found += of_sheet
    if not found:
        raise InputError(
            "no sheet has the columns", file=path, remedy=next(iter(tables.values())).found
        )
    if others:
        note = "sheets left out: " + ", ".join(f"{k} ({why[:60]})" for k, why in others.items())
        found = [replace(r, notes=(*r.notes, note)) for r in found]
    found = [_tension_positive(r, choice.tension_negative) for r in found]
    limit = header.get("stress_limit_kPa")
    for recording in found:
        recording.check(path, _sections(recording, header), None if limit is None else float(limit))
    check_signs(found, path)
    return found


def _tension_positive(recording: Recording, negative: str) -> Recording:
    """A recording with the loads of some directions turned round."""
    if not negative:
        return recording
    signs = [-1.0 if axis in negative else 1.0 for axis in "xy"]
    note = f"the sign of the load in {' and '.join(negative)} is turned round"
    assumptions = (*recording.assumptions, note)
    return replace(recording, load=recording.load * signs, assumptions=assumptions)


def check_signs(recordings: Sequence[Recording], file: object) -> None:
    """Refuse loads that fall where the stretch is largest, as from a cell with tension negative."""
    for k, axis in enumerate("xy"):
        ends = []
        for r in recordings:
            row, start = int(np.argmax(r.stretch[:, k])), int(np.argmin(r.stretch[:, k]))
            rise = r.stretch[row, k] - r.stretch[start, k]
            ends.append((rise, r.load[row, k] - r.load[start, k], r))
        _, change, recording = max(ends, key=lambda end: end[0])
        largest = max(float(np.ptp(r.load, axis=0).max()) for r in recordings)
        if change < -NEGATIVE * largest:
            raise InputError(
                f"the load in {axis} falls by {-change:.3g} while the stretch in {axis} rises to "
                f"its largest value: the load cell may count tension negative",
                file=file,
                column=recording.columns[2 + k],
                remedy=f"turn its sign round with --tension-negative {axis} (or xy for both)",
            )


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
    recorded: Sequence[Protocol],
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
    assumptions = dict.fromkeys(note for r in recordings for note in r.assumptions)
    if assumptions:
        metadata["conversion"] = "; ".join(assumptions)
    metadata.update(_shear(recordings))
    noise = header.get(f"load_noise_{unit}")
    wrong = "kPa" if unit == "N" else "N"
    if f"load_noise_{wrong}" in header:
        raise InputError(
            f"--load-noise-{wrong} does not fit: the columns are in {unit}",
            remedy=f"give --load-noise-{unit}",
        )
    return Specimen(
        name=str(header.get("specimen", paths[0].stem)),
        protocols=tuple(recorded),
        stress_pair=recordings[0].stress_pair,
        geometry=str(header.get("geometry", "unloaded")),
        load_noise=None if noise is None else float(noise),
        metadata=metadata,
        **{key: header[key] for key in _FIELDS if key in header and key not in _RENAMED},  # type: ignore[arg-type]
    )


_RENAMED = ("specimen", "geometry")
_FIELDS = (
    *_RENAMED,
    "layer",
    "axis_x",
    "axis_y",
    "edge_x_mm",
    "edge_y_mm",
    "thickness_mm",
    "reference",
)


def _protocol(recording: Recording, timed: bool) -> Protocol:
    """The rows as measured; the reader divides by the stretch at rest, and can tell the drift."""
    x, y = recording.stretch.T
    fx, fy = recording.load.T
    time = recording.time_s if timed else None
    return Protocol(recording.name, x, y, fx, fy, time)


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
