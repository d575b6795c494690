"""``biaxbayes convert``: machine exports to a specimen file."""

from __future__ import annotations

import itertools
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import click

from biaxbayes.errors import InputError
from biaxbayes.experiments import EXPERIMENTS
from biaxbayes.machines.choice import FORMATS, Choice
from biaxbayes.machines.outcome import (
    Conversion,
    OpenQuestions,
    read_recipe,
    recipe_text,
    refuse_other_content,
)
from biaxbayes.options import takes_options
from biaxbayes.reports.text import plural
from biaxbayes.specimens.keys import KEYS, METADATA_KEYS, OF_FORCES, checked_value
from biaxbayes.specimens.specimen_file import parse_specimen, specimen_text
from biaxbayes.tables.units import likely_name
from biaxbayes.text_files import aligned, atomic_write_text
from biaxbayes.verbs import options as opt
from biaxbayes.verbs.inputs import PathLike, check_new

BESIDE = ("-record.png", "-recipe.toml")
"""Ends of the names of the picture and the recipe beside a specimen file."""


@takes_options(Choice)
def convert(
    raw: PathLike | Sequence[PathLike],
    choice: Choice | None = None,
    *,
    header: Mapping[str, float | str] | None = None,
    protocol_names: Sequence[str] = (),
    recipe: PathLike | None = None,
    out: PathLike | None = None,
    overwrite: bool = False,
    **options: Any,
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
        ``load_noise_N``, ``layer`` ...); or each as a keyword (``edge_x_mm=20``).
    protocol_names : sequence of str
        One per protocol; by default from the names of the files.
    recipe : path-like, optional
        Options and header values of an earlier conversion, as written beside its result; those
        given here replace them. A file that does not fit it is refused.
    out : path-like, optional
        The specimen file to write; it is written only if it can be read again. A picture of the
        record and the recipe are written beside it.
    overwrite : bool
        Replace a file of that name.
    **options
        As in :class:`~biaxbayes.machines.choice.Choice`. A text counts as a list of one.

    Returns
    -------
    Conversion
        With ``out``, its specimen is the one that the file reads back to.

    Raises
    ------
    OpenQuestions
        All choices that the files leave, with proposals; nothing is written. Each proposal names
        the argument that takes it.
    InputError
        For files, columns and options that do not fit together.
    """
    from biaxbayes.machines.conversion import convert as conversion

    found: dict[str, Any] = {}
    known_keys = (*HEADER_OPTIONS, *METADATA_KEYS)
    of_header = set(known_keys) - {f.name for f in fields(Choice)}
    keys = {name: options.pop(name) for name in [*options] if name in of_header}
    header = {**(header or {}), **keys}
    if recipe is not None:
        answers, lab, found = read_recipe(Path(recipe))
        options, header = answers | options, lab | header
    if choice is None:
        if "machine" not in options:
            known = " or ".join(FORMATS)
            raise InputError("no machine is given", remedy=f"give `machine`: {known}")
        for name in {"columns", "sets", "sheets"} & options.keys():
            texts = options[name]
            options[name] = (texts,) if isinstance(texts, str) else tuple(texts)
        choice = Choice.from_values(options)
    elif options:
        problem = f"{next(iter(options))} cannot be combined with a Choice"
        raise InputError(problem, remedy="give one")
    files = [Path(path) for path in ([raw] if isinstance(raw, str | Path) else raw)]
    for path in files:
        if files.count(path) > 1:
            raise InputError("is given twice", file=path, remedy="name each file once")
    if out is not None:
        _check_new(files, Path(out), overwrite)
    values = {}
    for key, value in header.items():
        if key not in known_keys:
            _, hint = likely_name(str(key), known_keys)
            remedy = f"{hint}known keys are {', '.join(dict.fromkeys(known_keys))}"
            raise InputError(f"unknown header key {str(key)[:60]!r}", remedy=remedy)
        if value is not None and str(value).strip():
            values[key] = checked_value(key, value)
    result = conversion(files, choice, header=values, protocol_names=list(protocol_names))
    if len(files) > 1 and not (choice.specimen or "specimen" in values):
        result = replace(result, specimen=replace(result.specimen, name=common_stem(files)))
    if recipe is not None:
        refuse_other_content(found, result, Path(recipe))
    return result if out is None else _written(result, Path(out))


def common_stem(files: Sequence[Path]) -> str:
    """The parts that the names of files begin with in common; else the name of the first."""
    parts = [re.split(r"([-_. ]+)", path.stem) for path in files]
    same = itertools.takewhile(lambda column: len(set(column)) == 1, zip(*parts, strict=False))
    return "".join(column[0] for column in same).rstrip("-_. ") or files[0].stem


def _check_new(files: Sequence[Path], out: Path, overwrite: bool) -> None:
    """Refuse to overwrite an export, or unless asked a specimen file and what is beside it."""
    for path in files:
        if path.exists() and out.exists() and path.samefile(out):
            raise InputError("would be overwritten", file=path, remedy="choose another `out`")
    for path in (out, *_beside(out)):
        check_new(path, overwrite)


def _beside(out: Path) -> list[Path]:
    return [out.with_name(out.stem + end) for end in BESIDE]


def _written(result: Conversion, out: Path) -> Conversion:
    """The conversion as its file reads back, with the file, its picture and its recipe written."""
    from biaxbayes.figures.specimen import conversion_figure
    from biaxbayes.figures.style import save_figure

    text = specimen_text(result.specimen, result.protocols_as_measured)
    specimen = parse_specimen(text.split("\n"), out)
    atomic_write_text(out, text)
    picture, recipe = _beside(out)
    save_figure(conversion_figure(result), picture)
    atomic_write_text(recipe, recipe_text(result))
    return replace(result, specimen=specimen)


# --- the command ---------------------------------------------------------------------------------


HEADER_OPTIONS = (
    "specimen", "layer", "axis_x", "axis_y", "geometry", "reference",
    "edge_x_mm", "edge_y_mm", "thickness_mm",
    *dict.fromkeys(k for test in EXPERIMENTS.values() if not test.is_mounted for k in test.keys),
    "load_noise_N", "load_noise_kPa", "edge_sd_mm", "thickness_sd_mm",
    "mounting_stretch_x", "mounting_stretch_y", "mounted_state_x", "mounted_state_y",
    "stress_limit_kPa",
)  # fmt: skip
"""Header keys that have an option, among them all of tests without a mounted state."""


def _header_option(key: str) -> opt.Decorator:
    """An option for a header key of a specimen file."""
    meaning, default, between, choices = KEYS[key]
    metavar = "TEXT" if between is None else key.rpartition("_")[2].upper()  # the unit
    if choices:
        metavar = "|".join(map(shlex.quote, choices))
    elif key.startswith("mounting_stretch"):
        metavar = "'M +- SD'"
    default = "what the names of the files begin with" if key == "specimen" else default
    without = default if default == OF_FORCES else f"default: {default}"
    text = f"{meaning}." if default == "none" else f"{meaning} ({without})."
    flag = f"--{key.replace('_', '-')}"
    flags = dict.fromkeys([flag, flag.lower()])
    return click.option(*flags, key.lower(), metavar=metavar, help=text)


@click.command("convert")
@opt.argument("raw", nargs=-1, required=True)
@click.option(
    "--machine",
    type=click.Choice(list(FORMATS)),
    help="; ".join(f"{name}: {words}" for name, words in FORMATS.items()) + ".",
)
@opt.file_option("out", "Specimen file.", required=True)
@opt.options(
    Choice,
    columns={"multiple": True, "show_default": False},
    sets={"multiple": True, "show_default": False},
    sheets={"multiple": True, "show_default": False},
)
@click.option(
    "--protocol-names", metavar="NAME,...", help="One per protocol (default: names of the files)."
)
@opt.file_option("recipe", "Answers of an earlier conversion, for files of the same kind.")
@opt.flag("overwrite", "Replace files of the same names.")
@opt.together(*map(_header_option, HEADER_OPTIONS))
def command(
    raw: tuple[Path, ...], out: Path, overwrite: bool, protocol_names: str | None, **given: Any
) -> None:
    r"""Convert machine exports to one specimen file, each RAW (or set, or sheet) a protocol of it.

    \b
    biaxbayes convert export.csv --machine biotester --out specimen.csv --geometry unloaded \
        --cycles last --branch loading --edge-x-mm 10 --edge-y-mm 10 --thickness-mm 1.2
    biaxbayes convert tests.xlsx --machine generic --sheet all --out specimen.csv \
        --columns stretch_x=F11,stretch_y=F22,piola_x_kPa=P11_kPa,piola_y_kPa=P22_kPa
    biaxbayes convert strip.csv --machine generic --test "strip x" --out strip-x.csv \
        --columns "stretch_x=1 + {Disp [mm]} / 20.6,force_x_N=Load [N]" --edge-y-mm 3 \
        --thickness-mm 1.2 --geometry unloaded
    biaxbayes convert tube.csv --machine generic --test tube --out tube-specimen.csv \
        --columns "outer_diameter_mm=OD [um],stretch_z=lambda z,pressure_kPa=P [mmHg]" \
        --unloaded-outer-diameter-mm 8 --thickness-mm 0.9
    """
    names = [name.strip() for name in protocol_names.split(",")] if protocol_names else []
    values = {key: given.pop(key.lower()) for key in HEADER_OPTIONS}
    header = {key: text for key, text in values.items() if text is not None}
    answers = {name: value for name, value in given.items() if opt.was_given(name)}
    _check_new(raw, out, overwrite)
    try:
        result = convert(raw, header=header, protocol_names=names, **answers)
    except OpenQuestions as asked:
        _print_questions(asked)
        count = len(asked.questions)
        remedy = "nothing is written; add one of the options" + " of each" * (count > 1)
        text = asked.questions[0].text if count == 1 else f"{count} questions are open"
        raise InputError(text, file=asked.file, remedy=remedy) from None
    _print_conversion(result)
    _written(result, out)
    for what, path in zip(("specimen", "picture", "recipe"), (out, *_beside(out)), strict=True):
        click.echo(f"{what}: {path}")
    click.echo(f"next: biaxbayes check {out}")


def _print_questions(asked: OpenQuestions) -> None:
    """Each question with the options that answer it, and what each would give."""
    if asked.obstacle:
        click.echo(f"with the likely answers it stops: {asked.obstacle}", err=True)
    flags = {p.name: p.opts[0] for p in click.get_current_context().command.params}
    for number, question in enumerate(asked.questions, start=1):
        if len(asked.questions) > 1:
            click.echo(f"{number}. {question.text}", err=True)
        lines = []
        for p in question.proposals:
            flag = flags.get(p.option.lower(), f"--{p.option.replace('_', '-')}")
            answer = flag if p.value == "True" else f"{flag} {shlex.quote(p.value)}"
            lines.append((answer, p.label))
        for line in aligned(lines):
            click.echo(f"  {line}", err=True)


def _print_conversion(conversion: Conversion) -> None:
    """The account of every row, and what 'check' finds."""
    specimen = conversion.specimen
    rows = sum(p.rows for p in specimen.protocols)
    click.echo(f"{specimen.name}: {rows} rows in {plural(len(specimen.protocols), 'protocol')}")
    click.echo("  " + conversion.account.replace("\n", "\n  "))
    readings, sds = specimen.mounting_readings(shared=False)
    for p, reading, sd in zip(specimen.protocols, readings, sds, strict=True):
        if p.rest_rows:
            axes = specimen.experiment.axes
            read = ", ".join(f"{'xy'[k]} {reading[k]:.4g} +- {sd[k]:.2g}" for k in axes)
            click.echo(f"  {p.name}: mounting force {read} {specimen.unit}")
    if "geometry" not in conversion.header and specimen.experiment.is_mounted:
        click.echo("  geometry not stated: the stresses are taken to refer to the unloaded state")
    for finding in conversion.findings:
        if finding.severity != "note" or finding.code == "shear":
            click.echo(f"  {finding}")
