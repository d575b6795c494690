r"""A pressurised tube: x runs around it, y along it; the radial stress is zero outside.

Stretches are total: of the outer surface around, relative to the unloaded tube, and along it. With
the stress-free sector of radii A < B that lacks the angle phi of a circle, c = pi / (pi - phi / 2),

    (ro^2 - r^2) lz c = B^2 - R^2         stretch around lt = c r / R
    p = \int s_t / r dr          pressure, kPa
    f = pi \int (2 s_z - s_t) r dr      force on the closed tube beside that of the pressure, mN

by Gauss points in r, with the stresses of a membrane, s_t - s_r and s_z - s_r.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from scipy.optimize import brentq

from biaxbayes.errors import ReadingError
from biaxbayes.experiments.experiment import (
    EDGE_MM,
    FROM_SCATTER,
    LOAD_SD,
    Column,
    Experiment,
    Key,
    Loads,
    Points,
)
from biaxbayes.mechanics.mounting import N_PER_KPA_MM2

MMHG_PER_KPA = 1.0 / 0.133322387415  # millimetres of mercury per kPa, as in the table of units
GAUSS_POINTS = 5
"""Points through the wall of a tube: for a wall as thick as its inner radius, pressures of GOH
materials differ by less than 1e-4 from those of 40 points."""
STARTS = 400  # radii at which the pressure is computed to find where it is zero
INFLATES = 0.5  # change of a pressure over its largest value, from which a tube is inflated
OF_TUBES = "required of a tube"
NO_RESIDUAL_STRESS = "0, no residual stress"
PRESSURE_COLUMNS = {
    "pressure_kPa": Column("Pressure inside less that outside", "required of inflated tests"),
    "pressure_mmHg": Column(
        "The same in millimetres of mercury",
        "pressure_kPa",
        stands_for=("pressure_kPa",),
        follows=lambda columns, header: columns["pressure_mmHg"] / MMHG_PER_KPA,
    ),
}


@dataclass(frozen=True)
class Tube(Experiment):
    """A pressurised tube; by default one of 10 mm with a wall of 1 mm."""

    outer_radius_mm: float = 5.0
    thickness_mm: float = 1.0
    missing_sector_deg: float = 0.0
    reads_force: bool = True
    points_through_wall: int = GAUSS_POINTS

    name = "tube"
    meaning = "a pressurised tube, whose circumference is x and whose axis is y"
    words = "the inflation of a tube"
    curves = ("pressure", "axial force")
    stretches = ("circumferential stretch", "axial stretch")
    drawing = """<title>Of a tube without pressure: outer diameter, wall thickness, and length
between two marks</title>
<path d="M60 40h170 M60 130h170"/><ellipse cx="60" cy="85" rx="20" ry="45"/>
<ellipse cx="60" cy="85" rx="13" ry="32"/><path d="M230 40a20 45 0 0 1 0 90"/>
<path class="arrow" d="M24 40v90 M19 40h10 M19 130h10 M100 150h100 M100 145v10 M200 145v10
M60 117v30 M55 117h10 M55 130h10"/><path stroke-dasharray="4" d="M100 40v90 M200 40v90"/>
<text x="14" y="85" transform="rotate(-90 14 85)">outer diameter</text>
<text x="60" y="162">thickness</text><text x="158" y="170">length</text>
<text x="150" y="192">x around, y along →</text>"""
    columns: ClassVar[Mapping[str, Column]] = {
        **PRESSURE_COLUMNS,
        "axial_force_N": Column(
            "Of a tube: force of the transducer at its closed end, that is the axial force of the "
            "wall less pressure times lumen",
            "not read",
        ),
        "outer_diameter_mm": Column(
            "Of a tube: outer diameter under load; or `stretch_x`, the same over the unloaded one",
            OF_TUBES,
            stands_for=("stretch_x",),
            needs=("unloaded_outer_diameter_mm",),
            follows=lambda columns, header: (
                columns["outer_diameter_mm"] / header["unloaded_outer_diameter_mm"]
            ),
        ),
        "length_mm": Column(
            "Of a tube: length under load between the marks of `unloaded_length_mm`",
            "stretch_z",
            stands_for=("stretch_y",),
            needs=("unloaded_length_mm",),
            follows=lambda columns, header: columns["length_mm"] / header["unloaded_length_mm"],
        ),
        "stretch_z": Column(
            "Of a tube: axial stretch, relative to the unloaded tube; `stretch_y` means the same",
            OF_TUBES,
            stands_for=("stretch_y",),
        ),
    }
    keys: ClassVar[Mapping[str, Key]] = {
        "unloaded_outer_diameter_mm": Key(
            "Outer diameter of a tube without pressure and force", OF_TUBES, EDGE_MM
        ),
        "unloaded_length_mm": Key(
            "Length of a tube without pressure and force between the same two marks",
            "required with a column length_mm",
            EDGE_MM,
        ),
        "opening_angle_fung_deg": Key(
            "Opening angle of a ring of a tube cut open, between the lines from the middle of its "
            "inner wall to the ends of the inner wall; half the missing sector",
            NO_RESIDUAL_STRESS,
            (0.0, 175.0),
        ),
        "missing_sector_deg": Key(
            "Angle that the opened ring lacks of a full circle, at its centre",
            NO_RESIDUAL_STRESS,
            (0.0, 350.0),
        ),
        "axial_force_noise_N": Key(
            "Standard deviation of one reading of the axial force of a tube", FROM_SCATTER, LOAD_SD
        ),
    }
    is_mounted = False

    @property
    def axes(self) -> tuple[int, ...]:  # type: ignore[override]
        """Pressure, and the axial force where it was read."""
        return (0, 1) if self.reads_force else (0,)

    @property
    def loads(self) -> dict[str, Loads]:  # type: ignore[override]
        """Pressure in x, axial force in y."""
        words = "pressure and axial force" if self.reads_force else "pressure"
        compared = "pressures and axial forces" if self.reads_force else "pressures"
        columns, noise = ("pressure_kPa", "axial_force_N"), "axial_force_noise_N"
        return {"pressure": Loads(columns, ("kPa", "N"), words, compared, (1,), noise)}

    def needed(self, loads: str) -> tuple[str, ...]:
        """Dimensions of the unloaded tube."""
        return ("unloaded_outer_diameter_mm", "thickness_mm")

    def of(self, header: Mapping[str, Any], reads: Sequence[bool]) -> Tube:
        """The tube of a header."""
        # Fung's angle has its vertex on the circle, the missing sector at the centre
        sector = 2.0 * header.get("opening_angle_fung_deg", 0.0)
        return replace(
            self,
            outer_radius_mm=0.5 * header["unloaded_outer_diameter_mm"],
            thickness_mm=header["thickness_mm"],
            missing_sector_deg=header.get("missing_sector_deg", sector),
            reads_force=reads[1],
        )

    def check(self, header: Mapping[str, Any], protocols: Sequence[Any]) -> None:
        """Refuse a tube without a lumen."""
        if {"opening_angle_fung_deg", "missing_sector_deg"} <= set(header):
            problem = "the opening angle is given twice"
            remedy = "keep opening_angle_fung_deg or missing_sector_deg"
            raise ReadingError(problem, argument="missing_sector_deg", remedy=remedy)
        diameter = 2.0 * self.outer_radius_mm
        if not self.sector[0] > 0.0 or not self.thickness_mm < self.outer_radius_mm:
            problem = (
                f"a wall of {self.thickness_mm:g} mm leaves no lumen in an outer diameter of "
                f"{diameter:g} mm"
            )
            remedy = "both are those of the unloaded tube, in mm"
            raise ReadingError(problem, argument="thickness_mm", remedy=remedy)
        for p in protocols:
            for index in np.flatnonzero(np.isnan(self.radii(p.stretch)[0])).tolist():
                around, along = p.stretch[index]
                problem = (
                    f"there is no lumen: at {diameter * around:.4g} mm and an axial stretch of "
                    f"{along:.4g} the wall fills the outer diameter"
                )
                remedy = "check this row, and thickness and diameter of the unloaded tube"
                raise ReadingError(
                    problem, argument="stretch_x", index=index, protocol=p.name, remedy=remedy
                )

    def pulled(self, load: np.ndarray) -> tuple[int, ...]:
        """Around while it is inflated, along at constant pressure."""
        pressure = load[:, 0]
        return (0,) if np.ptp(pressure) > INFLATES * np.abs(pressure).max() else (1,)

    @property
    def sector(self) -> tuple[float, float, float]:
        """(A, B, c) of the stress-free sector, of the unloaded wall's thickness and section."""
        c = np.pi / (np.pi - 0.5 * np.deg2rad(self.missing_sector_deg))
        half = 0.5 * self.thickness_mm
        # equal sections: (pi / c) (B^2 - A^2) = pi (b^2 - a^2), B - A = b - a
        mid = c * (self.outer_radius_mm - half)
        return mid - half, mid + half, float(c)

    def radii(self, stretch: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Inner and outer radius (rows,) of the deformed tube, mm; NaN where there is no lumen."""
        inside, outside, c = self.sector
        outer = stretch[:, 0] * self.outer_radius_mm
        # (ro^2 - ri^2) lz c = B^2 - A^2
        square = outer**2 - (outside**2 - inside**2) / (stretch[:, 1] * c)
        return np.sqrt(np.where(square > 0.0, square, np.nan)), outer

    def points(self, stretch: np.ndarray) -> Points:
        """Gauss points through the wall of each row."""
        _, outside, c = self.sector
        inner, outer = self.radii(stretch)
        place, share = np.polynomial.legendre.leggauss(self.points_through_wall)
        half = 0.5 * (outer - inner)[:, None]
        r, dr = 0.5 * (outer + inner)[:, None] + half * place, half * share
        axial = stretch[:, 1][:, None]
        # R^2 = B^2 - (ro^2 - r^2) lz c
        sector = np.sqrt(outside**2 - (outer[:, None] ** 2 - r**2) * axial * c)
        around = c * r / sector
        weight = np.zeros((*r.shape, 2, 2))
        weight[..., 0, 0] = dr / r
        if self.reads_force:
            weight[..., 1, 0] = -N_PER_KPA_MM2 * np.pi * r * dr
            weight[..., 1, 1] = 2.0 * N_PER_KPA_MM2 * np.pi * r * dr
        count = self.points_through_wall
        state = np.stack([around, np.broadcast_to(axial, r.shape)], axis=-1).reshape(-1, 2)
        return Points(state, weight.reshape(-1, 2, 2), np.repeat(np.arange(len(stretch)), count))

    def stresses(self, stretch: np.ndarray, load: np.ndarray) -> np.ndarray:
        """Mean stresses of the wall from pressure and force."""
        inner, outer = self.radii(stretch)
        mid, wall = 0.5 * (inner + outer), outer - inner
        # s_t = p r / h,   s_z = f / (2 pi r h) + s_t / 2
        around = load[:, 0] * mid / wall
        along = 0.5 * around
        if self.reads_force:
            along = load[:, 1] / (2.0 * np.pi * mid * wall * N_PER_KPA_MM2) + along
        return np.column_stack([around, along])

    def paths(
        self,
        largest_stretch: float,
        along: Sequence[float],
        increments: int,
        readings: Callable[[np.ndarray], np.ndarray],
    ) -> dict[str, np.ndarray]:
        """From no pressure to the largest stretch around, in equal steps of the diameter."""
        paths = {}
        for axial in along:

            def state(around: Any, axial: float = axial) -> np.ndarray:
                return np.column_stack([around, np.full(np.size(around), axial)])

            inner, outer = self.radii(state(largest_stretch))
            # the wall's section stays, so that without a lumen ro^2 is that of a solid rod
            solid = np.sqrt(outer**2 - inner**2)[0] / self.outer_radius_mm
            grid = np.linspace(solid, largest_stretch, STARTS)[1:]
            below = np.flatnonzero(~(readings(state(grid))[:, 0] > 0.0))
            if not np.isfinite(solid) or not below.size or below[-1] == grid.size - 1:
                raise ValueError(f"no pressure holds the tube at an axial stretch of {axial:g}")
            bracket = grid[below[-1] : below[-1] + 2]
            start = brentq(lambda r, at=state: float(readings(at(r))[0, 0]), *bracket)
            paths[f"{axial:g}"] = state(
                np.linspace(start, largest_stretch, increments + 1).round(6)
            )
        return paths

    def size(self, header: Mapping[str, Any]) -> str:
        """Outer diameter and wall."""
        return f"outer diameter {2.0 * self.outer_radius_mm:g} mm, wall {self.thickness_mm:g} mm"

    def methods(self, header: Mapping[str, Any], paths: str) -> str:
        """The tube, its residual stress and what was read."""
        angle = self.missing_sector_deg
        residual = f", missing sector {angle:g} degrees" if angle else "; no residual stress"
        read = "pressure and axial force were" if self.reads_force else "the pressure was"
        return (
            f"A tube (unloaded {self.size(header)}{residual}) was pressurised on {paths}: at "
            f"measured outer diameters and axial stretches {read} read. Stresses were integrated "
            "through the thick wall."
        )
