"""``biaxbayes fit``: deterministic fits side by side."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from biaxbayes.errors import InputError

if TYPE_CHECKING:
    from rich.table import Table

    from biaxbayes.inference.fit_result import FitResult
    from biaxbayes.specimens.specimen import Specimen

__all__ = ["command"]

METHODS = ("standard", "zeroed", "fip", "linden", "constrained")
NOT_CONVERGED = 3
ROWS = (
    ("C1", "kPa", "C1_kPa", "{:.4g}"),
    ("k1", "kPa", "k1_kPa", "{:.4g}"),
    ("k2", "", "k2", "{:.4g}"),
    ("alpha", "deg", "alpha_deg", "{:.2f}"),
    ("kappa", "", "kappa", "{:.4f}"),
    ("mounting stretch x", "", "mounting_stretch_x", "{:.4f}"),
    ("mounting stretch y", "", "mounting_stretch_y", "{:.4f}"),
    ("R2", "", "r2", "{:.5f}"),
    ("RMSE", "kPa", "rmse_kPa", "{:.4g}"),
    ("iterations", "", "iterations", "{:d}"),
)


@click.command("fit")
@click.argument("specimen", type=click.Path(path_type=Path))
@click.option(
    "--method",
    type=click.Choice([*METHODS, "all"]),
    default="all",
    show_default=True,
    help="standard and zeroed take the mounted state as reference; the others infer its stretch.",
)
@click.option("--json", "as_json", is_flag=True, help="A list of objects instead of the table.")
@click.option("--fix", multiple=True, metavar="NAME=VALUE", help="Hold a parameter, e.g. kappa=0.")
@click.option(
    "--mounting-stretch",
    type=click.Choice(["shared", "per-protocol"]),
    default="shared",
    show_default=True,
    help="One mounted state for all protocols, or one each.",
)
@click.option(
    "--mounting-force",
    type=float,
    nargs=2,
    metavar="X Y",
    help="Force (N, or stress in kPa) at the mounted state of a tared file, known from elsewhere.",
)
@click.option("--starts", type=click.IntRange(1, 512), default=8, show_default=True)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@click.option(
    "--fibre-switch", is_flag=True, help="Fibres carry no compression, as in Abaqus and FEBio."
)
def command(
    specimen: Path,
    method: str,
    as_json: bool,
    fix: tuple[str, ...],
    mounting_stretch: str,
    mounting_force: tuple[float, float] | None,
    starts: int,
    seed: int,
    fibre_switch: bool,
) -> int:
    """Fit the material by least squares, with and without the mounting stretch."""
    from biaxbayes.findings.goh_description import poor_fit
    from biaxbayes.inference.fit import fit, fit_all

    fixed = dict(_held(text) for text in fix)
    data = _read(specimen, mounting_force)
    options: dict[str, Any] = {
        "starts": starts,
        "seed": seed,
        "fixed": fixed,
        "mounting_stretch": mounting_stretch,
        "fibre_switch": fibre_switch,
    }
    fits = fit_all(data, **options) if method == "all" else [fit(data, method, **options)]
    if as_json:
        import json

        click.echo(json.dumps([found.record() for found in fits], indent=2, allow_nan=False))
    else:
        _print_table(data, fits, fixed)
    if method == "all" and data.is_tared:
        click.echo(
            "note: the force at the mounted state is zero (a tared load cell), so fip, linden and "
            "constrained cannot infer prestretch; give it with --mounting-force X Y",
            err=True,
        )
    if poor := poor_fit(data, fits):
        click.echo(f"warning: {poor}", err=True)
    missed = [found.method for found in fits if not found.converged]
    if missed:
        click.echo(f"not converged: {', '.join(missed)}", err=True)
    return NOT_CONVERGED if missed else 0


def _read(path: Path, mounting_force: tuple[float, float] | None) -> Specimen:
    import math

    from biaxbayes.specimens.specimen_file import read_specimen

    data = read_specimen(path)
    if mounting_force is None:
        return data
    if not data.is_tared:
        raise InputError(
            "--mounting-force is for a tared file, and this one has a force at the mounted state",
            file=path,
            remedy="leave the option out",
        )
    if not all(math.isfinite(v) for v in mounting_force) or mounting_force == (0.0, 0.0):
        raise InputError(
            "--mounting-force must be two finite numbers, not both zero",
            remedy=f"give the force before taring, in {data.unit}",
        )
    return data.with_mounting_force(*mounting_force)


def _held(text: str) -> tuple[str, float]:
    name, sign, value = text.partition("=")
    try:
        if not sign:
            raise ValueError
        return name.strip(), float(value)
    except ValueError:
        raise InputError(
            f"--fix {text!r} is not NAME=VALUE", remedy="for instance --fix kappa=0.1"
        ) from None


def _print_table(specimen: Specimen, fits: list[FitResult], fixed: dict[str, float]) -> None:
    from rich.console import Console

    console = Console(highlight=False)
    for note in specimen.notes:
        console.print(f"note: {note}", markup=False)
    console.print(_table(specimen, fits, fixed))
    if any(found.at_bound for found in fits):
        console.print("* ended on a bound", markup=False)
    if fixed:
        console.print("= held", markup=False)
    if any(found.method in ("standard", "zeroed") for found in fits):
        console.print(
            "standard and zeroed fit their own data; R2 does not tell how far they are from the "
            "tissue.",
            markup=False,
        )


def _table(specimen: Specimen, fits: list[FitResult], fixed: dict[str, float]) -> Table:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(
        title=Text(specimen.name), box=box.SIMPLE_HEAD, title_justify="left", pad_edge=False
    )
    table.add_column("", no_wrap=True)
    for found in fits:
        table.add_column(found.method, justify="right", no_wrap=True)
    records = [found.record() for found in fits]
    for label, unit, key, form in ROWS:
        cells = []
        for found, record in zip(fits, records, strict=True):
            value = record[key]
            values = value if isinstance(value, list) else [value]
            shown = [_shown(value, form) for value in values]
            mark = "*" if label in found.at_bound else "=" if label in fixed else ""
            if key.startswith("mounting") and found.method in ("standard", "zeroed"):
                shown = ["-"]
            cells.append("\n".join(shown) + mark)
        table.add_row(f"{label} {unit}".rstrip(), *cells)
    table.add_row("converged", *("yes" if found.converged else "NO" for found in fits))
    return table


def _shown(value: object, form: str) -> str:
    return "-" if value is None else form.format(value)
