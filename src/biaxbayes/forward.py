r"""The forward model: from material, mounted state and dimensions to the readings of a piece.

    q_i = sum_p sum_k  w_pik g_k s_k(theta, l_p lm)          (.experiments)
    g_k = c A_k / lm_k      dimensions of the unloaded state
    g_k = c A_k             dimensions of the mounted state
    f_i = q_i + z_i + error,  i = x, y

with the Cauchy stress s at the measured stretch l times the mounting stretch lm, the section A
(that of the file times factors near one for the errors of its dimensions), the stiffness c of the
piece over that of the first, and the offset z of the load cell. The compiled density has the same
equations, from the same functions.

*Values* are numbers or arrays of shape (draws,) by the names of ``summary.csv``, lm = 1, factors of
one and z = 0 where they are missing. Results have the shape (draws, rows, 2); a reading that a test
does not have is zero. Least squares take one material in fit coordinates, with derivatives.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from biaxbayes.experiments import BIAXIAL, Experiment
from biaxbayes.laws.law import Law
from biaxbayes.laws.materials import cauchy_stress, squared_stretches
from biaxbayes.mechanics.mounting import (
    mounted_section,
    sections,
    solve_balance,
    with_free_side,
)
from biaxbayes.options import Settings
from biaxbayes.parameters import DIMENSION_PARAMETERS, STIFFNESS, mounting_names, name_of
from biaxbayes.specimens.specimen import Specimen

EDGE_X, EDGE_Y, THICKNESS, OFFSET_X, OFFSET_Y = (p.name for p in DIMENSION_PARAMETERS)


@dataclass(frozen=True, eq=False)
class LoadResponse:
    """Readings of one material at n rows, and their derivatives."""

    load: np.ndarray  # (n, 2)
    by_fit_coordinate: np.ndarray  # (n, 2, p)
    by_log_mounting: np.ndarray  # (n, load, stretch), with respect to the log mounting stretches
    # load per Cauchy stress (n, 2), with which a residual is a stress; 1 where nothing is read
    load_per_stress: np.ndarray

    @property
    def stress(self) -> np.ndarray:
        """The Cauchy stress that a load stands for, (n, 2)."""
        return self.load / self.load_per_stress

    @classmethod
    def joined(cls, parts: Iterable[LoadResponse]) -> LoadResponse:
        """Readings at the rows of all parts, one below the other."""
        return cls(*map(np.concatenate, zip(*(vars(p).values() for p in parts), strict=True)))


@dataclass(frozen=True, eq=False)
class ForwardModel:
    """Readings of a law in the test of one piece."""

    law: Law
    area: np.ndarray  # load per kPa from the dimensions of the file, (2,)
    mounted_dimensions: bool  # whether the dimensions are those of the mounted state
    experiment: Experiment = BIAXIAL
    piece: str = ""  # label of the piece, empty for the first
    states: Mapping[str, str] = field(default_factory=dict)  # mounted state of each protocol

    @classmethod
    def from_specimen(cls, specimen: Specimen, settings: Settings, piece: str = "") -> ForwardModel:
        """The forward model of a piece in a run with these settings."""
        mounted = specimen.geometry == "mounted"
        prefix = f"{piece}: " if piece else ""
        states = {p.name: piece if settings.shared else prefix + p.name for p in specimen.protocols}
        law, experiment = settings.material_law, specimen.experiment
        return cls(law, specimen.area, mounted, experiment, piece, states)

    # --- one material in fit coordinates ---

    def response(
        self, point: np.ndarray, stretch: Any, mounting: np.ndarray, stiffness: float = 1.0
    ) -> LoadResponse:
        """Readings at measured and mounting stretches (n, 2), with derivatives.

        The mounting stretch of a free side has no influence: its stretch is the root at every row.
        """
        points = self.experiment.points(np.broadcast_to(stretch, mounting.shape))
        lm, side = mounting[points.row], self.experiment.free_side
        total = points.stretch * lm
        if side is not None and not np.isnan(total[:, side]).any():
            side = None  # it was measured
        if side is not None:
            constants = self.law.constants_from_fit(*point)

            def cauchy(x: Any, y: Any) -> Any:
                return cauchy_stress(constants, *squared_stretches(x, y))

            total = with_free_side(cauchy, total, side)
        stress, by_point, by_log = self.law.response(point, total)
        if side is not None:
            # implicit function theorem, with f the free side and k the other direction:
            # d s_k = (ds_k/dp - ds_k/dl_f (ds_f/dl_f)^-1 ds_f/dp) dp
            k, of_point, of_log = 1 - side, np.zeros_like(by_point), np.zeros_like(by_log)
            ratio = by_log[:, k, side] / by_log[:, side, side]
            of_point[:, k] = by_point[:, k] - ratio[:, None] * by_point[:, side]
            of_log[:, k, k] = by_log[:, k, k] - ratio * by_log[:, side, k]
            by_point, by_log = of_point, of_log
        if not self.mounted_dimensions:  # g = A0 / lm
            by_log = by_log - stress[..., None] * np.eye(2)
        section = mounted_section(stiffness * self.area, lm, self.mounted_dimensions)
        weight = points.weight * np.broadcast_to(section, lm.shape)[:, None]
        load_per_stress = np.abs(points.of_rows(np.einsum("nkk->nk", weight)))
        load, by_point, by_log = (
            points.of_rows(np.einsum("nik,nk...->ni...", weight, values))
            for values in (stress, by_point, by_log)
        )
        return LoadResponse(
            load, by_point, by_log, np.where(load_per_stress > 0.0, load_per_stress, 1.0)
        )

    def solve_mounting(
        self, point: np.ndarray, load: np.ndarray, *, compiled: bool = True
    ) -> np.ndarray:
        """Mounting stretches that balance mounting loads, both (m, 2); NaN without a root."""
        if not self.experiment.is_mounted:
            return np.ones(load.shape)
        # for a law that is fitted once, running in Python is faster than compiling
        solve: Any = solve_balance if compiled else solve_balance.py_func  # type: ignore[attr-defined]
        constants = self.law.constants_from_fit(*point)
        roots = np.full(load.shape, np.nan)
        for m, (px, py) in enumerate(load / self.area):
            ok, x, y, *_ = solve(constants, px, py, self.mounted_dimensions)
            if ok:
                roots[m] = np.exp(x), np.exp(y)
        return roots

    # --- parts of the model, (draws, 1, 2) unless noted ---

    def mounting_stretch(self, values: Any, protocol: str = "") -> np.ndarray:
        """Mounting stretches of a protocol: its own, the shared ones, or 1."""
        if not self.experiment.is_mounted:
            return np.ones((1, 1, 2))
        names = mounting_names("stretch", self.states.get(protocol, protocol))
        if not any(name in values for name in names):
            names = mounting_names("stretch", self.piece)
        lm = [values.get(name) for name in names]
        side = self.experiment.free_side
        if side is not None and lm[1 - side] is not None:
            lm[side] = np.nan
        pair = _pair(*(np.atleast_1d(np.asarray(1.0 if v is None else v))[:, None] for v in lm))
        return pair if side is None else self._with_free_side(values, pair)

    def _with_free_side(self, values: Any, total: np.ndarray) -> np.ndarray:
        side = self.experiment.free_side
        assert side is not None
        return with_free_side(self.law.material(values).cauchy, total, side)

    def section(self, values: Any) -> np.ndarray:
        """Load per kPa in the state that the dimensions refer to, times the stiffness."""
        factors = (self._column(values, name, 1.0) for name in (EDGE_X, EDGE_Y, THICKNESS))
        stiffness = self._column(values, STIFFNESS.name, 1.0)[..., None]
        return stiffness * _pair(*sections(self.area, *factors))

    def _column(self, values: Any, name: str, default: float) -> np.ndarray:
        """A quantity of the piece of shape (draws, 1), or its default of shape (1, 1)."""
        value = values.get(name_of(name, self.piece), default)
        return np.atleast_1d(np.asarray(value, dtype=float))[:, None]

    def unloaded_section(self, values: Any, mounting: np.ndarray) -> np.ndarray:
        """Load per first Piola-Kirchhoff stress at mounting stretches of that shape."""
        # f = A0 P;  A0 = Am lm
        section = self.section(values)
        return section * mounting if self.mounted_dimensions else section

    def offset(self, values: Any) -> np.ndarray:
        """Load offsets z, the readings of the cell without load."""
        return _pair(*(self._column(values, name, 0.0) for name in (OFFSET_X, OFFSET_Y)))

    def load_per_stress(self, values: Any, stretch: Any, protocol: str = "") -> np.ndarray:
        """Load per Cauchy stress at measured stretches (rows, 2); (draws, rows, 2)."""
        lm = self.mounting_stretch(values, protocol)
        return mounted_section(self.section(values), lm, self.mounted_dimensions) / stretch

    # --- loads and readings ---

    def load(self, values: Any, stretch: Any, protocol: str = "") -> np.ndarray:
        """Loads that the material carries at measured stretches (rows, 2)."""
        with np.errstate(over="ignore", invalid="ignore"):
            points = self.experiment.points(np.asarray(stretch, dtype=float))
            lm = self.mounting_stretch(values, protocol)
            total = points.stretch[None] * lm
            if self.experiment.free_side is not None:
                total = self._with_free_side(values, total)
            stress = self.law.material(values).cauchy(total[..., 0], total[..., 1])
            section = mounted_section(self.section(values), lm, self.mounted_dimensions)
            return points.sums(np.stack(stress, axis=-1) * section)

    def mounting_load(self, values: Any, protocol: str = "") -> np.ndarray:
        """Loads of the mounted state, (draws, 2)."""
        return self.load(values, np.ones((1, 2)), protocol)[:, 0]


def _pair(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Columns (draws, 1) in x and y as one array (draws, 1, 2)."""
    return np.stack(np.broadcast_arrays(x, y), axis=-1)
