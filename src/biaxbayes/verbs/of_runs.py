"""Verbs that begin with a run, which may be given by its folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from biaxbayes.errors import InputError, NotConverged
from biaxbayes.executors.executor import executor_for
from biaxbayes.output.run import Run, open_run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from biaxbayes.findings.compare import Comparison
    from biaxbayes.findings.design import Design
    from biaxbayes.findings.identifiability import Identifiability
    from biaxbayes.findings.ledger import Ledger
    from biaxbayes.findings.profile import Profile

__all__ = [
    "compare",
    "design",
    "export",
    "identify",
    "inflate",
    "ledger",
    "plot",
    "predict",
    "profile",
    "report",
]

RunLike = Run | str | Path


def _opened(run: RunLike) -> Run:
    return run if isinstance(run, Run) else open_run(run)


def _usable(run: RunLike) -> Run:
    opened = _opened(run)
    if opened.state == "unusable":
        raise NotConverged(f"{opened.path}: the chains have not converged; sample longer")
    return opened


def _switch(run: Run) -> bool:
    return run.provenance["settings"].get("fibre_switch") is True


def identify(run: RunLike) -> Identifiability:
    """Which parameters the data determine: a verdict with its evidence for each."""
    from biaxbayes.findings.identifiability import identify as judge

    return judge(_opened(run))


def profile(run: RunLike, parameters: Sequence[str], *, workers: int = 1) -> list[Profile]:
    """Profile likelihoods: what the data of a run alone say of each parameter."""
    from biaxbayes.findings.profile import profiles

    return profiles(_opened(run).posterior(), parameters, workers=workers)


def compare(runs: Sequence[RunLike], *, labels: Sequence[str] | None = None) -> Comparison:
    """Runs side by side: verdicts, and how far apart they are in what both determine.

    Parameters
    ----------
    runs : sequence of Run or path-like
        Two or more.
    labels : sequence of str, optional
        Default: the layers if they differ, else the specimens, else the folders.
    """
    from biaxbayes.findings.compare import Member, labels_of
    from biaxbayes.findings.compare import compare as lay_out

    opened = [_usable(run) for run in runs]
    names = labels or labels_of([r.specimen for r in opened], [r.path.name for r in opened])
    if len(names) != len(opened):
        raise InputError(f"{len(names)} labels for {len(opened)} runs")
    pairs = zip(names, opened, strict=True)
    return lay_out([Member(name, r.posterior(), r.draws, r.state) for name, r in pairs])


def ledger(run: RunLike, *, seed: int = 1, ess: float = 1000.0, workers: int = 1) -> Ledger:
    """What ignoring the mounting stretch costs: the specimen of a run sampled twice more."""
    from biaxbayes.findings.ledger import Treated, classical, treat
    from biaxbayes.findings.ledger import ledger as lay_out
    from biaxbayes.inference.sampler import Plan

    opened = _usable(run)
    posterior = opened.posterior()
    if not posterior.settings.infers_mounting:
        raise InputError("the mounting stretch of this run is not inferred", file=opened.path)
    plan = Plan(ess=ess, seed=seed, workers=workers)
    treated = {"inferred": Treated(posterior, opened.draws, opened.state)}
    for name in ("ignored", "zeroed"):
        treated[name] = treat(opened.specimen, classical(posterior.options(), name), plan)
    return lay_out(treated)


def design(
    run: RunLike, *, rank_by: str = "parameters", seed: int = 1, workers: int = 1, **candidates: Any
) -> Design:
    """Which further measurement would narrow the posterior of a run most.

    Parameters
    ----------
    run : Run or path-like
    rank_by : str
    seed : int
    workers : int
        Processes.
    **candidates
        As in :func:`biaxbayes.findings.candidates.standard_candidates`.
    """
    from biaxbayes.findings.candidates import standard_candidates
    from biaxbayes.findings.design import design as rank

    opened = _usable(run)
    posterior = opened.posterior()
    tried = standard_candidates(posterior, **candidates)
    executor = executor_for(workers)
    return rank(posterior, opened.draws, tried, rank_by=rank_by, seed=seed, executor=executor)


def predict(
    run: RunLike,
    path: Any = None,
    *,
    stretch: float | None = None,
    ratio: tuple[float, float] = (1.0, 1.0),
    points: int = 51,
    **how: Any,
) -> pd.DataFrame:
    """Stress with credible and predictive bands on any path.

    Parameters
    ----------
    run : Run or path-like
    path : array_like, shape (m, 2), optional
        Stretches in x and y; or a straight path to ``stretch`` in ``ratio``.
    stretch, ratio, points
        As in :func:`biaxbayes.findings.prediction.stretch_path`.
    **how
        As in :func:`biaxbayes.findings.prediction.predict_stress`.
    """
    from biaxbayes.findings.prediction import predict_stress, stretch_path

    opened = _usable(run)
    if (path is None) == (stretch is None):
        raise InputError("give either a path or the largest stretch of one")
    if stretch is not None:
        path = stretch_path(stretch, ratio=ratio, points=points)
    states = np.asarray(path, dtype=float)
    return predict_stress(
        opened.draws, opened.specimen, states, fibre_switch=_switch(opened), **how
    )


def inflate(
    run: RunLike,
    pressure_kPa: Any,
    *,
    radius_mm: float,
    wall_mm: float,
    axial_stretch: float = 1.0,
    around: str = "x",
    **how: Any,
) -> pd.DataFrame:
    """Diameter of a thin-walled tube of this tissue at stated pressures, with bands.

    Parameters
    ----------
    run : Run or path-like
    pressure_kPa : array_like, shape (m,)
    radius_mm, wall_mm : float
        Unloaded radius of the mid wall, and thickness.
    axial_stretch : float
        Total.
    around : {"x", "y"}
        The axis of the test that runs around the tube.
    **how
        As in :func:`biaxbayes.findings.inflation_prediction.predict_diameter`.
    """
    from biaxbayes.findings.inflation_prediction import predict_diameter
    from biaxbayes.mechanics.inflation import Tube

    opened = _usable(run)
    tube = Tube(radius_mm, wall_mm, axial_stretch, around)
    pressure = np.asarray(pressure_kPa, dtype=float)
    return predict_diameter(
        opened.draws, opened.specimen, tube, pressure, fibre_switch=_switch(opened), **how
    )


def plot(run: RunLike, figure: str = "corner", **how: Any) -> Figure:
    """A figure of a run, in the style of a paper; see :func:`~biaxbayes.output.figures.run_figure`.

    Parameters
    ----------
    run : Run or path-like
    figure : {"corner", "bands", "identifiability", "mounting", "trace", "profile"}
    **how
        ``width_mm`` and more.
    """
    from biaxbayes.output.figures.run_figure import run_figure

    return run_figure(_opened(run), figure, **how)


def report(run: RunLike) -> Path:
    """Write the report of a run into its folder again; the path of the page."""
    from biaxbayes.output.report.page import write_report

    opened = _opened(run)
    return write_report(opened.path, opened)


def export(
    run: RunLike,
    to: str,
    *,
    out: str | Path | None = None,
    draws: int | None = None,
    at: str = "median",
    units: str = "kPa-mm",
    bulk_ratio: float | None = None,
    seed: int = 0,
    overwrite: bool = False,
) -> pd.DataFrame:
    """Material cards of posterior draws, each checked against its draw; the manifest.

    Parameters
    ----------
    run : Run or path-like
    to : {"abaqus", "febio"}
    out : path-like, optional
        Folder; default in the run.
    draws : int, optional
        So many random draws; else the one that ``at`` names.
    at : {"median", "map"}
    units : {"kPa-mm", "MPa-mm", "Pa-m"}
    bulk_ratio, seed, overwrite
        As the options of the command.
    """
    from biaxbayes.findings.representative_draws import chosen_draws
    from biaxbayes.output.cards.export import PROGRAMS, export_cards

    if to not in PROGRAMS:
        raise InputError(f"no program {to[:40]!r}", remedy=f"choose {', '.join(PROGRAMS)}")
    opened = _usable(run)
    switch = _switch(opened)
    rows, origin = chosen_draws(
        opened.draws, opened.specimen, count=draws, at=at, seed=seed, fibre_switch=switch
    )
    return export_cards(
        opened.draws,
        opened.specimen,
        rows,
        Path(out) if out is not None else opened.path / f"cards-{to}-{units}",
        program=to,
        units=units,
        bulk_ratio=bulk_ratio,
        fibre_switch=switch,
        origin=origin,
        overwrite=overwrite,
    )
