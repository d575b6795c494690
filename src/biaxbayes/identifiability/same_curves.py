"""Materials that give the same curves: one parameter is moved, the others follow.

The measured curves of one posterior draw are the target. The moved parameter is fixed at a series
of values, and at each the others are fitted to the target's loads, the mounting stretch following
from the target's mounting force. What is left over is how much the curves change.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from biaxbayes.fitting.least_squares import descend
from biaxbayes.fitting.residuals import BalancedMounting, LoadResiduals, Readings
from biaxbayes.options import Settings
from biaxbayes.parameters import mounting_names
from biaxbayes.prediction.draws import mounting_labels
from biaxbayes.specimens.specimen import Specimen

ROWS = 40  # of each protocol, to fit; the reported change is over all rows
STEPS = 12


@dataclass(frozen=True)
class SameCurves:
    """A path of materials along which the curves stay."""

    moved: str  # the parameter that was fixed at each value
    materials: pd.DataFrame  # natural values (kPa, degrees), one row per point
    mounting_stretch: np.ndarray  # (points, 2, m); ones where not inferred
    mounting_load: np.ndarray  # (2, m), of the whole path; zeros where not inferred
    change_kPa: float  # largest change of any stress of all rows from the first material to another
    largest_kPa: float  # largest stress of the first material

    def to_frame(self) -> pd.DataFrame:
        """Materials and mounting stretches, one row per point of the path."""
        table = self.materials.copy()
        for m in range(self.mounting_stretch.shape[2]):
            tail = f"[{m + 1}]" if self.mounting_stretch.shape[2] > 1 else ""
            for k, axis in enumerate("xy"):
                table[f"mounting_stretch_{axis}{tail}"] = self.mounting_stretch[:, k, m]
        return table


def same_curves(
    draw: pd.Series,
    specimen: Specimen,
    settings: Settings,
    moved: str,
    values: tuple[float, float],
    free: tuple[str, ...],
) -> SameCurves:
    """Move one parameter of a draw between two natural values; those in `free` follow."""
    ridge = _Ridge(draw, specimen, settings, moved, free)
    here = ridge.to_fit(float(draw[moved]))
    low, high = (ridge.to_fit(v) for v in values)
    logs = settings.material_law.parameter(moved).logarithmic

    def between(a: float, b: float) -> np.ndarray:
        if logs and min(a, b) > 0.0:
            return np.geomspace(a, b, STEPS)[1:]
        return np.linspace(a, b, STEPS)[1:]

    down = ridge.follow(between(here, low)) if low != here else []
    up = ridge.follow(between(here, high)) if high != here else []
    points = [*reversed(down), ridge.origin, *up]
    loads, stretches = zip(*(ridge.loads(p) for p in points), strict=True)
    stress = np.array(loads) / ridge.full.area[:, None]
    change = np.abs(stress - stress[0]).max(axis=(1, 2))
    natural = [ridge.law.values(p) for p in points]
    table = pd.DataFrame(natural, columns=list(ridge.law.names))
    return SameCurves(
        moved,
        table,
        np.array(stretches),
        ridge.full.mounting_load,
        float(change.max()),
        float(np.abs(stress[0]).max()),
    )


class _Ridge:
    """The materials that come closest to the curves of one draw."""

    def __init__(
        self,
        draw: pd.Series,
        specimen: Specimen,
        settings: Settings,
        moved: str,
        free: tuple[str, ...],
    ) -> None:
        self.law = settings.material_law
        names = self.law.names
        self.moved = names.index(moved)
        self.free = np.array(
            [i for i, n in enumerate(names) if n != moved and n in free], dtype=int
        )
        self.balanced = settings.infers_mounting
        self.values = tuple(float(draw[n]) for n in names)
        self.origin = self.law.point(self.values)
        data = Readings.from_specimen(specimen, shared=settings.shared)
        if self.balanced:
            labels = mounting_labels(draw.to_frame().T, specimen)
            names_of = [mounting_names("force", label) for label in labels]
            load = [[float(draw[pair[k]]) for pair in names_of] for k in range(2)]
            data = replace(data, mounting_load=np.array(load))
        else:
            data = replace(data, mounting_load=np.zeros_like(data.mounting_load))
        self.full = replace(data, load=self._loads(data, self.origin)[0])
        self.few = self.full.thinned(ROWS)

    def to_fit(self, value: float) -> float:
        """A natural value of the moved parameter in the coordinates of the fits."""
        values = list(self.values)
        values[self.moved] = float(value)
        return float(self.law.point(values)[self.moved])

    def loads(self, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Loads (2, n) of every row and mounting stretches (2, m)."""
        return self._loads(self.full, point)

    def _loads(self, data: Readings, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        forward, lm = data.forward(self.law), np.ones_like(data.mounting_load)
        if self.balanced:
            lm = forward.mounting_roots(point, data.mounting_load)
        return forward.response(point, data.stretch, lm[:, data.group]).load, lm

    def follow(self, values: np.ndarray) -> list[np.ndarray]:
        """Fitted materials at a series of values of the moved parameter, until one has no fit."""
        out: list[np.ndarray] = []
        before, here = self.origin, self.origin
        for value in values:
            guess = here[self.free] + 0.9 * (here - before)[self.free]
            fitted = self._fit(value, guess)
            if fitted is None:
                fitted = self._fit(value, here[self.free])
            if fitted is None:
                break
            before, here = here, fitted
            out.append(fitted)
        return out

    def _fit(self, value: float, start: np.ndarray) -> np.ndarray | None:
        point = self.origin.copy()
        point[self.moved] = value
        kind = BalancedMounting if self.balanced else LoadResiduals
        one = np.ones_like(self.few.mounting_load)
        problem = kind(self.few, "load", point, self.free, self.few.peak, one, self.law)
        descent = descend(
            problem,
            start,
            self.law.lower[self.free],
            self.law.upper[self.free],
            steps=200,
            tolerance=1e-10,
        )
        return problem.fit_coordinates(descent.unknowns) if np.isfinite(descent.cost) else None
