"""The verbs for what a user takes away from a run: predictions, report and cards."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from biaxbayes.errors import InputError
from biaxbayes.jobs.opening import (
    PathLike,
    RunLike,
    made_folder,
    opened_run,
    opened_style,
    usable_run,
    write_table,
)
from biaxbayes.options import (
    CARD_PROGRAMS,
    DRAW_AT,
    REFERENCES,
    REPORTS,
    STRESSES,
    CardOptions,
    FigureOptions,
    PredictionOptions,
    documented,
)
from biaxbayes.runs.folder import CARDS
from biaxbayes.runs.run import Run
from biaxbayes.specimens.protocol import STRETCH_REMEDY
from biaxbayes.text_files import atomic_write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "cards_folder",
    "check_cards",
    "export",
    "inflate",
    "predict",
    "report",
    "report_text",
]


NEW_SPECIMENS = 20
"""Cards of new specimens where no number is asked for."""


@documented(PredictionOptions, FigureOptions, without=("seed",))
def predict(
    run: RunLike,
    path: Any = None,
    *,
    stretch: float | str | None = None,
    ratio: tuple[float, float] | None = None,
    reference: str = REFERENCES[0],
    protocol: str | None = None,
    stress: str = STRESSES[0],
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
    stretch : float or "tested", optional
        Largest stretch of a straight path; "tested" for the largest tested one.
    ratio : (float, float), optional
        Share of the stretch beyond 1 that each direction takes; equal by default.
    reference : {"total", "measured"}
        Stretches from the unloaded or from the mounted state.
    protocol : str, optional
        Whose mounted state, if each has its own.
    stress : {"cauchy", "piola"}
    out : path-like, optional
        Folder for prediction.csv and a figure.
    anyway : bool
        Take draws that the run itself calls unusable.
    **options
        As in :class:`~biaxbayes.options.PredictionOptions` and
        :class:`~biaxbayes.options.FigureOptions`.
    """
    from biaxbayes.figures.prediction import stress_figure
    from biaxbayes.prediction.stress import measured_stress, predict_stress

    how, rest = PredictionOptions.taken(options)
    drawn = FigureOptions.of(rest)
    style = opened_style(drawn.style)
    if (path is None) == (stretch is None):
        raise InputError("give either a path or the largest stretch of one")
    if path is not None and ratio is not None:
        raise InputError("--stretches is a whole path", remedy="leave --stretch and --ratio out")
    opened = usable_run(run, anyway=anyway)
    specimen = opened.specimen
    _check_protocol(protocol, [p.name for p in specimen.protocols])
    states = _states(opened, path, stretch, ratio, how.points, protocol, reference)
    table = predict_stress(
        opened.draws,
        specimen,
        opened.law,
        states,
        reference=reference,
        protocol=protocol,
        stress=stress,
        probability=how.probability,
    )
    if out is not None:
        zeroed = opened.posterior().settings.mounting == "zeroed"
        measured = measured_stress(
            opened.draws,
            specimen.zeroed() if zeroed else specimen,
            opened.law,
            states,
            reference=reference,
            protocol=protocol,
            stress=stress,
        )
        figure = stress_figure(
            table,
            reference=reference,
            probability=how.probability,
            directions=(specimen.axis_x or "x", specimen.axis_y or "y"),
            measured=measured,
            width_mm=drawn.width_mm,
            style=style,
        )
        _predicted(made_folder(out) / "prediction", table, figure, drawn.suffix, style)
    return table


def _check_protocol(protocol: str | None, names: list[str]) -> None:
    """Refuse a protocol that the run does not have, also where all share a mounted state."""
    if protocol is not None and protocol not in names:
        raise InputError(
            f"no protocol {protocol[:60]!r} in this run", remedy=f"it has {', '.join(names)}"
        )


def _states(
    run: Run,
    path: Any,
    stretch: float | str | None,
    ratio: tuple[float, float] | None,
    points: int,
    protocol: str | None,
    reference: str,
) -> np.ndarray:
    """States of stretch: as given, from the file, or straight from 1."""
    from biaxbayes.prediction.stress import prediction_range, stretch_path
    from biaxbayes.specimens.table import read_stretches

    if isinstance(path, str | Path):
        return read_stretches(Path(path))
    if path is not None:
        return np.asarray(path, dtype=float)
    if stretch == "tested":
        stretch = float(prediction_range(run.draws, run.specimen, protocol, reference).high.max())
    elif isinstance(stretch, str) or not 0.5 <= stretch <= 5.0 or stretch == 1.0:  # type: ignore
        told = stretch if isinstance(stretch, str) else f"{stretch:g}"
        strain = not isinstance(stretch, str) and 0.0 < stretch < 0.5  # type: ignore[operator]
        raise InputError(
            f"--stretch {told} is no largest stretch",
            remedy=f"for a strain of {told} write {1.0 + stretch:g}"  # type: ignore[operator]
            if strain
            else STRETCH_REMEDY,
        )
    return stretch_path(stretch, ratio=ratio or (1.0, 1.0), points=points)  # type: ignore[arg-type]


def _predicted(stem: Path, table: pd.DataFrame, figure: Figure, suffix: str, style: Any) -> None:
    from biaxbayes.figures.style import save_figure

    write_table(stem.parent, stem.name, table, None)
    save_figure(figure, stem.with_suffix(f".{suffix}"), style)


@documented(PredictionOptions, FigureOptions)
def inflate(
    run: RunLike,
    pressure_kPa: Any = None,
    *,
    radius_mm: float,
    wall_mm: float,
    axial_stretch: float = 1.0,
    around: str = "x",
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
    radius_mm, wall_mm : float
        Unloaded radius of the mid wall, and thickness.
    axial_stretch : float
        Total.
    around : {"x", "y"}
        The axis of the test that runs around the tube.
    circumferential_stretch : array_like, shape (m,), optional
        The pressure at these stretches of the mid wall instead.
    out : path-like, optional
        Folder for inflation.csv and a figure.
    anyway : bool
        Take draws that the run itself calls unusable.
    **options
        As in :class:`~biaxbayes.options.PredictionOptions` and
        :class:`~biaxbayes.options.FigureOptions`.
    """
    from biaxbayes.figures.prediction import inflation_figure
    from biaxbayes.prediction.inflation import Tube, predict_diameter, predict_pressure

    how, rest = PredictionOptions.taken(options)
    drawn = FigureOptions.of(rest)
    style = opened_style(drawn.style)
    if pressure_kPa is not None and circumferential_stretch is not None:
        raise InputError(
            "--pressure and --circumferential-stretch exclude each other",
            remedy="give one of them",
        )
    opened = usable_run(run, anyway=anyway)
    try:
        tube = Tube(radius_mm, wall_mm, axial_stretch, around)
    except ValueError as error:
        raise InputError(str(error)) from None
    data = (opened.draws, opened.specimen, opened.law, tube)
    if circumferential_stretch is not None:
        states = np.asarray(circumferential_stretch, dtype=float)
        table = predict_pressure(*data, states, probability=how.probability)
    else:
        pressure = np.linspace(0.0, 16.0, how.points) if pressure_kPa is None else pressure_kPa
        pressure = np.asarray(pressure, dtype=float)
        table = predict_diameter(*data, pressure, probability=how.probability, seed=how.seed)
    if out is not None:
        figure = inflation_figure(
            table, probability=how.probability, width_mm=drawn.width_mm, style=style
        )
        _predicted(made_folder(out) / "inflation", table, figure, drawn.suffix, style)
    return table


def report_text(run: RunLike, kind: str = "html") -> str:
    """The report of a run: a page that holds everything, tables for a paper, or a page to explore.

    Parameters
    ----------
    run : Run or path-like
    kind : {"html", "latex", "explore"}
    """
    from biaxbayes.reports.page import latex_table, report_page

    if kind not in REPORTS:
        raise InputError(f"no report {str(kind)[:40]!r}", remedy=f"choose {', '.join(REPORTS)}")
    write = {
        "html": report_page,
        "latex": latex_table,
        "explore": _exploration,
    }[kind]
    return write(opened_run(run))


def _exploration(run: Run) -> str:
    """The page to explore of a run."""
    from biaxbayes.reports.explore import explore_page

    return explore_page(run.posterior(), run.draws, run.state)


def report(run: RunLike, kind: str = "html", *, out: PathLike | None = None) -> Path:
    """Write the report of a run again; the path of the file.

    Parameters
    ----------
    run : Run or path-like
    kind : {"html", "latex", "explore"}
        ``html`` in the run itself renews the page to explore beside it, too.
    out : path-like, optional
        Default report.html, report.tex or explore.html in the run.
    """
    opened = opened_run(run)
    if kind in PAGES and out is None:
        return _own_page(opened, kind)
    text = report_text(opened, kind)
    path = opened.path / REPORTS[kind] if out is None else Path(out)
    if path.is_dir():
        raise InputError("is a folder", file=path, remedy="give a file name with --out")
    atomic_write_text(path, text)
    return path


PAGES = ("html", "explore")
"""Reports that point to each other where both stand in a run."""


def _own_page(run: Run, kind: str) -> Path:
    """A page in the folder of its run; with the report, the page to explore."""
    from biaxbayes.reports.explore import can_be_explored, write_explore
    from biaxbayes.reports.page import write_report

    if kind == "explore" or (
        run.state != "unusable" and can_be_explored(run.quantities, run.draws)
    ):
        path = write_explore(run.path, run.posterior(), run.draws, run.state)
    return path if kind == "explore" else write_report(run.path, run)


@documented(CardOptions)
def export(
    run: RunLike,
    to: str,
    *,
    population: str | None = None,
    out: PathLike | None = None,
    anyway: bool = False,
    **options: Any,
) -> pd.DataFrame:
    """Material cards of posterior draws, each checked against its draw; the manifest.

    Parameters
    ----------
    run : Run or path-like
    to : {"abaqus", "febio"}
    population : str, optional
        A group of a population, whose folder ``run`` is then: cards of its new specimens, and in a
        folder of its own that of the mean curve.
    out : path-like, optional
        Folder; default in the run.
    anyway : bool
        Take draws that the run itself calls unusable.
    **options
        As in :class:`~biaxbayes.options.CardOptions`.
    """
    from biaxbayes.cards.export import export_cards
    from biaxbayes.prediction.draws import chosen_draws

    if to not in CARD_PROGRAMS:
        raise InputError(f"no program {to[:40]!r}", remedy=f"choose {', '.join(CARD_PROGRAMS)}")
    how = CardOptions.of(options)
    check_cards(how.draws, how.at)
    if population is not None:
        if how.at is not None or isinstance(run, Run):
            raise InputError("--population takes a population's folder, and no --at")
        from biaxbayes.jobs.population_cards import export_population

        cards = vars(how) | {"draws": how.draws or NEW_SPECIMENS}
        cards.pop("at")
        folder = cards_folder(Path(run), to, how.units) if out is None else Path(out)
        return export_population(Path(run), population, to, out=folder, anyway=anyway, **cards)
    opened = usable_run(run, anyway=anyway)
    rows, origin = chosen_draws(
        opened.draws,
        opened.specimen,
        opened.law,
        count=how.draws,
        at=how.at or DRAW_AT[0],
        seed=how.seed,
    )
    return export_cards(
        opened.draws,
        opened.specimen,
        opened.law,
        rows,
        cards_folder(opened.path, to, how.units) if out is None else Path(out),
        program=to,
        units=how.units,
        bulk_ratio=how.bulk_ratio,
        origin=origin,
        overwrite=how.overwrite,
    )


def check_cards(draws: int | None, at: str | None) -> None:
    """Refuse to export both random draws and one that is chosen."""
    if draws is not None and at is not None:
        raise InputError("--draws and --at exclude each other", remedy="give one of them")


def cards_folder(run: Path, to: str, units: str) -> Path:
    """Where the cards of a run go if nothing else is said."""
    return run / f"{CARDS}-{to}-{units}"
