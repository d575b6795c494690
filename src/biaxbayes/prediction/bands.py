"""Percentile bands over posterior draws, and those of a run at the states that were measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from biaxbayes.error_model import standard_cdf, standard_quantile
from biaxbayes.errors import InputError
from biaxbayes.forward import ForwardModel
from biaxbayes.laws import DEFAULT_LAW
from biaxbayes.options import CONTENT, Settings
from biaxbayes.parameters import mounting_names
from biaxbayes.specimens.protocol import Protocol
from biaxbayes.specimens.specimen import Specimen

# --- percentile bands over posterior draws: of the model, and of a new measurement ---------------


BANDS = ("median", "credible_low", "credible_high", "predictive_low", "predictive_high")
"""Endings of the columns of a predicted quantity."""

MIXTURE_DRAWS = 4000  # draws that carry a predictive percentile
MAX_BISECTIONS = 60


def tails(probability: float) -> tuple[float, float]:
    """Lower and upper percentile of a central band; InputError if not between 0 and 1."""
    if not 0.0 < probability < 1.0:
        raise InputError(f"a probability of {probability:g} is not between 0 and 1")
    return 0.5 * (1.0 - probability), 0.5 * (1.0 + probability)


def credible_columns(name: str, model: np.ndarray, probability: float) -> dict[str, np.ndarray]:
    """Median and credible band of a quantity of shape (draws, m), as named columns."""
    values = np.quantile(model, [0.5, *tails(probability)], axis=0)
    return {f"{name}_{band}": v for band, v in zip(BANDS[:3], values, strict=True)}


def band_columns(
    name: str, model: np.ndarray, noise: np.ndarray, probability: float
) -> dict[str, np.ndarray]:
    """The five columns of a quantity.

    Parameters
    ----------
    name : str
        Stem of the columns, with the unit.
    model : ndarray, shape (draws, m)
    noise : ndarray, shape (draws, m) or (draws, 1)
        Standard deviation of a new measurement about the model.
    probability : float
        Content of each band.
    """
    predictive = mixture_percentiles(model, noise, tails(probability))
    return credible_columns(name, model, probability) | {
        f"{name}_{band}": v for band, v in zip(BANDS[3:], predictive, strict=True)
    }


def mixture_percentiles(
    model: np.ndarray, noise: np.ndarray, levels: tuple[float, ...]
) -> list[np.ndarray]:
    """Percentiles (m,) of the equal mixture of N(model, noise) over the draws, by root finding.

    No random numbers are drawn, so the band has no Monte Carlo error of its own. Arguments as of
    :func:`band_columns`.
    """
    step = -(-len(model) // MIXTURE_DRAWS)
    mean = np.ascontiguousarray(model[::step].T)
    sd = np.maximum(np.broadcast_to(noise, model.shape)[::step].T, 1e-300)
    out = []
    for level in levels:
        ends = mean + standard_quantile(level) * sd  # of the single draws: the root lies between
        low, high = ends.min(axis=1), ends.max(axis=1)
        accuracy = 1e-9 * (high - low)
        # Start: the normal distribution of the same mean and variance.
        spread = np.sqrt(mean.var(axis=1) + (sd**2).mean(axis=1))
        q = np.clip(mean.mean(axis=1) + standard_quantile(level) * spread, low, high)
        for _ in range(MAX_BISECTIONS):
            # F(q) = mean over draws of Phi((q - m) / sd), by Newton's method within [low, high]
            z = (q[:, None] - mean) / sd
            excess = standard_cdf(z).mean(axis=1) - level
            low, high = np.where(excess < 0.0, q, low), np.where(excess < 0.0, high, q)
            before = q
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                density = (np.exp(-0.5 * z**2) / sd).mean(axis=1) / np.sqrt(2.0 * np.pi)
                q = q - excess / density
            q = np.where((q >= low) & (q <= high), q, 0.5 * (low + high))
            if (abs(q - before) <= accuracy).all():
                break
        out.append(q)
    return out


def known_percentiles(values: np.ndarray, levels: tuple[float, ...]) -> np.ndarray:
    """Percentiles over the draws that have a value, shape (levels, m); NaN where none has."""
    out = np.full((len(levels), values.shape[1]), np.nan)
    for j, column in enumerate(values.T):
        finite = column[np.isfinite(column)]
        if finite.size:
            out[:, j] = np.quantile(finite, levels)
    return out


# --- credible and predictive bands of a run at the states that were measured ---------------------


MAX_BLOCK_SIZE = 1_000_000  # model values in memory at once


def bands(
    specimen: Specimen,
    draws: pd.DataFrame,
    *,
    settings: Settings,
    probability: float = CONTENT,
    max_rows: int | None = None,
    max_draws: int = 1000,
) -> pd.DataFrame:
    """Bands of the load at the measured stretches.

    The credible band holds the model's own load; the predictive band holds a new reading there:
    the model plus the noise that the run inferred, with its growth with the load.

    Parameters
    ----------
    draws : DataFrame
        One row per draw, columns as in ``summary.csv``.
    settings : Settings
        Those of the run. ``zeroed`` compares with loads less their mounting reading.
    probability : float
        Content of each band.
    max_rows : int, optional
        Largest number of rows of a protocol, evenly chosen.
    max_draws : int
        Largest number of draws, evenly chosen.

    Returns
    -------
    DataFrame
        One row per protocol, direction and state: ``protocol``, ``direction``, ``row`` (of the
        protocol, from 0), ``stretch`` (measured, in that direction), ``measured`` and the
        quantiles ``credible_q05``, ``credible_q50``, ``credible_q95``, ``predictive_q05``,
        ``predictive_q50``, ``predictive_q95`` (of other names for another probability). Loads are
        in the unit of the file, a Cauchy file's as Cauchy stress.
    """
    low, high = tails(probability)
    chosen = draws.iloc[evenly_chosen(len(draws), max_draws)]
    forward = ForwardModel.from_specimen(specimen, settings)
    levels = (low, 0.5, high)
    names = [
        f"{kind}_q{100 * level:04.1f}".removesuffix(".0")
        for kind in ("credible", "predictive")
        for level in levels
    ]
    tables = []
    for protocol in compared_protocols(specimen, settings):
        rows = evenly_spaced(protocol.rows, max_rows)
        stretch, measured = protocol.stretch[rows], specimen.load(protocol)[rows]
        scale = _scale(specimen, stretch)
        quantiles = np.empty((6, len(rows), 2))
        step = max(1, MAX_BLOCK_SIZE // (2 * len(chosen)))
        for first in range(0, len(rows), step):
            part = slice(first, first + step)
            mean, sd = forward.predict(chosen, stretch[part], protocol.name)
            flat = mean.reshape(len(mean), -1)
            predictive = mixture_percentiles(flat, sd.reshape(flat.shape), levels)
            both = np.concatenate([np.quantile(flat, levels, axis=0), predictive])
            quantiles[:, part] = both.reshape(6, *mean.shape[1:])
        for axis, direction in enumerate("xy"):
            table = {
                "protocol": protocol.name,
                "direction": direction,
                "row": rows,
                "stretch": stretch[:, axis],
                "measured": measured[:, axis] * scale[:, axis],
            }
            loads = quantiles[:, :, axis] * scale[:, axis]
            tables.append(pd.DataFrame(table | dict(zip(names, loads, strict=True))))
    return pd.concat(tables, ignore_index=True)


def true_loads(
    specimen: Specimen,
    truth: Mapping[str, float],
    *,
    settings: Settings | None = None,
    max_rows: int | None = None,
) -> np.ndarray:
    """Loads of a known material and mounted state, at the rows of :func:`bands`.

    Parameters
    ----------
    truth : mapping of str to float
        Material parameters and mounting stretches by the names of ``summary.csv``. Of the law of
        the run, or else of the default one.
    settings : Settings, optional
        Those of the run.
    max_rows : int, optional
        As in :func:`bands`.

    Returns
    -------
    ndarray, shape (rows,)
        In the unit of the file, without noise.

    Raises
    ------
    InputError
        If the truth lacks a parameter of the law or a mounting stretch.
    """
    settings = settings or Settings()
    if not set(settings.material_law.names) <= set(truth):
        settings = replace(settings, law=DEFAULT_LAW, fibre_switch=False)
    shared = mounting_names("stretch")
    own = [mounting_names("stretch", p.name) for p in specimen.protocols]
    states = [shared] if set(shared) <= set(truth) else own
    needed = (*settings.material_law.names, *(name for pair in states for name in pair))
    missing = [name for name in needed if name not in truth]
    if missing:
        raise InputError(
            f"the truth names no {', '.join(missing)[:200]}",
            remedy="bands need the whole material and its mounting stretches",
        )
    forward = ForwardModel.from_specimen(specimen, settings)
    values = {name: float(truth[name]) for name in needed}
    loads = []
    for protocol in specimen.protocols:
        stretch = protocol.stretch[evenly_spaced(protocol.rows, max_rows)]
        load = forward.load(values, stretch, protocol.name)[0] * _scale(specimen, stretch)
        if settings.mounting == "zeroed":
            load = load - load[0]
        loads.append(load.T.ravel())
    return np.concatenate(loads)


@dataclass(frozen=True)
class DrawnCurves:
    """Curves of one protocol, one per draw; loads in the unit of the file, Cauchy stress too."""

    protocol: str
    rows: np.ndarray  # (rows,), of the protocol, from 0
    stretch: np.ndarray  # (rows, 2), measured
    measured: np.ndarray  # (rows, 2)
    load: np.ndarray  # (draws, rows, 2)


def curves_of_draws(
    specimen: Specimen,
    draws: pd.DataFrame,
    *,
    settings: Settings,
    max_rows: int | None = None,
) -> list[DrawnCurves]:
    """The curves whose percentiles :func:`bands` gives, one per draw; arguments as there."""
    out = []
    forward = ForwardModel.from_specimen(specimen, settings)
    for protocol in compared_protocols(specimen, settings):
        rows = evenly_spaced(protocol.rows, max_rows)
        stretch = protocol.stretch[rows]
        scale = _scale(specimen, stretch)
        load, _ = forward.predict(draws, stretch, protocol.name)
        measured = specimen.load(protocol)[rows]
        out.append(DrawnCurves(protocol.name, rows, stretch, measured * scale, load * scale))
    return out


def compared_protocols(specimen: Specimen, settings: Settings) -> tuple[Protocol, ...]:
    """Protocols with the loads that a run compares: for ``zeroed`` less their mounting reading."""
    return (specimen.zeroed() if settings.mounting == "zeroed" else specimen).protocols


def _scale(specimen: Specimen, stretch: np.ndarray) -> np.ndarray:
    """Factor from a nominal load to the file's: the measured stretch for Cauchy stresses."""
    return stretch if specimen.stress_pair == "cauchy" else np.ones_like(stretch)


def evenly_chosen(count: int, limit: int | None) -> np.ndarray:
    """Indices of at most ``limit`` of ``count`` items, spread over all, both ends included."""
    if limit is None or count <= limit:
        return np.arange(count)
    return np.unique(np.linspace(0, count - 1, limit).round().astype(int))


def evenly_spaced(count: int, limit: int | None) -> np.ndarray:
    """Every n-th of ``count`` indices and the last one, at most ``limit``."""
    if limit is None or count <= limit:
        return np.arange(count)
    step = -(-(count - 1) // (limit - 1))
    return np.union1d(np.arange(0, count - 1, step), [count - 1])
