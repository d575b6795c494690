"""A virtual biaxial test in finite elements: mounting, then stretching from the mounted state.

Unknowns are the displacement u, the forces r of the grips and the travel d of the two carriages:

    f_int(u) - W r = 0             equilibrium
    W^T u - S d    = 0             every grip follows its carriage
    M u - m        = 0             the markers reach the wanted stretch,  or  d is given

Newton's method with the consistent tangent solves all three together. The stretch is measured as
a video extensometer does: from four markers at the corners of a central square. With markers as
control the test is strain-controlled, like the experiments of Section 2.4 of the method paper.

Fibres without a switch soften in compression, and the free corners of a hooked sheet are lightly
compressed, so the energy need not be convex there: steps are damped until the residual falls
(line search), and an increment that fails is halved.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse.linalg import splu

from biaxbayes.errors import NotConverged
from biaxbayes.fem.grips import Grips
from biaxbayes.fem.sheet import Sheet
from biaxbayes.laws.goh import GOH

__all__ = ["SheetTest", "SheetTester"]

GAUGE = 0.25  # distance of the markers as a share of the edge
TOLERANCE = 1e-10  # of the residual, relative to the forces
MAX_ITERATIONS = 20
MAX_HALVINGS = 12


@dataclass(frozen=True)
class State:
    """Equilibrium: free displacement (mm), grip reactions (kPa mm), carriage travel (mm)."""

    u: np.ndarray
    reaction: np.ndarray
    travel: np.ndarray
    residuals: tuple[float, ...] = field(default=(), compare=False)

    def extrapolated(self, before: State, factor: float) -> State:
        """Linear continuation of the path from ``before`` through this state."""
        return State(
            self.u + factor * (self.u - before.u),
            self.reaction + factor * (self.reaction - before.reaction),
            self.travel + factor * (self.travel - before.travel),
        )


@dataclass(frozen=True)
class SheetTest:
    """Error-free record of a finite-element test, one protocol.

    Attributes
    ----------
    states : tuple of State
        Equilibrium of every row.
    measured_x, measured_y : ndarray, shape (n,)
        Stretch between the markers, relative to the mounted state; the first row is 1.
    total_x, total_y : ndarray, shape (n,)
        The same relative to the unloaded state. The first row is the true mounting stretch.
    grip_x, grip_y : ndarray, shape (n,)
        Stretch between opposite grips, relative to the unloaded state.
    force_x_N, force_y_N : ndarray, shape (n,)
        Sum over the grips of an edge.
    """

    states: tuple[State, ...]
    measured_x: np.ndarray
    measured_y: np.ndarray
    total_x: np.ndarray
    total_y: np.ndarray
    grip_x: np.ndarray
    grip_y: np.ndarray
    force_x_N: np.ndarray
    force_y_N: np.ndarray


class SheetTester:
    """A sheet of known material in its grips.

    Parameters
    ----------
    material : GOH
    sheet : Sheet
    grips : Grips
    thickness_mm : float
        Unloaded thickness.
    control : {"markers", "grips"}
        Whether the stretches that are asked for are those between the markers (strain control)
        or those between opposite grips.
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
        if control not in ("markers", "grips"):
            raise ValueError("control must be 'markers' or 'grips'")
        self.material, self.sheet, self.grips = material, sheet, grips
        self.thickness_mm, self.control = thickness_mm, control
        half = 0.5 * GAUGE * sheet.edge
        # stretch_k = 1 + u_k(marker) / X_k(marker)
        self.markers = sheet.displacement_at(*half) / half[:, None]
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

    def grip_stretch(self, state: State) -> np.ndarray:
        """Total stretch (x, y) between opposite grips."""
        return 1.0 + state.travel / self.grips.distance_mm

    def force_N(self, state: State) -> np.ndarray:
        """Forces (x, y) on whole edges: the sum over their grips."""
        # kPa mm * mm = 1e-3 N
        return self.grips.edge_force(state.reaction) * self.thickness_mm * 1e-3

    def mount(self, stretch: tuple[float, float], *, increments: int = 10) -> State:
        """First step: from rest to the mounting stretch in equal increments."""
        return self.walk(self.unloaded, np.ones(2), np.asarray(stretch, float), increments)[-1]

    def stretch_to(
        self, mounted: State, top: tuple[float, float], *, increments: int = 100
    ) -> SheetTest:
        """Second step: from the mounted state to a measured stretch in equal increments.

        Parameters
        ----------
        mounted : State
            From :meth:`mount`.
        top : (float, float)
            Largest controlled stretch (markers or grips) relative to the mounted state.
        increments : int

        Returns
        -------
        SheetTest
        """
        stretch = self.stretch if self.control == "markers" else self.grip_stretch
        start = stretch(mounted)
        states = self.walk(mounted, start, start * np.asarray(top, dtype=float), increments)
        states = (mounted, *states)
        total = np.array([self.stretch(s) for s in states])
        grip = np.array([self.grip_stretch(s) for s in states])
        force = np.array([self.force_N(s) for s in states])
        return SheetTest(states, *np.hstack([total / total[0], total, grip, force]).T)

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
                guess = (
                    state if before is None else state.extrapolated(before, (trial - reached) / gap)
                )
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

    def equilibrium(self, guess: State, stretch: np.ndarray) -> State:
        """Newton's method for one controlled stretch.

        Parameters
        ----------
        guess : State
        stretch : ndarray, shape (2,)

        Returns
        -------
        State
            With the norms of the residual, one an iteration.

        Raises
        ------
        NotConverged
            If the residual does not fall to the tolerance.
        """
        # A trial step may overflow on its way to being rejected.
        with np.errstate(all="ignore"):
            return self._newton(guess, stretch)

    def _newton(self, state: State, stretch: np.ndarray) -> State:
        force, stiffness, area_ratio = self.sheet.internal_force(self.material, state.u)
        residual, norm = self._residual(state, force, stretch)
        norms = [norm]
        for _ in range(MAX_ITERATIONS):
            # kPa mm; the second term is a grip force that nobody would notice
            enough = TOLERANCE * (float(np.linalg.norm(state.reaction)) + 1e-4 * self.scale)
            if area_ratio > 0.0 and norm <= enough:
                return replace(state, residuals=tuple(norms))
            if not (area_ratio > 0.0 and np.isfinite(norm)):
                break
            du, dr, dd = self._newton_step(stiffness, residual)
            share = 1.0
            while share > 1e-3:
                trial = State(
                    state.u + share * du, state.reaction + share * dr, state.travel + share * dd
                )
                force, stiffness, area_ratio = self.sheet.internal_force(self.material, trial.u)
                residual, norm = self._residual(trial, force, stretch)
                # nan compares false, so a wild step is shortened as well
                if area_ratio > 0.0 and norm <= max((1.0 - 1e-4 * share) * norms[-1], enough):
                    break
                share *= 0.5
            else:
                break
            state = trial
            norms.append(norm)
        raise NotConverged(f"no equilibrium found at stretch {stretch[0]:.4g}, {stretch[1]:.4g}")

    def _residual(
        self, state: State, force: np.ndarray, stretch: np.ndarray
    ) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], float]:
        """Residuals of equilibrium, grips and control, and the norm of all three."""
        W, S = self.grips.weights, self.grips.carriage
        equilibrium = force - W @ state.reaction
        follow = W.T @ state.u - S @ state.travel
        if self.control == "markers":
            control = self.markers @ state.u - (stretch - 1.0)
        else:
            control = state.travel / self.grips.distance_mm - (stretch - 1.0)
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
            solve = splu(
                stiffness, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}
            ).solve
        except RuntimeError:  # exactly singular
            raise NotConverged("the stiffness of the sheet is singular") from None
        # K du = W dr - equilibrium
        solution = solve(np.column_stack([W, -equilibrium]))
        V, a = solution[:, :-1], solution[:, -1]
        if self.control == "markers":
            by_reaction, by_travel, offset = self.markers @ V, np.zeros((2, 2)), self.markers @ a
        else:
            by_reaction, offset = np.zeros((2, W.shape[1])), np.zeros(2)
            by_travel = np.diag(1.0 / self.grips.distance_mm)
        # [W^T V  -S] [dr]     [follow + W^T a]
        # [M V     D] [dd] = - [control + M a ]
        matrix = np.block([[W.T @ V, -S], [by_reaction, by_travel]])
        try:
            small = np.linalg.solve(matrix, -np.concatenate([follow + W.T @ a, control + offset]))
        except np.linalg.LinAlgError:
            raise NotConverged("the stiffness of the held sheet is singular") from None
        dr, dd = small[:-2], small[-2:]
        return a + V @ dr, dr, dd
