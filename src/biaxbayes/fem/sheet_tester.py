"""A virtual biaxial test in finite elements: how a sheet is gripped, mounted and stretched.

A grip is a constraint  w_h . u = d_k:  a weighted displacement in direction k = x or y follows the
carriage of that direction; its Lagrange multiplier is the force. Unknowns are the displacement u,
the forces r of the grips and the travel d of the two carriages, solved together by Newton's method:

    f_int(u) - W r = 0             equilibrium
    W^T u - S d    = 0             every grip follows its carriage
    M u + D d - m  = 0             the markers (M) or the grips (D) reach the wanted stretch

Fibres without a switch soften in compression, and free corners are lightly compressed, so the
energy need not be convex: steps are damped (line search), and an increment that fails is halved.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse.linalg import splu

from biaxbayes.errors import NotConverged
from biaxbayes.fem.sheet import Sheet
from biaxbayes.laws.goh import GOH
from biaxbayes.mechanics.mounting import N_PER_KPA_MM2

# --- how a sheet is gripped ----------------------------------------------------------------------


@dataclass(frozen=True)
class Grips:
    """Constraints on a quarter sheet."""

    weights: np.ndarray  # (n, m), one column a constraint, over the sheet's free unknowns
    direction: np.ndarray  # (m,): 0 for x, 1 for y
    distance_mm: np.ndarray  # (2,), unloaded, of the grips from the centre, by direction

    @property
    def carriage(self) -> np.ndarray:
        """Which constraint follows which carriage, shape (m, 2)."""
        return np.eye(2)[self.direction]


@dataclass(frozen=True)
class Hooks:
    """Hooks along each edge, pierced through the sheet; along the edge each is free, on a thread.

    The mean displacement of a round patch, weighted with (1 - r^2/R^2)^2, follows the carriage: a
    point would carry no force on a fine mesh.
    """

    count: int = 5  # per edge
    inset_mm: float = 1.5  # from the unloaded edge
    radius_mm: float = 1.0  # R of the patch; the half-width at half weight is 0.54 R
    spacing_mm: float | None = None  # unloaded; None: equal from each other and the corners

    def spacing(self, along_mm: float) -> float:
        """Distance between neighbours on an edge of that length, mm."""
        return self.spacing_mm or along_mm / (self.count + 1.0)

    def places(self, sheet: Sheet) -> list[tuple[int, float, float]]:
        """(direction, X, Y) of the hooks on the quarter sheet, mm from its centre."""
        out = []
        for direction in (0, 1):
            along = sheet.edge[1 - direction]
            across = sheet.edge[direction] / 2.0 - self.inset_mm
            for j in range(self.count):
                t = (j - 0.5 * (self.count - 1.0)) * self.spacing(along)
                if t > -1e-9 * along:
                    out.append((direction, *((across, t) if direction == 0 else (t, across))))
        return out

    def on(self, sheet: Sheet) -> Grips:
        """Constraints of the hooks; ValueError if patches reach over the edge or each other."""
        shortest = sheet.edge.min()
        spacing = self.spacing(shortest)
        reach = 0.5 * (self.count - 1.0) * spacing + self.radius_mm
        inside = self.inset_mm < shortest / 2.0 and reach <= shortest / 2.0 * (1.0 + 1e-9)
        apart = 0.0 < self.radius_mm <= min(self.inset_mm, spacing / 2.0)
        if not (self.count >= 1 and inside and apart):
            raise ValueError(
                f"{self.count} hooks of radius {self.radius_mm:g} mm, {spacing:.3g} mm apart, "
                f"{self.inset_mm:g} mm inside the edge, do not fit: patches must stay inside the "
                "edge and apart"
            )
        columns = []
        places = self.places(sheet)
        for direction, x, y in places:

            def weight(X, Y, x=x, y=y):
                # w = (1 - r^2/R^2)^2 inside the patch
                r2 = ((X - x) ** 2 + (Y - y) ** 2) / self.radius_mm**2
                return np.clip(1.0 - r2, 0.0, None) ** 2

            column = sheet.load_vector(weight, direction)
            # Unit sum over the tissue in the quarter: the constraint is on the mean. (A patch on
            # the symmetry line is half in the quarter, and its multiplier is half the force.)
            columns.append(column / column.sum())
        directions = np.array([direction for direction, _, _ in places])
        return Grips(np.column_stack(columns), directions, sheet.edge / 2.0 - self.inset_mm)


# --- mounting, then stretching from the mounted state --------------------------------------------

GAUGE = 0.25  # distance of the markers as a fraction of the edge
TOLERANCE = 1e-10  # of the residual, relative to the forces
MAX_ITERATIONS = 20
MAX_HALVINGS = 12


class State(NamedTuple):
    """Equilibrium: free displacement (mm), grip reactions (kPa mm), carriage travel (mm)."""

    u: np.ndarray
    reaction: np.ndarray
    travel: np.ndarray

    def moved(self, step: Iterable[np.ndarray], share: float) -> State:
        """The state a share of a step further."""
        return State(*(v + share * d for v, d in zip(self, step, strict=True)))


@dataclass(frozen=True)
class SheetTest:
    """Error-free record of a finite-element test, one protocol of n rows."""

    states: tuple[State, ...]  # equilibrium of every row
    measured: np.ndarray  # (n, 2), between the markers relative to the mounted state; starts at 1
    total: np.ndarray  # (n, 2), relative to the unloaded state; starts at the mounting stretch
    grip: np.ndarray  # (n, 2), between opposite grips, relative to the unloaded state
    force_N: np.ndarray  # (n, 2), sum over the grips of an edge


class SheetTester:
    """A sheet of known material and unloaded thickness in its grips.

    Prescribed stretches are those between the markers (strain control) or opposite grips.
    """

    def __init__(
        self,
        material: GOH,
        sheet: Sheet,
        grips: Grips,
        *,
        thickness_mm: float = 1.0,
        control: str = "markers",
    ) -> None:
        self.material, self.sheet, self.grips = material, sheet, grips
        self.thickness_mm = thickness_mm
        half = 0.5 * GAUGE * sheet.edge
        # stretch_k = 1 + u_k(marker) / X_k(marker)
        self.markers = sheet.displacement_at(*half) / half[:, None]
        # controlled stretch = 1 + M u + D d
        by_markers, travel = control == "markers", np.diag(1.0 / grips.distance_mm)
        self.control_by_u = self.markers if by_markers else np.zeros_like(self.markers)
        self.control_by_travel = np.zeros((2, 2)) if by_markers else travel
        # Stiffness that makes a missed constraint (mm) comparable to a residual force (kPa mm).
        self.scale = 2.0 * material.C1_kPa + 4.0 * material.k1_kPa

    @property
    def unloaded(self) -> State:
        """The sheet at rest."""
        free, count = self.grips.weights.shape
        return State(np.zeros(free), np.zeros(count), np.zeros(2))

    def stretch(self, state: State) -> np.ndarray:
        """Total stretch (x, y) between the markers."""
        return 1.0 + self.markers @ state.u

    def controlled_stretch(self, state: State) -> np.ndarray:
        """The stretch (x, y) that is prescribed."""
        return 1.0 + self.control_by_u @ state.u + self.control_by_travel @ state.travel

    def force_N(self, state: State) -> np.ndarray:
        """Forces (x, y) on whole edges: the sum over their grips."""
        # the quarter of a sheet 1 mm thick holds one half of each edge, kPa mm^2
        return 2.0 * state.reaction @ self.grips.carriage * self.thickness_mm * N_PER_KPA_MM2

    def mount(self, stretch: tuple[float, float], *, increments: int = 10) -> State:
        """First step: from rest to the mounting stretch in equal increments."""
        return self.walk(self.unloaded, np.ones(2), np.asarray(stretch, float), increments)[-1]

    def stretch_to(
        self, mounted: State, top: tuple[float, float], *, increments: int = 100
    ) -> SheetTest:
        """Second step: from the mounted state by a controlled stretch in equal increments."""
        start = self.controlled_stretch(mounted)
        end = start * np.asarray(top, dtype=float)
        states = (mounted, *self.walk(mounted, start, end, increments))
        total = np.array([self.stretch(s) for s in states])
        grip = 1.0 + np.array([s.travel for s in states]) / self.grips.distance_mm
        force = np.array([self.force_N(s) for s in states])
        return SheetTest(states, total / total[0], total, grip, force)

    def walk(
        self, state: State, start: np.ndarray, end: np.ndarray, increments: int
    ) -> tuple[State, ...]:
        """Equilibria at equal increments of the controlled stretch, without the first."""
        out, before, reached, gap = [], None, 0.0, 0.0
        for j in range(1, increments + 1):
            goal = j / increments
            step, halvings = goal - reached, 0
            while reached < goal - 1e-12:
                trial = min(reached + step, goal)
                guess = state
                if before is not None:  # linear continuation of the path
                    last = (a - b for a, b in zip(state, before, strict=True))
                    guess = state.moved(last, (trial - reached) / gap)
                try:
                    new = self.equilibrium(guess, start + trial * (end - start))
                except NotConverged:
                    halvings += 1
                    if halvings > MAX_HALVINGS:
                        raise
                    step *= 0.5
                    continue
                before, state, gap, reached = state, new, trial - reached, trial
            out.append(state)
        return tuple(out)

    @np.errstate(all="ignore")  # a trial step may overflow on its way to being rejected
    def equilibrium(self, state: State, stretch: np.ndarray) -> State:
        """Newton's method for a controlled stretch (2,), from a guess; NotConverged if it fails."""
        force, stiffness, area_ratio = self.sheet.internal_force(self.material, state.u)
        residual, norm = self._residual(state, force, stretch)
        for _ in range(MAX_ITERATIONS):
            # kPa mm; the second term is a grip force that nobody would notice
            enough = TOLERANCE * (float(np.linalg.norm(state.reaction)) + 1e-4 * self.scale)
            if area_ratio > 0.0 and norm <= enough:
                return state
            if not (area_ratio > 0.0 and np.isfinite(norm)):
                break
            step = self._newton_step(stiffness, residual)
            before, share = norm, 1.0
            while share > 1e-3:
                trial = state.moved(step, share)
                force, stiffness, area_ratio = self.sheet.internal_force(self.material, trial.u)
                residual, norm = self._residual(trial, force, stretch)
                # nan compares false, so a wild step is shortened as well
                if area_ratio > 0.0 and norm <= max((1.0 - 1e-4 * share) * before, enough):
                    break
                share *= 0.5
            else:
                break
            state = trial
        raise NotConverged(f"no equilibrium at stretch {stretch[0]:.4g}, {stretch[1]:.4g}")

    def _residual(
        self, state: State, force: np.ndarray, stretch: np.ndarray
    ) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], float]:
        """Residuals of equilibrium, grips and control, and the norm of all three."""
        W, S = self.grips.weights, self.grips.carriage
        equilibrium = force - W @ state.reaction
        follow = W.T @ state.u - S @ state.travel
        control = self.controlled_stretch(state) - stretch
        size = self.sheet.edge.min()
        norm = np.sqrt(
            equilibrium @ equilibrium
            + self.scale**2 * (follow @ follow + size**2 * (control @ control))
        )
        return (equilibrium, follow, control), float(norm)

    def _newton_step(
        self, stiffness, residual: tuple[np.ndarray, np.ndarray, np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Correction (u, reaction, travel): K is factorised once, the rest is a small system."""
        equilibrium, follow, control = residual
        W, S = self.grips.weights, self.grips.carriage
        try:
            factors = splu(stiffness, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        except RuntimeError:  # exactly singular
            raise NotConverged("the stiffness of the sheet is singular") from None
        # K du = W dr - equilibrium
        solution = factors.solve(np.column_stack([W, -equilibrium]))
        V, a = solution[:, :-1], solution[:, -1]
        # [W^T V  -S] [dr]     [follow + W^T a]
        # [M V     D] [dd] = - [control + M a ]
        M, D = self.control_by_u, self.control_by_travel
        matrix = np.block([[W.T @ V, -S], [M @ V, D]])
        try:
            small = np.linalg.solve(matrix, -np.concatenate([follow + W.T @ a, control + M @ a]))
        except np.linalg.LinAlgError:
            raise NotConverged("the stiffness of the gripped sheet is singular") from None
        dr, dd = small[:-2], small[-2:]
        return a + V @ dr, dr, dd
