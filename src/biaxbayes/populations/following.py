"""What follows from pooled parameters: structure tensor, stiffness and stress of a group."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from biaxbayes.comparison.compare import contractions
from biaxbayes.identifiability.determined import Derived, derived_quantities
from biaxbayes.identifiability.verdict import FIXED, NO_VERDICT, Thresholds
from biaxbayes.populations.model import LINEAR, LOG
from biaxbayes.populations.predictive import Hyper
from biaxbayes.populations.specimens import Source
from biaxbayes.studies.groups import DETERMINED
from biaxbayes.studies.result import NOT_DETERMINED

if TYPE_CHECKING:
    from biaxbayes.populations.result import Population

__all__ = ["CURVE_DRAWS", "derived", "following", "stated_stretches"]

CURVE_DRAWS = 400
CONSTANT = 1e-9
WITHIN, BETWEEN = 60, 30
"""Specimens of the typical donor, and donors, made for each draw of a quantity that follows."""


def stated_stretches(sources: Sequence[Source]) -> list[float]:
    """Equibiaxial total stretches that every specimen reached: half-way and the largest."""
    top = min(s.largest_stretch for s in sources)
    return [round(1.0 + share * (top - 1.0), 3) for share in (0.5, 1.0)]


def derived(found: Population, theta: np.ndarray) -> list[Derived]:
    """Quantities that follow from materials; infinite where they cannot be computed."""
    stretches = stated_stretches(found.sources)
    all_of = derived_quantities(found.materials(theta), found.law, stretches, [1.0, stretches[-1]])
    return [replace(q, values=np.nan_to_num(q.values, nan=np.inf)) for q in all_of]


def _typical(
    found: Population, hyper: Hyper, g: int, rng: np.random.Generator
) -> tuple[list[Derived], list[Derived]]:
    """Quantities of the typical donor's specimens, and their median draw by draw."""
    within = hyper.repeated(WITHIN)
    single = derived(found, within.specimens(within.mu[:, g], g, rng))
    shape = (hyper.draws, WITHIN)
    return single, [replace(q, values=np.median(q.values.reshape(shape), axis=1)) for q in single]


def following(
    found: Population, g: int
) -> Iterator[tuple[str, str, str, dict[str, np.ndarray], dict[str, Any]]]:
    """Structure tensor, stiffness and stress of a group, as its parameters are told.

    They are determined where the records narrow the median, as in a study.
    """
    hyper = found.hyper(CURVE_DRAWS)
    rng = found.rng(1 + g)
    M = hyper.draws
    of_typical, medians = _typical(found, hyper, g, rng)
    between = hyper.repeated(BETWEEN)
    of_donors = derived(found, between.median(between.donors(g, rng), g))
    wide = hyper.repeated(4)
    location = wide.donors(g, rng)
    new = derived(found, wide.specimens(location, g, rng))
    donor = derived(found, wide.median(location, g))
    _, before = _typical(found, found.prior[0].thinned(CURVE_DRAWS), g, found.rng(700 + g))
    shares = contractions(before, medians)
    for q, median, share, *others in zip(
        of_typical, medians, shares, of_donors, new, donor, strict=True
    ):
        typical, (donors, specimen, one) = q.values, (o.values for o in others)
        unit = q.unit or "1"
        told = {"verdict": NO_VERDICT}
        if found.state == "converged":
            known = share >= Thresholds().contraction
            told = {"verdict": DETERMINED if known else NOT_DETERMINED, "contraction": share}
            if np.ptp(median.values) <= CONSTANT * abs(median.values[0]):
                told = {"verdict": FIXED}  # as the parameters are that it follows from
        scale = LOG if unit != "1" and min(typical.min(), donors.min()) > 0.0 else LINEAR

        def spread(values: np.ndarray, scale: str = scale) -> np.ndarray:
            with np.errstate(over="ignore", invalid="ignore"):
                moved = np.log(values) if scale == LOG else values
                return np.asarray(moved.reshape(M, -1).std(axis=1, ddof=1))

        yield (
            q.key,
            unit,
            scale,
            {
                "mean": median.values,
                "sd_donors": spread(donors),
                "sd_specimens": spread(typical),
                "new_specimen": specimen,
                "new_donor": one,
            },
            told,
        )
