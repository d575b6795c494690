"""Laws weighted by their predictions of left-out parts of a record.

The score of a law is the log predictive density of the readings that were left out, under the law
and its misfit given the other readings. Readings of one curve miss together, so that weights are
more decided than as many independent readings would leave them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import logsumexp

from biaxbayes.comparison.law_comparison import WHOLE, PredictedReadings, Prediction, left_out_parts
from biaxbayes.errors import NotConverged
from biaxbayes.parameters import mounting_names
from biaxbayes.prediction.percentiles import quantile_columns
from biaxbayes.specimens.specimen import Specimen

MIXTURE = "mixture"
UNUSABLE = ("unusable", "failed")

PRIOR_READINGS = 1.0
"""Readings in all that the Dirichlet prior is equivalent to, a = 1 + 1 / models."""
_STEPS, _TOLERANCE = 20_000, 1e-10


def stacking_weights(log_density: np.ndarray) -> np.ndarray:
    """Weights (models,) of the mixture that predicts left-out readings best.

    Stacking (Yao, Vehtari, Simpson, Gelman, Bayesian Anal. 13 (2018) 917): with p_ki the density of
    reading i under model k, and a Dirichlet prior (a, ..., a) towards equal weights,

        maximise  sum_i ln sum_k w_k p_ki + (a - 1) sum_k ln w_k     over the simplex of w.

    ``log_density`` (models, readings) is -inf where a model excludes a reading. ArviZ takes its
    exponential without scaling, which leaves nothing of readings that all models miss by far.
    """
    models = len(log_density)
    top = log_density.max(axis=0)
    predicted = np.isfinite(top)  # readings that all models exclude do not inform weights
    density = np.exp(log_density[:, predicted] - top[predicted])
    weight = np.full(models, 1.0 / models)
    prior = PRIOR_READINGS / models  # a - 1
    total = predicted.sum() + PRIOR_READINGS
    for _ in range(_STEPS):
        # expectation maximisation: the fraction of every reading that each model explains
        joint = weight[:, None] * density
        explained = (joint / joint.sum(axis=0)).sum(axis=1) + prior
        new = explained / total
        if np.abs(new - weight).max() < _TOLERANCE:
            return new
        weight = new
    return weight


def weighted_density(log_density: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Log density (readings,) of a mixture, from log densities (models, readings)."""
    with np.errstate(divide="ignore"):
        return np.asarray(logsumexp(log_density + np.log(weight)[:, None], axis=0))


@dataclass(frozen=True)
class LawComparison:
    """Laws weighted by what they predict.

    Attributes
    ----------
    table : DataFrame
        ``laws.csv``: one row per law, with quantiles of the mounting stretches; the last one is
        ``mixture``.
    parts : DataFrame
        ``left-out.csv``: one row per law and part.
    left_out : dict of str to str
        Laws that are not part of the mixture, and why.
    """

    specimen: str
    table: pd.DataFrame
    parts: pd.DataFrame
    left_out: dict[str, str]

    @property
    def converged(self) -> bool:
        """True if every law has converged on every record."""
        states = self.table["state"][self.table["law"] != MIXTURE]
        return not self.left_out and bool((states == "converged").all())

    def __repr__(self) -> str:
        laws = self.table[self.table["law"] != MIXTURE].sort_values("weight", ascending=False)
        pairs = zip(laws["law"], laws["weight"].to_numpy(dtype=float), strict=True)
        weights = ", ".join(f"{law} {weight:.2f}" for law, weight in pairs if weight > 0.005)
        return f"LawComparison({self.specimen}: {weights})"


def weigh_laws(
    specimen: Specimen, predictions: Mapping[tuple[str, str], Prediction], laws: Sequence[str]
) -> LawComparison:
    """Weigh laws by predictions by law and left-out part; NotConverged if none is usable."""
    parts = [p.name for p in left_out_parts(specimen)]
    bad = {
        law: f"{name}: {predictions[law, name].reason}"
        for name in (*reversed(parts), WHOLE)
        for law in laws
        if predictions[law, name].state in UNUSABLE
    }
    used = [law for law in laws if law not in bad]
    if not used:
        raise NotConverged(
            "no law could be sampled on all parts of the record: "
            + "; ".join(f"{law} ({why})" for law, why in bad.items())
        )
    readings = {key: p.readings for key, p in predictions.items() if p.readings is not None}
    left = [[readings[law, part] for law in used] for part in parts]
    densities = [np.array([r.log_density for r in own]) for own in left]
    weight = stacking_weights(np.hstack(densities))
    # a part is predicted by a mixture that has not seen it
    blind = np.array(
        [stacking_weights(np.hstack(densities[:i] + densities[i + 1 :])) for i in range(len(left))]
    )
    weights = {
        law: np.tile(w, (len(left), 1)) for law, w in zip(used, np.eye(len(used)), strict=True)
    }
    scores = {
        name: np.array([_score(*part) for part in zip(left, densities, own, strict=True)])
        for name, own in (weights | {MIXTURE: blind}).items()
    }
    sizes = np.array([own[0].measured.size for own in left], dtype=float)
    rows = []
    for law in laws:
        whole = predictions[law, WHOLE]
        row: dict[str, Any] = {"law": law, "state": whole.state, "rms_kPa": whole.rmse_kPa}
        if law in used:
            of_law = blind[:, used.index(law)]
            row |= {
                **_overall(scores[law], sizes),
                "weight": float(weight[used.index(law)]),
                "weight_low": float(of_law.min()),
                "weight_high": float(of_law.max()),
                **_stretches(whole.draws, specimen),
            }
        rows.append(row)
    rows.append({"law": MIXTURE, **_overall(scores[MIXTURE], sizes), "weight": 1.0})
    table = pd.DataFrame(rows).fillna({"state": ""})
    parts_table = [
        {
            "part": part,
            "law": law,
            "weight": 1.0,
            "left_out_rms_kPa": float(np.sqrt(of_law[i, 1])),
            "left_out_density_nats": of_law[i, 0],
            # less the density, it is what these gain by having seen the part
            "density_final_weights": (
                _score(left[i], densities[i], weight)[0] if law == MIXTURE else of_law[i, 0]
            ),
            "readings": int(sizes[i]),
        }
        for i, part in enumerate(parts)
        for law, of_law in scores.items()
    ]
    return LawComparison(specimen.name, table, pd.DataFrame(parts_table), bad)


def _score(
    readings: Sequence[PredictedReadings], log_density: np.ndarray, weight: np.ndarray
) -> tuple[float, float]:
    """Log density (nats) and mean square miss (kPa^2) of a mixture of laws on a left-out part."""
    measured = readings[0].measured.ravel()
    # the mean of a mixture is the mixture of the means
    miss = [(measured - r.expected) / r.load_per_stress.ravel() for r in readings]
    density = float(weighted_density(log_density, weight).sum())
    return density, float(np.mean((weight @ np.array(miss)) ** 2))


def _overall(scores: np.ndarray, sizes: np.ndarray) -> dict[str, float]:
    """Scores of all parts together, from those of each (parts, 2) and their readings."""
    density, square = scores.T
    return {
        "left_out_rms_kPa": float(np.sqrt(square @ sizes / sizes.sum())),
        "left_out_density_nats": float(density.sum()),
    }


def _stretches(draws: pd.DataFrame, specimen: Specimen) -> dict[str, float]:
    """Quantiles of the mounting stretches that a table of draws has."""
    states = ("", *(p.name for p in specimen.protocols))
    names = [n for s in states for n in mounting_names("stretch", s) if n in draws]
    return {k: v for name in names for k, v in quantile_columns(name, draws[name]).items()}
