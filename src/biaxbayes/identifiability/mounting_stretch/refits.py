"""Mounting stretches of fits to parts of a record.

The way from the unloaded to the mounted state is not measured. The law extrapolates it from the
curves beyond, so a law that misses those curves gives a mounting stretch that is no more certain
than the miss. Fits to parts of the same record show how far it moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from biaxbayes.fitting.constrained import constrained_fit
from biaxbayes.fitting.effective_readings import misses_smoothly
from biaxbayes.fitting.residuals import Readings
from biaxbayes.fitting.result import FitResult
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.priors import DrawnPrior, Prior
from biaxbayes.parameters import mounting_names
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.thinning import averaged_specimen

SHARES = (0.3, 0.5)
"""Parts of the record that are fitted alone: until a load passes this share of its peak."""
FEWEST_ROWS = 6
ROWS = 60
"""Rows of a protocol that the refits use, averaged."""
TOE = 0.25
"""Share of a protocol's rows that the miss near the mounted state is read from."""
STARTS = 2
PRIOR_TAIL = 0.001


@dataclass(frozen=True)
class MountingRefits:
    """Mounting stretches of fits to parts of a record, by name."""

    stretch: dict[str, np.ndarray]  # (fits,): the value in every fit that has it
    error: dict[str, float]  # change that balances the largest miss near the mounted state

    def range(
        self, name: str, interval: tuple[float, float], errors: float, prior: Prior | DrawnPrior
    ) -> tuple[float, float]:
        """Range of an interval and all refits with their errors, cut to the prior."""
        values = self.stretch[name]
        margin = errors * self.error[name]
        low, high = interval
        first, last = prior.ppf(np.array([PRIOR_TAIL, 1.0 - PRIOR_TAIL]))
        return (
            min(low, max(float(values.min()) - margin, float(first))),
            max(high, min(float(values.max()) + margin, float(last))),
        )


def mounting_refits(posterior: Posterior) -> MountingRefits | None:
    """Fit parts of the record alone; None if no mounting stretch or no smooth misfit."""
    if not posterior.settings.infers_mounting:
        return None
    if not misses_somewhere(posterior.fit.residuals):
        return None
    work = _Work(posterior)
    names = [p.name for p in posterior.specimen.protocols]
    # (protocol that is fitted alone, or None for all; fit)
    fits: list[tuple[str | None, FitResult]] = [(None, work.full)]
    fits += [(None, work.fit(work.until(share))) for share in SHARES]
    if len(names) > 1:
        fits += [(name, work.fit(work.data.only(name))) for name in names]
    fits[1:] = [(name, fit) for name, fit in fits[1:] if fit.converged]
    stretch: dict[str, np.ndarray] = {}
    for i, label in enumerate(posterior.mounts):
        pairs = []
        for alone, fit in fits:
            if posterior.settings.shared or alone == label:
                pairs.append(fit.mounting_stretch[0])
            elif alone is None:
                pairs.append(fit.mounting_stretch[i])
        for axis, name in enumerate(mounting_names("stretch", label)):
            stretch[name] = np.array([pair[axis] for pair in pairs])
    return MountingRefits(stretch, work.errors())


def misses_somewhere(residuals: Sequence[np.ndarray]) -> bool:
    """True if a model misses a record smoothly, as a whole or near the mounted state."""
    return misses_smoothly(residuals) or misses_smoothly([_toe(r) for r in residuals])


def _toe(residual: np.ndarray) -> np.ndarray:
    """Residuals near the mounted state."""
    return residual[: max(4, int(TOE * len(residual)))]


@dataclass(frozen=True)
class _Work:
    posterior: Posterior

    @cached_property
    def data(self) -> Specimen:
        return averaged_specimen(self.posterior.specimen, ROWS)

    @cached_property
    def full(self) -> FitResult:
        return self.fit(self.data)

    def fit(self, part: Specimen) -> FitResult:
        settings = self.posterior.settings
        return constrained_fit(
            part,
            mounting=settings.fit_mounting,
            mounting_stretch=settings.mounting_stretch,
            fixed=settings.fixed_material,
            starts=STARTS,
            initial=self.posterior.fit.material,
            law=settings.law,
            fibre_switch=settings.fibre_switch,
        )

    def until(self, share: float) -> Specimen:
        """The record until a load first passes a share of its peak, six rows at least."""
        protocols = []
        for p in self.data.protocols:
            load = np.abs(self.data.load(p))
            beyond = (load > share * load.max(axis=0)).any(axis=1)
            last = int(np.argmax(beyond)) if beyond.any() else p.rows
            rows = slice(0, max(last, p.rest_rows + FEWEST_ROWS))
            x, y, fx, fy = (c[rows] for c in (p.stretch_x, p.stretch_y, p.load_x, p.load_y))
            protocols.append(
                replace(p, stretch_x=x, stretch_y=y, load_x=fx, load_y=fy, time_s=None)
            )
        return replace(self.data, protocols=tuple(protocols))

    def errors(self) -> dict[str, float]:
        """Largest miss near the mounted state over the stiffness there, as a stretch."""
        settings, full = self.posterior.settings, self.full
        shared = settings.shared
        data = Readings.from_specimen(self.data, shared=shared)
        law = self.posterior.law
        point = law.point(full.material.values)
        forward = data.forward(law)
        lm = forward.mounting_roots(point, data.mounting_load)
        # d f0 = df/d(ln lm) d(ln lm)
        slope = forward.response(point, 1.0, lm).by_log_mounting.transpose(2, 0, 1)
        toes = [np.abs(_toe(r)).max(axis=0) for r in full.residuals]
        miss = [np.max(toes, axis=0)] if shared else toes
        out = {}
        for i, label in enumerate(self.posterior.mounts):
            by_load = lm[:, i, None] * np.linalg.inv(slope[i])
            error = np.hypot(*(by_load * miss[i]).T)
            for axis, name in enumerate(mounting_names("stretch", label)):
                out[name] = float(error[axis])
        return out
