"""``biaxbayes simulate``: a virtual biaxial test, written as a specimen file."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from biaxbayes.commands.number_pair import Pair
from biaxbayes.errors import InputError

if TYPE_CHECKING:
    from biaxbayes.mechanics.goh import GOH
    from biaxbayes.specimens.specimen import Specimen
    from biaxbayes.specimens.virtual_specimen import Dimensions, Truth

DEFAULT_HOOKS = 5


@click.command("simulate")
@click.option("--material", metavar="NAME", help="A published material; 'list' prints them.")
@click.option(
    "--goh",
    nargs=5,
    type=float,
    metavar="C1 k1 k2 ALPHA KAPPA",
    help="Five numbers instead: kPa, kPa, 1, degrees, 1.",
)
@click.option("--fibre-switch", is_flag=True, help="Fibres carry no compression (Abaqus, FEBio).")
@click.option(
    "--prestretch",
    nargs=2,
    type=float,
    metavar="X Y",
    help="Mounting stretches; the published ones by default.",
)
@click.option("--total-stretch", type=float, metavar="L", help="Largest stretch from unloaded.")
@click.option("--measured-stretch", type=float, metavar="L", help="Largest stretch from mounted.")
@click.option(
    "--ratio",
    "ratios",
    multiple=True,
    type=Pair("ratio", ":", single=False, zero=True),
    metavar="X:Y",
    help="Stretch ratio, one protocol each time it is given  [default: 1:1]",
)
@click.option("--increments", type=click.IntRange(1, 100_000), default=100, show_default=True)
@click.option(
    "--edge",
    type=Pair("edge", "x", single=True),
    default="20",
    metavar="MM",
    help="Unloaded edge, 20 or 20x15 (x, y)  [default: 20]",
)
@click.option("--thickness", type=float, metavar="MM", help="Unloaded thickness  [default: 1]")
@click.option(
    "--noise-N", "noise_N", type=float, default=0.0, metavar="N", help="Sd of a force reading."
)
@click.option(
    "--misfit", type=float, default=0.0, metavar="R", help="Sd of a smooth error, share of force."
)
@click.option(
    "--stress-pair",
    type=click.Choice(["force", "piola", "cauchy"]),
    default="force",
    show_default=True,
    help="What the file holds: N, or kPa as a lab computes it.",
)
@click.option(
    "--geometry",
    type=click.Choice(["unloaded", "mounted"]),
    default="unloaded",
    show_default=True,
    help="State whose dimensions the file states.",
)
@click.option(
    "--hooks",
    type=click.IntRange(1, 50),
    is_flag=False,
    flag_value=DEFAULT_HOOKS,
    metavar="[N]",
    help=f"Finite elements with N hooks an edge ({DEFAULT_HOOKS} if not said).",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@click.option("--name", help="Name of the specimen  [default: that of the file]")
@click.option(
    "--out", type=click.Path(path_type=Path), metavar="FILE", help="CSV to write  [required]"
)
@click.option("--overwrite", is_flag=True, help="Replace files of the same name.")
def command(**options: Any) -> None:
    r"""A virtual biaxial test, written as a specimen file.

    The truth goes into a second file beside it, <stem>.truth.json, which no fit reads.

    \b
    biaxbayes simulate --material donor2-media --noise-N 0.0006 --out media.csv
    biaxbayes simulate --goh 14 140 11.9 38.4 0.21 --prestretch 1.02 1.02 \
        --total-stretch 1.2 --ratio 1:1 --ratio 1:0.5 --out test.csv
    """
    from biaxbayes.mechanics.materials import MATERIALS

    if options["material"] == "list":
        for name, published in MATERIALS.items():
            m = published.material
            click.echo(
                f"{name:18s} {m.C1_kPa:6g} {m.k1_kPa:6g} {m.k2:6g} {m.alpha_deg:6g} {m.kappa:6g}"
                f"  {published.source}"
            )
        return
    if options["out"] is None:
        raise InputError("no file to write", remedy="give --out FILE")
    out: Path = options["out"]
    truth_file = _truth_file(out)
    _check_files(out, truth_file, options["overwrite"])
    specimen, truth = _simulate(options)
    _write(specimen, truth, out, truth_file)
    _tell(specimen, truth, out, truth_file)


def _truth_file(out: Path) -> Path:
    return out.with_name(f"{out.stem}.truth.json")


def _check_files(out: Path, truth_file: Path, overwrite: bool) -> None:
    if not out.parent.is_dir():
        raise InputError("no such folder", file=out.parent, remedy="make it first")
    for path in (out, truth_file):
        if path.is_dir():
            raise InputError("is a folder, not a file", file=path, remedy="name a CSV in it")
        if path.exists() and not overwrite:
            raise InputError(
                "exists already", file=path, remedy="choose another name, or add --overwrite"
            )


def _simulate(options: dict[str, Any]) -> tuple[Specimen, Truth]:
    """The specimen that the options ask for."""
    import numpy as np

    from biaxbayes.mechanics.grips import Hooks
    from biaxbayes.specimens.virtual_specimen import (
        Machine,
        hooked_specimen,
        virtual_specimen,
    )

    material, conditions, dimensions = _conditions(options)
    for key in ("noise_N", "misfit"):
        if not (math.isfinite(options[key]) and options[key] >= 0.0):
            flag = "--" + key.replace("_", "-")
            raise InputError(f"{flag} is {options[key]:g}", remedy="give zero or more")
    common: dict[str, Any] = {
        "name": options["name"] or options["out"].stem,
        **conditions,
        "ratios": options["ratios"] or ((1.0, 1.0),),
        "increments": options["increments"],
        "dimensions": dimensions,
        "machine": Machine(
            noise_N=options["noise_N"],
            misfit=options["misfit"],
            stress_pair=options["stress_pair"],
            geometry=options["geometry"],
        ),
        "seed": options["seed"],
    }
    try:
        with np.errstate(all="ignore"):  # an overflow is seen in the result
            if options["hooks"]:
                hooks = Hooks(count=options["hooks"])
                pair = hooked_specimen(material, **common, hooks=hooks)
            else:
                pair = virtual_specimen(material, **common)
    except ValueError as error:
        raise InputError(str(error), remedy="see 'biaxbayes simulate --help'") from None
    _check_readable(pair[0])
    return pair


def _conditions(options: dict[str, Any]) -> tuple[GOH, dict[str, Any], Dimensions]:
    """Material, stretches and dimensions: the options, else what is published with a material."""
    from biaxbayes.mechanics.goh import GOH
    from biaxbayes.mechanics.materials import MATERIALS, PublishedMaterial
    from biaxbayes.specimens.virtual_specimen import Dimensions

    if (options["material"] is None) == (not options["goh"]):
        raise InputError(
            "give one of --material NAME and --goh C1 k1 k2 ALPHA KAPPA",
            remedy="'--material list' prints the names",
        )
    if options["material"] is not None:
        if options["material"] not in MATERIALS:
            raise InputError(
                f"no material {options['material'][:60]!r}",
                remedy=f"known are {', '.join(MATERIALS)}",
            )
        published = MATERIALS[options["material"]]
    else:
        try:
            published = PublishedMaterial(GOH(*options["goh"]), "command line")
        except ValueError as error:
            raise InputError(
                f"--goh: {error}", remedy="C1 and k1 in kPa, alpha in degrees"
            ) from None
    material = published.material
    if options["fibre_switch"]:
        material = replace(material, fibre_switch=True)
    thickness = options["thickness"]
    if thickness is None:
        thickness = published.thickness_mm or 1.0
    if not (math.isfinite(thickness) and thickness > 0.0):
        raise InputError(f"a thickness of {thickness:g} mm", remedy="give a positive number")
    edge_x, edge_y = options["edge"]
    conditions = {**_stretches(options, published), "source": published.source}
    return material, conditions, Dimensions(edge_x, edge_y, thickness)


def _stretches(options: dict[str, Any], published: Any) -> dict[str, Any]:
    mounting = options["prestretch"] or published.mounting_stretch
    if not options["prestretch"] and published.mounting_stretch == (1.0, 1.0):
        raise InputError(
            "no mounting stretch is published with this material",
            remedy="give --prestretch X Y ('--prestretch 1 1' for none)",
        )
    total, measured = options["total_stretch"], options["measured_stretch"]
    if total is not None and measured is not None:
        raise InputError("--total-stretch and --measured-stretch are given", remedy="give one")
    if total is None and measured is None:
        measured = published.measured_stretch
    if total is None and measured is None:
        raise InputError(
            "no stretch range is published with this material",
            remedy="give --total-stretch or --measured-stretch",
        )
    top = [measured, measured] if total is None else [total / lm if lm else 0.0 for lm in mounting]
    for flag, values in (("--prestretch", mounting), ("largest measured stretch", top)):
        for value in values:
            if not 0.5 <= value <= 3.0:
                raise InputError(
                    f"{flag} of {value:g}", remedy="stretches are ratios near 1, such as 1.02"
                )
    if 1.0 in top:
        raise InputError("the test ends where it starts", remedy="ask for a larger stretch")
    return {
        "mounting_stretch": tuple(mounting),
        "total_stretch": total,
        "measured_stretch": measured,
    }


def _check_readable(specimen: Specimen) -> None:
    """Refuse a simulation that ``read_specimen`` would refuse (too large a stress and the like)."""
    from tempfile import TemporaryDirectory

    from biaxbayes.specimens.specimen_file import read_specimen, write_specimen

    with TemporaryDirectory() as folder:
        trial = Path(folder) / "specimen.csv"
        write_specimen(specimen, trial)
        try:
            read_specimen(trial)
        except InputError as error:
            where = f" in {error.column}" if error.column else ""
            raise InputError(
                f"this test gives a record that cannot be used{where}: {error.problem}",
                remedy="ask for another stretch, ratio or material",
            ) from None


def _write(specimen: Specimen, truth: Truth, out: Path, truth_file: Path) -> None:
    from biaxbayes.specimens.specimen_file import write_specimen
    from biaxbayes.specimens.virtual_specimen import write_truth

    # The truth first: a specimen without its truth would be worth nothing.
    write_truth([truth], truth_file)
    write_specimen(specimen, out)


def _tell(specimen: Specimen, truth: Truth, out: Path, truth_file: Path) -> None:
    rows, unit = sum(p.rows for p in specimen.protocols), specimen.unit
    paths = f"{len(specimen.protocols)} protocol{'s' if len(specimen.protocols) > 1 else ''}"
    click.echo(f"{out}: {rows} rows, {paths}, largest load {specimen.peak_load:.4g} {unit}")
    first = next(iter(truth.disturbed_mounting_force.values()))
    click.echo(f"mounting load {first[0]:.4g}, {first[1]:.4g} {unit}; truth in {truth_file}")
    if specimen.is_tared:
        click.echo("no mounting load: 'sample' will treat the file as tared", err=True)
