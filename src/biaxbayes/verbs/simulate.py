"""``biaxbayes simulate``: a virtual biaxial test, written as a specimen file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.experiments import BIAXIAL, EXPERIMENTS
from biaxbayes.laws import LAWS, law_named
from biaxbayes.laws.goh import GOH
from biaxbayes.laws.materials import CheckedMaterial, MaterialResponse
from biaxbayes.laws.published import MATERIALS, PublishedMaterial
from biaxbayes.options import Options, Settings, option, options_of, takes_options
from biaxbayes.reports.text import plural
from biaxbayes.specimens.check import check_round_trip
from biaxbayes.specimens.keys import GEOMETRIES, NO_GRIPS, checked_value
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.specimen_file import write_specimen
from biaxbayes.specimens.truth import Truth, truth_file, write_truth
from biaxbayes.verbs import options as opt
from biaxbayes.verbs.inputs import as_numbers, check_new

DEFAULT_HOOKS = 5
LOWEST, HIGHEST = 0.5, 3.0
"""Range of stretches."""
STRETCHES: dict[str, Any] = {"kind": float, "between": (LOWEST, HIGHEST)}


@dataclass(frozen=True)
class SimulateOptions(Options):
    """A virtual test.

    ``material`` is the name of a published one, or one of your own: ``biaxbayes.law("fung", ...)``.
    """

    material: object = option(None, "A published material; 'list' prints them.", metavar="NAME")
    fibre_switch: bool = option(False, options_of(Settings)["fibre_switch"].help)
    test: str = option(BIAXIAL.name, "Kind of test.", choices=tuple(EXPERIMENTS))
    prestretch: Sequence[float] | None = option(
        None, "Mounting stretches; the published ones by default.", metavar="X Y"
    )
    total_stretch: float | None = option(
        None, "Largest stretch from unloaded.", metavar="L", **STRETCHES
    )
    measured_stretch: float | None = option(
        None, "Largest stretch from mounted.", metavar="L", **STRETCHES
    )
    ratios: Sequence[tuple[float, float]] = option(
        (),
        "Stretch ratio, one protocol each time it is given  [default: 1:1]",
        metavar="X:Y",
        flag="ratio",
    )
    increments: int = option(100, between=(1, 100_000))
    edge: tuple[float, float] = option(
        (20.0, 20.0), "Unloaded edge, 20 or 20x15 (x, y)  [default: 20]", metavar="MM"
    )
    thickness: float | None = option(
        None, "Unloaded thickness  [default: 1]", kind=float, inside=(0.0, 1e3), metavar="MM"
    )
    header: Mapping[str, float] | None = option(
        None,
        "Dimension of a test without a mounted state, as unloaded_outer_diameter_mm=8 of a tube; "
        "repeatable.",
        metavar="KEY=VALUE",
    )
    axial_stretches: Sequence[float] = option(
        (),
        "Axial stretch of a tube, one a protocol  [default: 1]",
        metavar="L",
        flag="axial-stretch",
    )
    noise_kPa: float = option(
        0.0, "Sd of a reading in kPa, such as a pressure.", minimum=0.0, metavar="KPA"
    )
    noise_N: float = option(0.0, "Sd of a force reading.", minimum=0.0, metavar="N")
    misfit: float = option(0.0, "Sd of a smooth error, share of force.", minimum=0.0, metavar="R")
    loads: str = option(
        "force",
        "What the file holds: N, or kPa as a lab computes it.",
        choices=tuple(BIAXIAL.loads),
    )
    geometry: str = option(
        "unloaded", "State whose dimensions the file states.", choices=GEOMETRIES
    )
    hooks: int | None = option(
        None,
        "Finite elements with N hooks per edge (default 5).",
        kind=int,
        between=(1, 50),
        metavar="[N]",
    )
    seed: int = option(0, minimum=0)
    name: str | None = option(None, "Name of the specimen  [default: that of the file]")


@takes_options(SimulateOptions)
def simulate(
    out: str | Path | None = None, *, overwrite: bool = False, **options: Any
) -> tuple[Specimen, Truth]:
    """Simulate a virtual biaxial test, and write it to ``out`` as a specimen file.

    Parameters
    ----------
    out : path-like, optional
        The CSV; the truth goes into ``<stem>.truth.json`` beside it, which no fit reads.
    overwrite : bool
        Replace files of the same name.
    **options
        As in :class:`SimulateOptions`.

    Raises
    ------
    InputError
        For an impossible test, or a file that exists already.
    """
    test = SimulateOptions.from_values(options)
    if out is not None:
        if not Path(out).parent.is_dir():
            raise InputError("no such folder", file=Path(out).parent, remedy="make it first")
        for path in (Path(out), truth_file(Path(out))):
            check_new(path, overwrite)
    specimen, truth = _simulate(test, test.name or ("virtual" if out is None else Path(out).stem))
    if out is not None:
        # The truth first, so that no specimen is left without its truth.
        write_truth([truth], truth_file(Path(out)))
        write_specimen(specimen, Path(out))
    return specimen, truth


def _simulate(test: SimulateOptions, name: str) -> tuple[Specimen, Truth]:
    """Specimen and truth of the test."""
    from biaxbayes.fem.sheet_tester import Hooks
    from biaxbayes.specimens import virtual_specimen as virtual

    material, published = _material(test)
    _check_options(test, material)
    thickness = test.thickness or published.thickness_mm or 1.0
    common: dict[str, Any] = {n: getattr(test, n) for n in ("test", "increments", "seed")}
    common |= {"name": name, "source": published.source}
    keys: dict[str, Any] = {}
    try:
        with np.errstate(all="ignore"):  # an overflow is seen in the result
            if not EXPERIMENTS[test.test].is_mounted:
                specimen, truth = virtual.virtual_inflation(
                    material,
                    thickness_mm=thickness,
                    header={k: float(checked_value(k, v)) for k, v in (test.header or {}).items()},
                    largest_stretch=test.total_stretch or 1.0,
                    axial_stretches=_stretches(test.axial_stretches or (1.0,), "axial_stretches"),
                    noise={"kPa": test.noise_kPa, "N": test.noise_N},
                    misfit=test.misfit,
                    **common,
                )
            else:
                edge_x, edge_y = as_numbers(test.edge, "edge", 2).tolist()
                hooks = Hooks(count=test.hooks) if test.hooks else None
                of_machine = ("noise_N", "misfit", "loads", "geometry")
                specimen, truth = virtual.virtual_specimen(
                    material,
                    **_path(test, published),
                    dimensions=virtual.Dimensions(edge_x, edge_y, thickness),
                    machine=virtual.Machine(**{n: getattr(test, n) for n in of_machine}),
                    hooks=hooks,
                    **common,
                )
                keys = {"grips": NO_GRIPS} if EXPERIMENTS[test.test].is_biaxial else {}
                if hooks is not None:
                    keys = {"grips": f"hooks {hooks.count}", "grip_inset_mm": hooks.inset_mm}
                    keys["grip_width_mm"] = 2.0 * hooks.radius_mm
    except ValueError as error:
        raise InputError(str(error), remedy="see 'biaxbayes simulate --help'") from None
    specimen = replace(specimen, metadata={**specimen.metadata, **keys})
    try:
        check_round_trip(specimen, name)
    except InputError as error:
        problem = f"this test gives a record that cannot be used: {error.problem}"
        remedy = "choose another stretch, ratio or material"
        raise InputError(problem, remedy=remedy) from None
    return specimen, truth


OF_MOUNTED = ("prestretch", "measured_stretch", "ratios", "edge", "loads", "geometry")
OF_OTHERS = ("axial_stretches", "header", "noise_kPa")
"""Options of tests that start from a mounted state, and of those that do not."""


def _check_options(test: SimulateOptions, material: MaterialResponse) -> None:
    """Refuse options that do not belong to the kind of test."""
    kind, defaults = EXPERIMENTS[test.test], SimulateOptions()
    for name in OF_OTHERS if kind.is_mounted else OF_MOUNTED:
        if not np.array_equal(getattr(test, name), getattr(defaults, name)):
            problem = f"`{name}` does not belong to a {test.test} test"
            raise InputError(problem, remedy="leave it out")
    if not kind.is_mounted:
        header = {"thickness_mm": test.thickness} | dict(test.header or {})
        for key in kind.needed(next(iter(kind.loads))):
            if key not in header:
                problem = f"a {test.test} test needs {key}"
                raise InputError(problem, remedy=f"give `header={key}=...`")
        for key in header.keys() - {"thickness_mm", *kind.keys}:
            problem = f"`header`: a {test.test} test has no key {str(key)[:60]!r}"
            raise InputError(problem, remedy=f"it has {', '.join(kind.keys)}")
        if test.total_stretch is None:
            problem = f"a {test.test} test needs its largest stretch"
            raise InputError(problem, remedy="give `total_stretch`")
    if test.hooks and not (kind.is_biaxial and isinstance(material, GOH)):
        problem = "tests on `hooks` are simulated for squares of the law goh alone"
        raise InputError(problem, remedy="leave `hooks` out, or give such a test and material")


def _material(test: SimulateOptions) -> tuple[Any, PublishedMaterial]:
    """The material to test, and what is published with it."""
    if isinstance(test.material, MaterialResponse):
        published = PublishedMaterial(test.material, "command line")
    elif isinstance(test.material, str) and test.material in MATERIALS:
        published = MATERIALS[test.material]
    else:
        remedy = f"make one by biaxbayes.law(...), or name one of {', '.join(MATERIALS)}"
        raise InputError(f"unknown material {str(test.material)[:60]!r}", remedy=remedy)
    material = published.material
    if test.fibre_switch and isinstance(material, GOH):
        material = replace(material, fibre_switch=True)
    elif test.fibre_switch:
        switched = law_named(material.law.key, fibre_switch=True)
        material = CheckedMaterial(switched, material.theta)
    return material, published


def _path(test: SimulateOptions, published: PublishedMaterial) -> dict[str, Any]:
    """Mounting stretch, largest stretch and ratios, from the options or as published."""
    if test.prestretch is None and published.mounting_stretch == (1.0, 1.0):
        problem = "no mounting stretch is published with this material"
        raise InputError(problem, remedy="give `prestretch` X Y (1 1 for none)")
    given = published.mounting_stretch if test.prestretch is None else test.prestretch
    mounting = _stretches(given, "prestretch", 2)
    total, measured = test.total_stretch, test.measured_stretch
    if total is None and measured is None:
        measured = published.measured_stretch
    if measured == 1.0 or total in mounting:
        raise InputError("the test ends where it starts", remedy="choose a larger stretch")
    ratios = as_numbers(test.ratios, "ratios") if len(test.ratios) else np.ones((1, 2))
    if ratios.shape[1:] != (2,):
        raise InputError("`ratios` must be pairs of numbers", remedy="as ((1, 1), (1, 0.5))")
    return {
        "mounting_stretch": tuple(mounting),
        "total_stretch": total,
        "measured_stretch": measured,
        "ratios": tuple(map(tuple, ratios.tolist())),
    }


def _stretches(given: Any, name: str, count: int | None = None) -> list[float]:
    """Stretches of an argument."""
    stretches: list[float] = as_numbers(given, name, count).ravel().tolist()
    for value in stretches:
        if not LOWEST <= value <= HIGHEST:
            remedy = "stretches are ratios near 1, such as 1.02"
            raise InputError(f"`{name}` of {value:g} is out of range", remedy=remedy)
    return stretches


# --- the command ---------------------------------------------------------------------------------


@click.command("simulate")
@opt.options(SimulateOptions, "material")
@click.option(
    "--goh",
    nargs=5,
    type=float,
    metavar="C1 k1 k2 ALPHA KAPPA",
    help="Five numbers instead: kPa, kPa, 1, degrees, 1.",
)
@click.option("--law", metavar="NAME|FILE.py", help="Another law, or your own, with --values.")
@click.option(
    "--values",
    metavar="NAME=VALUE,...",
    help="All parameters of --law, as c0_kPa=10,c_kPa=5,b_x=8,b_y=5,b_xy=2.",
)
@opt.options(
    SimulateOptions,
    *(name for name in options_of(SimulateOptions) if name != "material"),
    prestretch={"nargs": 2, "type": float},
    ratios={"multiple": True, "type": opt.RATIO, "show_default": False},
    axial_stretches={"multiple": True, "type": float, "show_default": False},
    edge={"type": opt.pair("x", "20 or 20x15", single=True), "show_default": False},
    header={"multiple": True, "type": str, "show_default": False},
    noise_kPa={"show_default": False},
    noise_N={"show_default": False},
    misfit={"show_default": False},
    hooks={"is_flag": False, "flag_value": DEFAULT_HOOKS},
)
@opt.file_option("out", "CSV to write  [required]", "FILE")
@opt.flag("overwrite", "Replace files of the same name.")
def command(
    out: Path | None,
    material: str | None,
    goh: tuple[float, float, float, float, float] | None,
    law: str | None,
    values: str | None,
    **test: Any,
) -> None:
    r"""Simulate a virtual biaxial test, and write it as a specimen file.

    The truth goes into a second file beside it, `<stem>.truth.json`, which no fit reads.

    \b
    biaxbayes simulate --material donor2-media --noise-N 0.0006 --out media.csv
    biaxbayes simulate --goh 14 140 11.9 38.4 0.21 --prestretch 1.02 1.02 \
        --total-stretch 1.2 --ratio 1:1 --ratio 1:0.5 --out test.csv
    biaxbayes simulate --law fung --values c0_kPa=10,c_kPa=5,b_x=8,b_y=5,b_xy=2 \
        --prestretch 1.02 1.02 --total-stretch 1.2 --out fung.csv
    biaxbayes simulate --goh 15 40 4 40 0.15 --test tube --thickness 0.9 \
        --header unloaded_outer_diameter_mm=8 --total-stretch 1.28 \
        --axial-stretch 1.1 --axial-stretch 1.2 --out tube.csv
    """
    if material == "list":
        for name, published in MATERIALS.items():
            numbers = " ".join(f"{value:6g}" for value in published.material.values)
            click.echo(f"{name:18s} {numbers}  {published.source}")
        return
    if out is None:
        raise InputError("--out is missing", remedy="give --out FILE")
    chosen: Any = material
    if sum(x is not None for x in (material, goh, law or values)) != 1:
        problem = (
            "give one of --material NAME and --goh C1 k1 k2 ALPHA KAPPA, or --law with --values"
        )
        raise InputError(problem, remedy="'--material list' prints the names")
    if goh:
        try:
            chosen = GOH(*goh)
        except ValueError as error:
            remedy = "C1 and k1 in kPa, alpha in degrees"
            raise InputError(f"--goh: {error}", remedy=remedy) from None
    elif law or values:
        chosen = _given_material(law, values)
    header = dict(opt.named_number(text, "--header", "KEY=8") for text in test["header"])
    test["header"] = header or None
    specimen, truth = simulate(out, material=chosen, **test)
    rows, unit = sum(p.rows for p in specimen.protocols), specimen.unit
    paths = plural(len(specimen.protocols), "protocol")
    click.echo(f"{out}: {rows} rows, {paths}, largest load {specimen.peak_load:.4g} {unit}")
    for x, y in list(truth.disturbed_mounting_force.values())[:1]:
        click.echo(f"mounting load {x:.4g}, {y:.4g} {unit}")
    click.echo(f"truth in {truth_file(out)}")
    if specimen.is_tared:
        click.echo("the mounting load is zero: 'sample' will treat the file as tared", err=True)


def _given_material(law: str | None, values: str | None) -> Any:
    """The material of --law and --values."""
    if law is None:
        raise InputError("--values needs --law", remedy=f"give --law, one of {', '.join(LAWS)}")
    chosen = law_named(law)
    example = ",".join(f"{p.label}=..." for p in chosen.parameters)
    if values is None:
        raise InputError(f"--law {law} needs --values", remedy=f"give --values {example}")
    numbers: dict[str, float] = {}
    for text in values.split(","):
        name, value = opt.named_number(text, "--values", example)
        if name in numbers:
            raise InputError(f"--values: {name[:40]} is given twice", remedy="give it once")
        numbers[name] = value
    return chosen.checked_material(numbers)
