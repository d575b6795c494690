"""``biaxbayes predict``, ``plot``, ``report`` and ``export``: what a user takes away from a run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from biaxbayes.cli.options import (
    Pair,
    anyway_option,
    argument,
    file_option,
    open_usable_run,
    options,
)
from biaxbayes.errors import InputError, NotConverged
from biaxbayes.options import (
    AXES,
    CARD_PROGRAMS,
    PICTURES,
    PLOTS,
    REFERENCES,
    REPORTS,
    STRESSES,
    CardOptions,
    FigureOptions,
    PredictionOptions,
)

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["export", "plot", "predict", "report"]


# --- predict: stress on any path, and the inflation of a tube, with bands ------------------------


TUBE = ("radius", "wall", "axial_stretch", "pressure", "circumferential_stretch")
PATH = ("stretch", "ratio", "stretches", "protocol")


@click.command("predict")
@argument("run")
@click.option(
    "--stretch", type=float, metavar="L", help="Largest stretch  [default: the largest tested]"
)
@click.option(
    "--ratio",
    type=Pair("ratio", ":", "1:0.5", zero=True),
    metavar="X:Y",
    help="Share of the stretch that x and y take  [default: 1:1]",
)
@file_option("stretches", "Any path instead: columns stretch_x, stretch_y.", "CSV")
@click.option(
    "--reference",
    type=click.Choice(REFERENCES),
    default=REFERENCES[0],
    show_default=True,
    help="Stretches from the unloaded or from the mounted state.",
)
@click.option("--protocol", metavar="NAME", help="Whose mounted state, if each has its own.")
@click.option(
    "--stress",
    type=click.Choice(STRESSES),
    default=STRESSES[0],
    show_default=True,
    help="Cauchy or first Piola-Kirchhoff stress.",
)
@click.option("--inflate", is_flag=True, help="A thin-walled tube of this tissue instead.")
@click.option("--radius", type=float, metavar="MM", help="Unloaded radius of the mid wall.")
@click.option("--wall", type=float, metavar="MM", help="Unloaded wall thickness.")
@click.option("--axial-stretch", type=float, metavar="L", help="Total axial stretch  [default: 1]")
@click.option(
    "--around",
    type=click.Choice(AXES),
    default=AXES[0],
    show_default=True,
    help="The axis of the test that runs around the tube.",
)
@click.option(
    "--pressure",
    type=Pair("pressure", ":", "0:16", zero=True),
    metavar="A:B",
    help="Pressures, kPa  [default: 0:16]",
)
@click.option(
    "--circumferential-stretch",
    type=Pair("stretch", ":", "1:1.2"),
    metavar="A:B",
    help="Stretches of the mid wall instead of pressures.",
)
@options(PredictionOptions)
@options(FigureOptions, style={"type": click.Path(path_type=Path)})
@file_option("out", "Folder  [default: the run]", "DIR")
@anyway_option
def predict(
    run: Path, out: Path | None, anyway: bool, inflate: bool, seed: int, **chosen: Any
) -> None:
    r"""Stress with credible and predictive bands on any path, or the inflation of a tube.

    Writes a CSV and a figure. States outside what was tested are marked row by row.

    \b
    biaxbayes predict media-posterior --stretch 1.25 --ratio 1:0.5
    biaxbayes predict media-posterior --stretches path.csv --reference measured
    biaxbayes predict media-posterior --inflate --radius 10 --wall 1.2 --axial-stretch 1.1
    """
    from biaxbayes import api

    _check_prediction(inflate, chosen)
    path = {name: chosen.pop(name) for name in PATH}
    tube = {name: chosen.pop(name) for name in TUBE}
    reference, stress, around = (chosen.pop(n) for n in ("reference", "stress", "around"))
    opened = open_usable_run(run, anyway=anyway)
    folder = out or opened.path
    chosen |= {"out": folder, "anyway": anyway}
    if inflate:
        table = api.inflate(
            opened,
            radius_mm=tube["radius"],
            wall_mm=tube["wall"],
            axial_stretch=1.0 if tube["axial_stretch"] is None else tube["axial_stretch"],
            around=around,
            pressure_kPa=_evenly(tube["pressure"], chosen["points"]),
            circumferential_stretch=_evenly(tube["circumferential_stretch"], chosen["points"]),
            seed=seed,
            **chosen,
        )
        _warn_of_lost(table)
    else:
        stretches = path.pop("stretches")
        if stretches is None and path["stretch"] is None:
            path["stretch"] = "tested"
        table = api.predict(opened, stretches, reference=reference, stress=stress, **path, **chosen)
    stem = folder / ("inflation" if inflate else "prediction")
    _tell_predicted(table, stem.with_suffix(".csv"), stem.with_suffix(f".{chosen['suffix']}"))


def _check_prediction(inflate: bool, chosen: dict[str, Any]) -> None:
    """Options of the one kind of prediction do not go with the other."""
    if inflate and (chosen["radius"] is None or chosen["wall"] is None):
        raise InputError("a tube needs --radius and --wall", remedy="unloaded, in mm")
    for name in PATH if inflate else TUBE:
        if chosen[name] is not None:
            flag = name.replace("_", "-")
            raise InputError(f"--{flag} does not go {'with' if inflate else 'without'} --inflate")
    if chosen["stretches"] is not None and chosen["stretch"] is not None:
        raise InputError("--stretches is a whole path", remedy="leave --stretch and --ratio out")


def _evenly(ends: tuple[float, float] | None, points: int) -> Any:
    if ends is None:
        return None
    import numpy as np

    return np.linspace(*ends, points)


def _warn_of_lost(table: pd.DataFrame) -> None:
    if "share_without_equilibrium" not in table:
        return
    lost = table["share_without_equilibrium"].max()
    if lost > 0.0:
        click.echo(
            f"warning: up to {100 * lost:.2g} % of the draws have no state of equilibrium "
            "between stretches of 0.3 and 4; they are left out of the bands",
            err=True,
        )


def _tell_predicted(table: pd.DataFrame, *files: Path) -> None:
    from biaxbayes.prediction.stress import INSIDE

    click.echo(", ".join(map(str, files)))
    click.echo(
        "the predictive band is the interval of the tissue's response: it holds the error that "
        "the run inferred; the credible band is that of the model"
    )
    outside = int((table["extrapolation"] != INSIDE).sum())
    if outside:
        click.echo(
            f"note: {outside} of {len(table)} rows are extrapolations, marked in the table and "
            "dashed in the figure: there the bands rest on the model alone"
        )


# --- plot: figures of a run, sized for a paper ---------------------------------------------------


@click.command("plot")
@argument("run")
@click.option("--figure", type=click.Choice(list(PLOTS)), default="corner", show_default=True)
@click.option(
    "--format",
    "suffix",
    type=click.Choice(PICTURES),
    help="Kind of file  [default: that of --out, else pdf]",
)
@click.option(
    "--width-mm",
    type=click.FloatRange(60.0, 400.0),
    default=180.0,
    show_default=True,
    help="Width in print: 85 is a column, 180 a page.",
)
@file_option("style", "A matplotlib style (.mplstyle) for fonts and colours.", "FILE")
@file_option("truth", "Known values to draw: corner, bands and mounting.", "JSON")
@file_option("compare", "Another run to draw over this one: corner.", "RUN")
@click.option(
    "--parameter",
    "parameters",
    multiple=True,
    metavar="NAME",
    help="What to show, repeatable: corner, profile and trace.",
)
@file_option(
    "out", "The file to write  [default: in the run folder, named by figure and width]", "FILE"
)
@anyway_option
def plot(
    run: Path,
    figure: str,
    suffix: str | None,
    compare: Path | None,
    out: Path | None,
    anyway: bool,
    **how: Any,
) -> None:
    r"""Draw a figure of RUN for a paper: letters as text, 7 to 8 pt at print size.

    \b
    biaxbayes plot media-posterior --figure corner --width-mm 180
    biaxbayes plot media-posterior --figure bands --width-mm 85 --format svg --out fig3.svg
    biaxbayes plot media-posterior --compare adventitia-posterior --style journal.mplstyle
    biaxbayes plot media-posterior --figure profile --parameter kappa
    """
    from biaxbayes import api

    api.check_figure(figure, compare=compare, **{n: how[n] for n in ("truth", "parameters")})
    shown = {"compare": compare, "parameters": how["parameters"], "suffix": suffix}
    target = api.picture(out or run / api.picture_name(figure, how["width_mm"], **shown), suffix)
    # Traces are there to see why a run has not converged; a profile rests on no draws.
    judged = figure not in api.WITHOUT_JUDGEMENT
    opened: Any = open_usable_run(run, anyway=anyway) if judged else run
    other = None if compare is None else open_usable_run(compare, anyway=anyway)
    api.plot(opened, figure, out=target, compare=other, anyway=anyway, **how)
    click.echo(str(target))


# --- report: the page of a run again, or its tables for a paper ----------------------------------


@click.command("report")
@argument("run")
@click.option(
    "--format",
    "kind",
    type=click.Choice(list(REPORTS)),
    default="html",
    show_default=True,
    help="A page, the table as LaTeX, or the page to explore.",
)
@file_option(
    "out",
    "The file to write; - prints  [default: report.html, report.tex or explore.html in RUN]",
    "FILE",
)
def report(run: Path, kind: str, out: Path | None) -> int:
    r"""Report RUN: one self-contained HTML page, tables for a paper, or a page to explore.

    explore.html, beside the report, holds draws to brush in any pair of parameters, with their
    curves, and sliders for other priors; it needs no network.

    \b
    biaxbayes report media-run
    biaxbayes report media-run --format latex --out table2.tex

    Exit code 3 where the chains did not converge: the report says so, too.
    """
    from biaxbayes import api

    opened = api.open_run(run)
    if out is not None and str(out) == "-":
        click.echo(api.report_text(opened, kind), nl=False)
    else:
        click.echo(str(api.report(opened, kind, out=out)))
    return 0 if opened.state == "converged" else NotConverged.exit_code


# --- export: material cards of a run for Abaqus and FEBio ----------------------------------------


@click.command("export")
@argument("run")
@click.option(
    "--to",
    "program",
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
@anyway_option
def export(
    run: Path, program: str, population: str | None, out: Path | None, anyway: bool, **how: Any
) -> None:
    r"""Material cards of posterior draws, each checked against the draw.

    \b
    biaxbayes export media-posterior --to abaqus --units MPa-mm
    biaxbayes export media-posterior --to febio --draws 50
    biaxbayes export aortas-population --to abaqus --population media --draws 20
    """
    from biaxbayes import api
    from biaxbayes.cards.export import MANIFEST

    api.check_cards(how["draws"], how["at"])
    opened: Any = run if population is not None else open_usable_run(run, anyway=anyway)
    folder = out or api.cards_folder(run, program, how["units"])
    manifest = api.export(opened, program, population=population, out=folder, anyway=anyway, **how)
    _tell_cards(manifest, folder / MANIFEST)


def _tell_cards(manifest: pd.DataFrame, path: Path) -> None:
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
