"""Stretches from displacements of grips or marks, or from the distance between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.tables.question import Question

MAX_LENGTH_OVER_EDGE, MIN_LENGTH_OVER_EDGE = 1.5, 0.11
"""Range of lengths between marks or grips over the edge of the tissue: longer ones are impossible,
shorter ones are probably in cm."""


@dataclass(frozen=True)
class Gauge:
    """Lengths in x and y that displacements and distances refer to."""

    given_mm: tuple[float | None, float | None] = (None, None)  # by the user
    edges_mm: tuple[float | None, float | None] = (None, None)  # which lengths have to fit on
    at: str = ""  # as `gauge_at` of `Choice`
    is_of_tube: bool = False  # lengths are those of the unloaded tube

    @property
    def _reference(self) -> str:
        return "that of the unloaded tube" if self.is_of_tube else "the stated gauge length"

    def _key(self, k: int) -> str:
        """The option or header key that gives a length."""
        of_tube = ("unloaded_outer_diameter_mm", "unloaded_length_mm")
        return of_tube[k] if self.is_of_tube else f"gauge_{'xy'[k]}_mm"

    def from_displacement(
        self, moved_mm: np.ndarray, first_mm: float, k: int, column: str, file: object
    ) -> tuple[np.ndarray, str]:
        """Stretches from a displacement and its first reading in the file, and a note."""
        axis, length, edge = "xy"[k], self.given_mm[k], self.edges_mm[k]
        if length is None:
            gives = {f"{self._key(k)}=MM": "the length between marks or grips"}
            if edge is not None:
                gives[f"{self._key(k)}={edge:g}"] = (
                    "the edge; where that is of the unloaded state and the displacement is zero in "
                    "the mounted state, strains are too large by the mounting stretch"
                )
            problem = f"{column!r} is a displacement and needs its length at displacement zero"
            raise Question(problem, gives, file=file)
        if not self.at and abs(first_mm) > 0.01 * length:
            raise Question(
                f"{column!r} starts at {first_mm:g} mm, not at zero",
                {
                    "gauge_at=zero": f"{length:g} mm is the length at displacement zero",
                    "gauge_at=start": f"{length:g} mm is the length in the first row",
                },
                file=file,
            )
        origin = first_mm if self.at == "start" else 0.0
        # lambda = 1 + (d - d0) / L0
        stretch = 1.0 + (moved_mm - origin) / length
        formula = "displacement" if origin == 0.0 else f"(displacement - {origin:g} mm)"
        note = f"stretch {axis} is 1 + {formula} / {length:g} mm, {self._reference}"
        return stretch, note + self._doubt(length, k, column, file)

    def from_distance(
        self, length_mm: np.ndarray, first_mm: float, k: int, column: str, file: object
    ) -> tuple[np.ndarray, str]:
        """Stretches from a distance between marks or grips, and a note."""
        if first_mm <= 0.0:
            problem = f"{column!r} starts at {first_mm:g}, which is not a length"
            remedy = f"for a displacement write stretch_{'xy'[k]}={column}:displacement_mm"
            raise InputError(problem, file=file, column=column, remedy=remedy)
        given = self.given_mm[k]
        if given is None and self.is_of_tube:
            gives = {f"{self._key(k)}=MM": "the same of the tube without pressure and force"}
            raise Question(f"{column!r} needs the {self._key(k)}", gives, file=file)
        reference = first_mm if given is None else given
        origin = "its first value" if given is None else self._reference
        doubt = self._doubt(first_mm, k, column, file)
        return length_mm / reference, (
            f"stretch {'xy'[k]} is {column} over {origin}, {reference:g} mm{doubt}"
        )

    def _doubt(self, length_mm: float, k: int, column: str, file: object) -> str:
        """Refuse a length that does not fit on the tissue; return a note on a very short one."""
        axis, edge = "xy"[k], self.edges_mm[k]
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
