r"""The forward model: from material, mounted state and dimensions to loads.

    q_k = A_k s_k(theta, l lm) / (l_k lm_k)      dimensions of the unloaded state
    q_k = A_k s_k(theta, l lm) / l_k             dimensions of the mounted state
    f_k = q_k + z_k + error,  k = x, y

with the Cauchy stress s at the measured stretch l times the mounting stretch lm, the section A
(that of the file times factors near one for the errors of its dimensions), and the offset z of the
load cell. The compiled density has the same equations, from the same functions.

*Values* are numbers or arrays of shape (draws,) by the names of ``summary.csv``: a dictionary or a
table of draws. Missing quantities default to lm = 1, factors of one, z = 0.
Results have the shape (draws, rows, 2), x and y last.

Least squares use the fit coordinates of the law (:meth:`.Law.to_fit_coordinates`) and need
derivatives: :meth:`ForwardModel.response` and :meth:`ForwardModel.solve_mounting` take those of one
material and arrays of shape (2, n), one column per state of deformation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from biaxbayes.laws.law import Law, StressResponse
from biaxbayes.mechanics.mounting import (
    load_per_stress,
    sections,
    solve_balance,
    unloaded_section,
)
from biaxbayes.options import Settings
from biaxbayes.parameters import DIMENSION_PARAMETERS, mounting_names
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.thinning import ThinnedSpecimen

EDGE_X, EDGE_Y, THICKNESS, OFFSET_X, OFFSET_Y = (p.name for p in DIMENSION_PARAMETERS)


@dataclass(frozen=True)
class MeasuredRows:
    """Rows of the likelihood: those after the mounted state, concatenated over protocols."""

    stretch: np.ndarray  # (rows, 2)
    load: np.ndarray  # (rows, 2)
    scatter: np.ndarray  # (rows, 2), mean square scatter of the readings that a load is the mean of
    protocol: np.ndarray  # (rows,), index of the protocol
    names: tuple[str, ...]  # of the protocols

    @classmethod
    def from_thinned(cls, thinned: ThinnedSpecimen) -> MeasuredRows:
        """The rows of a specimen as they enter the likelihood."""
        specimen = thinned.specimen
        stretch, load, counts = [], [], []
        for p in specimen.protocols:
            stretch.append(p.stretch[p.rest_rows :])
            load.append(specimen.load(p)[p.rest_rows :])
            counts.append(p.rows - p.rest_rows)
        return cls(
            np.concatenate(stretch),
            np.concatenate(load),
            np.concatenate(thinned.scatter),
            np.repeat(np.arange(len(counts)), counts),
            tuple(p.name for p in specimen.protocols),
        )


@dataclass(frozen=True, eq=False)
class LoadResponse:
    """Loads of one material at n states of deformation, and their derivatives."""

    stress: StressResponse
    per_stress: np.ndarray  # load per Cauchy stress, (2, n)
    mounted_dimensions: bool  # whether the dimensions are those of the mounted state

    @property
    def load(self) -> np.ndarray:
        """Loads, shape (2, n)."""
        return self.per_stress * self.stress.stress

    @property
    def by_fit_coordinate(self) -> np.ndarray:
        """Derivatives with respect to the fit coordinates, shape (2, p, n)."""
        return self.per_stress[:, None] * self.stress.by_fit_coordinate

    @property
    def by_log_mounting(self) -> np.ndarray:
        """Derivatives with respect to the log mounting stretches, shape (load, stretch, n)."""
        slope = self.stress.by_log_stretch.copy()
        if not self.mounted_dimensions:  # f = A0 s / (l lm)
            slope[0, 0] -= self.stress.stress[0]
            slope[1, 1] -= self.stress.stress[1]
        return self.per_stress[:, None] * slope


@dataclass(frozen=True)
class ForwardModel:
    """Loads of a law on a specimen."""

    law: Law
    area: np.ndarray  # load per kPa from the dimensions of the file, (2,)
    mounted_dimensions: bool  # whether the dimensions are those of the mounted state

    @classmethod
    def from_specimen(cls, specimen: Specimen, settings: Settings) -> ForwardModel:
        """The forward model of a specimen in a run with these settings."""
        mounted = specimen.geometry == "mounted"
        return cls(settings.material_law, specimen.area, mounted)

    # --- one material in fit coordinates, one column per state of deformation ---

    def per_stress(self, stretch: Any, mounting: Any) -> np.ndarray:
        """Load per Cauchy stress at measured and mounting stretches, shape (..., 2, n)."""
        factor = load_per_stress(self.area[:, None], stretch, mounting, self.mounted_dimensions)
        return np.asarray(factor)

    def response(self, point: np.ndarray, stretch: Any, mounting: np.ndarray) -> LoadResponse:
        """Loads at measured and mounting stretches of shape (2, n), with derivatives."""
        stress = self.law.response(point, stretch * mounting)
        return LoadResponse(stress, self.per_stress(stretch, mounting), self.mounted_dimensions)

    def solve_mounting(
        self, point: np.ndarray, load: np.ndarray, *, compiled: bool = True
    ) -> np.ndarray:
        """Mounting stretches that balance mounting loads, both (2, m); NaN without a root."""
        # for a law that is fitted once, running in Python is faster than compiling
        solve: Any = solve_balance if compiled else solve_balance.py_func  # type: ignore[attr-defined]
        constants = self.law.constants_from_fit(*point)
        roots = np.full(load.shape, np.nan)
        for m, (px, py) in enumerate((load / self.area[:, None]).T):
            ok, x, y, *_ = solve(constants, px, py, self.mounted_dimensions)
            if ok:
                roots[:, m] = np.exp(x), np.exp(y)
        return roots

    # --- parts of the model, (draws, 1, 2) unless noted ---

    def mounting_stretch(self, values: Any, protocol: str = "") -> np.ndarray:
        """Mounting stretches of a protocol: its own, the shared ones, or 1."""
        own = mounting_names("stretch", protocol)
        x, y = own if own[0] in values else mounting_names("stretch")
        return _pair(_column(values, x, 1.0), _column(values, y, 1.0))

    def section(self, values: Any) -> np.ndarray:
        """Load per kPa in the state that the dimensions refer to."""
        factors = (_column(values, name, 1.0) for name in (EDGE_X, EDGE_Y, THICKNESS))
        return _pair(*sections(self.area, *factors))

    def unloaded_section(self, values: Any, mounting: np.ndarray) -> np.ndarray:
        """Load per first Piola-Kirchhoff stress at mounting stretches of that shape."""
        return unloaded_section(self.section(values), mounting, self.mounted_dimensions)

    def offset(self, values: Any) -> np.ndarray:
        """Load offsets z, the readings of the cell without load."""
        return _pair(_column(values, OFFSET_X, 0.0), _column(values, OFFSET_Y, 0.0))

    def load_per_stress(self, values: Any, stretch: Any, protocol: str = "") -> np.ndarray:
        """Load per Cauchy stress at measured stretches (rows, 2); (draws, rows, 2)."""
        lm = self.mounting_stretch(values, protocol)
        return load_per_stress(
            self.section(values), np.asarray(stretch)[None], lm, self.mounted_dimensions
        )

    # --- loads and readings ---

    def load(self, values: Any, stretch: Any, protocol: str = "") -> np.ndarray:
        """Loads that the material carries at measured stretches (rows, 2)."""
        with np.errstate(over="ignore", invalid="ignore"):
            total = np.asarray(stretch)[None] * self.mounting_stretch(values, protocol)
            stress = self.law.material(values).cauchy(total[..., 0], total[..., 1])
            factor = self.load_per_stress(values, stretch, protocol)
            return factor * np.stack(stress, axis=-1)

    def mounting_load(self, values: Any, protocol: str = "") -> np.ndarray:
        """Loads of the mounted state, (draws, 2)."""
        return self.load(values, np.ones((1, 2)), protocol)[:, 0]


def _column(values: Any, name: str, default: float) -> np.ndarray:
    """A quantity of shape (draws, 1), or its default of shape (1, 1)."""
    return np.atleast_1d(np.asarray(values.get(name, default), dtype=float))[:, None]


def _pair(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Columns (draws, 1) in x and y as one array (draws, 1, 2)."""
    return np.stack(np.broadcast_arrays(x, y), axis=-1)
