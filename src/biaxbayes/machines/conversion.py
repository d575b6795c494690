"""Machine exports to one specimen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from importlib import import_module
from pathlib import Path

import numpy as np

from biaxbayes.errors import InputError, ReadingError
from biaxbayes.experiments import Experiment
from biaxbayes.machines import generic
from biaxbayes.machines.choice import Choice
from biaxbayes.machines.outcome import Conversion, OpenQuestions
from biaxbayes.machines.record import Record, Recording
from biaxbayes.machines.selection import select, without_repeats
from biaxbayes.specimens.check import LARGE_DRIFT, check_specimen
from biaxbayes.specimens.keys import ARGUMENT_KEYS, KEYS, MOUNTED_STATE, checked_value
from biaxbayes.specimens.protocol import CURVES, Protocol, second_difference_scatter
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.tables.layout import ALL_SHEETS, tables_in
from biaxbayes.tables.question import Proposal, Question
from biaxbayes.tables.sheets import read_sheets
from biaxbayes.tables.table import Table
from biaxbayes.tables.worksheet import Worksheet

BELOW_START = 0.02
"""Fall of a loading branch below its start, over its range, that cannot be loading."""
Header = Mapping[str, float | str]
"""Values by their key in a specimen file."""
Sheets = dict[str, Worksheet]
Files = Mapping[Path, Sheets]


def convert(
    paths: Sequence[Path], choice: Choice, *, header: Header, protocol_names: Sequence[str] = ()
) -> Conversion:
    """Read machine exports as one specimen; all that is open is asked at once."""
    files = {path: read_sheets(path) for path in paths}
    open_ones: dict[tuple[str, str, str], Question] = {}
    seen, obstacle = set[tuple[str, str]](), ""
    # ends of sources with a number that nobody gave, and those of the proposals they stand for
    invented, certain = dict[str, str](), True
    result: Conversion | None = None
    while result is None:
        try:
            result = _converted(files, choice, header, protocol_names)
        except Question as question:
            asked = (question.target, question.text)
            if asked in seen:
                break  # what was assumed answers nothing
            seen.add(asked)
            question.rename(invented, assumed=False)
            _merge(question, open_ones)
            if question.assumed is None:
                break
            if question.assumed.value not in {p.value for p in question.proposals}:
                certain = False
                if question.option == "columns":
                    made, stands_for = question.assumed.value, question.proposals[0].value
                    invented["/" + made.rpartition("/")[2]] = "/" + stands_for.rpartition("/")[2]
            choice, header = _answered(choice, header, question.assumed)
        except InputError as error:
            if not open_ones:
                raise
            obstacle = str(error) if certain else ""
            break  # what was assumed does not fit: the questions come first
    if open_ones or result is None:
        raise OpenQuestions(list(open_ones.values()), result, obstacle)
    return result


def _merge(question: Question, others: dict[tuple[str, str, str], Question]) -> None:
    """Add a question; a later one on the same column has the other answers of the earlier."""
    of_column = question.target not in ("", "ignore", "protocol", "cycle")
    key = (question.option, question.target, "" if of_column else question.text)
    before = others.get(key)
    if before is not None:
        # what was assumed led to this question
        known = {p.value for p in (*question.proposals, before.assumed) if p}
        question.proposals += tuple(p for p in before.proposals if p.value not in known)
        if not before.text.startswith("no column"):
            question.text = f"{before.text}; {question.text}"
    others[key] = question


def _answered(choice: Choice, header: Header, answer: Proposal) -> tuple[Choice, Header]:
    """The options and header values with an answer."""
    name, value = answer.option, answer.value
    if name not in {f.name for f in fields(Choice)} or name == "specimen":
        return choice, {**header, name: checked_value(name, value)}
    before = getattr(choice, name)
    new: object = value
    if isinstance(before, tuple):
        new = (*before, value) if name == "columns" else (value,)
    elif isinstance(before, bool):
        new = value == "True"
    return replace(choice, **{name: new}), header  # type: ignore[arg-type]


def _converted(files: Files, choice: Choice, header: Header, names: Sequence[str]) -> Conversion:
    """The specimen of some files whose sheets are read."""
    paths, given = list(files), (choice, header)
    name = choice.specimen or (str(header["specimen"]) if "specimen" in header else None)
    choice = replace(choice, specimen=name)
    mounted = [float(header.get(key, 1.0)) for key in MOUNTED_STATE]
    if set(MOUNTED_STATE) & set(header):
        header = {k: v for k, v in header.items() if k not in MOUNTED_STATE}
        header["reference"] = "common"
    records, recordings = _named_recordings(files, choice, header, names)
    loads, experiment = recordings[0].record.loads, recordings[0].record.experiment
    _check_header(header, loads, experiment, paths[0])
    noise = header.get(f"load_noise_{experiment.loads[loads].units[0]}")
    in_doubt = experiment.is_mounted and "reference" not in header
    try:
        timed = all(r.time_s is not None for r in recordings)
        protocols = []
        for r in recordings:
            # stretches over those of the mounted state; across a strip the width may be unmeasured
            measured = [bool(column) for column in r.record.columns[:2]]
            (x, y), (load_x, load_y) = np.where(measured, r.stretch / mounted, np.nan).T, r.load.T
            protocols.append(Protocol(r.name, x, y, load_x, load_y, r.time_s if timed else None))
        if in_doubt:
            _ask_for_reference(protocols, list(experiment.axes), paths[0])
        specimen = Specimen(
            name=name or paths[0].stem,
            protocols=tuple(protocols),
            loads=loads,
            test=experiment.name,
            geometry=str(header.get("geometry", "unloaded")),
            load_noise=None if noise is None else float(noise),
            metadata=_metadata(recordings, paths, choice, header),
            **{key: header[key] for key in ARGUMENT_KEYS if key in header},  # type: ignore[arg-type]
        )
        findings = check_specimen(specimen)
    except ReadingError as error:
        of_error = next((r for r in recordings if r.name == error.protocol), None)
        if of_error is None:
            raise
        columns = dict(zip(CURVES, of_error.record.columns, strict=True))
        raise error.at(of_error.record.path, of_error.lines, columns) from None
    for protocol, recording in zip(specimen.protocols, recordings, strict=True):
        _check_start(protocol, recording)
        if in_doubt:
            _ask_about_far_start(recording, paths[0])
    errors = [str(f) for f in findings if f.severity == "error"]
    if errors and choice.rows is None and choice.branch in (None, "loading"):
        gives = {"rows=LINES": "lines of a loading branch", "rows=all": "as it is"}
        raise Question(errors[0], gives, file=paths[0])
    return Conversion(
        specimen, tuple(recordings), tuple(protocols), tuple(records), findings, *given
    )


def _check_header(header: Header, loads: str, test: Experiment, file: Path) -> None:
    """Ask for the dimensions that loads of the test need; refuse the noise of other loads."""
    unit = test.loads[loads].units[0]
    other = "kPa" if unit == "N" else "N"
    if f"load_noise_{other}" in header:
        problem = f"`load_noise_{other}` does not fit: the columns are in {unit}"
        raise InputError(problem, remedy=f"give `load_noise_{unit}`")
    for key in (key for key in test.needed(loads) if key not in header):
        readings = test.loads[loads].compared if test.is_mounted else f"readings of a {test.name}"
        problem = f"{readings} need {key}"
        if key == "geometry":
            gives = {
                "geometry=unloaded": "dimensions were measured on the unloaded tissue",
                "geometry=mounted": "they were measured after mounting",
            }
            raise Question(f"{problem}: {KEYS[key].meaning}", gives, file=file, likely=False)
        assumed = f"{key}={1 if key == 'thickness_mm' else 10}"
        raise Question(problem, {f"{key}=MM": KEYS[key].meaning}, file=file, assumed=assumed)


def _ask_for_reference(protocols: Sequence[Protocol], axes: Sequence[int], file: Path) -> None:
    """Ask for the reference of protocols that start at different stretches."""
    starts = np.array([p.known_stretch[: max(p.rest_rows, 1)].mean(axis=0) for p in protocols])
    if np.ptp(starts, axis=0).max() <= LARGE_DRIFT:
        return
    named = zip(protocols, starts, strict=True)
    shown = "; ".join(f"{p.name}: {x:.4f}, {y:.4f}" for p, (x, y) in named)
    gives = {
        "reference=each protocol": "each starts at the mounted state, by which it is divided",
        "reference=common": "one reference for all; those that start elsewhere have no rest",
    }
    own = [p.known_stretch / start for p, start in zip(protocols, starts, strict=True)]
    if not np.ptp(np.concatenate(own), axis=0)[axes].all():
        del gives["reference=each protocol"]  # a direction is held at levels
    raise Question(f"its protocols start at different stretches ({shown[:300]})", gives, file=file)


def _ask_about_far_start(r: Recording, file: Path) -> None:
    """Ask for the reference where a chosen cycle starts far from the first rows of its record."""
    of_protocol = [
        cycles for cycles in r.record.cycles.values()
        if any(np.isin(r.rows, cycle.loading).any() for cycle in cycles)
    ]  # fmt: skip
    if r.branch != "loading" or not of_protocol or len(of_protocol[0]) < 2:
        return
    first, axes = int(of_protocol[0][0].loading[0]), list(r.axes)
    at_first = r.record.stretch[first, axes]
    if np.abs(r.stretch[0, axes] - at_first).max() <= LARGE_DRIFT:
        return
    at = (first, r.rows[0])
    of_record, own = (r.record.stretches_text(r.record.stretch[k], ".4f") for k in at)
    gives = {
        "reference=each protocol": f"its own start, {own}, is the mounted state",
        "reference=common": "the mounted state is where the columns are one",
        f"mounted_state_x={at_first[0]:.5g}": "the first rows are (and mounted_state_y)",
    }
    problem = f"the cycle in lines {r.lines[0]} to {r.lines[-1]} starts at {own}, and its record "
    problem += f"in line {r.record.lines[first]} at {of_record}"
    raise Question(problem, gives, file=file)


def _check_start(p: Protocol, r: Recording) -> None:
    """Refuse a loading branch that falls below the state that it starts from."""
    if r.branch != "loading" or p.rest_rows == 0:
        return
    stretch = p.known_stretch
    total = p.recorded_load.sum(axis=1)
    rise = stretch[np.argmax(total)] - stretch[np.argmin(total)]
    along = (stretch - stretch[: p.rest_rows].mean(axis=0)) @ rise
    along /= max(float(np.linalg.norm(rise)), 1e-300)
    low, scatter = int(along.argmin()), second_difference_scatter(along)
    if along[low] < -max(BELOW_START * float(np.ptp(along)), 6.0 * scatter):
        at = r.record.stretches_text(p.stretch[low], ".4f")
        problem = f"the loading branch {r.name!r} falls to {at} of the state that it starts from"
        remedy = "give the lines of the loading side with `rows`"
        raise InputError(problem, file=r.record.path, row=int(r.lines[low]), remedy=remedy)


def _named_recordings(
    files: Files, choice: Choice, header: Header, names: Sequence[str]
) -> tuple[list[Record], list[Recording]]:
    """Records of all files, and their recordings with the given names or those in the files."""
    records: list[Record] = []
    recordings: list[Recording] = []
    several = len(files) > 1 or len(next(iter(files.values()))) > 1
    if choice.join is None and choice.machine == "generic" and several:
        _ask_for_join(files, choice)
    if choice.join in ("time", "stretch"):
        tables = [t for path, s in files.items() for t in _tables(path, s, choice)[0].values()]
        of_files = {next(iter(files)): generic.joined(tables, choice, header)}
    else:
        of_files = {path: _records(path, s, choice, header) for path, s in files.items()}
    for path, of_file in of_files.items():
        in_file = [r for record in of_file for r in select(record, choice)]
        for r in in_file:
            name = f"{r.record.name} {r.name}".strip() if r.record.name != r.name else r.name
            name = name if len(of_files) == 1 else f"{path.stem} {name}"
            recordings.append(replace(r, name=path.stem if len(in_file) == 1 else name))
        records += of_file
    recordings = without_repeats(recordings, choice)
    kinds = {r.record.experiment.loads[r.record.loads].words for r in recordings}
    if len(kinds) > 1:
        problem = f"the files hold different loads ({', '.join(sorted(kinds))})"
        raise InputError(problem, remedy="convert them with the same columns")
    names = list(names) or [r.name for r in recordings]
    if len(names) != len(recordings):
        of = ", ".join(f"{r.name} from {r.record.source}" for r in recordings)
        problem = f"{len(names)} protocol names for {len(recordings)} protocols"
        raise InputError(problem, remedy=f"the protocols are {of[:300]}")
    for name in names:
        if not name.strip() or names.count(name) > 1:
            problem = f"protocol name {name[:40]!r} is empty or duplicated"
            raise InputError(problem, remedy="give `protocol_names`, one per protocol")
    named = zip(recordings, names, strict=True)
    return records, [replace(r, name=name) for r, name in named]


def _ask_for_join(files: Files, choice: Choice) -> None:
    """Ask how tables belong together that have the named columns only together."""
    names, tables = generic.names_of(choice), list[Table]()
    for path, sheets in files.items():
        chosen = choice.sheets or ((ALL_SHEETS,) if "" not in sheets else ())
        tables += tables_in(sheets, path, chosen, choice.hidden or "keep", names)[0].values()
    plain = [each for each in names if "*" not in each[-1]]
    found = [[any(map(t.has_column, each)) for each in plain] for t in tables]
    if len(tables) > 1 and not any(map(all, found)) and all(map(any, zip(*found, strict=True))):
        problem = f"of {len(tables)} tables none has all of the columns, and all together have them"
        raise Question(problem, generic.JOINS, file=next(iter(files)))


def _tables(path: Path, sheets: Sheets, choice: Choice) -> tuple[dict[str, Table], dict[str, str]]:
    """Tables of a file by sheet, below the columns that are named; and why others hold none."""
    named = generic.names_of(choice) if choice.machine == "generic" else []
    chosen = choice.sheets
    if choice.join in ("time", "stretch") and not chosen and "" not in sheets:
        chosen = (ALL_SHEETS,)
    return tables_in(sheets, path, chosen, choice.hidden, named)


def _records(path: Path, sheets: Sheets, choice: Choice, header: Header) -> list[Record]:
    """Records of all tables of a file; sheets without the columns are left out."""
    tables, skipped = _tables(path, sheets, choice)
    reader = import_module(f"biaxbayes.machines.{choice.machine}")
    records: list[Record] = []
    for sheet, table in tables.items():
        if len(tables) > 1 and not reader.recognises(table, choice):
            skipped[sheet] = "has none of the columns"
            continue
        for record in reader.records(table, choice, header):
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
    assumed = [note for r in recordings for note in (*r.record.assumptions, *r.assumptions)]
    if assumed:
        metadata["conversion"] = "; ".join(dict.fromkeys(assumed))
    gradients = [r.record.gradient[r.rows] for r in recordings if r.record.gradient is not None]
    if gradients:
        # rounded, as it is a caution and not a measurement
        gradient = np.concatenate(gradients)
        # of the right angle between x and y: C = F^T F;  sin(gamma) = C12 / sqrt(C11 C22)
        C = np.einsum("nki,nkj->nij", gradient, gradient)
        sine = C[:, 0, 1] / np.sqrt(C[:, 0, 0] * C[:, 1, 1])
        angle = np.abs(np.degrees(np.arcsin(np.clip(sine, -1.0, 1.0))))
        metadata["largest_shear"] = float(f"{np.abs(gradient[:, [0, 1], [1, 0]]).max():.3g}")
        metadata["largest_shear_angle_deg"] = float(f"{angle.max():.3g}")
    return metadata
