"""The joint posterior of the material parameters, the mounted state and the errors.

The constructor runs no fit: the least-squares fit, whose loads a smooth misfit is relative to, runs
on first use where none is given.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.fitting.constrained import FitSetup
from biaxbayes.fitting.fit_result import FitResult
from biaxbayes.forward import ForwardModel
from biaxbayes.laws.law import Law
from biaxbayes.model import density
from biaxbayes.model.assembly import (
    Assembly,
    SamplingConstants,
    assemble,
    check_settings,
    natural_values,
    sampling_coordinates,
    to_slot,
)
from biaxbayes.model.density import PIECE_SLOTS, REASONS, Evaluation, Problem
from biaxbayes.model.misfit import SmoothMisfit
from biaxbayes.model.piece import Piece
from biaxbayes.model.priors import BOTH, Prior, Tie, parse_priors, prior_value
from biaxbayes.model.readings import ReadingVector, TestedPaths
from biaxbayes.options import ModelOptions, Settings, takes_options
from biaxbayes.parameters import STIFFNESS, Quantities, Quantity, mounting_names, name_of
from biaxbayes.sampling.target import Target
from biaxbayes.specimens.averaging import rows_to_keep
from biaxbayes.specimens.rows import MeasuredRows
from biaxbayes.specimens.specimen import Specimen

MAX_POINTS = 65_536
"""Points of a density that are evaluated together."""


class Posterior:
    """Log posterior density of a specimen.

    Parameters
    ----------
    sampling_constants : SamplingConstants, optional
        Constants of the sampling coordinates.
    fit : FitResult, optional
        The least-squares fit, where it is known.
    misfit_fit : FitResult, optional
        The fit whose loads a smooth misfit is relative to, if it is not ``fit``.
    terms : sequence of int arrays, optional
        Terms of the smooth misfit that are summed, by piece; by default all.
    max_rows : int, "none" or "auto"
        Maximum number of rows per protocol; longer protocols are averaged down to it. See
        :func:`~biaxbayes.specimens.averaging.rows_to_keep`.
    **options
        As in :class:`~biaxbayes.options.Settings`. ``priors`` override the default ones, as
        objects or as in a priors file.

    Raises
    ------
    InputError
        If the settings do not fit the specimen, for example independent errors and a noisy mounting
        force in a file without load noise.
    """

    @takes_options(Settings)
    def __init__(
        self,
        specimen: Specimen,
        *,
        sampling_constants: SamplingConstants | None = None,
        fit: FitResult | None = None,
        misfit_fit: FitResult | None = None,
        terms: Sequence[np.ndarray] | None = None,
        max_rows: int | str = ModelOptions.max_rows,
        **options: Any,
    ) -> None:
        if not isinstance(specimen, Specimen):
            raise InputError(
                f"`specimen` must be a Specimen, not {type(specimen).__name__}",
                remedy="read a file with biaxbayes.read_specimen",
            )
        if specimen.needs_grip_correction:
            raise InputError(
                "the loads are not corrected for the grips that the file states",
                file=specimen.name,
                remedy="sample it, and give specimen.csv of the run, which is corrected; or leave "
                "out the line 'grips'",
            )
        self.specimen = specimen
        chosen = Settings.from_values(options)
        self.settings = replace(
            chosen,
            max_rows=rows_to_keep(specimen, max_rows, automatic=chosen.has_misfit),
            priors=_prior_objects(chosen.priors, chosen.material_law),
        )
        if fit is not None:
            self.fit = fit
        if misfit_fit is not None:
            self.misfit_fit = misfit_fit
        self.sampling_constants = sampling_constants or SamplingConstants()
        self.terms = terms
        check_settings(specimen, self.settings)

    @cached_property
    def fit(self) -> FitResult:
        """The least-squares fit of the settings, without priors; computed on first use."""
        return self.least_squares()

    def least_squares(self, seed: int = 0) -> FitResult:
        """Least-squares fit of the settings, without priors, from random starts of this seed."""
        return FitSetup.from_settings(self.specimen, self.settings).fitted(seed=seed)

    # --- layout ---

    @cached_property
    def assembly(self) -> Assembly:
        """The density in the sampling coordinates, laid out for the compiled code."""
        return assemble(self.specimen, self.settings, self.sampling_constants)

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """The pieces of the tissue, with their rows, readings and forward models."""
        return self.assembly.pieces

    @property
    def rows(self) -> MeasuredRows:
        """The rows of the first piece that enter the likelihood."""
        return self.pieces[0].rows

    @property
    def readings(self) -> ReadingVector:
        """How the rows of the first piece make up its readings."""
        return self.pieces[0].readings

    @property
    def forward(self) -> ForwardModel:
        """The forward model of the first piece, from quantities of draws to loads."""
        return self.pieces[0].forward

    def of_piece(self, piece: int) -> slice:
        """The readings of a piece among all."""
        ends = np.cumsum([0, *(len(p.readings.weight) for p in self.pieces)])
        return slice(int(ends[piece]), int(ends[piece + 1]))

    @cached_property
    def natural_assembly(self) -> Assembly:
        """The same density with slots as coordinates, which are finite at kappa = 0 as well."""
        return assemble(self.specimen, self.settings, self.sampling_constants, sampling=False)

    def replaced(self, **changes: Any) -> Posterior:
        """Another posterior with some arguments of the constructor changed."""
        own = ("sampling_constants", "fit", "misfit_fit", "terms")
        given = self.options() | {name: vars(self).get(name) for name in own}
        return type(self)(self.specimen, **{**given, **changes})

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
        """Label of each mounted state of all pieces; that of the first is empty when shared."""
        return self.quantities.states

    @property
    def priors(self) -> dict[str, Prior | float | Tie]:
        """The prior of every unknown; a number where fixed."""
        return dict(self.assembly.priors)

    @property
    def law(self) -> Law:
        """The material law."""
        return self.settings.material_law

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
        return self.assembly.bounds

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the natural quantities of a draw, as in ``summary.csv``."""
        return self.assembly.names

    # --- likelihood ---

    @cached_property
    def misfit_fit(self) -> FitResult:
        """The least-squares fit whose loads a smooth misfit is relative to."""
        return self.fit

    @cached_property
    def _fitted(self) -> dict[str, Any]:
        """Natural values of the fit whose loads a smooth misfit is relative to."""
        fit = self.misfit_fit
        fitted: dict[str, Any] = dict(zip(self.law.names, fit.material.values, strict=True))
        if self.settings.infers_mounting:
            for state, stretch in zip(self.mounts, fit.mounting_stretch, strict=True):
                fitted |= dict(zip(mounting_names("stretch", state), stretch, strict=True))
        for piece, stiffness in zip(self.pieces, fit.stiffness, strict=True):
            fitted[name_of(STIFFNESS.name, piece.labels.label)] = float(stiffness)
        return fitted

    @cached_property
    def paths_of_pieces(self) -> tuple[TestedPaths, ...]:
        """Paths of the protocols of each piece, with the smooth loads of the fit."""
        return tuple(TestedPaths(p.specimen, p.forward, self._fitted) for p in self.pieces)

    @cached_property
    def misfits(self) -> tuple[SmoothMisfit, ...]:
        """The smooth misfit of the law in each piece, independent of one another."""
        terms: list[Any] = list(self.terms or ()) or [None] * len(self.pieces)
        return tuple(
            piece.smooth_misfit(paths, chosen)
            for piece, paths, chosen in zip(self.pieces, self.paths_of_pieces, terms, strict=True)
        )

    @property
    def paths(self) -> TestedPaths:
        """Paths of the protocols of the first piece."""
        return self.paths_of_pieces[0]

    @property
    def misfit(self) -> SmoothMisfit:
        """The smooth misfit of the law in the first piece."""
        return self.misfits[0]

    def log_likelihood(self, residual: np.ndarray, noise_sd: np.ndarray) -> np.ndarray:
        """Log likelihood of residuals (draws, n).

        The sds (draws, pieces) are those of independent errors. The misfits of the pieces are
        independent of one another.
        """
        out = np.zeros(len(residual))
        for i, piece in enumerate(self.pieces):
            own = residual[:, self.of_piece(i)]
            if self.settings.has_misfit:
                out += self.misfits[i].log_likelihood(own)
            else:
                out += piece.independent_log_likelihood(own, noise_sd[:, i])
        return out

    def residuals(self, values: Any, piece: int | None = None) -> np.ndarray:
        """Readings less model loads of draws, (draws, n), from natural values by name.

        Of all pieces, or of one.
        """
        chosen = self.pieces if piece is None else self.pieces[piece : piece + 1]
        return np.concatenate([p.residuals(values) for p in chosen], axis=1)

    # --- densities ---

    def evaluate(
        self, problem: Problem, u: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, Evaluation]:
        """Log density and log likelihood of walkers (n, d), and what they are made of."""
        at = density.evaluate(problem, u)
        likelihood = np.full(len(u), -np.inf)
        inside = np.isfinite(at.log_prior)
        if inside.any():
            first = problem.size + PIECE_SLOTS * np.arange(len(self.pieces))
            noise_sd = at.values[np.ix_(inside, first)]
            with np.errstate(over="ignore", invalid="ignore"):
                found = self.log_likelihood(at.residual[inside], noise_sd)
            likelihood[inside] = np.where(np.isfinite(found), found, -np.inf)
        return at.log_prior + likelihood, likelihood, at

    def log_prob(self, coordinates: np.ndarray) -> np.ndarray:
        """Log density in the sampling coordinates, shape (walkers,); finite or -inf."""
        u = np.atleast_2d(np.asarray(coordinates, dtype=float))
        return self.evaluate(self.assembly.problem, u)[0]

    def target(self, counts: np.ndarray | None = None) -> Target:
        """The density for a sampler; evaluations are added to ``counts``, by outcome."""
        seen = np.zeros(1 + len(REASONS), dtype=np.int64) if counts is None else counts
        lock = threading.Lock()  # ensembles are advanced by several threads

        def log_prob(coordinates: np.ndarray) -> np.ndarray:
            out, _, at = self.evaluate(self.assembly.problem, coordinates)
            with lock:
                np.add.at(seen, at.outcome, 1)
            return out

        return Target(
            log_prob,
            self.bounds,
            self.natural,
            skip_diagnostics=("log_likelihood",),
            counts=seen,
            reasons=REASONS,
            constants={
                "isotropy_scale": self.sampling_constants.isotropy_scale,
                "terms": list(self.terms or ()),
            },
        )

    def log_density(self, parameters: Mapping[str, Any]) -> Any:
        """Log posterior density of natural parameters, up to a constant.

        It is a density in the parameters of the law (in ln of stiffnesses and exponents, in angles
        in radians), the mounting forces (for ``free`` the mounting stretches; none for ``exact``,
        ``ignored`` and ``zeroed``), ln of the noise sd (of independent errors) and whatever
        measured dimensions are unknowns.

        Parameters
        ----------
        parameters : mapping of str to array_like
            Names and units as in ``summary.csv``, for the law ``goh`` C1, k1 (kPa), k2, alpha
            (degrees), kappa; noise_sd; for ``noisy`` mounting_force_x and mounting_force_y, for
            ``free`` mounting_stretch_x and mounting_stretch_y. Forces and noise are in the unit of
            the file's loads (N or kPa). Arrays broadcast. Fixed and tied parameters are not
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
            values = np.asarray(parameters[name], dtype=float)
            columns.append(to_slot(self.quantities[slot_name].parameter, values))
        shape = np.broadcast_shapes(*(c.shape for c in columns))
        u = np.stack([np.broadcast_to(c, shape).ravel() for c in columns], axis=1)
        problem = self.natural_assembly.problem
        # in blocks: every point has residuals of all readings
        blocks = range(0, len(u), MAX_POINTS)
        parts = [self.evaluate(problem, u[i : i + MAX_POINTS])[0] for i in blocks]
        return np.concatenate([np.empty(0), *parts]).reshape(shape)[()]

    # --- between coordinates and natural quantities ---

    def natural(
        self, coordinates: np.ndarray, log_prob: np.ndarray | None = None
    ) -> dict[str, np.ndarray]:
        """Natural quantities of draws, by the names of ``summary.csv``, and ``lp``.

        ``lp`` is that of :meth:`log_density`, whatever the sampling coordinates;
        ``log_likelihood`` that of all readings. ``log_prob`` are the values of :meth:`log_prob`,
        where they are known.
        """
        u = np.atleast_2d(np.asarray(coordinates, dtype=float))
        if log_prob is None:
            log_density, likelihood, at = self.evaluate(self.assembly.problem, u)
        else:
            at = density.evaluate(self.assembly.problem, u)
            log_density, likelihood = log_prob, log_prob - at.log_prior
        values = natural_values(self.assembly, at.values, u)
        out = {name: values[name] for name in self.parameter_names}
        lp = likelihood
        if self.assembly.free:
            with np.errstate(invalid="ignore"):  # outside of the support both may be infinite
                lp = log_density - at.log_jacobian
        return out | {"log_likelihood": likelihood, "lp": lp}

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
            names = mounting_names("stretch") if name == BOTH else (name,)
            out |= dict.fromkeys(names, value)
        else:
            others[name] = prior_value(value) if isinstance(value, Tie) else value
    return out | parse_priors(others, law=law)
