"""How a sheet is held: linear constraints on its displacement, and the forces that go with them.

A grip is a set of constraints  w_h . u = d_k:  a weighted displacement in direction k = x or y
follows the carriage of that direction. The Lagrange multiplier of a constraint is the force the
grip carries. The tangential displacement is free.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from biaxbayes.fem.sheet import Sheet

__all__ = ["Grips", "Hooks"]


@dataclass(frozen=True)
class Grips:
    """Constraints on a quarter sheet.

    Attributes
    ----------
    weights : ndarray, shape (n, m)
        One column a constraint, over the sheet's free unknowns.
    direction : ndarray, shape (m,)
        0 for x, 1 for y.
    distance_mm : ndarray, shape (2,)
        Unloaded distance of the grips from the centre of the sheet, by direction.
    """

    weights: np.ndarray
    direction: np.ndarray
    distance_mm: np.ndarray

    @property
    def carriage(self) -> np.ndarray:
        """Which constraint follows which carriage, shape (m, 2)."""
        return np.eye(2)[self.direction]

    def edge_force(self, reaction: np.ndarray) -> np.ndarray:
        """Forces (x, y) on whole edges per unit of thickness, kPa mm."""
        # The quarter holds one half of each edge.
        return 2.0 * reaction @ self.carriage


@dataclass(frozen=True)
class Hooks:
    """Hooks pierced through the sheet along each edge.

    The hooks of an edge stand at equal distances from each other and from the corners, on a
    line ``inset_mm`` inside the edge. A hook holds a small round patch of tissue: the mean
    displacement over it, weighted with (1 - r^2/R^2)^2, follows the carriage in the direction of
    the pull, and the hook's force spreads over the patch with the same weight. (A hook that holds
    a mathematical point would carry no force at all on a fine mesh.) The hooks of an edge move
    alike; along the edge each is free to follow the tissue, as on a thread.

    Attributes
    ----------
    count : int
        Hooks an edge.
    inset_mm : float
        Distance of the hooks from the unloaded edge.
    radius_mm : float
        Radius R of the patch; the half-width at half weight is 0.54 R.
    """

    count: int = 5
    inset_mm: float = 1.5
    radius_mm: float = 1.0

    def places(self, sheet: Sheet) -> list[tuple[int, float, float]]:
        """(direction, X, Y) of the hooks on the quarter sheet, mm from its centre."""
        out = []
        for direction in (0, 1):
            along = sheet.edge[1 - direction]
            for j in range(self.count):
                t = along * ((j + 1.0) / (self.count + 1.0) - 0.5)
                if t > -1e-9 * along:
                    across = sheet.edge[direction] / 2.0 - self.inset_mm
                    point = (across, t) if direction == 0 else (t, across)
                    out.append((direction, *point))
        return out

    def on(self, sheet: Sheet) -> Grips:
        """Constraints of the hooks on a sheet.

        Raises
        ------
        ValueError
            If the patches reach over the edge or meet each other along it.
        """
        spacing = sheet.edge.min() / (self.count + 1.0)
        if self.count < 1 or not 0.0 < self.radius_mm <= min(self.inset_mm, spacing / 2.0):
            raise ValueError(
                f"{self.count} hooks of radius {self.radius_mm:g} mm, {self.inset_mm:g} mm inside "
                "the edge, do not fit: patches must stay inside the edge and apart"
            )
        columns, directions = [], []
        for direction, x, y in self.places(sheet):

            def weight(X, Y, x=x, y=y):
                # w = (1 - r^2/R^2)^2 inside the patch
                r2 = ((X - x) ** 2 + (Y - y) ** 2) / self.radius_mm**2
                return np.clip(1.0 - r2, 0.0, None) ** 2

            column = sheet.load_vector(weight, direction)
            # Unit sum over the tissue in the quarter: the constraint is on the mean. (A patch on
            # the symmetry line is half in the quarter, and its multiplier is half the force.)
            columns.append(column / column.sum())
            directions.append(direction)
        return Grips(
            np.column_stack(columns), np.array(directions), sheet.edge / 2.0 - self.inset_mm
        )
