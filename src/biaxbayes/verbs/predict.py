"""``biaxbayes predict``: stress with bands on any path; thin-walled inflation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from biaxbayes.errors import InputError, listed
from biaxbayes.mechanics.mounting import BRACKET
from biaxbayes.options import FIGURE_FORMATS, PredictionOptions, option, takes_options
from biaxbayes.parameters import STRETCH
from biaxbayes.specimens.protocol import STRETCH_REMEDY
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.table import read_stretches
from biaxbayes.text_files import atomic_write_all, csv_text
from biaxbayes.verbs import inputs
from biaxbayes.verbs import options as opt
from biaxbayes.verbs.inputs import PathLike, RunLike

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from biaxbayes.runs.run import Run

TESTED = "tested"
"""Value of ``stretch`` for the largest tested stretch."""


@dataclass(frozen=True)
class BandOptions(PredictionOptions):
    """Bands and their figure; ``style`` is a matplotlib style file, or its settings."""

    suffix: str = option("pdf", choices=FIGURE_FORMATS, flag="format")
    width_mm: float = option(85.0, between=(50.0, 400.0))
    style: Any = option(  # noqa: RUF009  an option, which is a field
        None, "A matplotlib style file.", metavar="FILE", read=inputs.as_style
    )


# --- stress on a path ----------------------------------------------------------------------------


@dataclass(frozen=True)
class PathOptions(BandOptions):
    """A path of stretches, and the stress on it."""

    stretch: float | str | None = option(
        None, "Largest stretch of a straight path, or 'tested' for the largest tested.", metavar="L"
    )
    ratio: tuple[float, float] | None = option(
        None, "Share of the stretch that x and y take  [default: 1:1]", metavar="X:Y"
    )
    strip: str | None = option(None, "A strip, with free sides.", choices=("x", "y"))
    relative_to: str = option(
        "mounted", "The state that stretches are relative to.", choices=("mounted", "unloaded")
    )
    protocol: str | None = option(None, "Whose mounted state, if each has its own.", metavar="NAME")
    stress: str = option(
        "cauchy", "Cauchy or first Piola-Kirchhoff stress.", choices=("cauchy", "piola")
    )


@takes_options(PathOptions, without=("seed",))
def predict(
    run: RunLike,
    path: Any = None,
    *,
    out: PathLike | None = None,
    anyway: bool = False,
    **options: Any,
) -> pd.DataFrame:
    """Stress with credible and predictive bands on any path.

    Parameters
    ----------
    run : Run or path-like
    path : array_like, shape (m, 2), or path-like, optional
        Stretches in x and y, or the CSV to read them from; or a straight path to ``stretch``.
    out : path-like, optional
        Folder for prediction.csv and a figure.
    anyway : bool
        Use the draws of a run that has not converged.
    **options
        As in :class:`PathOptions`.
    """
    from biaxbayes.figures.prediction import stress_figure
    from biaxbayes.prediction.draws import with_free_sides
    from biaxbayes.prediction.stress import measured_stress, predict_stress

    chosen = PathOptions.from_values(options)
    if path is not None and (chosen.stretch is not None or chosen.ratio is not None):
        remedy = "leave `stretch` and `ratio` out"
        raise InputError("`path` already gives the whole path", remedy=remedy)
    if chosen.strip is not None and chosen.ratio is not None:
        raise InputError("`ratio` does not go with `strip`", remedy="leave it out")
    if path is None and chosen.stretch is None:
        raise InputError("give either `path` or `stretch`")
    opened = inputs.usable_run(run, anyway=anyway)
    specimen = with_free_sides(opened.draws, opened.specimen, opened.law)
    names = [p.name for p in specimen.protocols]
    if chosen.protocol is not None and chosen.protocol not in names:
        problem = f"unknown protocol {str(chosen.protocol)[:60]!r}"
        raise InputError(problem, remedy=f"the run has {', '.join(names)}")
    if path is None:
        states = _straight_path(opened, specimen, chosen)
    elif isinstance(path, str | Path):
        states = read_stretches(Path(path))
    else:
        states = inputs.as_numbers(path, "path")
    where = {name: getattr(chosen, name) for name in ("relative_to", "protocol", "stress")}
    how = {"strip": chosen.strip, "probability": chosen.probability, **where}
    posterior = opened.posterior()
    table = predict_stress(posterior, opened.draws, states, **how)
    if out is not None:
        states = table[["stretch_x", "stretch_y"]].to_numpy()
        measured = measured_stress(posterior, opened.draws, states, **where)
        look = {"directions": specimen.directions, "relative_to": chosen.relative_to}
        stem = inputs.make_folder(out) / "prediction"
        _write(stem, table, chosen, stress_figure, measured=measured, **look)
    return table


def _about_total(run: Run) -> str:
    """What stretches from the unloaded state rest on; nothing where no mounting was inferred."""
    known = [
        f"{r.name} ({r.interval})"
        for r in run.result.reported
        if run.quantities[r.name].parameter.kind == STRETCH
    ]
    if not known:
        return ""
    return (
        f"note: stretches from the unloaded state rest on {listed(known)}, and on the law below "
        "the mounted state, where nothing was read; the bands are as wide as that leaves them\n"
    )


def _straight_path(run: Run, specimen: Specimen, chosen: PathOptions) -> np.ndarray:
    """States of stretch on a straight path from 1."""
    from biaxbayes.prediction.stress import prediction_range, stretch_path

    stretch: Any = chosen.stretch
    if np.ndim(stretch) > 0:
        problem = "`stretch` must be a number, the largest stretch of a straight path"
        remedy = "for other paths give `path`, an array of two columns (x, y)"
        raise InputError(problem, remedy=remedy)
    is_number = isinstance(stretch, int | float)
    if stretch == TESTED:
        tested = prediction_range(run.draws, specimen, chosen.protocol, chosen.relative_to)
        stretch = float(tested.high.max())
    elif not is_number or not 0.5 <= stretch <= 5.0 or stretch == 1.0:
        remedy = STRETCH_REMEDY
        if is_number and 0.0 < stretch < 0.5:
            remedy = f"for a strain of {stretch:g} write {1.0 + stretch:g}"
        shown = f"{stretch:g}" if is_number else str(stretch)[:40]
        raise InputError(f"`stretch` {shown} is not a possible largest stretch", remedy=remedy)
    return stretch_path(stretch, ratio=chosen.ratio or (1.0, 1.0), points=chosen.points)


def _write(
    stem: Path, table: pd.DataFrame, chosen: BandOptions, draw: Callable[..., Figure], **look: Any
) -> None:
    """Write table and figure together: a new one never stands beside an old one."""
    from biaxbayes.figures.style import figure_bytes, print_style

    with print_style(chosen.style):
        figure = draw(table, probability=chosen.probability, width_mm=chosen.width_mm, **look)
        drawn = figure_bytes(figure, chosen.suffix)
    csv = csv_text(table).encode("utf-8")
    atomic_write_all({stem.with_suffix(".csv"): csv, stem.with_suffix(f".{chosen.suffix}"): drawn})


# --- inflation of a tube -------------------------------------------------------------------------


@dataclass(frozen=True)
class TubeOptions(BandOptions):
    """A thin-walled tube."""

    radius_mm: float | None = option(
        None, "Unloaded radius of the mid wall.", kind=float, metavar="MM", flag="radius"
    )
    wall_mm: float | None = option(
        None, "Unloaded wall thickness.", kind=float, metavar="MM", flag="wall"
    )
    axial_stretch: float = option(1.0, "Total axial stretch.", metavar="L")
    around: str = option("x", "The axis of the test that runs around the tube.", choices=("x", "y"))


@takes_options(TubeOptions)
def inflate(
    run: RunLike,
    pressure_kPa: Any = None,
    *,
    circumferential_stretch: Any = None,
    out: PathLike | None = None,
    anyway: bool = False,
    **options: Any,
) -> pd.DataFrame:
    """Inflation of a thin-walled tube of this tissue, with bands.

    Parameters
    ----------
    run : Run or path-like
    pressure_kPa : array_like, shape (m,), optional
        The diameter at these pressures; 0 to 16 kPa by default.
    circumferential_stretch : array_like, shape (m,), optional
        The pressure at these stretches of the outer surface instead.
    out : path-like, optional
        Folder for inflation.csv and a figure.
    anyway : bool
        Use the draws of a run that has not converged.
    **options
        As in :class:`TubeOptions`.
    """
    from biaxbayes.figures.prediction import inflation_figure
    from biaxbayes.prediction.inflation import ThinTube, predict_diameter, predict_pressure

    chosen = TubeOptions.from_values(options)
    if chosen.radius_mm is None or chosen.wall_mm is None:
        raise InputError("a tube needs `radius_mm` and `wall_mm`", remedy="unloaded, in mm")
    if pressure_kPa is not None and circumferential_stretch is not None:
        problem = "`pressure_kPa` and `circumferential_stretch` exclude each other"
        raise InputError(problem, remedy="give one of them")
    opened = inputs.usable_run(run, anyway=anyway)
    tube = ThinTube(chosen.radius_mm, chosen.wall_mm, chosen.axial_stretch, chosen.around)
    data = (opened.posterior(), opened.draws, tube)
    if circumferential_stretch is not None:
        states = inputs.as_numbers(circumferential_stretch, "circumferential_stretch")
        table = predict_pressure(*data, states, probability=chosen.probability)
    else:
        states = np.linspace(0.0, 16.0, chosen.points) if pressure_kPa is None else pressure_kPa
        states = inputs.as_numbers(states, "pressure_kPa")
        table = predict_diameter(*data, states, probability=chosen.probability, seed=chosen.seed)
    if out is not None:
        _write(inputs.make_folder(out) / "inflation", table, chosen, inflation_figure)
    return table


# --- the command ---------------------------------------------------------------------------------


PATH_OPTION_NAMES = ("path", "stretch", "ratio", "strip", "protocol")
OF_TUBE = ("pressure_kPa", "circumferential_stretch")
TUBE_OPTION_NAMES = ("radius_mm", "wall_mm", "axial_stretch", *OF_TUBE)


@click.command("predict")
@opt.argument("run")
@opt.options(
    PathOptions,
    "stretch",
    "ratio",
    stretch={"type": float, "help": "Largest stretch  [default: the largest tested]"},
    ratio={"type": opt.RATIO},
)
@opt.file_option("stretches", "Any path instead: columns stretch_x, stretch_y.", "CSV", name="path")
@opt.options(PathOptions, "strip", "relative_to", "protocol", "stress")
@opt.flag("inflate", "A thin-walled tube of this tissue instead.")
@opt.options(TubeOptions, "radius_mm", "wall_mm", "axial_stretch", "around")
@click.option(
    "--pressure",
    "pressure_kPa",
    type=opt.pair(":", "0:16", zero=True),
    metavar="A:B",
    help="Pressures, kPa  [default: 0:16]",
)
@click.option(
    "--circumferential-stretch",
    type=opt.pair(":", "1:1.2"),
    metavar="A:B",
    help="Stretches of the outer diameter instead of pressures.",
)
@opt.options(PredictionOptions)
@opt.options(BandOptions, "suffix", "width_mm", "style", style={"type": click.Path(path_type=Path)})
@opt.file_option("out", "Folder  [default: the run]", "DIR")
@opt.unconverged_option
def command(run: Path, out: Path | None, anyway: bool, **given: Any) -> None:
    r"""Stress with credible and predictive bands on any path, or the inflation of a tube.

    Writes a CSV and a figure. States outside what was tested are marked row by row.

    \b
    biaxbayes predict media-posterior --stretch 1.25 --ratio 1:0.5
    biaxbayes predict media-posterior --stretches path.csv --relative-to mounted
    biaxbayes predict media-posterior --strip x --stretch 1.2
    biaxbayes predict media-posterior --inflate --radius 10 --wall 1.2 --axial-stretch 1.1
    """
    from biaxbayes.prediction.stress import INSIDE

    if inflated := given.pop("inflate"):
        opt.refuse_options(PATH_OPTION_NAMES, "{} does not go with `inflate`")
        own = {*OF_TUBE, *(f.name for f in fields(TubeOptions))}
    else:
        opt.refuse_options(TUBE_OPTION_NAMES, "{} does not go without `inflate`")
        own = {"path", *(f.name for f in fields(PathOptions))}
    chosen = {n: v for n, v in given.items() if v is not None and n in own}
    opened = opt.open_usable_run(run, anyway=anyway)
    folder = out or opened.path
    if inflated:
        PredictionOptions.check("points", chosen["points"])
        for name in set(OF_TUBE) & set(chosen):
            low, high = chosen[name]
            chosen[name] = np.linspace(low, high, chosen["points"])
        table = inflate(opened, out=folder, anyway=anyway, **chosen)
    else:
        if "path" not in chosen:
            chosen.setdefault("stretch", TESTED)
        table = predict(opened, out=folder, anyway=anyway, **chosen)
    lost = np.max(table.get("share_without_equilibrium", 0.0))
    if lost > 0.0:
        click.echo(
            f"warning: up to {100 * lost:.2g} % of the draws have no state of equilibrium "
            "between stretches of {:g} and {:g}; they are left out of the bands".format(*BRACKET),
            err=True,
        )
    stem = folder / ("inflation" if inflated else "prediction")
    click.echo(f"{stem.with_suffix('.csv')}, {stem.with_suffix('.' + given['suffix'])}")
    click.echo(
        "credible band: the response of the tissue (law and misfit); predictive band: a new reading"
    )
    if inflated or given["relative_to"] == "unloaded":
        click.echo(_about_total(opened), nl=False)
    if outside := int((table["extrapolation"] != INSIDE).sum()):
        click.echo(
            f"note: {outside} of {len(table)} rows are extrapolations, marked in the table and "
            "dashed in the figure: their bands depend on the model alone"
        )
