"""Candidates for the next measurement: a protocol, strips, a tube, histology, an image.

A candidate says what it would read for every draw of the posterior, each with its own material and
mounted state, and how large the errors of these readings are.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
from scipy.linalg import solve_triangular

from biaxbayes.evenly import evenly_chosen
from biaxbayes.experiments import Experiment, Strip, Tube
from biaxbayes.forward import ForwardModel
from biaxbayes.model.misfit import CurvePoints
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.priors import Prior
from biaxbayes.model.readings import LEAST_NOISE
from biaxbayes.options import DesignOptions
from biaxbayes.parameters import NOISE_SD, mounting_names
from biaxbayes.prediction.draws import mounting_labels
from biaxbayes.prediction.percentiles import quantiles

RATIOS = ((1.0, 1.0), (1.0, 0.5), (0.5, 1.0), (1.0, 0.0), (0.0, 1.0))
MAX_PLANNED_ROWS = 100
SHARE_DRAWS = 500
"""Draws that weigh the structures of the misfit."""
HISTOLOGY = {"alpha": "fibre angle", "kappa": "dispersion"}


@dataclass(frozen=True)
class Reading:
    """Direct readings of columns of the draws, with independent normal errors."""

    name: str
    quantities: tuple[str, ...]
    sd: float  # in the unit of the quantity (degrees for alpha)

    def response(self, draws: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
        """Readings without errors (draws, readings); variance (readings,) of independent errors."""
        values = draws[list(self.quantities)].to_numpy(dtype=float)
        return values, np.full(values.shape[1], self.sd**2)


@dataclass(frozen=True, eq=False)
class FurtherProtocol:
    """One more protocol on the same specimen and machine, its readings with the errors of the run.

    With the residuals r of the run's own readings, the readings of a draw are

        y = f + C21 C11^-1 r + e,    e ~ N(0, C22 - C21 C11^-1 C12 + s0^2)

    where C is the covariance of the misfit, averaged by the posterior weights of its terms, as the
    factor of the noise s0 is. Independent errors have the mean variance of the draws. The mounting
    reading is one more reading.
    """

    name: str
    posterior: Posterior
    stretch: np.ndarray  # (n + 1, 2), measured; the first row is the mounted state
    repeats: float  # rows of a record that a planned row stands for
    weights: np.ndarray  # posterior weights of the terms of the misfit, (terms,)

    @property
    def loads_as_tested(self) -> bool:
        """Whether its loads compare with those of the record."""
        return True

    @property
    def first(self) -> int:
        """The first row that is a reading: the mounted state where its force is read."""
        return 0 if self.posterior.settings.reads_force else 1

    def load(self, draws: pd.DataFrame) -> np.ndarray:
        """Loads of the law with the offset of the cell, (draws, rows, 2)."""
        columns = {str(k): draws[k].to_numpy(dtype=float) for k in draws.columns}
        labels = mounting_labels(draws, self.posterior.specimen)
        if labels and labels != ("",):
            # of several mounted states one by the number of the draw, the same each time
            chosen = np.asarray(draws.index, dtype=np.int64) * 7919 % len(labels)
            for axis, name in enumerate(mounting_names("stretch")):
                states = np.stack([columns[mounting_names("stretch", n)[axis]] for n in labels])
                columns[name] = states[chosen, np.arange(len(draws))]
        forward = self.posterior.forward
        return forward.load(columns, self.stretch) + forward.offset(columns)

    @cached_property
    def _errors(self) -> tuple[np.ndarray | None, np.ndarray]:
        """C11^-1 C12, and the root L of the covariance of the errors, for a unit scale."""
        rows = len(self.stretch) - self.first
        specimen, settings = self.posterior.specimen, self.posterior.settings
        noise = specimen.noise_sd if settings.has_misfit else 1.0
        sd = np.full((rows, 2), noise / np.sqrt(self.repeats))
        if self.first == 0:
            sd[0] = specimen.noise_sd
        if not settings.has_misfit:
            return None, np.diag(sd.ravel())
        misfit, points = self.posterior.misfit, self.posterior.paths.path(self.stretch)
        at = points.take(np.arange(2 * self.first, self.stretch.size))
        gain, cross = misfit.conditional(at, self.weights)
        factor = np.sqrt(self.weights @ misfit.terms.noise**2)
        sd = factor * np.maximum(sd, LEAST_NOISE * specimen.peak_load)
        left = misfit.covariance(at, at, self.weights) - cross.T @ gain
        return gain, np.linalg.cholesky(left + np.diag(sd.ravel() ** 2))

    def expected(self, draws: pd.DataFrame) -> np.ndarray:
        """Expected readings, (draws, readings)."""
        gain = self._errors[0]
        readings = self.load(draws)[:, self.first :].reshape(len(draws), -1)
        return readings if gain is None else readings + self.posterior.residuals(draws, 0) @ gain

    def response(self, draws: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`Reading`; readings in units of L."""
        with np.errstate(over="ignore", invalid="ignore"):
            readings = self.expected(draws)
            root = self._errors[1]
            readings = solve_triangular(root, readings.T, lower=True, check_finite=False).T
        return readings, self._variance(draws).ravel()

    def _variance(self, draws: pd.DataFrame) -> np.ndarray:
        """Variance of the errors in units of L, (rows, 2)."""
        out = np.ones((len(self.stretch) - self.first, 2))
        if not self.posterior.settings.has_misfit:
            out[1 - self.first :] = np.square(draws[NOISE_SD.name].to_numpy(dtype=float)).mean()
        return out

    def peak_load(self, draws: pd.DataFrame) -> tuple[float, float]:
        """5 and 95 % of the largest load (N or kPa) that the specimen and cell must bear."""
        low, _, high = quantiles(np.abs(self.load(draws)).max(axis=(1, 2)))
        return low, high


STRIP_REACH = 1.2
"""Largest strain of a planned strip over that of the square; a strip bears more."""
TUBE_REACH, TUBE_LENGTH, TUBE_RADIUS = 0.6, 0.5, 5.0
"""Largest strain around the outside of a planned tube, and its axial strain, over those of the
square; its outer radius over its thickness. Strains inside are about those of the square."""
PIECE_MOUNTING = (0.015, 0.01)
"""Mean and sd of the mounting strain of planned pieces."""
PIECE_DRAWS = 400


@dataclass(frozen=True, eq=False)
class FurtherPieces(FurtherProtocol):
    """Other pieces of the same tissue, with the thickness and relative load noise of the square.

    The readings of a draw are those of pieces mounted at a typical stretch. That their mounting
    stretches and stiffnesses are unknown counts as an error of the readings, with the covariance
    that drawing them gives at the median of the draws, as the misfit and the noise do:

        y = f + e,    e ~ N(0, C_unknown + a^2 D K_h D + t^2 V G V + s0^2)

    ``stretch`` is that of all pieces, each in the directions of its test.
    """

    median: pd.DataFrame  # one row
    experiments: tuple[Experiment, ...]  # of each piece; together they read x and y once

    def load(self, draws: pd.DataFrame) -> np.ndarray:
        """See :class:`FurtherProtocol`."""
        lm = np.full((1, 2), 1.0 + PIECE_MOUNTING[0])
        return self._load(draws, lm, np.ones((1, len(self.experiments))))

    def _load(self, draws: pd.DataFrame, lm: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
        """Readings at mounting stretches and stiffnesses of the pieces, (draws, rows, 2)."""
        out = np.zeros((len(draws), *self.stretch.shape))
        columns = {name: draws[name].to_numpy(dtype=float) for name in self.posterior.law.names}
        columns |= dict(zip(mounting_names("stretch"), lm.T, strict=True))
        for experiment, c in zip(self.experiments, stiffness.T, strict=True):
            area = self.posterior.forward.area if experiment.is_mounted else np.ones(2)
            piece = ForwardModel(self.posterior.law, area, False, experiment)
            path, side = self.stretch.copy(), experiment.free_side
            if side is not None:
                path[:, side] = np.nan
            out += c[:, None, None] * piece.load(columns, path)
        return out

    @cached_property
    def _errors(self) -> tuple[np.ndarray | None, np.ndarray]:
        """Nothing of the run's residuals, and the root of the covariance of the errors."""
        posterior, rng = self.posterior, np.random.default_rng(0)
        settings, specimen = posterior.settings, posterior.specimen
        mean, sd = PIECE_MOUNTING
        lm = 1.0 + np.abs(rng.normal(mean, sd, (PIECE_DRAWS, 2)))
        normal = rng.standard_normal((PIECE_DRAWS, len(self.experiments)))
        copies = self.median.loc[self.median.index.repeat(PIECE_DRAWS)]
        drawn = self._load(copies, lm, np.exp(settings.piece_sd * normal))
        covariance = np.cov(drawn[:, self.first :].reshape(PIECE_DRAWS, -1), rowvar=False)
        load = self.load(self.median)[0]
        position = np.linspace(0.0, 1.0, len(load))
        for axis in (0, 1) if settings.has_misfit else ():
            own = np.arange(len(load) - self.first) * 2 + axis
            at = CurvePoints(
                protocol=np.zeros(len(load), dtype=int),
                axis=np.full(len(load), axis),
                path=position,
                plane=np.column_stack([position, position]),
                load=load[:, axis],
                peak=np.full(len(load), np.abs(load[:, axis]).max()),
            ).take(np.arange(self.first, len(load)))
            covariance[np.ix_(own, own)] += posterior.misfit.covariance(at, at, self.weights)
        relative = max(specimen.noise_sd / specimen.peak_load, LEAST_NOISE)
        noise = relative * np.abs(load).max(axis=0)
        rows = np.tile(noise / np.sqrt(self.repeats), (len(load) - self.first, 1))
        if self.first == 0:
            rows[0] = noise
        return None, np.linalg.cholesky(covariance + np.diag(rows.ravel() ** 2))

    def _variance(self, draws: pd.DataFrame) -> np.ndarray:
        """See :class:`FurtherProtocol`."""
        return np.ones((len(self.stretch) - self.first, 2))

    @property
    def loads_as_tested(self) -> bool:
        """See :class:`FurtherProtocol`."""
        return all(e.is_mounted for e in self.experiments)


Candidate = Reading | FurtherProtocol


def standard_candidates(
    posterior: Posterior,
    draws: pd.DataFrame,
    *,
    ratios: tuple[tuple[float, float], ...] = (),
    further: float = DesignOptions.further,
    alpha_sd_deg: float = DesignOptions.alpha_sd_deg,
    kappa_sd: float = DesignOptions.kappa_sd,
    image_sd: float = DesignOptions.image_sd,
) -> list[Candidate]:
    """Protocols (standard ratios, `ratios`, one `further` as far), pieces and direct readings."""
    specimen, settings = posterior.specimen, posterior.settings
    ends = [p.known_stretch[-1] - 1.0 for p in specimen.protocols]
    top = np.max([p.known_stretch.max(axis=0) for p in specimen.protocols], axis=0) - 1.0
    rows = int(np.mean([p.rows - p.rest_rows for p in specimen.protocols]))
    planned, weights = min(rows, MAX_PLANNED_ROWS), np.empty(0)
    if settings.has_misfit:
        residual = posterior.residuals(draws.iloc[evenly_chosen(len(draws), SHARE_DRAWS)], 0)
        weights = np.asarray(posterior.misfit.shares(residual).mean(axis=0))

    def protocol(name: str, end: np.ndarray) -> FurtherProtocol:
        path = 1.0 + np.linspace(0.0, 1.0, planned + 1)[:, None] * end
        return FurtherProtocol(name, posterior, path, rows / planned, weights)

    out: list[Candidate] = []
    for x, y in dict.fromkeys((*RATIOS, *ratios)):
        end = np.array([x, y]) / max(x, y) * top
        same = [np.allclose(end, e, atol=0.03 * np.max(top)) for e in ends]
        out.append(protocol(f"{'repeat ' if any(same) else ''}{x:g}:{y:g}", end))
    if further != 1.0:
        stretch = " × ".join(f"{v:.3g}" for v in 1.0 + further * top)
        out.append(protocol(f"1:1 to {stretch}", further * top))
    if specimen.experiment.is_biaxial and settings.infers_mounting:
        median = draws[list(posterior.law.names)].median().to_frame().T
        position = np.linspace(0.0, 1.0, planned + 1)[:, None]
        strips = 1.0 + position * STRIP_REACH * top
        inflated = 1.0 + position * [TUBE_REACH, 0.0] * top + [0.0, TUBE_LENGTH] * top
        tube = Tube(TUBE_RADIUS, 1.0)
        for name, path, tests in (
            ("strips x and y", strips, (Strip(0), Strip(1))),
            ("tube, pressure and force", inflated, (tube,)),
        ):
            pieces = (posterior, path, rows / planned, weights, median, tests)
            out.append(FurtherPieces(name, *pieces))
    free = {n for n, p in posterior.priors.items() if isinstance(p, Prior)}
    for name, sd, unit in (("alpha", alpha_sd_deg, "°"), ("kappa", kappa_sd, "")):
        if name in free:
            out.append(Reading(f"{HISTOLOGY[name]} ± {sd:g}{unit}", (name,), sd))
    pair = mounting_names("stretch")
    if settings.infers_mounting and free.issuperset(pair):
        out.append(Reading(f"mounting image ± {image_sd:g}", pair, image_sd))
    return out
