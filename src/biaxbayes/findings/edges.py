"""Where a parameter's range ends, and whether the data keep it away from there.

Physical edges: kappa at 0 (aligned fibres) and at 1/3 (isotropic), and C1, k1 and k2 towards 0 (no
matrix, no fibres, no stiffening). At an edge the draws are judged by the likelihood with everything
else averaged out, relative to its maximum (see :mod:`biaxbayes.findings.marginal`): above
exp(-1.92) = 0.147, what a 95 % likelihood interval leaves in, the data do not exclude the edge. An
angle of 0 or 90 degrees is a mirror of the material, not an edge. Bounds that a user set are no
property of tissue and are kept apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from biaxbayes.findings.marginal import Density
from biaxbayes.findings.material_draws import (
    fibre_strains,
    mounting_labels,
    parameters,
    protocol_mounting,
)
from biaxbayes.findings.sampling_scale import Scale, prior_cumulative, prior_values
from biaxbayes.inference.priors import DEFAULT_BOUNDS, Prior
from biaxbayes.mechanics.goh import structure_tensor
from biaxbayes.specimens.specimen import Specimen

__all__ = ["Edge", "edge_distances", "find_edges"]

KAPPA_DISTANCE = 0.02
EXPONENT_DISTANCE = 0.1  # k2 E^2 at the largest stretch
STIFFNESS_SHARE = 0.05  # of the small-strain stiffness
PRIOR_TAIL = 0.025  # share of a prior without bounds that counts as its end
BOUND_TAIL = 0.05  # share of a prior that counts as near a bound
MEANINGS = {
    ("kappa", 0): "aligned fibres",
    ("kappa", 1): "isotropic",
    ("C1", 0): "no matrix",
    ("k1", 0): "no fibres",
    ("k2", 0): "no exponential stiffening",
}


@dataclass(frozen=True)
class Edge:
    """One end of a parameter's range.

    Attributes
    ----------
    side : int
        0 for the low end, 1 for the high one.
    value : float
        Natural value at the end; for a range without end the prior's 2.5 % or 97.5 % point.
    kind : {"physical", "user", "prior"}
        A property of the model, a bound in the priors, or merely where the prior thins out.
    distance : float
        How near counts as near, in the parameter's unit.
    mass, prior_mass : float
        Share of the draws and of the prior that near.
    support : float
        Likelihood there over its maximum.
    """

    side: int
    value: float
    kind: str
    distance: float
    mass: float
    prior_mass: float
    support: float

    def meaning(self, parameter: str) -> str:
        """What a material at a physical edge is."""
        return MEANINGS.get((parameter, self.side), "")


def edge_distances(draws: pd.DataFrame, specimen: Specimen) -> dict[str, float]:
    """How near to a physical edge counts as near, by parameter, in natural units.

    kappa: 0.02. k2: the exponent k2 E^2 at the largest stretch is below 0.1. C1 and k1: less than
    5 % of the small-strain stiffness (trace of d s / d ln l) comes from the matrix, or the fibres.
    """
    C1, k1, _, alpha, kappa = (v[:, 0] for v in parameters(draws))
    Hx, Hy, Hz = structure_tensor(alpha, kappa)
    # trace of the Hessian at l = 1: 16 C1 + 8 k1 (gx^2 + gy^2), gk = Hk - Hz
    per_k1 = 8.0 * ((Hx - Hz) ** 2 + (Hy - Hz) ** 2)
    stiffness = STIFFNESS_SHARE * float(np.median(16.0 * C1 + k1 * per_k1))
    strain2 = np.zeros(len(draws))
    for protocol in specimen.protocols:
        lm = protocol_mounting(draws, protocol) if mounting_labels(draws) else np.ones((1, 2))
        top = np.array([protocol.stretch_x.max(), protocol.stretch_y.max()]) * lm
        E = fibre_strains(draws, top[:, :1], top[:, 1:])[:, 0]
        strain2 = np.maximum(strain2, E * E)
    return {
        "C1": stiffness / 16.0,
        "k1": stiffness / max(float(np.median(per_k1)), 1e-9),
        "k2": EXPONENT_DISTANCE / max(float(np.median(strain2)), 1e-12),
        "kappa": KAPPA_DISTANCE,
    }


def find_edges(
    scale: Scale, natural: np.ndarray, likelihood: Density, distance: float | None
) -> tuple[Edge, ...]:
    """Both ends of a parameter's range; none for a mirror.

    Parameters
    ----------
    scale : Scale
        Of a parameter with a prior.
    natural : ndarray, shape (n,)
        Draws.
    likelihood : Density
        Of the draws' cumulative prior probability.
    distance : float, optional
        From :func:`edge_distances`.
    """
    prior = scale.prior
    assert isinstance(prior, Prior)
    out = []
    for side in (0, 1):
        bound = (prior.low, prior.high)[side]
        physical = DEFAULT_BOUNDS.get(scale.kind, (0.0 if scale.logarithmic else None, None))[side]
        if physical is not None and abs(bound - physical) < 1e-12:
            bound = np.inf  # the physical end itself
        if bound == 0.0 and scale.kind.startswith("mounting"):
            bound = -np.inf  # a stretch is positive, which is no one's choice
        if np.isfinite(bound):
            out.append(_end(prior, natural, likelihood, side, float(bound)))
        elif scale.kind == "alpha":
            continue
        elif physical is not None:
            out.append(_physical(prior, natural, likelihood, side, physical, distance))
        else:
            out.append(_end(prior, natural, likelihood, side))
    return tuple(out)


def _near(prior: Prior, natural: np.ndarray, side: int, threshold: float) -> tuple[float, float]:
    """Mass of the draws and of the prior beyond a threshold."""
    below = float(prior_cumulative(prior, np.array([threshold]))[0])
    if side == 0:
        return float((natural <= threshold).mean()), below
    return float((natural >= threshold).mean()), 1.0 - below


def _physical(
    prior: Prior,
    natural: np.ndarray,
    likelihood: Density,
    side: int,
    value: float,
    distance: float | None,
) -> Edge:
    assert distance is not None
    threshold = value + distance if side == 0 else value - distance
    mass, prior_mass = _near(prior, natural, side, threshold)
    support = likelihood.at(float(side)) / likelihood.peak
    return Edge(side, value, "physical", distance, mass, prior_mass, support)


def _end(
    prior: Prior,
    natural: np.ndarray,
    likelihood: Density,
    side: int,
    bound: float | None = None,
) -> Edge:
    """A bound in the priors, or without one the place where the prior thins out."""
    tail = PRIOR_TAIL if bound is None else BOUND_TAIL
    threshold = float(prior_values(prior, np.array([tail if side == 0 else 1.0 - tail]))[0])
    mass, prior_mass = _near(prior, natural, side, threshold)
    if bound is None:
        support = min(mass / prior_mass / likelihood.peak, 1.0)
        return Edge(side, threshold, "prior", 0.0, mass, prior_mass, support)
    support = likelihood.at(float(side)) / likelihood.peak
    return Edge(side, bound, "user", abs(threshold - bound), mass, prior_mass, support)
