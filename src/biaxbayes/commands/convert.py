"""``biaxbayes convert``: machine exports to one specimen file, and what was taken from them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from biaxbayes.errors import InputError

if TYPE_CHECKING:
    from biaxbayes.specimens.machines import Conversion
    from biaxbayes.specimens.specimen import Specimen

__all__ = ["command"]

HEADER_OPTIONS = (
    ("specimen", "TEXT", "Name of the specimen (default: that of the first file)."),
    ("layer", "TEXT", "Such as media."),
    ("axis_x", "TEXT", "What x is, such as circumferential."),
    ("axis_y", "TEXT", "What y is."),
    ("geometry", "unloaded|mounted", "State that dimensions, and stresses in the file, refer to."),
    ("edge_x_mm", "MM", "Edge along x."),
    ("edge_y_mm", "MM", "Edge along y; the force in x acts on edge_y x thickness."),
    ("thickness_mm", "MM", ""),
    ("load_noise_N", "N", "Standard deviation of one force reading."),
    ("load_noise_kPa", "KPA", "The same of a stress."),
    ("edge_sd_mm", "MM", "Uncertainty of the edges."),
    ("thickness_sd_mm", "MM", "Uncertainty of the thickness."),
    ("mounting_stretch_x", "'M +- SD'", "Mounting stretch known from an image."),
    ("mounting_stretch_y", "'M +- SD'", ""),
    ("stress_limit_kPa", "KPA", "Accept stresses up to this (default 5000)."),
)


def header_options(function: Callable) -> Callable:
    """Add an option for each header key of a specimen file."""
    for key, metavar, text in reversed(HEADER_OPTIONS):
        option = f"--{key.replace('_', '-')}"
        names = [option] if option == option.lower() else [option, option.lower()]
        function = click.option(*names, key.lower(), metavar=metavar, help=text)(function)
    return function


@click.command("convert")
@click.argument("raw", type=click.Path(path_type=Path), nargs=-1, required=True)
@click.option("--machine", type=click.Choice(["biotester", "generic"]), required=True)
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Specimen file.")
@click.option(
    "--columns",
    multiple=True,
    metavar="TARGET=COLUMN[:UNIT],...",
    help="generic: stretch_x=F11,stretch_y=F22,piola_x_kPa=P11_kPa,... Targets are stretch_x, _y, "
    "force_x_N, piola_x_kPa, cauchy_x_kPa (and _y), time_s, protocol, cycle, shear_xy, shear_yx. "
    "Units are read from the ending of the column's name or given as :mN, :gf, :MPa, :um, "
    ":stretch, :engineering, :green, :percent.",
)
@click.option("--cycle", default="last", show_default=True, metavar="last|N", help="Cycle to take.")
@click.option(
    "--branch",
    type=click.Choice(["loading", "unloading", "both"]),
    default="loading",
    show_default=True,
)
@click.option(
    "--stretch-from",
    type=click.Choice(["auto", "tracked", "rake"]),
    default="auto",
    show_default=True,
    help="biotester: points tracked on the tissue, or the distance of the rakes.",
)
@click.option(
    "--set",
    "sets",
    multiple=True,
    metavar="NAME|all",
    help="biotester: sets to take as protocols (default: the last).",
)
@click.option("--sheet", help="Sheet of a workbook.")
@click.option(
    "--protocol-names", metavar="NAME,...", help="One a protocol (default: names of the files)."
)
@header_options
def command(
    raw: tuple[Path, ...],
    machine: str,
    out: Path,
    columns: tuple[str, ...],
    cycle: str,
    branch: str,
    stretch_from: str,
    sets: tuple[str, ...],
    sheet: str | None,
    protocol_names: str | None,
    **header: str | None,
) -> int:
    """Convert machine exports to one specimen file, each RAW (or set) a protocol of it."""
    from biaxbayes.specimens.machines import Choice, convert
    from biaxbayes.specimens.specimen_file import parse_specimen, specimen_text
    from biaxbayes.specimens.text_file import atomic_write_text

    _check_options(raw, machine, out, columns, cycle, sets, stretch_from)
    choice = Choice(machine, columns, _cycle(cycle), branch, stretch_from, sets, sheet)
    names = [name.strip() for name in protocol_names.split(",")] if protocol_names else []
    conversion = convert(raw, choice, header=_header(header), protocol_names=names)
    text = specimen_text(conversion.specimen)
    specimen = parse_specimen(text.split("\n"), out)  # nothing is written that cannot be read
    atomic_write_text(out, text)
    _report(conversion, specimen, out)
    return 0


def _check_options(
    raw: tuple[Path, ...],
    machine: str,
    out: Path,
    columns: tuple[str, ...],
    cycle: str,
    sets: tuple[str, ...],
    stretch_from: str,
) -> None:
    if machine == "biotester" and columns:
        raise InputError("--columns is for --machine generic", remedy="leave it out")
    if machine == "generic" and (sets or stretch_from != "auto"):
        raise InputError(
            "--set and --stretch-from are for --machine biotester", remedy="leave them out"
        )
    seen: set[Path] = set()
    for path in raw:
        try:
            real = path.resolve()
            same = real == out.resolve()
        except (OSError, RuntimeError, ValueError):
            continue  # the reader says what is wrong with it
        if same:
            raise InputError("would be overwritten", file=path, remedy="choose another --out")
        if real in seen:
            raise InputError("is given twice", file=path, remedy="name each file once")
        seen.add(real)


def _cycle(text: str) -> str:
    if text == "last":
        return text
    if not (text.isascii() and text.isdigit() and len(text) < 10 and int(text) > 0):
        raise InputError(f"--cycle {text[:20]!r} is no cycle", remedy="give a number or 'last'")
    return str(int(text))


def _header(options: dict[str, str | None]) -> dict[str, float | str]:
    from biaxbayes.specimens.header import checked_value

    values: dict[str, float | str] = {}
    for key, _, _ in HEADER_OPTIONS:
        text = options[key.lower()]
        if text is not None and text.strip():
            values[key] = checked_value(key, " ".join(text.split()))
    return values


def _report(conversion: Conversion, specimen: Specimen, out: Path) -> None:
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
            f"{r.branch} branch{', turned round' if r.branch == 'unloading' else ''}"
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
    if not conversion.geometry_stated:
        click.echo("  geometry not stated: the stresses are taken to refer to the unloaded state")
    shear: Any = specimen.metadata.get("largest_shear")
    if shear is not None:
        click.echo(f"  largest shear {shear:g}, which the model ignores")
    click.echo(f"next: biaxbayes check {out}")


def _range(stretch: Any) -> str:
    return f"{stretch.min():.4f}-{stretch.max():.4f}"
