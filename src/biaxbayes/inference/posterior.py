"""The joint posterior of the GOH parameters, the mounted state and the noise."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.inference import kernel
from biaxbayes.inference.assemble import SLOT_NAMES, Assembly, assemble, mounting_names
from biaxbayes.inference.conversion import natural_values, sampling_coordinates, to_slot
from biaxbayes.inference.coordinates import ANGULAR, DEFAULT_SOFTENING, SHEAR, softening_of
from biaxbayes.inference.fit import constrained_fit
from biaxbayes.inference.fit_result import FitResult
from biaxbayes.inference.noise import EffectiveReadings
from biaxbayes.inference.priors import Prior, Tie
from biaxbayes.inference.priors_file import parse_priors
from biaxbayes.inference.settings import Settings
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.thinning import ThinnedSpecimen, rows_to_keep, thinned_specimen

__all__ = ["Posterior"]


class Posterior:
    """Log posterior density of a specimen.

    Parameters
    ----------
    specimen : Specimen
    mounting, noise, mounting_stretch, noise_growth, fibre_switch
        As in :class:`~biaxbayes.inference.settings.Settings`.
    priors : mapping, optional
        Overrides of the default priors, as objects or as in a priors file.
    start : FitResult, optional
        The deterministic fit that ``effective`` noise and the sampler start from; made here
        when it is not given.
    beta : float, optional
        Weight n_eff / n of the log likelihood; overrides the estimate.
    seed : int
        For the random starts of the deterministic fit.
    thin : int, "none" or "auto"
        Rows of a protocol that longer ones are averaged to; see
        :func:`~biaxbayes.specimens.thinning.rows_to_keep`.

    Raises
    ------
    InputError
        If the settings do not fit the specimen, for example a noisy mounting force in a file
        without load noise.
    """

    def __init__(
        self,
        specimen: Specimen,
        *,
        mounting: str = "noisy",
        noise: str = "effective",
        mounting_stretch: str = "shared",
        noise_growth: bool = False,
        fibre_switch: bool = False,
        priors: Mapping[str, Any] | None = None,
        start: FitResult | None = None,
        beta: float | None = None,
        seed: int = 0,
        determinant: bool = True,
        thin: int | str = "auto",
    ) -> None:
        self.specimen = specimen
        self.settings = Settings(
            mounting,
            noise,
            mounting_stretch,
            noise_growth,
            fibre_switch,
            rows_to_keep(specimen, thin, automatic=noise != "independent"),
            _objects(priors or {}),
        )
        self._check_noise()
        self._start = start
        self._seed = seed
        self._determinant = determinant
        self.readings: EffectiveReadings | None = None
        if beta is None and noise != "independent":
            from biaxbayes.inference.modal_residuals import sampled_readings  # needs this class

            self.readings = sampled_readings(self)
            beta = self.readings.beta
        self._softening = DEFAULT_SOFTENING
        self.beta = 1.0 if beta is None else float(beta)
        self._assembly = self._assemble(SHEAR, structural=True)
        self._natural = self._assemble(ANGULAR, structural=False)
        self.rejected = np.zeros(4, dtype=np.int64)

    # --- layout ---

    @property
    def thinned(self) -> ThinnedSpecimen:
        """The specimen as its rows enter the likelihood: zeroed and thinned where asked for."""
        zeroed = self.settings.mounting == "zeroed"
        source = self.specimen.zeroed() if zeroed else self.specimen
        return thinned_specimen(source, self.settings.thin)

    def _assemble(self, chart: int, *, structural: bool) -> Assembly:
        reference = None
        if self._start is not None and self.settings.infers_mounting:
            # One constant a specimen: largest measured stretch at the fit's mounting stretch.
            lm = np.clip(np.max(self._start.mounting_stretch, axis=0), 1.0, 1.5)
            tops = [(p.stretch_x.max(), p.stretch_y.max()) for p in self.specimen.protocols]
            reference = tuple(np.max(tops, axis=0) * lm)
        return assemble(
            self.specimen,
            self.settings,
            beta=self.beta,
            reference_stretch=reference,
            chart=chart,
            softening=self._softening,
            structural=structural,
            determinant=self._determinant,
        )

    def _check_noise(self) -> None:
        if self.settings.mounting not in ("noisy", "free"):
            return
        _, sd = self.specimen.mounting_readings(shared=self.settings.mounting_stretch == "shared")
        if np.any(sd <= 0.0):
            raise InputError(
                "the file has no load noise, so the mounting force cannot be noisy",
                file=self.specimen.name,
                remedy="use --mounting exact, or state load_noise_N (or load_noise_kPa)",
            )

    @property
    def start(self) -> FitResult:
        """The deterministic fit in the posterior's own residual."""
        if self._start is None:
            reading = "noisy" if self.settings.mounting == "free" else self.settings.mounting
            self._start = constrained_fit(
                self.specimen,
                reading=reading,
                mounting_stretch=self.settings.mounting_stretch,
                fixed={k: v for k, v in self.settings.fixed.items() if k != "noise_sd"},
                seed=self._seed,
                fibre_switch=self.settings.fibre_switch,
            )
        return self._start

    @property
    def free(self) -> tuple[str, ...]:
        """Natural names of what is sampled, in the order of the coordinates.

        In mounting modes ``noisy`` and ``exact`` the mounting coordinates are the forces.
        """
        if self.settings.mounting == "noisy":
            return tuple(n.replace("mounting_stretch", "mounting_force") for n in self._free)
        return self._free

    @property
    def _free(self) -> tuple[str, ...]:
        return self._assembly.free

    @property
    def dimension(self) -> int:
        """Number of sampled coordinates."""
        return len(self._free)

    @property
    def mounts(self) -> tuple[str, ...]:
        """Label of each mounted state: one empty label when shared, else the protocols' names."""
        return self._assembly.mounts

    @property
    def priors(self) -> dict[str, Prior | float | Tie]:
        """The prior of every unknown; a number where fixed."""
        return dict(self._assembly.priors)

    @property
    def chart(self) -> int:
        """Chart of the fibre angle and dispersion."""
        return self._assembly.problem.chart

    @property
    def edges(self) -> dict[int, tuple[float, float]]:
        """Hard edges of the sampling coordinates: index to (low, high)."""
        limits = (
            {"kappa": (0.0, 1.0)}
            if self.chart == SHEAR
            else {
                "alpha": (0.0, 0.5 * np.pi),
                "kappa": (0.0, 1.0 / 3.0),
            }
        )
        return {i: limits[n] for i, n in enumerate(self._free) if n in limits}

    @property
    def softening(self) -> float:
        """Scale of the sampling chart near isotropy (see :mod:`.coordinates`)."""
        return float(self._assembly.problem.softening)

    def use_chart(self, softening: float | None = None) -> None:
        """Lay the sampling coordinates out around the deterministic fit.

        Coordinates mean nothing without their reference stretch and softening: whoever draws,
        or continues from stored coordinates, calls this first.

        Parameters
        ----------
        softening : float, optional
            Scale of the chart near isotropy; default that of the fit's own material.
        """
        material = self.start.material
        self._softening = (
            softening_of(material.theta[3], material.kappa) if softening is None else softening
        )
        self._assembly = self._assemble(SHEAR, structural=True)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the natural quantities of a draw, as in ``summary.csv``."""
        names = list(SLOT_NAMES[:5])
        if self.settings.infers_mounting:
            for what in ("stretch", "force"):
                for label in self._assembly.mounts:
                    names.extend(mounting_names(what, label))
        names.append("noise_sd")
        extras = [n for n in self._free if n in SLOT_NAMES[6:]]
        return (*names, *extras)

    # --- densities ---

    def log_prob(self, coordinates: np.ndarray) -> np.ndarray:
        """Log density in the sampling coordinates, shape (walkers,); finite or -inf."""
        u = np.ascontiguousarray(np.atleast_2d(coordinates), dtype=float)
        counts = np.zeros(4, dtype=np.int64)  # its own: threads call this at the same time
        out = kernel.log_density(self._assembly.problem, u, counts)
        self.rejected += counts
        return out

    def log_density(self, parameters: Mapping[str, Any]) -> Any:
        """Log posterior density of natural parameters, up to a constant.

        It is a density in ln C1, ln k1, ln k2, alpha, kappa, the mounting forces (for ``free``
        the mounting stretches; none for ``exact``, ``ignored`` and ``zeroed``), ln of the noise
        sd (and of its growth) and whatever measured dimensions are unknowns.

        Parameters
        ----------
        parameters : mapping of str to array_like
            Names as in ``summary.csv``: C1, k1 (kPa), k2, alpha (degrees), kappa, noise_sd; for
            ``noisy`` mounting_force_x and mounting_force_y, for ``free`` mounting_stretch_x and
            mounting_stretch_y. Forces and noise are in the unit of the file's stress pair
            (N or kPa). Arrays broadcast. Fixed and tied parameters are not read.

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
        for name, slot_name in zip(self.free, self._free, strict=True):
            if name not in parameters:
                raise InputError(f"log_density needs {name}", remedy=f"give {', '.join(self.free)}")
            columns.append(to_slot(slot_name, np.asarray(parameters[name], dtype=float)))
        shape = np.broadcast_shapes(*(c.shape for c in columns))
        u = np.stack([np.broadcast_to(c, shape).ravel() for c in columns], axis=1)
        out = kernel.log_density(
            self._natural.problem, np.ascontiguousarray(u), np.zeros(4, dtype=np.int64)
        )
        return out.reshape(shape)[()]

    # --- between coordinates and natural quantities ---

    def natural(self, coordinates: np.ndarray) -> dict[str, np.ndarray]:
        """Natural quantities of draws, by the names of ``summary.csv``, and ``lp``.

        ``lp`` is the log density of :meth:`log_density`, which does not depend on the chart;
        ``log_likelihood`` the tempered log likelihood of the curves.
        """
        u = np.ascontiguousarray(np.atleast_2d(coordinates), dtype=float)
        likelihood, values = natural_values(self._assembly, self.settings, u)
        out = {name: values[name] for name in self.parameter_names}
        out["log_likelihood"] = likelihood
        out["lp"] = np.atleast_1d(self.log_density(out)) if self._free else likelihood
        return out

    def coordinates(self, parameters: Mapping[str, Any]) -> np.ndarray:
        """Sampling coordinates of natural parameters, shape (n, d); inverse of :meth:`natural`."""
        renamed = dict(zip(self.free, self._free, strict=True))
        given = {renamed.get(name, name): value for name, value in parameters.items()}
        return sampling_coordinates(self._assembly, given)

    def without_temper(self) -> Posterior:
        """The same posterior with independent errors."""
        return Posterior(
            self.specimen,
            **{**self.options(), "noise": "independent"},
            start=self._start,
        )

    def options(self) -> dict[str, Any]:
        """The settings, as keyword arguments of :class:`Posterior`."""
        return {key: getattr(self.settings, key) for key in self.settings.__dataclass_fields__}


def _objects(priors: Mapping[str, Any]) -> dict[str, Prior | float | Tie]:
    out: dict[str, Prior | float | Tie] = {}
    for name, value in priors.items():
        if isinstance(value, Prior | Tie):
            names = [f"{name}_x", f"{name}_y"] if name == "mounting_stretch" else [name]
            out.update(dict.fromkeys(names, value))
        else:
            out.update(parse_priors({name: value}))
    return out
