"""Options of the verbs: how much is sampled, and what is made of it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass

from biaxbayes.options.model import MOST, MOST_WHOLE, Options, Settings, option, stated

CONTENT = 0.9
"""Content of every interval and band, where no other is asked for."""
CARD_PROGRAMS = ("abaqus", "febio")
CARD_UNITS = ("kPa-mm", "MPa-mm", "Pa-m")
DRAW_AT = ("median", "map")
STRESS_PAIRS = ("force", "piola", "cauchy")
GEOMETRIES = ("unloaded", "mounted")
REFERENCES = ("total", "measured")
STRESSES = ("cauchy", "piola")
AXES = ("x", "y")
PICTURES = ("pdf", "svg", "png")
PLOTS = {
    "corner": "corner",
    "bands": "stress-bands",
    "identifiability": "identifiability",
    "mounting": "mounting",
    "trace": "trace",
    "profile": "profile",
}
"""Figures of a run and the stems of their files."""
PLOT_TAKES = {
    "truth": ("corner", "bands", "mounting"),
    "compare": ("corner",),
    "parameters": ("corner", "profile", "trace"),
}
"""Options that go with some figures only."""
REPORTS = {
    "html": "report.html",
    "latex": "report.tex",
    "explore": "explore.html",
}
"""Kinds of report and their files in a run."""


# --- how a posterior is sampled ------------------------------------------------------------------


SAME_SEED = "Same seed, same bytes."
WANTED = "Effective draws wanted."


@dataclass(frozen=True)
class SamplingPlan(Options):
    """How much is sampled, and by how many processors.

    Attributes
    ----------
    seed : int
        The same seed gives the same draws, whatever ``workers`` is.
    ess : float
        Effective sample size asked for, for the worst quantity.
    max_steps : int
        Kept steps of each ensemble at which the sampler gives up.
    workers : int, optional
        Processors to use; default all of them, at most four.
    """

    seed: int = option(1, SAME_SEED, least=0, most=MOST_WHOLE)
    ess: float = option(2000.0, WANTED, least=50, most=MOST)
    max_steps: int = option(20_000, "When to give up.", least=128, most=MOST)
    workers: int | None = option(None, "Processors to use [all, at most 4].", kind=int, least=1)

    @property
    def processors(self) -> int:
        """Processors to use."""
        return min(os.cpu_count() or 1, 4) if self.workers is None else int(self.workers)


@dataclass(frozen=True)
class LedgerPlan(SamplingPlan):
    """A :class:`SamplingPlan` for the ledger, whose medians need fewer draws."""

    ess: float = option(1000.0, WANTED, least=50, most=MOST)


CORRELATIONS = ("auto", "always", "never")
SPREADS = ("common", "by-group")


@dataclass(frozen=True)
class PopulationOptions(Options):
    """A hierarchical posterior over specimens.

    Attributes
    ----------
    pool_mounting : bool
        Whether mounting stretches are pooled like parameters.
    spread : {"common", "by-group"}
        One sd between the specimens of a donor for all groups, or one each.
    correlations : {"auto", "always", "never"}
        Of donors and of specimens.
    seed : int
    ess : float
        Effective draws of the worst quantity.
    max_steps : int
        Kept sweeps of each ensemble at which the sampler gives up.
    workers : int, optional
        As in :class:`SamplingPlan`.
    """

    pool_mounting: bool = option(False, "Pool the mounting stretches, too.")
    spread: str = option(
        "common",
        "One sd between the specimens of a donor for all groups, or one each.",
        choices=SPREADS,
    )
    correlations: str = option(
        "auto",
        "Correlations of donors and of specimens; auto: where there are four for each parameter.",
        choices=CORRELATIONS,
    )
    seed: int = option(1, SAME_SEED, least=0, most=MOST_WHOLE)
    ess: float = option(1000.0, WANTED, least=50, most=MOST)
    max_steps: int = option(6000, "When to give up.", least=128, most=MOST)
    workers: int | None = option(None, stated(SamplingPlan)["workers"].words, kind=int, least=1)

    @property
    def processors(self) -> int:
        """Processors to use."""
        return SamplingPlan(workers=self.workers).processors


@dataclass(frozen=True)
class LawsPlan(Options):
    """How much is sampled to weigh laws.

    Attributes
    ----------
    laws : sequence of str, or str
        Their names, in a text separated by commas; all where none is given.
    seed : int
    ess : float
        Effective draws of each law on each part of the record.
    max_steps : int
    """

    laws: Sequence[str] | str | None = option(
        None, "Laws, separated by commas  [all]", metavar="NAME,NAME"
    )
    seed: int = option(1, SAME_SEED, least=0, most=MOST_WHOLE)
    ess: float = option(500.0, "Effective draws of each posterior.", least=50, most=MOST)
    max_steps: int = option(20_000, "When to give up.", least=128, most=MOST)


@dataclass(frozen=True)
class CalibrationPlan(Options):
    """A calibration study.

    Attributes
    ----------
    replications : int
    source : {"prior", "posterior"}
        Where the true values come from.
    seed : int
    ess : float
        Effective draws of each replication.
    broken : str
        What is broken on purpose, to show that the study notices.
    """

    replications: int = option(200, least=1)
    source: str = option(
        "prior",
        "True values from a prior scaled to the protocol, or around the specimen's posterior.",
        choices=("prior", "posterior"),
        flag="from",
    )
    seed: int = option(1, least=0, most=MOST_WHOLE)
    ess: float = option(
        600.0, "Effective draws of each.", least=200, reason="127 draws are ranked against"
    )
    broken: str = option("", "determinant, or noise.", flag="break")


# --- what the other verbs are asked --------------------------------------------------------------


@dataclass(frozen=True)
class DesignOptions(Options):
    """Which further measurements are tried, and how they are ranked.

    Attributes
    ----------
    ratios : sequence of (float, float)
        Further stretch ratios to try.
    further : float
        How far the protocol goes that goes further, relative to the tested range.
    alpha_sd_deg, kappa_sd, image_sd : float
        Sds of histology and of the mounting stretch by image.
    rank_by : str
        ``parameters``, ``information``, or one quantity.
    seed : int
    """

    ratios: Sequence[tuple[float, float]] = option(
        (), "A further stretch ratio to try, as 1:0.75. Repeatable.", metavar="X:Y", flag="ratio"
    )
    further: float = option(
        1.25,
        "How far the protocol goes that goes further, relative to the tested range.",
        least=1.0,
        most=3.0,
        shown=True,
    )
    alpha_sd_deg: float = option(
        5.0, "Histology, degrees.", least=0.0, most=1e3, inside=True, flag="alpha-sd"
    )
    kappa_sd: float = option(0.03, "Histology.", least=0.0, most=1e3, inside=True)
    image_sd: float = option(0.005, "Mounting stretch by image.", least=0.0, most=1e3, inside=True)
    rank_by: str = option(
        "parameters",
        "The mean over the parameters, 'information', or one quantity, such as kappa.",
    )
    seed: int = option(1, SAME_SEED, least=0)


@dataclass(frozen=True)
class PredictionOptions(Options):
    """Bands of stress on a path, or of the inflation of a tube.

    Attributes
    ----------
    points : int
        States of a path that is not given one by one.
    probability : float
        Content of the bands.
    seed : int
    """

    points: int = option(61, least=2, most=100_000, shown=True)
    probability: float = option(
        CONTENT, "Content of the bands.", least=0.0, most=1.0, inside=True, shown=True
    )
    seed: int = option(0, least=0, shown=True)


@dataclass(frozen=True)
class FigureOptions(Options):
    """How a figure is printed.

    Attributes
    ----------
    suffix : {"pdf", "svg", "png"}
    width_mm : float
    style : path-like, optional
        A matplotlib style file.
    """

    suffix: str = option("pdf", choices=PICTURES, flag="format")
    width_mm: float = option(85.0, least=50.0, most=400.0, shown=True)
    style: object = option(None, "A matplotlib style file.", metavar="FILE")


@dataclass(frozen=True)
class CardOptions(Options):
    """Material cards of posterior draws.

    Attributes
    ----------
    draws : int, optional
        So many random draws; else the one that ``at`` names.
    at : {"median", "map"}
        Default ``median``.
    units : {"kPa-mm", "MPa-mm", "Pa-m"}
    bulk_ratio : float, optional
        Bulk modulus over stiffness; default incompressible for Abaqus, 1000 for FEBio.
    seed : int
    overwrite : bool
        Replace the cards of an earlier export.
    """

    draws: int | None = option(
        None, "N random posterior draws.", kind=int, least=1, shown=True, metavar="N"
    )
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
    seed: int = option(0, least=0, shown=True)
    overwrite: bool = option(False, "Replace the cards of an earlier export.")


@dataclass(frozen=True)
class VirtualTest(Options):
    """A virtual biaxial test.

    Attributes
    ----------
    material : str, GOH or StatedMaterial
        Name of a published material, or one of your own: ``biaxbayes.law("fung", ...)``.
    fibre_switch : bool
    prestretch : (float, float), optional
        Mounting stretches; the published ones by default.
    total_stretch, measured_stretch : float, optional
        Largest stretch from unloaded, or from mounted.
    ratios : sequence of (float, float)
        Stretch ratios, one protocol each; 1:1 where none is given.
    increments : int
    edge : (float, float)
        Unloaded edges, mm.
    thickness : float, optional
        Unloaded, mm; the published one by default, else 1.
    noise_N, misfit : float
        Sd of a force reading; sd of a smooth error as a share of the force.
    stress_pair : {"force", "piola", "cauchy"}
    geometry : {"unloaded", "mounted"}
    hooks : int, optional
        Finite elements with so many hooks an edge, of a GOH material.
    seed : int
    name : str, optional
        Of the specimen; default that of the file.
    """

    material: object = option(None, "A published material; 'list' prints them.", metavar="NAME")
    fibre_switch: bool = option(False, stated(Settings)["fibre_switch"].words)
    prestretch: Sequence[float] | None = option(
        None, "Mounting stretches; the published ones by default.", metavar="X Y"
    )
    total_stretch: float | None = option(
        None, "Largest stretch from unloaded.", kind=float, metavar="L"
    )
    measured_stretch: float | None = option(
        None, "Largest stretch from mounted.", kind=float, metavar="L"
    )
    ratios: Sequence[tuple[float, float]] = option(
        (),
        "Stretch ratio, one protocol each time it is given  [default: 1:1]",
        metavar="X:Y",
        flag="ratio",
    )
    increments: int = option(100, least=1, most=100_000, shown=True)
    edge: tuple[float, float] = option(
        (20.0, 20.0), "Unloaded edge, 20 or 20x15 (x, y)  [default: 20]", metavar="MM"
    )
    thickness: float | None = option(
        None, "Unloaded thickness  [default: 1]", kind=float, metavar="MM"
    )
    noise_N: float = option(0.0, "Sd of a force reading.", metavar="N")
    misfit: float = option(0.0, "Sd of a smooth error, share of force.", metavar="R")
    stress_pair: str = option(
        "force", "What the file holds: N, or kPa as a lab computes it.", choices=STRESS_PAIRS
    )
    geometry: str = option(
        "unloaded", "State whose dimensions the file states.", choices=GEOMETRIES
    )
    hooks: int | None = option(
        None,
        "Finite elements with N hooks an edge (5 if not said).",
        kind=int,
        least=1,
        most=50,
        shown=True,
        metavar="[N]",
    )
    seed: int = option(0, least=0, shown=True)
    name: str | None = option(None, "Name of the specimen  [default: that of the file]")
