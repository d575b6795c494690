"""``biaxbayes export``: material cards of a run for Abaqus and FEBio."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from biaxbayes.errors import InputError

if TYPE_CHECKING:
    import pandas as pd


__all__ = ["command"]


@click.command("export")
@click.argument("run", type=click.Path(path_type=Path))
@click.option(
    "--to",
    "program",
    type=click.Choice(["abaqus", "febio"]),
    required=True,
    help="Abaqus *ANISOTROPIC HYPERELASTIC, HOLZAPFEL or FEBio Holzapfel-Gasser-Ogden.",
)
@click.option(
    "--draws", "count", type=click.IntRange(1), metavar="N", help="N random posterior draws."
)
@click.option(
    "--at",
    type=click.Choice(["median", "map"]),
    help="One draw: that with the curves nearest the median curves, or the most probable one  "
    "[default: median]",
)
@click.option(
    "--units",
    type=click.Choice(["kPa-mm", "MPa-mm", "Pa-m"]),
    default="kPa-mm",
    show_default=True,
    help="Unit system of the numbers.",
)
@click.option(
    "--bulk-ratio",
    type=float,
    metavar="R",
    help="Bulk modulus over stiffness, for nearly incompressible cards  "
    "[default: incompressible for Abaqus, 1000 for FEBio]",
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@click.option(
    "--out", type=click.Path(path_type=Path), metavar="DIR", help="Folder  [default: in the run]"
)
@click.option("--overwrite", is_flag=True, help="Replace the cards of an earlier export.")
@click.option("--anyway", is_flag=True, help="Even if the run is not reliable.")
def command(
    run: Path,
    program: str,
    count: int | None,
    at: str | None,
    units: str,
    bulk_ratio: float | None,
    seed: int,
    out: Path | None,
    overwrite: bool,
    anyway: bool,
) -> None:
    r"""Material cards of posterior draws, each checked against the draw.

    \b
    biaxbayes export media-posterior --to abaqus --units MPa-mm
    biaxbayes export media-posterior --to febio --draws 50
    """
    from biaxbayes.commands.run_state import open_usable_run, uses_fibre_switch
    from biaxbayes.findings.representative_draws import chosen_draws
    from biaxbayes.output.cards.export import MANIFEST, export_cards

    if count is not None and at is not None:
        raise InputError("--draws and --at exclude each other", remedy="give one of them")
    opened = open_usable_run(run, anyway=anyway)
    rows, origin = chosen_draws(
        opened.draws,
        opened.specimen,
        count=count,
        at=at or "median",
        seed=seed,
        fibre_switch=uses_fibre_switch(opened),
    )
    folder = out or opened.path / f"cards-{program}-{units}"
    manifest = export_cards(
        opened.draws,
        opened.specimen,
        rows,
        folder,
        program=program,
        units=units,
        bulk_ratio=bulk_ratio,
        fibre_switch=uses_fibre_switch(opened),
        origin=origin,
        overwrite=overwrite,
    )
    _tell(manifest, folder / MANIFEST)


def _tell(manifest: pd.DataFrame, path: Path) -> None:
    number = len(manifest)
    click.echo(f"{number} card{'s' if number > 1 else ''}; {path} maps cards to draws")
    click.echo(
        "stress of the written cards agrees with the draws to "
        f"{manifest['check_relative_deviation'].max():.1e}"
    )
    changed = manifest[manifest["switch_changes_stress_kPa"] > 0.0]
    if len(changed):
        click.echo(
            f"warning: the fibre strain is negative in tested states of {len(changed)} of {number} "
            "draws; there the program drops the fibres, which the fit did not (up to "
            f"{changed['switch_changes_stress_kPa'].max():.3g} kPa); sample with --fibre-switch",
            err=True,
        )
