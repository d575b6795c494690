"""Candidates for the next measurement: a further protocol, histology, an image of the mounting.

A candidate simulates outcomes from draws of the posterior, each with its own material, mounted
state and noise, and gives the probability of an outcome for any other draw.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
import pandas as pd
from scipy.signal import lfilter

from biaxbayes.forward import ForwardModel
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.priors import Prior
from biaxbayes.options import DesignOptions, Settings
from biaxbayes.parameters import mounting_names
from biaxbayes.prediction.draws import mounting_labels
from biaxbayes.specimens.protocol import Protocol as MeasuredProtocol
from biaxbayes.specimens.specimen import Specimen, pooled_reading

RATIOS = ((1.0, 1.0), (1.0, 0.5), (0.5, 1.0), (1.0, 0.0), (0.0, 1.0))
MAX_PLANNED_ROWS = 200
HISTOLOGY = {"alpha": "fibre angle", "kappa": "dispersion"}


class Candidate(Protocol):
    """Something that could be measured."""

    name: str

    def outcomes(self, draws: pd.DataFrame, rng: np.random.Generator) -> np.ndarray:
        """One simulated outcome per draw, shape (draws, readings)."""

    def log_likelihood(self, outcomes: np.ndarray, draws: pd.DataFrame) -> np.ndarray:
        """Weighted log likelihood, (outcomes, draws), up to a term common to all draws."""

    def response(self, draws: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
        """Noise-free readings (draws, readings) and the mean variance of one (readings,)."""

    def added_to(
        self, posterior: Posterior, outcome: np.ndarray
    ) -> tuple[Specimen, dict[str, Any]]:
        """The specimen and options with which an outcome would be sampled."""


@dataclass(frozen=True)
class Reading:
    """Direct readings of columns of the draws, with independent normal errors."""

    name: str
    quantities: tuple[str, ...]
    sd: float  # in the unit of the quantity (degrees for alpha)

    def outcomes(self, draws: pd.DataFrame, rng: np.random.Generator) -> np.ndarray:
        """See :class:`Candidate`."""
        values = draws[list(self.quantities)].to_numpy(dtype=float)
        return values + self.sd * rng.standard_normal(values.shape)

    def log_likelihood(self, outcomes: np.ndarray, draws: pd.DataFrame) -> np.ndarray:
        """See :class:`Candidate`."""
        values = draws[list(self.quantities)].to_numpy(dtype=float)
        return -0.5 * np.square((outcomes[:, None] - values[None]) / self.sd).sum(axis=-1)

    def response(self, draws: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`Candidate`."""
        values = draws[list(self.quantities)].to_numpy(dtype=float)
        return values, np.full(values.shape[1], self.sd**2)

    def added_to(
        self, posterior: Posterior, outcome: np.ndarray
    ) -> tuple[Specimen, dict[str, Any]]:
        """See :class:`Candidate`; the reading enters as a prior."""
        options = posterior.options()
        priors = dict(options["priors"])
        for name, value in zip(self.quantities, outcome, strict=True):
            before = posterior.priors[name]
            assert isinstance(before, Prior)
            location, sd = float(value), self.sd
            if before.family == "normal":
                # product of two normal densities
                weight = before.scale**2 / (before.scale**2 + sd**2)
                location = before.location + weight * (location - before.location)
                sd = sd * np.sqrt(weight)
            priors[name] = Prior("normal", location, float(sd), before.low, before.high)
        return posterior.specimen, options | {"priors": priors}


@dataclass(frozen=True)
class FurtherProtocol:
    """One more protocol on the same specimen and machine, its n rows again worth beta n."""

    name: str
    specimen: Specimen
    stretch: np.ndarray  # (n + 1, 2), measured; the first row is the mounted state
    beta: float
    mounting_sd: float  # of the reading of the mounting force; zero without one
    settings: Settings  # those of the run; readings of a shared mounted state are pooled

    def predict(self, draws: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
        """Loads and variances of one reading, both (draws, rows, 2); the mounted state first."""
        columns = _one_mounted_state(draws, self.specimen)
        forward = ForwardModel.from_specimen(self.specimen, self.settings)
        load, sd = forward.predict(columns, self.stretch)
        variance = np.square(sd)
        variance[:, 0] = self.mounting_sd**2 if self.mounting_sd > 0.0 else 1.0
        return load, variance

    def outcomes(self, draws: pd.DataFrame, rng: np.random.Generator) -> np.ndarray:
        """See :class:`Candidate`."""
        load, variance = self.predict(draws)
        # n readings of a first-order autoregression are worth n (1 - rho) / (1 + rho) = beta n.
        rho = (1.0 - self.beta) / (1.0 + self.beta)
        white = rng.standard_normal(load.shape)
        white[:, 1] /= np.sqrt(1.0 - rho**2)
        errors = np.sqrt(1.0 - rho**2) * lfilter([1.0], [1.0, -rho], white[:, 1:], axis=1)
        errors = np.concatenate([white[:, :1], errors], axis=1)
        return (load + np.sqrt(variance) * errors).reshape(len(draws), -1)

    def log_likelihood(self, outcomes: np.ndarray, draws: pd.DataFrame) -> np.ndarray:
        """See :class:`Candidate`."""
        load, variance = self.predict(draws)
        centre = load.mean(axis=0)
        f = (load - centre).reshape(len(draws), -1)
        y = outcomes - centre.ravel()
        weight = np.full(self.stretch.shape, self.beta)
        weight[0] = 1.0 if self.mounting_sd > 0.0 and not self.settings.shared else 0.0
        precision = (weight / variance).reshape(len(draws), -1)
        # sum_j w_j (y_j - f_j)^2 / v_j, multiplied out so that all pairs are one matrix product
        square = np.square(y) @ precision.T - 2.0 * y @ (precision * f).T
        square += (precision * np.square(f)).sum(axis=1)
        curves = -0.5 * (square + (weight * np.log(variance)).sum(axis=(1, 2)))
        if self.mounting_sd > 0.0 and self.settings.shared:
            curves += self._pooled(outcomes[:, :2], load[:, 0])
        return curves

    def _pooled(self, reading: np.ndarray, mounting_load: np.ndarray) -> np.ndarray:
        """Change of the log likelihood of the mounting readings by one more, (outcomes, n).

        Readings that disagree by more than their noise make the mounting load less certain
        (:meth:`.Specimen.mounting_readings`).
        """
        old, sd = self.specimen.mounting_readings(shared=False)
        at_rest = [p.rest_rows > 0 for p in self.specimen.protocols]
        old, sd = old[at_rest], sd[at_rest]
        with_new = np.concatenate(
            [np.broadcast_to(old, (len(reading), *old.shape)), reading[:, None]], axis=1
        )
        sds = np.concatenate([sd, np.full((1, 2), self.mounting_sd)])
        mean, pooled = pooled_reading(with_new, sds)
        before, before_sd = pooled_reading(old, sd)
        z = (mean[:, None] - mounting_load) / pooled[:, None]
        z_before = (before - mounting_load) / before_sd
        gained = -0.5 * np.square(z).sum(axis=-1) + 0.5 * np.square(z_before).sum(axis=-1)
        return gained - np.log(pooled / before_sd).sum(axis=-1)[:, None]

    def response(self, draws: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`Candidate`."""
        load, variance = self.predict(draws)
        mean = variance.mean(axis=0)
        mean[1:] /= self.beta
        # A pooled reading need not add information, so the lower bound omits it.
        first = 0 if self.mounting_sd > 0.0 and not self.settings.shared else 1
        return load[:, first:].reshape(len(draws), -1), mean[first:].ravel()

    def added_to(
        self, posterior: Posterior, outcome: np.ndarray
    ) -> tuple[Specimen, dict[str, Any]]:
        """See :class:`Candidate`; the outcome becomes one more protocol."""
        load = outcome.reshape(self.stretch.shape).copy()
        if self.mounting_sd <= 0.0:
            # without a reading the mounting load is that of the specimen
            load[0] = self.specimen.mounting_readings(shared=True)[0][0]
        if self.specimen.stress_pair == "cauchy":
            load = load * self.stretch
        taken = {p.name for p in self.specimen.protocols}
        name = next(n for n in (f"next{i or ''}" for i in range(99)) if n not in taken)
        columns = (*self.stretch.T, *load.T)
        protocol = MeasuredProtocol(
            name, columns[0], columns[1], columns[2], columns[3], rest_rows=1
        )
        if self.specimen.protocols[0].time_s is not None:
            last = float(self.specimen.protocols[-1].time_s[-1])  # type: ignore[index]
            protocol = replace(protocol, time_s=last + 1.0 + np.arange(protocol.rows))
        protocols = (*self.specimen.protocols, protocol)
        return replace(self.specimen, protocols=protocols), posterior.options()

    def peak_load(self, draws: pd.DataFrame) -> tuple[float, float]:
        """5 and 95 % of the largest load (N or kPa) that the specimen and cell must bear."""
        load, _ = self.predict(draws)
        low, high = np.quantile(np.abs(load).max(axis=(1, 2)), [0.05, 0.95])
        return float(low), float(high)


def _one_mounted_state(draws: pd.DataFrame, specimen: Specimen) -> dict[str, np.ndarray]:
    """Columns with one mounted state: of several, one at random for each draw."""
    columns = {str(k): draws[k].to_numpy(dtype=float) for k in draws.columns}
    labels = mounting_labels(draws, specimen)
    if labels and labels != ("",):
        # by the number of the draw, so that it has the same mounted state each time
        chosen = np.asarray(draws.index, dtype=np.int64) * 7919 % len(labels)
        for axis, name in enumerate(mounting_names("stretch")):
            states = np.stack([columns[mounting_names("stretch", n)[axis]] for n in labels])
            columns[name] = states[chosen, np.arange(len(draws))]
    return columns


def standard_candidates(
    posterior: Posterior,
    *,
    ratios: tuple[tuple[float, float], ...] = (),
    further: float = DesignOptions.further,
    alpha_sd_deg: float = DesignOptions.alpha_sd_deg,
    kappa_sd: float = DesignOptions.kappa_sd,
    image_sd: float = DesignOptions.image_sd,
) -> list[Any]:
    """Candidates for a specimen: protocols (five standard ratios and `ratios`), direct readings.

    Protocols reach the largest measured stretches, one goes `further` times as far.
    """
    specimen, settings = posterior.specimen, posterior.settings
    ends = [np.array([p.stretch_x[-1], p.stretch_y[-1]]) - 1.0 for p in specimen.protocols]
    top = np.max([[p.stretch_x.max(), p.stretch_y.max()] for p in specimen.protocols], axis=0) - 1.0
    rows = int(np.mean([p.rows - p.rest_rows for p in specimen.protocols]))
    beta, rows_planned = posterior.beta, min(rows, MAX_PLANNED_ROWS)
    mounting_sd = specimen.noise_sd if settings.reads_force else 0.0

    def protocol(name: str, end: np.ndarray) -> FurtherProtocol:
        path = 1.0 + np.linspace(0.0, 1.0, rows_planned + 1)[:, None] * end
        weight = min(1.0, beta * rows / rows_planned)
        return FurtherProtocol(name, specimen, path, weight, mounting_sd, settings)

    out: list[Any] = []
    for x, y in dict.fromkeys((*RATIOS, *ratios)):
        end = np.array([x, y]) / max(x, y) * top
        same = [np.allclose(end, e, atol=0.03 * top.max()) for e in ends]
        out.append(protocol(f"{'repeat ' if any(same) else ''}{x:g}:{y:g}", end))
    if further != 1.0:
        stretch = " × ".join(f"{v:.3g}" for v in 1.0 + further * top)
        out.append(protocol(f"1:1 to {stretch}", further * top))
    free = {n for n, p in posterior.priors.items() if isinstance(p, Prior)}
    for name, sd, unit in (("alpha", alpha_sd_deg, "°"), ("kappa", kappa_sd, "")):
        if name in free:
            out.append(Reading(f"{HISTOLOGY[name]} ± {sd:g}{unit}", (name,), sd))
    pair = mounting_names("stretch")
    if settings.infers_mounting and free.issuperset(pair):
        out.append(Reading(f"mounting image ± {image_sd:g}", pair, image_sd))
    return out
