r"""A sheet inflated through a circular clamp, read at its pole, whatever it does elsewhere.

    p rho / (2 T) = (s_x + s_y) / (2 lx ly)      tension over the unloaded thickness T, kPa

by Laplace's law for a membrane of thickness T / (lx ly), with the pressure p, the stretches of the
pole and the radius rho of its mean curvature; curvatures that differ make an error of second order.
The spherical cap of a height is more curved than the pole, see docs/specimen-file.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from biaxbayes.experiments.experiment import Column, Experiment, Loads, Points
from biaxbayes.experiments.tube import PRESSURE_COLUMNS

TENSION = "pole_tension_kPa"
LOADS = {
    "tension": Loads((TENSION, ""), ("kPa", "kPa"), "tension at the pole", "tensions at the pole")
}


class Bulge(Experiment):
    """A sheet inflated through a circular clamp."""

    name = "bulge"
    meaning = "a sheet inflated through a circular clamp, whose stretches are those of its pole"
    words = "a bulge test"
    curves = ("tension", "")
    stretches = ("stretch of the pole in x", "stretch of the pole in y")
    drawing = """<title>Of a sheet that is inflated through a circular clamp: radius of curvature
at its pole under pressure, and thickness of the unloaded sheet</title>
<path d="M20 140h40v12h-40z M240 140h40v12h-40z M60 140a104 104 0 0 1 180 0
M60 146a108 108 0 0 1 180 0"/>
<path class="pull" d="M110 140v-16l-4 6m4 -6l4 6M190 140v-16l-4 6m4 -6l4 6"/>
<path class="arrow" d="M150 191v-102l-4 6m4 -6l4 6M204 92l14 -20"/>
<text class="start" x="156" y="180">radius_mm</text><text x="150" y="76">pole</text>
<text x="222" y="64">thickness</text><text x="100" y="160">pressure</text>"""
    loads = LOADS
    columns: ClassVar = {
        **PRESSURE_COLUMNS,
        "radius_mm": Column(
            "Of a bulge: radius of curvature at the pole (one over the mean of the curvatures in x "
            "and y)",
            "required of a bulge",
            stands_for=(TENSION,),
            needs=("thickness_mm", "pressure_kPa"),
            follows=lambda columns, header: (
                columns["pressure_kPa"] * columns["radius_mm"] / (2.0 * header["thickness_mm"])
            ),
        ),
        TENSION: Column(
            "Of a bulge: pressure times that radius over twice the thickness", "radius_mm"
        ),
    }
    axes = (0,)
    is_mounted = False

    def needed(self, loads: str) -> tuple[str, ...]:
        """The thickness of the unloaded sheet."""
        return ("thickness_mm",)

    def points(self, stretch: np.ndarray) -> Points:
        """The pole."""
        weight = np.zeros((len(stretch), 2, 2))
        # q = (s_x + s_y) / (2 lx ly)
        weight[:, 0, :] = 0.5 / stretch.prod(axis=1)[:, None]
        return Points(stretch, weight, np.arange(len(stretch)))

    def stresses(self, stretch: np.ndarray, load: np.ndarray) -> np.ndarray:
        """The mean stress of the pole, in both directions."""
        return np.repeat(load[:, :1] * stretch.prod(axis=1)[:, None], 2, axis=1)

    def paths(
        self, largest_stretch: float, along: Sequence[float], increments: int, readings: Any
    ) -> dict[str, np.ndarray]:
        """Equal stretches in x and y."""
        if tuple(along) != (1.0,):
            raise ValueError("no stretch is held in a bulge test")
        stretch = np.linspace(1.0, largest_stretch, increments + 1)
        return {"1": np.column_stack([stretch, stretch]).round(12)}

    def size(self, header: Mapping[str, Any]) -> str:
        """The thickness."""
        return f"{header['thickness_mm']:g} mm thick"

    def methods(self, header: Mapping[str, Any], paths: str) -> str:
        """How the tension was read."""
        return (
            f"A sheet ({header['thickness_mm']:g} mm thick, unloaded) was inflated through a "
            f"circular clamp on {paths}. Pressure and radius of curvature gave the tension of the "
            "pole by Laplace's law, at the stretches measured there."
        )
