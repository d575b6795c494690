"""``biaxbayes export``: material cards for Abaqus and FEBio, of a run or of a population."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.options import CARD_PROGRAMS, CARD_UNITS, Options, option, takes_options
from biaxbayes.reports.text import plural
from biaxbayes.text_files import as_path
from biaxbayes.verbs import options as opt
from biaxbayes.verbs.inputs import PathLike, RunLike, usable_run

if TYPE_CHECKING:
    import pandas as pd

DRAW_AT = ("median", "map")
NEAREST = "law nearest to the"


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
    parameters: str = option(
        "nearest",
        "Of a run: the law nearest to each drawn tissue on the tested paths, for simulations, or "
        "the drawn law without its misfit.",
        choices=("nearest", "drawn"),
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
    """Write material cards of posterior draws.

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
    from biaxbayes.cards.export import export_cards, export_population_cards
    from biaxbayes.prediction import nearest_law
    from biaxbayes.prediction.draws import chosen_draws
    from biaxbayes.runs.run import Run

    if to not in CARD_PROGRAMS:
        problem = f"unknown program {str(to)[:40]!r}"
        raise InputError(problem, remedy=f"one of {', '.join(CARD_PROGRAMS)}")
    chosen = CardOptions.from_values(options)
    if chosen.draws is not None and chosen.at is not None:
        raise InputError("`draws` and `at` exclude each other", remedy="give one of them")
    how: dict[str, Any] = {n: getattr(chosen, n) for n in ("units", "bulk_ratio", "overwrite")}
    how["program"] = to
    which: dict[str, Any] = {"count": chosen.draws, "seed": chosen.seed}
    if population is not None:
        if chosen.at is not None or isinstance(run, Run):
            raise InputError("`population` takes a population's folder, and no `at`")
        source = as_path(run, "run")
        folder = _folder(source, to, chosen.units, out)
        return export_population_cards(source, population, folder, anyway=anyway, **which, **how)
    opened = usable_run(run, anyway=anyway)
    posterior, at = opened.posterior(), chosen.at or DRAW_AT[0]
    data = (opened.draws, opened.specimen, opened.law)
    if chosen.parameters == "drawn":
        rows, origin = chosen_draws(*data, at=at, **which)
        cards = opened.draws.iloc[rows]
        distances = nearest_law.drawn_distances(posterior, cards)
        cards = cards.assign(**{nearest_law.TO_READINGS: distances})
    elif chosen.draws is None and at == DRAW_AT[0]:
        cards, middle = nearest_law.median_nearest_law(posterior, opened.draws)
        rows, origin = [middle], f"{NEAREST} tissue with the median curves"
    else:
        rows, origin = chosen_draws(*data, at=at, **which)
        origin = f"{NEAREST} tissue of a {origin}"
        cards = nearest_law.nearest_laws(posterior, opened.draws.iloc[rows])
    table = opened.draws.copy()
    table[[nearest_law.TO_TISSUE, nearest_law.TO_READINGS]] = np.nan
    table.loc[cards.index, list(cards)] = cards
    folder = _folder(opened.path, to, chosen.units, out)
    return export_cards(table, opened.specimen, opened.law, rows, folder, origin=origin, **how)


def _folder(run: Path, to: str, units: str, out: PathLike | None) -> Path:
    from biaxbayes.runs.folder import inside

    return inside(run, f"cards-{to}-{units}") if out is None else as_path(out, "out")


# --- the command ---------------------------------------------------------------------------------


@click.command("export")
@opt.argument("run")
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
@opt.options(CardOptions, "draws", "at", "parameters", "units", "bulk_ratio", "seed")
@opt.file_option("out", "Folder  [default: in the run]", "DIR")
@opt.options(CardOptions, "overwrite")
@opt.unconverged_option
def command(run: Path, out: Path | None, **given: Any) -> None:
    r"""Material cards of posterior draws.

    \b
    biaxbayes export media-posterior --to abaqus --units MPa-mm
    biaxbayes export media-posterior --to febio --draws 50
    biaxbayes export aortas-population --to abaqus --population media --draws 20
    """
    from biaxbayes.cards.export import MANIFEST

    opened: Any = run
    if given["population"] is None:
        opened = opt.open_usable_run(run, anyway=given["anyway"])
    folder = _folder(run, given["to"], given["units"], out)
    manifest = export(opened, out=folder, **given)
    click.echo(f"{plural(len(manifest), 'card')}; {folder / MANIFEST} maps cards to draws")
    if "distance_to_readings" in manifest:
        click.echo(
            f"stresses of the cards are off the readings by "
            f"{100.0 * manifest['distance_to_readings'].median():.2g} % (relative root mean square"
            f"{', median' if len(manifest) > 1 else ''})"
        )
    changed = manifest[manifest["switch_changes_stress_kPa"] > 0.0]
    if len(changed):
        click.echo(
            f"warning: the fibre strain is negative in tested states of {len(changed)} of "
            f"{len(manifest)} draws; there the program ignores the fibres, and the fit did not "
            f"(difference up to {changed['switch_changes_stress_kPa'].max():.3g} kPa); sample with "
            "--fibre-switch",
            err=True,
        )
