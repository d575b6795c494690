"""Laws weighted by their predictions of left-out parts of a record.

The score of a law is the log predictive density of the readings that were left out, under the law
and its misfit given the other readings, averaged over the draws. Readings are averaged as in the
likelihood, 20 to 32 a curve, and each counts once. Those of one curve miss together all the same:
weights are more decided than as many independent readings would leave them, which their range with
a part dropped shows.

Stacking (Yao, Vehtari, Simpson, Gelman, Bayesian Anal. 13 (2018) 917) chooses the mixture of
predictive densities that predicts left-out readings best. With p_ki the density that law k gives
to reading i, and a Dirichlet prior (a, ..., a) towards equal weights,

    maximise  sum_i ln sum_k w_k p_ki + (a - 1) sum_k ln w_k     over the simplex of w.

The mixture predicts stresses in the tested range; it says nothing of the mounting stretch, which
lies where no reading does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import logsumexp

from biaxbayes.comparison.law_comparison import (
    WHOLE,
    Part,
    PredictedReadings,
    Prediction,
    left_out_parts,
)
from biaxbayes.errors import NotConverged
from biaxbayes.parameters import mounting_names
from biaxbayes.prediction.percentiles import quantile_columns
from biaxbayes.specimens.specimen import Specimen

MIXTURE = "mixture"
UNUSABLE = ("unusable", "failed")

# --- stacking ------------------------------------------------------------------------------------

PRIOR_READINGS = 1.0
"""Readings in all that the Dirichlet prior is equivalent to, a = 1 + 1 / models."""
_STEPS, _TOLERANCE = 20_000, 1e-10


def stacking_weights(log_density: np.ndarray) -> np.ndarray:
    """Weights (models,) of the mixture that predicts left-out readings best.

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
        mixed: np.ndarray = logsumexp(log_density + np.log(weight)[:, None], axis=0)
    return mixed


# --- laws ----------------------------------------------------------------------------------------


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


@dataclass(frozen=True)
class _LeftOut:
    """Predictions of a left-out part by all laws."""

    readings: list[PredictedReadings]

    @property
    def measured(self) -> np.ndarray:
        """The readings, (readings,)."""
        return self.readings[0].measured.ravel()

    @property
    def log_density(self) -> np.ndarray:
        """Log predictive density of each law, (laws, readings)."""
        return np.array([r.log_density for r in self.readings])

    def score(self, weight: np.ndarray) -> tuple[float, float]:
        """Log density (nats) and mean square miss (kPa^2) of a mixture."""
        density = float(weighted_density(self.log_density, weight).sum())
        # the mean of a mixture is the mixture of the means
        miss = [(self.measured - r.expected) / r.load_per_stress.ravel() for r in self.readings]
        return density, float(np.mean((weight @ np.array(miss)) ** 2))


def weigh_laws(
    specimen: Specimen, predictions: Mapping[tuple[str, str], Prediction], laws: Sequence[str]
) -> LawComparison:
    """Weigh laws by predictions by law and left-out part; NotConverged if none is usable."""
    parts = left_out_parts(specimen)
    names = (WHOLE, *(p.name for p in parts))
    bad = {
        law: f"{name}: {predictions[law, name].reason}"
        for name in reversed(names)
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
    left = [_LeftOut([readings[law, part.name] for law in used]) for part in parts]
    weight = _weights(left, len(used))
    # a part is predicted by a mixture that has not seen it
    blind = [_weights([*left[:i], *left[i + 1 :]], len(used)) for i in range(len(left))]
    return LawComparison(
        specimen.name,
        _law_table(specimen, laws, used, predictions, left, weight, np.array(blind)),
        _part_table(parts, used, left, weight, blind),
        bad,
    )


def _weights(left: Sequence[_LeftOut], laws: int) -> np.ndarray:
    """Stacking weights of the laws; equal where no part is left to learn from."""
    if not left:
        return np.full(laws, 1.0 / laws)
    return stacking_weights(np.hstack([p.log_density for p in left]))


# --- tables --------------------------------------------------------------------------------------


def _law_table(
    specimen: Specimen,
    laws: Sequence[str],
    used: Sequence[str],
    predictions: Mapping[tuple[str, str], Prediction],
    left: Sequence[_LeftOut],
    weight: np.ndarray,
    blind: np.ndarray,
) -> pd.DataFrame:
    sizes = np.array([part.measured.size for part in left], dtype=float)

    def scores(weights: np.ndarray) -> dict[str, Any]:
        """Of a mixture with the part's own weights on each part."""
        parts = zip(left, weights, strict=True)
        density, square = np.transpose([part.score(w) for part, w in parts])
        return {
            "left_out_rms_kPa": float(np.sqrt(square @ sizes / sizes.sum())),
            "left_out_density_nats": float(density.sum()),
        }

    rows = []
    for law in laws:
        whole = predictions[law, WHOLE]
        row: dict[str, Any] = {"law": law, "state": whole.state, "rms_kPa": whole.rmse_kPa}
        if law in used:
            k = used.index(law)
            row |= {
                **scores(np.tile(np.eye(len(used))[k], (len(left), 1))),
                "weight": float(weight[k]),
                "weight_low": float(blind[:, k].min()),
                "weight_high": float(blind[:, k].max()),
                **_stretches(whole.draws, specimen),
            }
        rows.append(row)
    rows.append({"law": MIXTURE, **scores(blind), "weight": 1.0})
    return pd.DataFrame(rows).fillna({"state": ""})


def _stretches(draws: pd.DataFrame, specimen: Specimen) -> dict[str, float]:
    """Quantiles of the mounting stretches that a table of draws has."""
    states = ("", *(p.name for p in specimen.protocols))
    names = [n for s in states for n in mounting_names("stretch", s) if n in draws]
    return {k: v for name in names for k, v in quantile_columns(name, draws[name]).items()}


def _part_table(
    parts: Sequence[Part],
    used: Sequence[str],
    left: Sequence[_LeftOut],
    weight: np.ndarray,
    blind: Sequence[np.ndarray],
) -> pd.DataFrame:
    """Each law, and the mixture that has not seen the part, on each part.

    ``density_final_weights`` is the density with the weights of the whole record: the difference is
    what these gain by having seen the part.
    """
    rows = []
    for i, (part, own) in enumerate(zip(parts, left, strict=True)):
        for law, w, final in (
            *((law, w, w) for law, w in zip(used, np.eye(len(used)), strict=True)),
            (MIXTURE, blind[i], weight),
        ):
            (density, square), (seen, _) = own.score(w), own.score(final)
            rows.append(
                {
                    "part": part.name,
                    "law": law,
                    "weight": float(w[used.index(law)]) if law != MIXTURE else 1.0,
                    "left_out_rms_kPa": float(np.sqrt(square)),
                    "left_out_density_nats": density,
                    "density_final_weights": seen,
                    "readings": int(own.measured.size),
                }
            )
    return pd.DataFrame(rows)
