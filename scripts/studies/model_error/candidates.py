"""Error models: a specimen to draws (a table), each in its own way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.model.curves import Curves
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import charted, prepare
from biaxbayes.model.search import draw_posterior
from biaxbayes.sampling.sampler import Draws, Plan
from biaxbayes.specimens.specimen import Specimen

__all__ = ["CANDIDATES", "Answer", "sandwich"]

DRAWS = 600
CHEAP: dict[str, Any] = {
    "max_steps": 3000,
    "ensembles": 2,
    "population": 1024,
    "walkers": 36,
    "first_block": 64,
}


@dataclass(frozen=True)
class Answer:
    """What a candidate says of a specimen."""

    draws: pd.DataFrame
    state: str
    beta: float
    cpu_s: float = float("nan")


def _answer(posterior: Posterior, found: Draws, quantities=None) -> Answer:
    values = quantities or {k: v.ravel() for k, v in found.quantities.items()}
    table = pd.DataFrame(values)
    step = max(1, len(table) // DRAWS)
    return Answer(table.iloc[::step], found.convergence.state, posterior.beta)


def _sampled(specimen: Specimen, ess: float, **options: Any) -> tuple[Posterior, Draws]:
    posterior = prepare(specimen, **options)
    found = draw_posterior(posterior, Plan(ess=ess, **CHEAP))
    return charted(posterior, found.target.frame["softening"]), found


def plain(options: dict[str, Any]):
    return lambda specimen, ess: {"": _answer(*_sampled(specimen, ess, **options))}


def independent(specimen: Specimen, ess: float) -> dict[str, Answer]:
    posterior, found = _sampled(specimen, ess, noise="independent")
    adjusted = sandwich(posterior, found)
    return {
        "": _answer(posterior, found),
        "sandwich": _answer(posterior, found, adjusted),
    }


CANDIDATES = {
    "effective": plain({}),
    "growth": plain({"noise_growth": True}),
    "systematic": plain({"noise": "systematic"}),
    "systematic, growth": plain({"noise": "systematic", "noise_growth": True}),
    "independent": independent,
}


def sandwich(posterior: Posterior, found: Draws) -> dict[str, np.ndarray]:
    """Draws stretched about their mean to the covariance S J S of misspecified models.

    S is their own covariance; J the scatter of the scores, correlated along each curve (Bartlett
    weights over half a curve), and the curvature of prior and mounting reading.
    """
    u = found.chain.reshape(-1, found.chain.shape[-1])
    u = u[:: max(1, len(u) // DRAWS)]
    centre, S = u.mean(axis=0), np.cov(u.T)
    step = 0.2 * np.sqrt(np.diag(S))
    curves = Curves.of(posterior)

    def pointwise(points: np.ndarray) -> np.ndarray:
        at = posterior.natural(points)
        return curves.log_likelihood(curves.model(at), curves.noise(at))

    scores = np.stack(
        [
            (pointwise(centre[None] + h) - pointwise(centre[None] - h))[0] / (2.0 * h.sum())
            for h in np.diag(step)
        ]
    )  # (d, rows, 2)
    J = _rest_information(posterior, centre, step)
    for p in np.unique(curves.protocol):
        for axis in (0, 1):
            g = scores[:, curves.protocol == p, axis]
            lags = g.shape[1] // 2
            for lag in range(lags):
                part = g[:, : g.shape[1] - lag] @ g[:, lag:].T * (1.0 - lag / lags)
                J += part if lag == 0 else part + part.T
    target = S @ J @ S
    stretch = np.linalg.cholesky(target + 1e-10 * S) @ np.linalg.inv(np.linalg.cholesky(S))
    moved = centre + (u - centre) @ stretch.T
    for i, (low, high) in enumerate(posterior.bounds):
        if not np.isfinite([low, high]).all():
            continue
        span = high - low
        folded = np.mod(moved[:, i] - low, 2.0 * span)  # mirrored at the edges
        moved[:, i] = low + np.where(folded > span, 2.0 * span - folded, folded)
    natural = posterior.natural(moved[np.isfinite(posterior.log_prob(moved))])
    there = np.isfinite(natural["lp"])  # not so where a parameter underflows to 0
    return {name: values[there] for name, values in natural.items()}


def _rest_information(posterior: Posterior, x: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Curvature of everything but the curves: priors and mounting readings."""
    from biaxbayes.model import density as kernel

    d = x.size
    eye = np.diag(step)
    pairs = [(i, j) for i in range(d) for j in range(i, d)]
    signs = ((1, 1), (1, -1), (-1, 1), (-1, -1))
    points = np.array([x + a * eye[i] + b * eye[j] for i, j in pairs for a, b in signs])
    total, likelihood, _ = kernel.evaluate(posterior._assembly.problem, points)
    value = (total - likelihood).reshape(-1, 4)
    second = value @ np.array([1.0, -1.0, -1.0, 1.0])
    H = np.zeros((d, d))
    for (i, j), s in zip(pairs, second, strict=True):
        H[i, j] = H[j, i] = -s / (4.0 * step[i] * step[j])
    values, vectors = np.linalg.eigh(np.nan_to_num(H))
    return (vectors * np.maximum(values, 0.0)) @ vectors.T
