"""``biaxbayes check``, ``convert`` and ``simulate``: specimen files, read and made."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from biaxbayes.cli.options import (
    HEADER_OPTIONS,
    Pair,
    argument,
    file_option,
    header_options,
    options,
)
from biaxbayes.errors import InputError
from biaxbayes.laws import LAWS
from biaxbayes.machines import BRANCHES, DIRECTIONS, FORMATS, GAUGE_AT, STRETCH_SOURCES
from biaxbayes.options import VirtualTest
from biaxbayes.tables.units import STRAINS, units_of

if TYPE_CHECKING:
    from biaxbayes.jobs.specimen_files import Checked
    from biaxbayes.machines.conversion import Conversion
    from biaxbayes.specimens.specimen import Specimen
    from biaxbayes.specimens.virtual_specimen import Truth

__all__ = ["check", "convert", "simulate"]


# --- check: what the tool understands of a specimen file, and what is odd about it ---------------


@click.command("check")
@argument("specimen")
@file_option("figure", "Draw the record (.pdf, .png or .svg).")
@click.option("--json", "as_json", is_flag=True, help="One object instead of the text.")
@click.option(
    "--fit/--no-fit",
    "with_fit",
    default=True,
    show_default=True,
    help="Whether to try if GOH can follow the record.",
)
def check(specimen: Path, figure: Path | None, as_json: bool, with_fit: bool) -> int:
    """Print what is understood of a specimen file, and warn of what may go wrong.

    Exit code 0 for a record that 'sample' takes, with or without warnings; 2 for one with an error,
    which 'sample' refuses without --anyway.
    """
    from biaxbayes.jobs import specimen_files

    found = specimen_files.check(specimen, fit=with_fit, figure=figure)
    if as_json:
        import json

        click.echo(json.dumps(found.record(), indent=2, ensure_ascii=False, allow_nan=False))
    else:
        _tell_checked(found)
        if figure is not None:
            click.echo(f"figure: {figure}")
    refused = any(finding.severity == "error" for finding in found.findings)
    return InputError.exit_code if refused else 0


def _tell_checked(found: Checked) -> None:
    specimen, findings, about = found.specimen, found.findings, found.record()
    layer = f", {specimen.layer}" if specimen.layer else ""
    click.echo(f"specimen {specimen.name}{layer}")
    axes = [f"{k} {getattr(specimen, f'axis_{k}')}" for k in "xy" if getattr(specimen, f"axis_{k}")]
    if axes:
        click.echo(f"  axes       {', '.join(axes)}")
    click.echo(f"  dimensions {_dimensions(specimen)}")
    if about["section_x_mm2"] is not None:
        click.echo(
            f"  sections   {about['section_x_mm2']:.4g} mm2 under the force in x, "
            f"{about['section_y_mm2']:.4g} mm2 in y"
        )
    kind = {"force": "force", "piola": "first Piola-Kirchhoff stress", "cauchy": "Cauchy stress"}
    rows = sum(p["rows"] for p in about["protocols"])
    count = len(about["protocols"])
    click.echo(
        f"  readings   {kind[specimen.stress_pair]} in {specimen.unit}, {rows} rows in {count} "
        f"{'protocol' if count == 1 else 'protocols'}"
    )
    origin = "stated" if specimen.load_noise is not None else "from the scatter of the rows"
    click.echo(f"  load noise {specimen.noise_sd:.3g} {specimen.unit}, {origin}")
    for key, value in specimen.metadata.items():
        click.echo(f"  {key}: {value}")
    click.echo("")
    for line in _protocol_table(about):
        click.echo(line)
    click.echo("")
    for finding in findings:
        click.echo(_wrapped(str(finding)))
    errors, count = (sum(f.severity == s for f in findings) for s in ("error", "warning"))
    if errors:
        click.echo("'sample' refuses it without --anyway")
    if count or not errors:
        click.echo(f"{count or 'no'} {'warning' if count == 1 else 'warnings'}")


def _dimensions(specimen: Specimen) -> str:
    if specimen.edge_x_mm is None or specimen.edge_y_mm is None:
        text = "not stated"
    else:
        text = f"{specimen.edge_x_mm:g} x {specimen.edge_y_mm:g} mm"
    if specimen.thickness_mm is not None:
        text += f", {specimen.thickness_mm:g} mm thick"
    return f"{text} (stresses and dimensions refer to the {specimen.geometry} state)"


def _protocol_table(about: dict[str, Any]) -> list[str]:
    unit = about["unit"]
    heads = (
        "protocol",
        "rows",
        "at rest",
        "stretch x",
        "stretch y",
        f"mounting force x, y ({unit})",
    )
    lines = [heads]
    for p in about["protocols"]:
        forces = (
            [f"{p[f'mounting_force_{k}']:.3g} +- {p[f'mounting_force_sd_{k}']:.2g}" for k in "xy"]
            if p["rest_rows"]
            else ["of the others"]
        )
        name = p["name"] if len(p["name"]) <= 30 else p["name"][:29] + "…"
        lines.append(
            (
                name,
                str(p["rows"]),
                str(p["rest_rows"]),
                "{:.4f}-{:.4f}".format(*p["stretch_x"]),
                "{:.4f}-{:.4f}".format(*p["stretch_y"]),
                ", ".join(forces),
            )
        )
    widths = [max(len(line[i]) for line in lines) for i in range(len(heads))]
    return [
        "  " + "  ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)).rstrip()
        for line in lines
    ]


def _wrapped(text: str) -> str:
    import textwrap

    return textwrap.fill(text, width=96, subsequent_indent="    ", break_long_words=False)


# --- convert: machine exports to one specimen file, and what was taken from them -----------------


@click.command("convert")
@argument("raw", nargs=-1, required=True)
@click.option(
    "--machine",
    type=click.Choice(list(FORMATS)),
    required=True,
    help="; ".join(f"{name}: {format_.words}" for name, format_ in FORMATS.items()) + ".",
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
@click.option(
    "--branch",
    type=click.Choice(BRANCHES),
    default=BRANCHES[0],
    show_default=True,
)
@click.option(
    "--stretch-from",
    type=click.Choice(STRETCH_SOURCES),
    default=STRETCH_SOURCES[0],
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
    help="Directions whose load cell counts tension negative: their sign is turned round.",
)
@click.option(
    "--drop-missing",
    is_flag=True,
    help="Leave out rows in which a reading is missing, and count them.",
)
@click.option(
    "--protocol-names", metavar="NAME,...", help="One per protocol (default: names of the files)."
)
@click.option("--overwrite", is_flag=True, help="Replace a file of the same name.")
@header_options()
def convert(
    raw: tuple[Path, ...],
    out: Path,
    overwrite: bool,
    protocol_names: str | None,
    machine: str,
    columns: tuple[str, ...],
    cycle: str,
    branch: str,
    stretch_from: str,
    sets: tuple[str, ...],
    sheets: tuple[str, ...],
    gauge_x_mm: float | None,
    gauge_y_mm: float | None,
    gauge_at: str | None,
    tension_negative: str | None,
    drop_missing: bool,
    **header: str | None,
) -> int:
    r"""Convert machine exports to one specimen file, each RAW (or set, or sheet) a protocol of it.

    \b
    biaxbayes convert export.csv --machine biotester --out specimen.csv --geometry unloaded \
        --edge-x-mm 10 --edge-y-mm 10 --thickness-mm 1.2
    biaxbayes convert tests.xlsx --machine generic --sheet all --out specimen.csv \
        --columns stretch_x=F11,stretch_y=F22,piola_x_kPa=P11_kPa,piola_y_kPa=P22_kPa
    """
    from biaxbayes.jobs import specimen_files
    from biaxbayes.machines.conversion import Choice

    names = [name.strip() for name in protocol_names.split(",")] if protocol_names else []
    stated = {key: header[key.lower()] for key in HEADER_OPTIONS}
    found = specimen_files.convert(
        raw,
        Choice(
            machine,
            columns,
            cycle,
            branch,
            stretch_from,
            sets,
            sheets,
            gauge_x_mm,
            gauge_y_mm,
            gauge_at or "",
            drop_missing,
            tension_negative or "",
        ),
        header={key: text for key, text in stated.items() if text is not None},
        protocol_names=names,
        out=out,
        overwrite=overwrite,
    )
    _tell_converted(found, out)
    return 0


def _tell_converted(conversion: Conversion, out: Path) -> None:
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


# --- simulate: a virtual biaxial test, written as a specimen file --------------------------------


DEFAULT_HOOKS = 5
RATIO = Pair("ratio", ":", "1:0.5", zero=True)


@click.command("simulate")
@options(VirtualTest, "material")
@click.option(
    "--goh",
    nargs=5,
    type=float,
    metavar="C1 k1 k2 ALPHA KAPPA",
    help="Five numbers instead: kPa, kPa, 1, degrees, 1.",
)
@click.option("--law", type=click.Choice(list(LAWS)), help="Another law, with --values.")
@click.option(
    "--values",
    metavar="NAME=VALUE,...",
    help="All parameters of --law, as c0_kPa=10,c_kPa=5,b_x=8,b_y=5,b_xy=2.",
)
@options(
    VirtualTest,
    "fibre_switch",
    "prestretch",
    "total_stretch",
    "measured_stretch",
    "ratios",
    "increments",
    "edge",
    "thickness",
    "noise_N",
    "misfit",
    "stress_pair",
    "geometry",
    "hooks",
    "seed",
    "name",
    prestretch={"nargs": 2, "type": float},
    ratios={"multiple": True, "type": RATIO, "show_default": False},
    edge={"type": Pair("edge", "x", "20 or 20x15", single=True), "show_default": False},
    noise_N={"show_default": False},
    misfit={"show_default": False},
    hooks={"is_flag": False, "flag_value": DEFAULT_HOOKS},
)
@file_option("out", "CSV to write  [required]", "FILE")
@click.option("--overwrite", is_flag=True, help="Replace files of the same name.")
def simulate(
    out: Path | None,
    overwrite: bool,
    material: str | None,
    goh: tuple[float, float, float, float, float] | None,
    law: str | None,
    values: str | None,
    **test: Any,
) -> None:
    r"""A virtual biaxial test, written as a specimen file.

    The truth goes into a second file beside it, `<stem>.truth.json`, which no fit reads.

    \b
    biaxbayes simulate --material donor2-media --noise-N 0.0006 --out media.csv
    biaxbayes simulate --goh 14 140 11.9 38.4 0.21 --prestretch 1.02 1.02 \
        --total-stretch 1.2 --ratio 1:1 --ratio 1:0.5 --out test.csv
    biaxbayes simulate --law fung --values c0_kPa=10,c_kPa=5,b_x=8,b_y=5,b_xy=2 \
        --prestretch 1.02 1.02 --total-stretch 1.2 --out fung.csv
    """
    if material == "list":
        _tell_materials()
        return
    from biaxbayes.jobs.simulate import simulate as simulated

    if out is None:
        raise InputError("no file to write", remedy="give --out FILE")
    chosen: Any = material
    if sum(x is not None for x in (material, goh, law or values)) > 1:
        chosen = None  # as if none was given
    elif goh:
        chosen = _stated_goh(goh)
    elif law or values:
        chosen = _stated_material(law, values)
    specimen, truth = simulated(out, overwrite=overwrite, material=chosen, **test)
    _tell_simulated(specimen, truth, out)


def _stated_goh(goh: tuple[float, float, float, float, float]) -> Any:
    from biaxbayes.laws.goh import GOH

    try:
        return GOH(*goh)
    except ValueError as error:
        raise InputError(f"--goh: {error}", remedy="C1 and k1 in kPa, alpha in degrees") from None


def _stated_material(law: str | None, values: str | None) -> Any:
    """The material of --law and --values."""
    from biaxbayes.laws import law_named

    if law is None:
        raise InputError("--values without a law", remedy=f"give --law, one of {', '.join(LAWS)}")
    chosen = law_named(law)
    labels = [p.label for p in chosen.parameters]
    if values is None:
        raise InputError(
            f"--law {law} without values",
            remedy=f"give --values {','.join(f'{label}=...' for label in labels)}",
        )
    stated: dict[str, float] = {}
    for text in values.split(","):
        name, _, value = (part.strip() for part in text.partition("="))
        if name in stated:
            raise InputError(f"--values: {name[:40]} is given twice", remedy="give it once")
        try:
            stated[name] = float(value)
        except ValueError:
            raise InputError(
                f"--values: {text[:60]!r} is no NAME=VALUE",
                remedy=f"parameters of {law} are {', '.join(labels)}",
            ) from None
    try:
        return chosen.stated(stated)
    except InputError as error:
        raise InputError(f"--values: {error.problem}", remedy=error.remedy) from None


def _tell_materials() -> None:
    from biaxbayes.laws.published import MATERIALS

    for name, published in MATERIALS.items():
        m = published.material
        click.echo(
            f"{name:18s} {m.C1_kPa:6g} {m.k1_kPa:6g} {m.k2:6g} {m.alpha_deg:6g} {m.kappa:6g}"
            f"  {published.source}"
        )


def _tell_simulated(specimen: Specimen, truth: Truth, out: Path) -> None:
    from biaxbayes.jobs.simulate import truth_file

    rows, unit = sum(p.rows for p in specimen.protocols), specimen.unit
    paths = f"{len(specimen.protocols)} protocol{'s' if len(specimen.protocols) > 1 else ''}"
    click.echo(f"{out}: {rows} rows, {paths}, largest load {specimen.peak_load:.4g} {unit}")
    first = next(iter(truth.disturbed_mounting_force.values()))
    truths = truth_file(out)
    click.echo(f"mounting load {first[0]:.4g}, {first[1]:.4g} {unit}; truth in {truths}")
    if specimen.is_tared:
        click.echo("no mounting load: 'sample' will treat the file as tared", err=True)
