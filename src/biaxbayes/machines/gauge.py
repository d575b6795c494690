"""Stretches from displacements of grips or marks, or from the distance between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from biaxbayes.errors import InputError

MAX_LENGTH_OVER_EDGE, MIN_LENGTH_OVER_EDGE = 1.5, 0.11
"""Range of lengths between marks or grips over the edge of the tissue: longer ones are impossible,
shorter ones are probably in cm."""


@dataclass(frozen=True)
class Gauge:
    """Lengths in x and y that displacements and distances refer to."""

    given_mm: tuple[float | None, float | None] = (None, None)  # by the user
    edges_mm: tuple[float, float] | None = None  # used in place of a length that is not given
    geometry: str = "unloaded"  # state of the edges
    at: str = ""  # as `gauge_at` of `Choice`

    def from_displacement(
        self, moved_mm: np.ndarray, first_mm: float, k: int, column: str, file: object
    ) -> tuple[np.ndarray, str]:
        """Stretches from a displacement and its first reading in the file, and a note."""
        axis, length = "xy"[k], self.given_mm[k]
        if length is None and self.edges_mm is not None:
            length = self.edges_mm[k]
        if length is None:
            raise InputError(
                f"{column!r} is a displacement and needs the length between the marks or grips at "
                "displacement zero",
                file=file,
                column=column,
                remedy=f"give `gauge_{axis}_mm` (or `edge_x_mm` and `edge_y_mm`, if the edges are "
                "all that is known)",
            )
        if not self.at and abs(first_mm) > 0.01 * length:
            raise InputError(
                f"{column!r} starts at {first_mm:g} mm, not at zero",
                file=file,
                column=column,
                remedy=f"give `gauge_at`: 'zero' if the gauge length of {length:g} mm is that at "
                "displacement zero, 'start' if it is that of the first row",
            )
        origin = first_mm if self.at == "start" else 0.0
        # lambda = 1 + (d - d0) / L0
        stretch = 1.0 + (moved_mm - origin) / length
        formula = "displacement" if origin == 0.0 else f"(displacement - {origin:g} mm)"
        note = f"stretch {axis} is 1 + {formula} / {length:g} mm"
        if self.given_mm[k] is not None:
            return stretch, f"{note}, the stated gauge length{self._doubt(length, k, column, file)}"
        if self.geometry == "mounted":
            return stretch, (
                f"{note}: no gauge length is stated, and the mounted edge is taken for it. If "
                f"marks or grips were another distance apart, give --gauge-{axis}-mm"
            )
        reached = float(stretch.max())
        return stretch, (
            f"{note}: no gauge length is stated, and the unloaded edge is taken for it. The length "
            f"when the test was zeroed is longer by the mounting stretch, so that the strain in "
            f"{axis} is too large by that factor (mounted at 1.05: {reached:.3f} is "
            f"{1.0 + (reached - 1.0) / 1.05:.3f}). Give --gauge-{axis}-mm"
        )

    def from_distance(
        self, length_mm: np.ndarray, first_mm: float, k: int, column: str, file: object
    ) -> tuple[np.ndarray, str]:
        """Stretches from a distance between marks or grips, and a note."""
        if first_mm <= 0.0:
            problem = f"{column!r} starts at {first_mm:g}, which is not a length"
            remedy = f"for a displacement write stretch_{'xy'[k]}={column}:displacement_mm"
            raise InputError(problem, file=file, column=column, remedy=remedy)
        given = self.given_mm[k]
        reference = first_mm if given is None else given
        origin = "its first value" if given is None else "the stated gauge length"
        doubt = self._doubt(reference, k, column, file)
        return length_mm / reference, (
            f"stretch {'xy'[k]} is {column} over {origin}, {reference:g} mm{doubt}"
        )

    def _doubt(self, length_mm: float, k: int, column: str, file: object) -> str:
        """Refuse a length that does not fit on the tissue; return a note on a very short one."""
        axis, edge = "xy"[k], None if self.edges_mm is None else self.edges_mm[k]
        if edge is not None and length_mm > MAX_LENGTH_OVER_EDGE * edge:
            raise InputError(
                f"the length of {length_mm:g} mm in {axis} does not fit on a tissue with an edge "
                f"of {edge:g} mm",
                file=file,
                column=column,
                remedy=f"check that `edge_{axis}_mm` and the column are in the units stated; for a "
                f"distance that includes sutures or grips write "
                f"stretch_{axis}={column}:displacement_mm with `gauge_{axis}_mm` and "
                "`gauge_at=start`",
            )
        if edge is not None and length_mm < MIN_LENGTH_OVER_EDGE * edge:
            return f" (only {length_mm / edge:.0%} of the edge of {edge:g} mm: is it in mm?)"
        return ""
