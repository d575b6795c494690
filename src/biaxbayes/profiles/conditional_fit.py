"""The largest likelihood with one parameter held: what a profile likelihood is made of.

    D(theta, lm) = -2 ln L(theta, lm)

L is the likelihood of the posterior, with its misfit averaged out. No prior enters: of independent
errors the sd is one more unknown, dimensions and offsets of the load cell have nominal values.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from biaxbayes.fitting.constrained import FitSetup
from biaxbayes.model.assembly import assemble, natural_values, sampling_coordinates
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import start_parameters
from biaxbayes.model.priors import Prior
from biaxbayes.parameters import NOISE_SD, mounting_names
from biaxbayes.sampling.modes import BOUND_MARGIN, local_mode
from biaxbayes.sampling.target import LogDensity

CLIMBS, LEAST_RISE = 10, 1e-7
"""Climbs in a row, and the rise of ln L below which a climb has arrived."""
FIRST_RISE = 1.0
"""The same of a first climb from a start that is one of many."""
STRETCH_WIDTH = 0.02
FLAT = 30.0
"""Widths of a posterior along which a likelihood may be flat: valleys that no prior ends."""
STEP = 0.03
"""Step of finite differences, in conditional sds."""


@dataclass(frozen=True, eq=False)
class ConditionalFit:
    """A conditional maximum."""

    values: dict[str, float]  # natural values by name
    deviance: float  # infinite where there is none


class ConditionalLikelihood:
    """The likelihood of a posterior, as a function of one parameter of the law or the mounting."""

    def __init__(self, posterior: Posterior, parameter: str) -> None:
        self.posterior, self.parameter = posterior, parameter
        settings = posterior.settings
        self.specimen = replace(posterior.specimen, metadata={})
        self.settings = replace(
            settings,
            # the mounting stretches themselves are unknowns, not the forces
            mounting="free" if settings.mounting == "noisy" else settings.mounting,
            priors={n: p for n, p in settings.priors.items() if not isinstance(p, Prior)},
        )

    def best(
        self, value: float | None, start: Mapping[str, float], least_rise: float = LEAST_RISE
    ) -> ConditionalFit:
        """The least deviance with the parameter at a value (None: free), climbing from a start."""
        held = {} if value is None else {self.parameter: value}
        law = self.settings.material_law
        of_law = {n: v for n, v in held.items() if n in law.names}
        settings = replace(self.settings, priors={**self.settings.priors, **of_law})
        constants = self.posterior.sampling_constants
        assembly = assemble(self.specimen, settings, constants, determinant=False)
        values = {**start, **held}
        # parameters of the law off the ends of their ranges
        inner = law.clip_inside([values[name] for name in law.names])
        values |= dict(zip(law.names, inner, strict=True))
        point = sampling_coordinates(assembly, values)[0] if assembly.free else np.empty(0)
        # a stretch has a coordinate of its own; a parameter of the law is fixed in the assembly
        free = np.array([i for i, name in enumerate(assembly.free) if name not in held], dtype=int)

        def log_likelihood(x: np.ndarray) -> np.ndarray:
            points = np.tile(point, (len(x), 1))
            points[:, free] = x
            return self.posterior.evaluate(assembly.problem, points)[1]

        if free.size:
            widths = assembly.law.sampling_widths(assembly.problem.transform)
            widths = {NOISE_SD.name: 1.0} | widths
            scale = np.array([widths.get(n, STRETCH_WIDTH) for n in assembly.free])[free]
            # a climb stays off its bounds by so much
            bounds = assembly.bounds[free] + [-BOUND_MARGIN, BOUND_MARGIN]
            point[free] = _climb(log_likelihood, point[free], scale, bounds, least_rise)
        _, (height,), at = self.posterior.evaluate(assembly.problem, point[None])
        natural = natural_values(assembly, at.values, point[None])
        return ConditionalFit({n: float(v[0]) for n, v in natural.items()}, float(-2.0 * height))

    def fitted_start(self) -> dict[str, float]:
        """The least-squares fit."""
        fit = start_parameters(self.posterior)
        stretches = zip(self.posterior.mounts, self.posterior.fit.mounting_stretch, strict=True)
        for state, lm in stretches if self.settings.infers_mounting else ():
            fit |= dict(zip(mounting_names("stretch", state), np.clip(lm, 0.9, 1.2), strict=True))
        return fit

    def other_starts(self, value: float | None, count: int) -> list[dict[str, float]]:
        """Starts far from one another, the best of many random materials."""
        law, settings = self.settings.material_law, self.settings
        fixed = dict(settings.fixed_material)
        if value is not None and self.parameter in law.names:
            fixed[self.parameter] = value
        setup = FitSetup.from_settings(self.specimen, settings, fixed)
        materials, stretches = setup.starting_points(count, 0)
        out = []
        for material, pair in zip(materials, stretches, strict=True):
            start = dict(zip(law.names, law.from_fit_coordinates(material), strict=True))
            for state in self.posterior.mounts:
                start |= dict(zip(mounting_names("stretch", state), pair, strict=True))
            out.append(start | {NOISE_SD.name: 3.0 * self.posterior.fit.rms})
        return out


def _climb(
    log_likelihood: LogDensity,
    x: np.ndarray,
    scale: np.ndarray,
    bounds: np.ndarray,
    least_rise: float,
) -> np.ndarray:
    """Climb from x until neither steps of a posterior's width nor far ones rise any more."""
    height = float(log_likelihood(x[None])[0])
    for _ in range(CLIMBS if np.isfinite(height) else 0):
        for width in (scale, FLAT * scale):
            x, _ = local_mode(log_likelihood, x, width, bounds, least_rise=least_rise, step=STEP)
        before, height = height, float(log_likelihood(x[None])[0])
        if height - before < least_rise:
            break
    return x
