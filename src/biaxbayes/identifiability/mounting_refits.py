"""Mounting stretches of fits to parts of a record.

The way from the unloaded to the mounted state is not measured. The law extrapolates it from the
curves beyond: the larger the residuals that the law leaves on those curves, the less certain the
mounting stretch. Fits to parts of the same record show how far it changes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from biaxbayes.fitting.constrained import constrained_fit
from biaxbayes.fitting.effective_readings import has_smooth_misfit
from biaxbayes.fitting.residuals import Readings
from biaxbayes.fitting.result import FitResult
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.priors import DrawnPrior, Prior
from biaxbayes.parameters import mounting_names
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.thinning import averaged_specimen

LOAD_FRACTIONS = (0.3, 0.5)
"""Parts of the record that are fitted alone: until a load passes this fraction of its peak."""
MIN_ROWS = 6
REFIT_ROWS = 60
"""Rows of a protocol that the refits use, averaged."""
TOE_FRACTION = 0.25
"""Fraction of a protocol's rows that count as near the mounted state."""
REFIT_STARTS = 2
CUT_PROBABILITY = 0.001


@dataclass(frozen=True)
class MountingRefits:
    """Mounting stretches of fits to parts of a record, by name."""

    stretch: dict[str, np.ndarray]  # (fits,): the value in every fit that has it
    error: dict[str, float]  # change that balances the largest residual near the mounted state

    def range(
        self, name: str, interval: tuple[float, float], errors: float, prior: Prior | DrawnPrior
    ) -> tuple[float, float]:
        """Range of an interval and all refits with their errors, truncated to the prior."""
        values = self.stretch[name]
        margin = errors * self.error[name]
        low, high = interval
        first, last = prior.ppf(np.array([CUT_PROBABILITY, 1.0 - CUT_PROBABILITY]))
        return (
            min(low, max(float(values.min()) - margin, float(first))),
            max(high, min(float(values.max()) + margin, float(last))),
        )


def mounting_refits(posterior: Posterior) -> MountingRefits | None:
    """Fit parts of the record alone; None if no mounting stretch or no smooth misfit."""
    settings, residuals = posterior.settings, posterior.fit.residuals
    if not settings.infers_mounting:
        return None
    # as a whole or near the mounted state
    if not (has_smooth_misfit(residuals) or has_smooth_misfit([_toe(r) for r in residuals])):
        return None
    data = averaged_specimen(posterior.specimen, REFIT_ROWS)

    def refit(part: Specimen) -> FitResult:
        return constrained_fit(
            part,
            mounting=settings.fit_mounting,
            mounting_stretch=settings.mounting_stretch,
            fixed=settings.fixed_material,
            starts=REFIT_STARTS,
            initial=posterior.fit.material,
            law=settings.law,
            fibre_switch=settings.fibre_switch,
        )

    full = refit(data)
    # by the protocol that is fitted alone, None for all
    parts: list[tuple[str | None, FitResult]] = [
        (None, refit(_first_part(data, share))) for share in LOAD_FRACTIONS
    ]
    names = [p.name for p in data.protocols]
    parts += [(name, refit(data.only(name))) for name in names if len(names) > 1]
    fits = [(None, full), *((name, fit) for name, fit in parts if fit.converged)]
    stretch: dict[str, np.ndarray] = {}
    for i, label in enumerate(posterior.mounts):
        pairs = []
        for alone, fit in fits:
            if settings.shared or alone == label:
                pairs.append(fit.mounting_stretch[0])
            elif alone is None:
                pairs.append(fit.mounting_stretch[i])
        for axis, name in enumerate(mounting_names("stretch", label)):
            stretch[name] = np.array([pair[axis] for pair in pairs])
    return MountingRefits(stretch, _errors(posterior, data, full))


def _toe(residual: np.ndarray) -> np.ndarray:
    """Residuals near the mounted state."""
    return residual[: max(4, int(TOE_FRACTION * len(residual)))]


def _first_part(data: Specimen, share: float) -> Specimen:
    """The record until a load first passes a fraction of its peak, six rows at least."""
    protocols = []
    for p in data.protocols:
        load = np.abs(data.load(p))
        beyond = (load > share * load.max(axis=0)).any(axis=1)
        last = int(np.argmax(beyond)) if beyond.any() else p.rows
        protocols.append(p.at_rows(slice(0, max(last, p.rest_rows + MIN_ROWS))))
    return replace(data, protocols=tuple(protocols))


def _errors(posterior: Posterior, data: Specimen, full: FitResult) -> dict[str, float]:
    """Largest residual near the mounted state over the stiffness there, as a stretch by name."""
    shared = posterior.settings.shared
    readings = Readings.from_specimen(data, shared=shared)
    point = posterior.law.to_fit_coordinates(full.material.values)
    forward = readings.forward(posterior.law)
    lm = forward.solve_mounting(point, readings.mounting_load)
    # d f0 = df/d(ln lm) d(ln lm),  so  d lm = lm (df/d(ln lm))^-1 d f0
    slope = forward.response(point, 1.0, lm).by_log_mounting.transpose(2, 0, 1)
    toes = [np.abs(_toe(r)).max(axis=0) for r in full.residuals]
    residual = [np.max(toes, axis=0)] if shared else toes
    out: dict[str, float] = {}
    for i, label in enumerate(posterior.mounts):
        by_load = lm[:, i, None] * np.linalg.inv(slope[i])
        error = np.hypot(*(by_load * residual[i]).T)
        out |= dict(zip(mounting_names("stretch", label), map(float, error), strict=True))
    return out
