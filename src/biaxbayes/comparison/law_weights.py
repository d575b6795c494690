"""Laws weighted by their predictions of left-out parts of a record.

The score of a law is the log predictive density of single readings that were left out, averaged
over its draws. A left-out curve has one weight n_eff / n for all laws, from the residuals of the
law that fits the whole record best: readings that miss together are no independent evidence. The
mixture by the stacking weights is a prediction of stresses, with bands at levels that are learned
from left-out parts as the weights are; it is no posterior of the mounting
stretch, which lies where no reading does. What is reported of that is the union of the intervals of
the laws that predict the record about as well as the best.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.comparison.law_comparison import WHOLE, Part, Prediction, left_out_parts, only
from biaxbayes.comparison.mixture import (
    calibrated_levels,
    mixed_percentiles,
    mixed_probabilities,
    mixture_bands,
    mixture_draws,
    shared_stretches,
    sharpness,
    stacking_weights,
    weighted_density,
)
from biaxbayes.error_model import log_likelihood
from biaxbayes.errors import NotConverged
from biaxbayes.fitting.effective_readings import effective_readings, has_smooth_misfit
from biaxbayes.identifiability.mounting_interval import (
    MEASURED_REASON,
    MountingInterval,
    interval_from_predictions,
)
from biaxbayes.identifiability.reported import Reported, mounting_row
from biaxbayes.model.posterior import Posterior
from biaxbayes.options import ALL_ROWS, CONTENT
from biaxbayes.parameters import mounting_names
from biaxbayes.prediction.bands import tails
from biaxbayes.specimens.specimen import Specimen

STACKED = "stacked"
UNUSABLE = ("unusable", "failed")
QUANTILES_90 = (0.05, 0.5, 0.95)
LEVEL_COLUMNS = ("band_low_level", "band_high_level")
"""Columns of the levels that a band of the mixture is read at."""


@dataclass(frozen=True)
class LawComparison:
    """Laws weighted by what they predict.

    Attributes
    ----------
    table : DataFrame
        ``laws.csv``: one row per law, the last one ``stacked``, which has the levels that its bands
        are read at.
    parts : DataFrame
        ``left-out.csv``: one row per law and part, with the levels that its band is read at.
    draws : DataFrame
        Draws of the mixture for what all laws share: mounting stretches, stresses, stiffnesses.
    bands : DataFrame
        Bands of the mixture over the record, columns as of
        :func:`~biaxbayes.prediction.bands.bands`, read at the levels of the table.
    reported : tuple of Reported
        Reported row of each mounting stretch of the tissue (``report.csv``), by
        :func:`~biaxbayes.identifiability.mounting_interval.interval_from_predictions`.
    left_out : dict of str to str
        Laws that are not part of the mixture, and why.
    """

    specimen: str
    table: pd.DataFrame
    parts: pd.DataFrame
    draws: pd.DataFrame
    bands: pd.DataFrame
    reported: tuple[Reported, ...]
    left_out: dict[str, str]

    @property
    def converged(self) -> bool:
        """True if every law has converged on every record."""
        states = self.table["state"][self.table["law"] != STACKED]
        return not self.left_out and bool((states == "converged").all())

    def __repr__(self) -> str:
        laws = self.table[self.table["law"] != STACKED].sort_values("weight", ascending=False)
        pairs = zip(laws["law"], laws["weight"].to_numpy(dtype=float), strict=True)
        weights = ", ".join(f"{law} {weight:.2f}" for law, weight in pairs if weight > 0.005)
        return f"LawComparison({self.specimen}: {weights})"


@dataclass(frozen=True)
class _LeftOut:
    """Predictions of a left-out part by all laws."""

    worth: np.ndarray  # (readings,)
    log_density: np.ndarray  # (laws, readings)
    # of each law (draws, readings), unit of the specimen, without draws that overflow
    model: list[np.ndarray]
    sd: list[np.ndarray]
    measured: np.ndarray  # (readings,)
    # of each law (readings,): load per Cauchy stress at its median mounting stretch
    per_kPa: list[np.ndarray]

    def score(self, weight: np.ndarray) -> tuple[float, float]:
        """Log density (nats) and mean square miss (kPa^2) of a mixture."""
        density = float(self.worth @ weighted_density(self.log_density, weight))
        # the mean of a mixture is the mixture of the means
        miss = [
            (self.measured - model.mean(axis=0)) / scale
            for model, scale in zip(self.model, self.per_kPa, strict=True)
        ]
        return density, float(np.mean((weight @ np.array(miss)) ** 2))


def weigh_laws(
    specimen: Specimen,
    options: Mapping[str, Any],
    predictions: Mapping[tuple[str, str], Prediction],
    laws: Sequence[str],
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
    posteriors = {law: Posterior(specimen, law=law, beta=1.0, **options) for law in used}
    best = min(used, key=lambda law: predictions[law, WHOLE].rmse_kPa)
    share = np.ones((len(specimen.protocols), 2))
    if posteriors[best].settings.noise == "effective":
        readings = effective_readings(predictions[best, WHOLE].residuals)
        share = np.minimum(readings.effective / readings.count, 1.0)
    left = [_left_out(specimen, part, share, used, options, predictions) for part in parts]
    weight = _weights(left, len(used))
    draws = mixture_draws(specimen, used, weight, predictions, posteriors)
    # a part is predicted by a mixture that has not seen it
    blind = [_weights([*left[:i], *left[i + 1 :]], len(used)) for i in range(len(left))]
    learned = _sharpness(left, weight)
    levels = calibrated_levels(tails(CONTENT), learned)
    table = _law_table(
        specimen, laws, used, predictions, left, weight, np.array(blind), draws, levels
    )
    return LawComparison(
        specimen.name,
        table,
        _part_table(parts, used, left, weight, blind),
        draws,
        mixture_bands(specimen, used, weight, predictions, posteriors, learned),
        _reported(specimen, table, best, predictions[best, WHOLE].residuals),
        bad,
    )


def _sharpness(left: Sequence[_LeftOut], weight: np.ndarray) -> float:
    """The sharpness of a mixture on the parts that its weights are learned from."""
    probability = [mixed_probabilities(p.measured, p.model, p.sd, weight) for p in left]
    return sharpness(np.concatenate(probability), np.concatenate([p.worth for p in left]))


def _weights(left: Sequence[_LeftOut], laws: int) -> np.ndarray:
    """Stacking weights of the laws; equal where no part is left to learn from."""
    if not left:
        return np.full(laws, 1.0 / laws)
    density, worth = np.hstack([p.log_density for p in left]), [p.worth for p in left]
    return stacking_weights(density, np.concatenate(worth))


def _left_out(
    specimen: Specimen,
    part: Part,
    share: np.ndarray,
    laws: Sequence[str],
    options: Mapping[str, Any],
    predictions: Mapping[tuple[str, str], Prediction],
) -> _LeftOut:
    model, sd, density, per_kPa = [], [], [], []
    for law in laws:
        # single readings are predicted, whatever the posterior averages
        each = {**options, "thin": ALL_ROWS}
        posterior = Posterior(only(specimen, part), law=law, beta=1.0, **each)
        measured, forward = posterior.rows, posterior.forward
        table = predictions[law, part.name].draws
        load, spread = forward.predict_rows(table, measured)
        with np.errstate(over="ignore", invalid="ignore"):
            pointwise = log_likelihood(load, spread, measured.load, measured.scatter)
        pointwise = np.where(np.isfinite(pointwise), pointwise, -np.inf)
        # ln p(f_i | rest) = ln mean_s p(f_i | theta_s)
        density.append((np.logaddexp.reduce(pointwise, axis=0) - np.log(len(load))).ravel())
        fine = np.isfinite(load).all(axis=(1, 2)) & np.isfinite(spread).all(axis=(1, 2))
        fine |= not fine.any()  # draws that overflow carry no band, unless there are no others
        model.append(load[fine].reshape(int(fine.sum()), -1))
        sd.append(spread[fine].reshape(int(fine.sum()), -1))
        medians = {n: table[n].median() for n in shared_stretches(table, specimen)}
        (name,) = measured.names
        per_kPa.append(forward.load_per_stress(medians, measured.stretch, name).ravel())
    rows = posterior.thinned.weight[0] * share[part.protocol]
    worth = np.broadcast_to(rows, measured.load.shape).ravel()
    return _LeftOut(worth, np.array(density), model, sd, measured.load.ravel(), per_kPa)


# --- tables --------------------------------------------------------------------------------------


def _law_table(
    specimen: Specimen,
    laws: Sequence[str],
    used: Sequence[str],
    predictions: Mapping[tuple[str, str], Prediction],
    left: Sequence[_LeftOut],
    weight: np.ndarray,
    blind: np.ndarray,
    draws: pd.DataFrame,
    levels: tuple[float, ...],
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
                **_quantiles(whole.draws, shared_stretches(whole.draws, specimen)),
            }
        rows.append(row)
    rows.append(
        {
            "law": STACKED,
            **scores(blind),
            "weight": 1.0,
            **dict(zip(LEVEL_COLUMNS, levels, strict=True)),
            **_quantiles(draws, shared_stretches(draws, specimen)),
        }
    )
    return pd.DataFrame(rows).fillna({"state": ""})


def _quantiles(table: pd.DataFrame, names: Sequence[str]) -> dict[str, float]:
    return {
        f"{name}_q{round(100 * q):02d}": float(np.quantile(table[name], q))
        for name in names
        for q in QUANTILES_90
    }


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
        others = [*left[:i], *left[i + 1 :]]
        for law, w, final in (
            *((law, w, w) for law, w in zip(used, np.eye(len(used)), strict=True)),
            (STACKED, blind[i], weight),
        ):
            (density, square), (seen, _) = own.score(w), own.score(final)
            levels: tuple[float, ...] = tails(CONTENT)
            if law == STACKED:  # nor have the levels of its band seen the part
                levels = calibrated_levels(levels, _sharpness(others, w))
            low, high = mixed_percentiles(own.model, own.sd, w, levels)
            scale = w @ np.array(own.per_kPa)
            rows.append(
                {
                    "part": part.name,
                    "law": law,
                    "weight": float(w[used.index(law)]) if law != STACKED else 1.0,
                    "left_out_rms_kPa": float(np.sqrt(square)),
                    "left_out_density_nats": density,
                    "density_final_weights": seen,
                    "band_coverage": float(np.mean((own.measured >= low) & (own.measured <= high))),
                    "band_width": float(np.mean((high - low) / scale)),
                    **dict(zip(LEVEL_COLUMNS, levels, strict=True)),
                    "readings": int(own.measured.size),
                    "effective_readings": float(own.worth.sum()),
                }
            )
    return pd.DataFrame(rows)


def _reported(
    specimen: Specimen, table: pd.DataFrame, best: str, residuals: Sequence[np.ndarray]
) -> tuple[Reported, ...]:
    """Mounting stretches from the laws that predict the record about as well as the best."""
    names = mounting_names("stretch")
    laws = table[(table["law"] != STACKED) & table["left_out_density_nats"].notna()].set_index(
        "law"
    )
    if f"{names[0]}_q50" not in laws:
        return ()
    smooth = has_smooth_misfit(residuals)
    density = {str(law): float(value) for law, value in laws["left_out_density_nats"].items()}
    rows = []
    for name in names:
        columns = [f"{name}_q{round(100 * q):02d}" for q in QUANTILES_90]
        if specimen.metadata.get(name) is not None:
            low, _, high = table.set_index("law").loc[STACKED, columns].to_numpy(dtype=float)
            interval = MountingInterval(float(low), float(high), MEASURED_REASON)
        else:
            quantiles = {
                str(law): (float(row.iloc[0]), float(row.iloc[1]), float(row.iloc[2]))
                for law, row in laws[columns].iterrows()
            }
            interval = interval_from_predictions(quantiles, density, smooth=smooth)
        rows.append(mounting_row(name, interval))
    return tuple(rows)
