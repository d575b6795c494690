"""``biaxbayes predict``: stress on any path, and the inflation of a tube, with bands."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from biaxbayes.commands.number_pair import Pair
from biaxbayes.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd
    from matplotlib.figure import Figure

    from biaxbayes.output.run import Run

__all__ = ["command"]

Style = dict[str, Any] | None

TUBE = ("radius", "wall", "axial_stretch", "pressure", "circumferential_stretch")
PATH = ("stretch", "ratio", "stretches", "protocol")
POINTS = 61


@click.command("predict")
@click.argument("run", type=click.Path(path_type=Path))
@click.option(
    "--stretch", type=float, metavar="L", help="Largest stretch  [default: the largest tested]"
)
@click.option(
    "--ratio",
    type=Pair("ratio", ":", single=False, zero=True),
    metavar="X:Y",
    help="Share of the stretch that x and y take  [default: 1:1]",
)
@click.option(
    "--stretches",
    type=click.Path(path_type=Path),
    metavar="CSV",
    help="Any path instead: columns stretch_x, stretch_y.",
)
@click.option(
    "--reference",
    type=click.Choice(["total", "measured"]),
    default="total",
    show_default=True,
    help="Stretches from the unloaded or from the mounted state.",
)
@click.option("--protocol", metavar="NAME", help="Whose mounted state, if each has its own.")
@click.option(
    "--stress",
    type=click.Choice(["cauchy", "piola"]),
    default="cauchy",
    show_default=True,
    help="Cauchy or first Piola-Kirchhoff stress.",
)
@click.option("--inflate", is_flag=True, help="A thin-walled tube of this tissue instead.")
@click.option("--radius", type=float, metavar="MM", help="Unloaded radius of the mid wall.")
@click.option("--wall", type=float, metavar="MM", help="Unloaded wall thickness.")
@click.option("--axial-stretch", type=float, metavar="L", help="Total axial stretch  [default: 1]")
@click.option(
    "--around",
    type=click.Choice(["x", "y"]),
    default="x",
    show_default=True,
    help="The axis of the test that runs around the tube.",
)
@click.option(
    "--pressure",
    type=Pair("pressure", ":", single=False, zero=True),
    metavar="A:B",
    help="Pressures, kPa  [default: 0:16]",
)
@click.option(
    "--circumferential-stretch",
    type=Pair("stretch", ":", single=False),
    metavar="A:B",
    help="Stretches of the mid wall instead of pressures.",
)
@click.option("--points", type=click.IntRange(2, 100_000), default=POINTS, show_default=True)
@click.option(
    "--probability",
    type=click.FloatRange(0.0, 1.0, min_open=True, max_open=True),
    default=0.9,
    show_default=True,
    help="Content of the bands.",
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@click.option(
    "--format", "suffix", type=click.Choice(["pdf", "svg", "png"]), default="pdf", show_default=True
)
@click.option("--width-mm", type=click.FloatRange(50.0, 400.0), default=85.0, show_default=True)
@click.option(
    "--style", type=click.Path(path_type=Path), metavar="FILE", help="A matplotlib style file."
)
@click.option(
    "--out", type=click.Path(path_type=Path), metavar="DIR", help="Folder  [default: the run]"
)
@click.option("--anyway", is_flag=True, help="Even if the run is not reliable.")
def command(run: Path, **options: Any) -> None:
    r"""Stress with credible and predictive bands on any path, or the inflation of a tube.

    Writes a CSV and a figure. States outside what was tested are marked row by row.

    \b
    biaxbayes predict media-posterior --stretch 1.25 --ratio 1:0.5
    biaxbayes predict media-posterior --stretches path.csv --reference measured
    biaxbayes predict media-posterior --inflate --radius 10 --wall 1.2 --axial-stretch 1.1
    """
    from biaxbayes.commands.run_state import open_usable_run
    from biaxbayes.output.style import read_style, save_figure

    _check(options)
    style = None if options["style"] is None else read_style(options["style"])
    opened = open_usable_run(run, anyway=options["anyway"])
    if options["inflate"]:
        table, figure = _inflate(opened, options, style)
        name = "inflation"
    else:
        table, figure = _stress(opened, options, style)
        name = "prediction"
    stem = (options["out"] or opened.path) / name
    picture = stem.with_suffix(f".{options['suffix']}")
    _write_table(stem.with_suffix(".csv"), table)
    save_figure(figure, picture, style)
    _tell(table, stem.with_suffix(".csv"), picture)


def _check(options: dict[str, Any]) -> None:
    """Options of the one kind of prediction do not go with the other."""
    if options["inflate"]:
        wrong = [name for name in PATH if options[name] is not None]
        if options["radius"] is None or options["wall"] is None:
            raise InputError("a tube needs --radius and --wall", remedy="unloaded, in mm")
        if options["pressure"] is not None and options["circumferential_stretch"] is not None:
            raise InputError(
                "--pressure and --circumferential-stretch exclude each other",
                remedy="give one of them",
            )
    else:
        wrong = [name for name in TUBE if options[name] is not None]
    if wrong:
        name = wrong[0].replace("_", "-")
        raise InputError(
            f"--{name} does not go {'with' if options['inflate'] else 'without'} --inflate"
        )
    if options["stretches"] is not None and (options["stretch"], options["ratio"]) != (None, None):
        raise InputError("--stretches is a whole path", remedy="leave --stretch and --ratio out")


def _stress(opened: Run, options: dict[str, Any], style: Style) -> tuple[pd.DataFrame, Figure]:
    from biaxbayes.commands.run_state import uses_fibre_switch
    from biaxbayes.findings.prediction import predict_stress
    from biaxbayes.output.figures.prediction import stress_figure

    table = predict_stress(
        opened.draws,
        opened.specimen,
        _path(opened, options),
        reference=options["reference"],
        protocol=options["protocol"],
        stress=options["stress"],
        probability=options["probability"],
        fibre_switch=uses_fibre_switch(opened),
    )
    specimen = opened.specimen
    figure = stress_figure(
        table,
        reference=options["reference"],
        probability=options["probability"],
        directions=(specimen.axis_x or "x", specimen.axis_y or "y"),
        width_mm=options["width_mm"],
        style=style,
    )
    return table, figure


def _path(opened: Run, options: dict[str, Any]) -> np.ndarray:
    """States of stretch: from the file, or straight from 1."""
    from biaxbayes.findings.prediction import prediction_range, stretch_path
    from biaxbayes.specimens.stretch_file import read_stretches

    if options["stretches"] is not None:
        return read_stretches(options["stretches"])
    largest = options["stretch"]
    if largest is None:
        tested = prediction_range(
            opened.draws, opened.specimen, options["protocol"], options["reference"]
        )
        largest = float(tested.high.max())
    elif not 0.2 <= largest <= 5.0 or largest == 1.0:
        raise InputError(
            f"--stretch {largest:g} is no largest stretch",
            remedy="stretches are ratios near 1, not strains or per cent",
        )
    ratio = options["ratio"] or (1.0, 1.0)
    return stretch_path(largest, ratio=ratio, points=options["points"])


def _inflate(opened: Run, options: dict[str, Any], style: Style) -> tuple[pd.DataFrame, Figure]:
    import numpy as np

    from biaxbayes.commands.run_state import uses_fibre_switch
    from biaxbayes.findings.inflation_prediction import predict_diameter, predict_pressure
    from biaxbayes.mechanics.inflation import Tube
    from biaxbayes.output.figures.prediction import inflation_figure

    axial = 1.0 if options["axial_stretch"] is None else options["axial_stretch"]
    try:
        tube = Tube(options["radius"], options["wall"], axial, options["around"])
    except ValueError as error:
        raise InputError(str(error)) from None
    shared: dict[str, Any] = {
        "probability": options["probability"],
        "fibre_switch": uses_fibre_switch(opened),
    }
    points = options["points"]
    if options["circumferential_stretch"] is not None:
        first, last = options["circumferential_stretch"]
        states = np.linspace(first, last, points)
        table = predict_pressure(opened.draws, opened.specimen, tube, states, **shared)
    else:
        first, last = options["pressure"] or (0.0, 16.0)
        pressure = np.linspace(first, last, points)
        table = predict_diameter(
            opened.draws, opened.specimen, tube, pressure, seed=options["seed"], **shared
        )
        lost = table["share_without_equilibrium"].max()
        if lost > 0.0:
            click.echo(
                f"warning: up to {100 * lost:.2g} % of the draws have no state of equilibrium "
                "between stretches of 0.5 and 2; they are left out of the bands",
                err=True,
            )
    figure = inflation_figure(
        table, probability=options["probability"], width_mm=options["width_mm"], style=style
    )
    return table, figure


def _write_table(path: Path, table: pd.DataFrame) -> None:
    from biaxbayes.specimens.text_file import atomic_write_text

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot be written ({error.strerror})", file=path.parent) from None
    atomic_write_text(path, table.to_csv(index=False, lineterminator="\n"))


def _tell(table: pd.DataFrame, *files: Path) -> None:
    from biaxbayes.findings.covered_stretches import INSIDE

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
