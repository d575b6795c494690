"""The joint posterior of the material parameters, the mounted state and the noise.

Evaluation has no side effects, and the constructor runs no fit: the weight of the likelihood and
the constants of the sampling coordinates are arguments, and :func:`.preparation.prepare` estimates
both from the least-squares fit. Where no fit is given, :attr:`Posterior.fit` runs it on first use.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.fitting.constrained import constrained_fit
from biaxbayes.fitting.effective_readings import EffectiveReadings
from biaxbayes.fitting.result import FitResult
from biaxbayes.forward import ForwardModel, MeasuredRows
from biaxbayes.laws.law import Law
from biaxbayes.model import density
from biaxbayes.model.assembly import (
    Assembly,
    SamplingConstants,
    assemble,
    natural_values,
    sampling_coordinates,
    to_slot,
)
from biaxbayes.model.density import REASONS
from biaxbayes.model.priors import Prior, Tie, parse_priors, prior_value
from biaxbayes.options import ModelOptions, Settings, takes_options
from biaxbayes.parameters import Quantities, Quantity, mounting_names
from biaxbayes.sampling.target import Target, bounds_array
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.thinning import ThinnedSpecimen, rows_to_keep, thinned_specimen


class Posterior:
    """Log posterior density of a specimen.

    Parameters
    ----------
    beta : float, optional
        Weight n_eff / n of the log likelihood. Independent noise needs none; for the others it
        is estimated from a fit: :func:`biaxbayes.prepare` does both.
    sampling_constants : SamplingConstants, optional
        Constants of the sampling coordinates.
    fit : FitResult, optional
        The least-squares fit, where it is known.
    readings : EffectiveReadings, optional
        Effective number of readings; used for ``beta`` if ``beta`` is not given.
    determinant : bool
        Include the Jacobian of the mounted state. False only to show its effect.
    thin : int, "none" or "auto"
        Maximum number of rows per protocol; longer protocols are averaged down to it. See
        :func:`~biaxbayes.specimens.thinning.rows_to_keep`.
    **options
        As in :class:`~biaxbayes.options.Settings`. ``priors`` override the default ones, as
        objects or as in a priors file.

    Raises
    ------
    InputError
        If the settings do not fit the specimen, for example a noisy mounting force in a file
        without load noise; or if ``beta`` is needed and not given.
    """

    @takes_options(Settings)
    def __init__(
        self,
        specimen: Specimen,
        *,
        beta: float | None = None,
        sampling_constants: SamplingConstants | None = None,
        fit: FitResult | None = None,
        readings: EffectiveReadings | None = None,
        determinant: bool = True,
        thin: int | str = ModelOptions.thin,
        **options: Any,
    ) -> None:
        if specimen.needs_grip_correction:
            raise InputError(
                "the loads are not corrected for the grips that the file states",
                file=specimen.name,
                remedy="sample it, and give specimen.csv of the run, which is corrected; or leave "
                "out the line 'grips'",
            )
        self.specimen = specimen
        chosen = Settings.from_values(options)
        tempered = chosen.noise != "independent"
        self.settings = replace(
            chosen,
            thin=rows_to_keep(specimen, thin, automatic=tempered),
            priors=_prior_objects(chosen.priors, chosen.material_law),
        )
        if beta is None and readings is not None:
            beta = readings.beta
        if beta is None and tempered:
            raise InputError(
                f"noise={chosen.noise!r} needs the weight beta of the likelihood",
                file=specimen.name,
                remedy="use biaxbayes.prepare(specimen, ...), or give beta or noise='independent'",
            )
        self.beta = 1.0 if beta is None else float(beta)
        self.readings = readings
        if fit is not None:
            self.fit = fit
        self.sampling_constants = sampling_constants or SamplingConstants()
        self.determinant = determinant
        self.assembly = assemble(
            specimen, self.settings, self.beta, self.sampling_constants, determinant=determinant
        )

    @cached_property
    def fit(self) -> FitResult:
        """The least-squares fit of the settings, without priors; computed on first use."""
        return self.least_squares()

    def least_squares(self, seed: int = 0) -> FitResult:
        """Least-squares fit of the settings, without priors, from random starts of this seed."""
        return constrained_fit(
            self.specimen,
            mounting=self.settings.fit_mounting,
            weighted=self.settings.noise == "effective",
            mounting_stretch=self.settings.mounting_stretch,
            fixed=self.settings.fixed_material,
            seed=seed,
            law=self.settings.law,
            fibre_switch=self.settings.fibre_switch,
        )

    # --- layout ---

    @property
    def thinned(self) -> ThinnedSpecimen:
        """The rows that enter the likelihood: zeroed and thinned according to the settings."""
        zeroed = self.settings.mounting == "zeroed"
        source = self.specimen.zeroed() if zeroed else self.specimen
        return thinned_specimen(source, self.settings.thin)

    @property
    def rows(self) -> MeasuredRows:
        """The rows that enter the likelihood."""
        return MeasuredRows.from_thinned(self.thinned)

    @property
    def forward(self) -> ForwardModel:
        """The forward model, from quantities of draws to loads."""
        return self.assembly.forward

    @cached_property
    def natural_assembly(self) -> Assembly:
        """The same density with slots as coordinates, which are finite at kappa = 0 as well."""
        return assemble(
            self.specimen,
            self.settings,
            self.beta,
            self.sampling_constants,
            determinant=self.determinant,
            sampling=False,
        )

    def replaced(self, **changes: Any) -> Posterior:
        """Another posterior with some arguments of the constructor changed."""
        own = ("beta", "sampling_constants", "fit", "readings", "determinant")
        given = self.options() | {name: vars(self).get(name) for name in own}
        return Posterior(self.specimen, **{**given, **changes})

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the sampled quantities, in the order of the coordinates.

        In mode ``noisy`` the mounting forces are sampled, in ``free`` the mounting stretches, in
        the other modes neither.
        """
        return tuple(q.name for q in self.sampled)

    @property
    def sampled(self) -> tuple[Quantity, ...]:
        """The sampled quantities, in the order of the coordinates."""
        known = [self.quantities[name] for name in self.assembly.free]
        if self.settings.mounting != "noisy":
            return tuple(known)
        return tuple(self.quantities.force_of(q) for q in known)

    @property
    def dimension(self) -> int:
        """Number of sampled coordinates."""
        return len(self.assembly.free)

    @property
    def mounts(self) -> tuple[str, ...]:
        """Label of each mounted state: one empty label when shared, else the protocols' names."""
        return self.assembly.mounts

    @property
    def priors(self) -> dict[str, Prior | float | Tie]:
        """The prior of every unknown; a number where fixed."""
        return dict(self.assembly.priors)

    @property
    def law(self) -> Law:
        """The material law."""
        return self.assembly.law

    @property
    def quantities(self) -> Quantities:
        """Symbol, unit and range of each quantity, by name."""
        return self.assembly.quantities

    @property
    def coordinate_constants(self) -> Any:
        """Constants of the law's sampling coordinates."""
        return self.assembly.problem.transform

    @property
    def bounds(self) -> np.ndarray:
        """Bounds of the sampling coordinates, shape (d, 2); infinite where there is none."""
        limits = self.law.sampling_bounds(self.coordinate_constants)
        finite = {i: limits[n] for i, n in enumerate(self.assembly.free) if n in limits}
        return bounds_array(finite, self.dimension)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the natural quantities of a draw, as in ``summary.csv``."""
        return self.assembly.names

    # --- densities ---

    def log_prob(self, coordinates: np.ndarray) -> np.ndarray:
        """Log density in the sampling coordinates, shape (walkers,); finite or -inf."""
        return self._counted(coordinates)[0]

    def _counted(self, coordinates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Log density, and the number of evaluations by outcome (see :data:`REASONS`)."""
        u = np.ascontiguousarray(np.atleast_2d(coordinates), dtype=float)
        counts = np.zeros(1 + len(REASONS), dtype=np.int64)
        return density.log_density(self.assembly.problem, u, counts), counts

    def target(self, counts: np.ndarray | None = None) -> Target:
        """The density for a sampler; evaluations are added to ``counts``, by outcome."""
        seen = np.zeros(1 + len(REASONS), dtype=np.int64) if counts is None else counts
        lock = threading.Lock()  # ensembles are advanced by several threads

        def log_prob(coordinates: np.ndarray) -> np.ndarray:
            out, new = self._counted(coordinates)
            with lock:
                np.add(seen, new, out=seen)
            return out

        return Target(
            log_prob,
            self.bounds,
            self.natural,
            skip_diagnostics=("log_likelihood",),
            counts=seen,
            reasons=REASONS,
            frame={"softening": self.sampling_constants.softening},
        )

    def log_density(self, parameters: Mapping[str, Any]) -> Any:
        """Log posterior density of natural parameters, up to a constant.

        It is a density in the parameters of the law (in ln of stiffnesses and exponents, in angles
        in radians), the mounting forces (for ``free`` the mounting stretches; none for ``exact``,
        ``ignored`` and ``zeroed``), ln of the noise sd (and of its growth) and whatever measured
        dimensions are unknowns.

        Parameters
        ----------
        parameters : mapping of str to array_like
            Names and units as in ``summary.csv``, for the law ``goh`` C1, k1 (kPa), k2, alpha
            (degrees), kappa; noise_sd; for ``noisy`` mounting_force_x and mounting_force_y, for
            ``free`` mounting_stretch_x and mounting_stretch_y. Forces and noise are in the unit of
            the file's stress pair (N or kPa). Arrays broadcast. Fixed and tied parameters are not
            read.

        Returns
        -------
        float or ndarray
            -inf where the density is zero.

        Raises
        ------
        InputError
            Naming the parameter that is missing.
        """
        columns = []
        for name, slot_name in zip(self.free, self.assembly.free, strict=True):
            if name not in parameters:
                raise InputError(f"log_density needs {name}", remedy=f"give {', '.join(self.free)}")
            columns.append(
                to_slot(
                    self.quantities[slot_name].parameter,
                    np.asarray(parameters[name], dtype=float),
                )
            )
        shape = np.broadcast_shapes(*(c.shape for c in columns))
        u = np.stack([np.broadcast_to(c, shape).ravel() for c in columns], axis=1)
        out = density.log_density(
            self.natural_assembly.problem,
            np.ascontiguousarray(u),
            np.zeros(1 + len(REASONS), dtype=np.int64),
        )
        return out.reshape(shape)[()]

    # --- between coordinates and natural quantities ---

    def natural(self, coordinates: np.ndarray) -> dict[str, np.ndarray]:
        """Natural quantities of draws, by the names of ``summary.csv``, and ``lp``.

        ``lp`` is that of :meth:`log_density`, whatever the sampling coordinates;
        ``log_likelihood`` the tempered log likelihood of the curves.
        """
        u = np.ascontiguousarray(np.atleast_2d(coordinates), dtype=float)
        at = density.evaluate(self.assembly.problem, u)
        values = natural_values(self.assembly, at.values, u)
        out = {name: values[name] for name in self.parameter_names}
        return out | {
            "log_likelihood": at.log_likelihood,
            "lp": at.log_density - at.log_jacobian if self.assembly.free else at.log_likelihood,
        }

    def coordinates(self, parameters: Mapping[str, Any]) -> np.ndarray:
        """Sampling coordinates of natural parameters, shape (n, d); inverse of :meth:`natural`."""
        renamed = dict(zip(self.free, self.assembly.free, strict=True))
        given = {renamed.get(name, name): value for name, value in parameters.items()}
        return sampling_coordinates(self.assembly, given)

    def options(self) -> dict[str, Any]:
        """The settings, as keyword arguments of :class:`Posterior`."""
        return self.settings.keywords()


def _prior_objects(priors: Mapping[str, Any], law: Law) -> dict[str, Prior | float | Tie]:
    """Priors as objects, those of both mounting stretches separately."""
    out: dict[str, Prior | float | Tie] = {}
    others = {}
    for name, value in priors.items():
        if isinstance(value, Prior):
            names = mounting_names("stretch") if name == "mounting_stretch" else (name,)
            out.update(dict.fromkeys(names, value))
        else:
            others[name] = prior_value(value) if isinstance(value, Tie) else value
    return out | parse_priors(others, law=law)
