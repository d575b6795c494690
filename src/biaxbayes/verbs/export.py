"""``biaxbayes export``: material cards for Abaqus and FEBio, of a run or of a population."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from biaxbayes.errors import InputError
from biaxbayes.options import CARD_PROGRAMS, CARD_UNITS, Options, option, takes_options
from biaxbayes.reports.text import plural
from biaxbayes.text_files import as_path
from biaxbayes.verbs.inputs import PathLike, RunLike, usable_run
from biaxbayes.verbs.options import (
    argument,
    file_option,
    open_usable_run,
    options,
    unconverged_option,
)

if TYPE_CHECKING:
    import pandas as pd

DRAW_AT = ("median", "map")


@dataclass(frozen=True)
class CardOptions(Options):
    """Material cards of posterior draws."""

    draws: int | None = option(None, "N random posterior draws.", kind=int, minimum=1, metavar="N")
    at: str | None = option(
        None,
        "One draw: that with the curves nearest the median curves, or the most probable one  "
        "[default: median]",
        choices=DRAW_AT,
    )
    units: str = option("kPa-mm", "Unit system of the numbers.", choices=CARD_UNITS)
    bulk_ratio: float | None = option(
        None,
        "Bulk modulus over stiffness, for nearly incompressible cards  "
        "[default: incompressible for Abaqus, 1000 for FEBio]",
        kind=float,
        metavar="R",
    )
    seed: int = option(0, minimum=0)
    overwrite: bool = option(False, "Replace the cards of an earlier export.")


@takes_options(CardOptions)
def export(
    run: RunLike,
    to: str,
    *,
    population: str | None = None,
    out: PathLike | None = None,
    anyway: bool = False,
    **options: Any,
) -> pd.DataFrame:
    """Write material cards of posterior draws, each checked against its draw.

    Parameters
    ----------
    run : Run or path-like
    to : {"abaqus", "febio"}
    population : str, optional
        A group, if ``run`` is the folder of a population: cards of new specimens of the group, and
        one of the mean curve in a sub-folder.
    out : path-like, optional
        Folder; default in the run.
    anyway : bool
        Use the draws of a run that has not converged.
    **options
        As in :class:`CardOptions`.

    Returns
    -------
    DataFrame
        The manifest: one row per card.
    """
    from biaxbayes.cards.export import export_cards
    from biaxbayes.cards.population import export_population_cards
    from biaxbayes.prediction.draws import chosen_draws
    from biaxbayes.runs.run import Run

    if to not in CARD_PROGRAMS:
        raise InputError(
            f"unknown program {str(to)[:40]!r}", remedy=f"one of {', '.join(CARD_PROGRAMS)}"
        )
    chosen = CardOptions.from_values(options)
    if chosen.draws is not None and chosen.at is not None:
        raise InputError("`draws` and `at` exclude each other", remedy="give one of them")
    how: dict[str, Any] = {
        "program": to,
        "units": chosen.units,
        "bulk_ratio": chosen.bulk_ratio,
        "overwrite": chosen.overwrite,
    }
    which: dict[str, Any] = {"count": chosen.draws, "seed": chosen.seed}
    if population is not None:
        if chosen.at is not None or isinstance(run, Run):
            raise InputError("`population` takes a population's folder, and no `at`")
        source = as_path(run, "run")
        folder = _folder(source, to, chosen.units, out)
        return export_population_cards(source, population, folder, anyway=anyway, **which, **how)
    opened = usable_run(run, anyway=anyway)
    better = opened.result.better_law
    data = (opened.draws, opened.specimen, opened.law)
    rows, origin = chosen_draws(*data, at=chosen.at or DRAW_AT[0], **which)
    warnings = (f"WARNING: {better}.",) if better else ()
    folder = _folder(opened.path, to, chosen.units, out)
    return export_cards(*data, rows, folder, origin=origin, warnings=warnings, **how)


def _folder(run: Path, to: str, units: str, out: PathLike | None) -> Path:
    from biaxbayes.runs.folder import CARDS

    return run / f"{CARDS}-{to}-{units}" if out is None else as_path(out, "out")


# --- the command ---------------------------------------------------------------------------------


@click.command("export")
@argument("run")
@click.option(
    "--to",
    type=click.Choice(CARD_PROGRAMS),
    required=True,
    help="Abaqus *ANISOTROPIC HYPERELASTIC, HOLZAPFEL or FEBio Holzapfel-Gasser-Ogden.",
)
@click.option(
    "--population",
    metavar="GROUP",
    help="RUN is a population's folder: cards of new specimens of the group, and the mean curve.",
)
@options(CardOptions, "draws", "at", "units", "bulk_ratio", "seed")
@file_option("out", "Folder  [default: in the run]", "DIR")
@options(CardOptions, "overwrite")
@unconverged_option
def command(run: Path, out: Path | None, **given: Any) -> None:
    r"""Material cards of posterior draws, each checked against the draw.

    \b
    biaxbayes export media-posterior --to abaqus --units MPa-mm
    biaxbayes export media-posterior --to febio --draws 50
    biaxbayes export aortas-population --to abaqus --population media --draws 20
    """
    from biaxbayes.cards.export import MANIFEST

    opened: Any = run
    if given["population"] is None:
        opened = open_usable_run(run, anyway=given["anyway"])
    folder = _folder(run, given["to"], given["units"], out)
    manifest = export(opened, out=folder, **given)
    click.echo(f"{plural(len(manifest), 'card')}; {folder / MANIFEST} maps cards to draws")
    click.echo(
        "stress of the written cards agrees with the draws to "
        f"{manifest['check_relative_deviation'].max():.1e}"
    )
    better = "" if given["population"] is not None else opened.result.better_law
    if better:
        click.echo(f"warning: {better}", err=True)
    changed = manifest[manifest["switch_changes_stress_kPa"] > 0.0]
    if len(changed):
        click.echo(
            f"warning: the fibre strain is negative in tested states of {len(changed)} of "
            f"{len(manifest)} draws; there the program ignores the fibres, and the fit did not "
            f"(difference up to {changed['switch_changes_stress_kPa'].max():.3g} kPa); sample with "
            "--fibre-switch",
            err=True,
        )
