"""``biaxbayes convert``: machine exports to a specimen file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from biaxbayes.errors import InputError
from biaxbayes.machines.choice import BRANCHES, DIRECTIONS, FORMATS, GAUGE_AT, STRETCH_SOURCES
from biaxbayes.specimens.keys import KEYS, METADATA_KEYS, NONE, OF_FORCES, checked_value
from biaxbayes.specimens.specimen_file import parse_specimen, specimen_text
from biaxbayes.tables.units import STRAINS, likely_name, units_of
from biaxbayes.text_files import atomic_write_text
from biaxbayes.verbs.inputs import PathLike, check_new
from biaxbayes.verbs.options import Decorator, argument, choice_option, file_option, flag

if TYPE_CHECKING:
    from biaxbayes.machines.choice import Choice
    from biaxbayes.machines.conversion import Conversion


def convert(
    raw: PathLike | Sequence[PathLike],
    choice: Choice | None = None,
    *,
    header: Mapping[str, float | str] | None = None,
    protocol_names: Sequence[str] = (),
    out: PathLike | None = None,
    overwrite: bool = False,
    **choices: Any,
) -> Conversion:
    """Read machine exports as the protocols of one specimen, and write it to ``out``.

    Parameters
    ----------
    raw : sequence of path-like
        A file, or several: each (or each set or sheet in it) becomes a protocol.
    choice : Choice, optional
        What to take from the files; or its fields as keywords.
    header : mapping, optional
        Header values by their key in a specimen file (``edge_x_mm``, ``geometry``,
        ``load_noise_N``, ``layer`` ...).
    protocol_names : sequence of str
        One per protocol; by default from the names of the files.
    out : path-like, optional
        The specimen file to write; it is written only if it can be read again.
    overwrite : bool
        Replace a file of that name.
    **choices
        ``machine``, ``columns``, ``cycle``, ``branch``, ``stretch_from``, ``sets`` and ``sheets``,
        as in :class:`~biaxbayes.machines.choice.Choice`. A text counts as a list of one.

    Returns
    -------
    Conversion
        With ``out``, its specimen is the one that the file reads back to.

    Raises
    ------
    InputError
        For files, columns and options that do not fit together.
    """
    from biaxbayes.machines.conversion import convert as conversion

    choice = _choice(choice, choices)
    paths = [raw] if isinstance(raw, str | Path) else raw
    files, target = [Path(path) for path in paths], None if out is None else Path(out)
    _check_choice(choice)
    _check_raw(files, target)
    if target is not None:
        check_new(target, overwrite)
    known_keys = (*HEADER_OPTIONS, *METADATA_KEYS)
    values = {}
    for key, value in (header or {}).items():
        if key not in known_keys:
            _, hint = likely_name(str(key), known_keys)
            raise InputError(
                f"unknown header key {str(key)[:60]!r}",
                remedy=f"{hint}known keys are {', '.join(dict.fromkeys(known_keys))}",
            )
        if value is not None and str(value).strip():
            values[key] = checked_value(key, value)
    cycle = str(choice.cycle)
    if cycle != "last":
        if not (cycle.isascii() and cycle.isdigit() and len(cycle) < 10 and int(cycle) > 0):
            raise InputError(
                f"`cycle` {cycle[:20]!r} is not a cycle", remedy="give a number or 'last'"
            )
        cycle = str(int(cycle))
    chosen = replace(choice, cycle=cycle)
    result = conversion(files, chosen, header=values, protocol_names=list(protocol_names))
    if target is None:
        return result
    text = specimen_text(result.specimen, result.recorded)
    specimen = parse_specimen(text.split("\n"), target)
    atomic_write_text(target, text)
    return replace(result, specimen=specimen)


def _choice(choice: Choice | None, given: Mapping[str, Any]) -> Choice:
    """The choice from either a Choice or its fields as keywords."""
    from biaxbayes.machines.choice import Choice

    if choice is not None:
        if given:
            raise InputError(
                f"{next(iter(given))} cannot be combined with a Choice", remedy="give one"
            )
        return choice
    known = Choice.__dataclass_fields__
    for name in given:
        if name not in known:
            raise InputError(f"unknown option {name[:60]!r}", remedy=f"one of {', '.join(known)}")
    if "machine" not in given:
        raise InputError("no machine is given", remedy=f"machine={' or '.join(map(repr, FORMATS))}")
    several = {
        name: (given[name],) if isinstance(given[name], str) else tuple(given[name])
        for name in ("columns", "sets", "sheets")
        if name in given
    }
    chosen: dict[str, Any] = {**given, **several}
    return Choice(**chosen)


def _check_choice(choice: Choice) -> None:
    """Refuse options that belong to another machine format."""
    values = {
        "--columns": choice.columns,
        "--set": choice.sets,
        "--stretch-from": choice.stretch_from != STRETCH_SOURCES[0],
    }
    given = {option for option, value in values.items() if value}
    own = FORMATS[choice.machine].options if choice.machine in FORMATS else ()
    for name, format_ in FORMATS.items():
        foreign = [option for option in format_.options if option not in own]
        if given.intersection(foreign):
            verb, them = ("are", "them") if len(foreign) > 1 else ("is", "it")
            raise InputError(
                f"{' and '.join(foreign)} {verb} for `machine={name}`", remedy=f"leave {them} out"
            )


def _check_raw(raw: Sequence[Path], out: Path | None) -> None:
    seen: set[Path] = set()
    for path in raw:
        try:
            real = path.resolve()
            same = out is not None and real == out.resolve()
        except (OSError, RuntimeError, ValueError):
            continue  # the reader says what is wrong with it
        if same:
            raise InputError("would be overwritten", file=path, remedy="choose another `out`")
        if real in seen:
            raise InputError("is given twice", file=path, remedy="name each file once")
        seen.add(real)


# --- the command ---------------------------------------------------------------------------------


HEADER_OPTIONS = {
    "specimen": "TEXT",
    "layer": "TEXT",
    "axis_x": "TEXT",
    "axis_y": "TEXT",
    "geometry": "unloaded|mounted",
    "reference": "common",
    "edge_x_mm": "MM",
    "edge_y_mm": "MM",
    "thickness_mm": "MM",
    "load_noise_N": "N",
    "load_noise_kPa": "KPA",
    "edge_sd_mm": "MM",
    "thickness_sd_mm": "MM",
    "mounting_stretch_x": "'M +- SD'",
    "mounting_stretch_y": "'M +- SD'",
    "stress_limit_kPa": "KPA",
}
"""Header keys that have an option, and what the help prints for their values."""


def header_options() -> Decorator:
    """An option for each header key of a specimen file."""

    def add(function: Any) -> Any:
        for key, metavar in reversed(HEADER_OPTIONS.items()):
            meaning, default = KEYS[key].meaning, KEYS[key].default
            default = "name of the first file" if key == "specimen" else default
            without = default if default == OF_FORCES else f"default: {default}"
            text = f"{meaning}." if default == NONE else f"{meaning} ({without})."
            option = f"--{key.replace('_', '-')}"
            names = [option] if option == option.lower() else [option, option.lower()]
            function = click.option(*names, key.lower(), metavar=metavar, help=text)(function)
        return function

    return add


@click.command("convert")
@argument("raw", nargs=-1, required=True)
@click.option(
    "--machine",
    type=click.Choice(list(FORMATS)),
    required=True,
    help="; ".join(f"{name}: {format_.description}" for name, format_ in FORMATS.items()) + ".",
)
@file_option("out", "Specimen file.", required=True)
@click.option(
    "--columns",
    multiple=True,
    metavar="TARGET=COLUMN[:UNIT],...",
    help="generic: stretch_x=F11,stretch_y=F22,piola_x_kPa=P11_kPa,... Targets are stretch_x, _y, "
    "force_x_N, piola_x_kPa, cauchy_x_kPa (and _y), time_s, protocol, cycle, shear_xy, shear_yx. "
    "Units and kinds of strain are read from the column's name where it is clear, or given behind "
    f"a colon: {units_of('force', 'stress', 'length', 'displacement', *STRAINS, 'time')}.",
)
@click.option(
    "--gauge-x-mm",
    type=float,
    metavar="MM",
    help="Length between marks or grips in x where the displacement is zero.",
)
@click.option("--gauge-y-mm", type=float, metavar="MM", help="The same in y.")
@click.option(
    "--gauge-at",
    type=click.Choice(GAUGE_AT),
    help="Where the gauge length was measured if the displacement does not start at zero: at "
    "displacement zero, or at the first row of the file.",
)
@click.option("--cycle", default="last", show_default=True, metavar="last|N", help="Cycle to take.")
@choice_option("branch", BRANCHES)
@choice_option(
    "stretch-from",
    STRETCH_SOURCES,
    "biotester: points tracked on the tissue, or the distance of the rakes.",
    name="stretch_from",
)
@click.option(
    "--set",
    "sets",
    multiple=True,
    metavar="NAME|all",
    help="biotester: sets to take as protocols (default: the last).",
)
@click.option(
    "--sheet",
    "sheets",
    multiple=True,
    metavar="NAME|all",
    help="Sheet of a workbook (struct of a .mat, group of a .tdms file), a protocol each; "
    "repeatable.",
)
@click.option(
    "--tension-negative",
    type=click.Choice(DIRECTIONS),
    help="Directions whose load cell counts tension negative: their sign is reversed.",
)
@flag("drop-missing", "Leave out rows in which a reading is missing, and count them.")
@click.option(
    "--protocol-names", metavar="NAME,...", help="One per protocol (default: names of the files)."
)
@flag("overwrite", "Replace a file of the same name.")
@header_options()
def command(
    raw: tuple[Path, ...], out: Path, overwrite: bool, protocol_names: str | None, **given: Any
) -> None:
    r"""Convert machine exports to one specimen file, each RAW (or set, or sheet) a protocol of it.

    \b
    biaxbayes convert export.csv --machine biotester --out specimen.csv --geometry unloaded \
        --edge-x-mm 10 --edge-y-mm 10 --thickness-mm 1.2
    biaxbayes convert tests.xlsx --machine generic --sheet all --out specimen.csv \
        --columns stretch_x=F11,stretch_y=F22,piola_x_kPa=P11_kPa,piola_y_kPa=P22_kPa
    """
    names = [name.strip() for name in protocol_names.split(",")] if protocol_names else []
    values = {key: given.pop(key.lower()) for key in HEADER_OPTIONS}
    result = convert(
        raw,
        header={key: text for key, text in values.items() if text is not None},
        protocol_names=names,
        out=out,
        overwrite=overwrite,
        **{name: value for name, value in given.items() if value is not None},
    )
    _print_conversion(result, out)


def _print_conversion(conversion: Conversion, out: Path) -> None:
    specimen = conversion.specimen
    unit = specimen.unit
    rows = sum(p.rows for p in specimen.protocols)
    count = len(specimen.protocols)
    click.echo(f"{out}: {rows} rows in {count} {'protocol' if count == 1 else 'protocols'}")
    readings, sds = specimen.mounting_readings(shared=False)
    common = len({r.notes for r in conversion.recordings}) == 1
    for r, p, reading, sd in zip(
        conversion.recordings, specimen.protocols, readings, sds, strict=True
    ):
        lines = (int(r.lines.min()), int(r.lines.max()))
        cycle = f"cycle {r.cycle}, " if r.cycle else ""
        click.echo(f"  {p.name} from {r.source}")
        click.echo(
            f"    {p.rows} of {r.rows_in_file} rows (lines {lines[0]} to {lines[1]}), {cycle}"
            f"{r.branch} branch{', reversed' if r.branch == 'unloading' else ''}"
        )
        click.echo(
            f"    stretch x {_range(p.stretch_x)}, y {_range(p.stretch_y)} of its value at rest "
            f"({p.reference[0]:.4f}, {p.reference[1]:.4f}; "
            f"{p.rest_rows} {'row' if p.rest_rows == 1 else 'rows'})"
        )
        click.echo(
            f"    mounting force x {reading[0]:.4g} +- {sd[0]:.2g}, "
            f"y {reading[1]:.4g} +- {sd[1]:.2g} {unit}; "
            f"largest {p.load_x.max():.4g}, {p.load_y.max():.4g} {unit}"
        )
        for note in r.notes if not common else ():
            click.echo(f"    {note}")
    for note in conversion.recordings[0].notes if common else ():
        click.echo(f"  {note}")
    for note in str(specimen.metadata.get("conversion", "")).split("; "):
        if note:
            click.echo(f"  {note}")
    if not conversion.geometry_stated:
        click.echo("  geometry not stated: the stresses are taken to refer to the unloaded state")
    shear: Any = specimen.metadata.get("largest_shear")
    if shear is not None:
        click.echo(f"  largest shear {shear:g}, which the model ignores")
    click.echo(f"next: biaxbayes check {out}")


def _range(stretch: Any) -> str:
    return f"{stretch.min():.4f}-{stretch.max():.4f}"
