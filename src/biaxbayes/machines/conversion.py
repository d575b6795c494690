"""Machine exports to one specimen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.machines.choice import Choice
from biaxbayes.machines.gauge import Gauge
from biaxbayes.machines.record import Record, Recording
from biaxbayes.machines.selection import select, without_repeats
from biaxbayes.specimens.check import LARGE_DRIFT
from biaxbayes.specimens.keys import ARGUMENT_KEYS, needed_with_forces
from biaxbayes.specimens.plausibility import check_readings, check_varies
from biaxbayes.specimens.protocol import (
    CURVES,
    LOAD_ROWS,
    Protocol,
    ReadingError,
    second_difference_scatter,
)
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.tables.question import Question
from biaxbayes.tables.table import read_tables

BELOW_START = 0.02
"""Fall of a loading branch below its start, over its range, that cannot be loading."""
Header = Mapping[str, float | str]
"""Values by their key in a specimen file."""


@dataclass(frozen=True)
class Conversion:
    """A specimen, its recordings, and its protocols with the stretches as measured."""

    specimen: Specimen
    recordings: tuple[Recording, ...]
    protocols_as_measured: tuple[Protocol, ...]
    geometry_given: bool  # by the user
    records: tuple[Record, ...] = ()  # all rows of the tables, with the reason of each left out

    @property
    def account(self) -> str:
        """What became of every row, as the command prints it."""
        from biaxbayes.machines.account import account

        return "\n".join(account(self))

    def __repr__(self) -> str:
        sources = ", ".join(r.record.source for r in self.recordings)
        return f"Conversion({self.specimen!r} from {sources})"


def convert(
    paths: Sequence[Path],
    choice: Choice,
    *,
    header: Header,
    protocol_names: Sequence[str] = (),
) -> Conversion:
    """Read machine exports as one specimen, as :func:`biaxbayes.convert` does."""
    name = choice.specimen or (str(header["specimen"]) if "specimen" in header else None)
    choice = replace(choice, specimen=name)
    records, recordings = _named_recordings(paths, choice, header, protocol_names)
    stress_pair = recordings[0].record.stress_pair
    _check_header(header, stress_pair, choice.test)
    noise = _number(header, "load_noise_N" if stress_pair == "force" else "load_noise_kPa")
    try:
        protocols = _protocols(recordings)
        if choice.test != "tube":
            _check_references(protocols, header, paths[0])
        specimen = Specimen(
            name=name or paths[0].stem,
            protocols=tuple(protocols),
            stress_pair=stress_pair,
            test=choice.test or "biaxial",
            geometry=str(header.get("geometry", "unloaded")),
            load_noise=noise,
            metadata=_metadata(recordings, paths, choice, header),
            **{key: header[key] for key in ARGUMENT_KEYS if key in header},  # type: ignore[arg-type]
        )
        check_readings(specimen)
    except ReadingError as error:
        r = next((r for r in recordings if r.name == error.protocol), None)
        if r is None:
            raise
        columns = dict(zip(CURVES, r.record.columns, strict=True))
        raise error.at(r.record.path, r.lines, columns) from None
    for p, r in zip(specimen.protocols, recordings, strict=True):
        _check_start(p, r)
    given = "geometry" in header
    return Conversion(specimen, tuple(recordings), tuple(protocols), given, tuple(records))


def _protocols(recordings: Sequence[Recording]) -> list[Protocol]:
    """Protocols with stretches as measured, each with a load in the directions that were read."""
    timed = all(r.time_s is not None for r in recordings)
    protocols = []
    for r in recordings:
        # across a strip the width may not be measured
        measured = [bool(name) for name in r.record.columns[:2]]
        (x, y), (load_x, load_y) = np.where(measured, r.stretch, np.nan).T, r.load.T
        protocols.append(Protocol(r.name, x, y, load_x, load_y, r.time_s if timed else None))
        for k in r.record.read:
            check_varies(r.load[:, k], argument=LOAD_ROWS[k], protocol=r.name)
    return protocols


def _check_header(header: Header, stress_pair: str, test: str | None) -> None:
    """Refuse a header that lacks dimensions of the test, or has the noise of other loads."""
    unit, other = ("N", "kPa") if stress_pair == "force" else ("kPa", "N")
    if f"load_noise_{other}" in header:
        raise InputError(
            f"`load_noise_{other}` does not fit: the columns are in {unit}",
            remedy=f"give `load_noise_{unit}`",
        )
    missing = [key for key in needed_with_forces(test) if key not in header]
    if missing and stress_pair == "force":
        remedy = "give " + ", ".join(f"`{key}`" for key in missing)
        if "geometry" in missing:
            remedy += " (unloaded or mounted: the state in which they were measured)"
        raise InputError(f"forces need {', '.join(missing)}", remedy=remedy)


def _number(header: Header, key: str) -> float | None:
    return float(header[key]) if key in header else None


def _check_references(protocols: Sequence[Protocol], header: Header, file: Path) -> None:
    """Ask for the reference of protocols that start at different stretches."""
    starts = np.array([p.known_stretch[: max(p.rest_rows, 1)].mean(axis=0) for p in protocols])
    if "reference" in header or np.ptp(starts, axis=0).max() <= LARGE_DRIFT:
        return
    shown = "; ".join(
        f"{p.name}: {x:.4f}, {y:.4f}" for p, (x, y) in zip(protocols, starts, strict=True)
    )
    gives = {
        "reference=each protocol": "each starts at the mounted state, by which it is divided",
        "reference=common": "one reference for all; those that start elsewhere have no rest",
    }
    raise Question(f"its protocols start at different stretches ({shown[:300]})", gives, file=file)


def _check_start(p: Protocol, r: Recording) -> None:
    """Refuse a loading branch that falls below the state that it starts from."""
    if r.branch != "loading" or p.rest_rows == 0:
        return
    stretch = p.known_stretch
    start = stretch[: p.rest_rows].mean(axis=0)
    total = p.recorded_load.sum(axis=1)
    rise = stretch[np.argmax(total)] - stretch[np.argmin(total)]
    along = (stretch - start) @ rise / max(float(np.linalg.norm(rise)), 1e-300)
    low, scatter = int(along.argmin()), second_difference_scatter(along)
    if along[low] < -max(BELOW_START * float(np.ptp(along)), 6.0 * scatter):
        raise InputError(
            f"the loading branch {r.name!r} falls to "
            f"{r.record.stretches_text(p.stretch[low], '.4f')} of the state that it starts from",
            file=r.record.path,
            row=int(r.lines[low]),
            remedy="give the lines of the loading side with `rows`",
        )


def _named_recordings(
    paths: Sequence[Path], choice: Choice, header: Header, protocol_names: Sequence[str]
) -> tuple[list[Record], list[Recording]]:
    """Records of all files, and their recordings with the given names or those in the files."""
    records: list[Record] = []
    recordings: list[Recording] = []
    for path in paths:
        of_file = _records(path, choice, header)
        in_file = [r for record in of_file for r in select(record, choice)]
        for r in in_file:
            name = f"{r.record.name} {r.name}".strip() if r.record.name != r.name else r.name
            name = name if len(paths) == 1 else f"{path.stem} {name}"
            recordings.append(replace(r, name=path.stem if len(in_file) == 1 else name))
        records += of_file
    recordings = without_repeats(recordings, choice)
    pairs = {r.record.stress_pair for r in recordings}
    if len(pairs) > 1:
        raise InputError(
            f"the files hold different stress pairs ({', '.join(sorted(pairs))})",
            remedy="convert them with the same columns",
        )
    if protocol_names and len(protocol_names) != len(recordings):
        of = ", ".join(f"{r.name} from {r.record.source}" for r in recordings)
        raise InputError(
            f"{len(protocol_names)} protocol names for {len(recordings)} protocols",
            remedy=f"the protocols are {of[:300]}",
        )
    names = protocol_names or [r.name for r in recordings]
    recordings = [replace(r, name=name) for r, name in zip(recordings, names, strict=True)]
    return records, recordings


def _records(path: Path, choice: Choice, header: Header) -> list[Record]:
    """Records of all tables of a file; sheets without the columns are left out."""
    tables, skipped = read_tables(path, choice.sheets, choice.hidden)
    is_tube = choice.test == "tube"
    lengths = [choice.gauge_x_mm, choice.gauge_y_mm]
    if is_tube:
        if any(lengths):
            raise InputError(
                "a tube has no gauge length",
                remedy="give `unloaded_outer_diameter_mm` and `unloaded_length_mm`",
            )
        lengths = [_number(header, k) for k in ("unloaded_outer_diameter_mm", "unloaded_length_mm")]
    edges = _number(header, "edge_x_mm"), _number(header, "edge_y_mm")
    gauge = Gauge((lengths[0], lengths[1]), edges, choice.gauge_at or "", is_tube)
    reader = import_module(f"biaxbayes.machines.{choice.machine}")
    records: list[Record] = []
    for sheet, table in tables.items():
        if len(tables) > 1 and not reader.recognises(table, choice):
            skipped[sheet] = "has none of the columns"
            continue
        for record in reader.records(table, choice, gauge):
            name = f"{sheet} {record.name}".strip() if len(tables) > 1 else record.name
            records.append(replace(record, name=name))
    if not records:
        remedy = next(iter(tables.values())).listing
        raise InputError("no sheet has the columns", file=path, remedy=remedy)
    if skipped:
        note = "sheets left out: " + ", ".join(f"{k} ({why})" for k, why in skipped.items())
        records = [replace(r, notes=(*r.notes, note)) for r in records]
    return records


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
    metadata["branch"] = recordings[0].branch
    assumptions = dict.fromkeys(
        note for r in recordings for note in (*r.record.assumptions, *r.assumptions)
    )
    if assumptions:
        metadata["conversion"] = "; ".join(assumptions)
    gradients = [r.record.gradient[r.rows] for r in recordings if r.record.gradient is not None]
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
