"""The load law, and the mounted state: the stretch at which the material balances the load.

A load is a force in N or a first Piola-Kirchhoff stress in kPa, as the specimen's file has it. The
section of a direction turns kPa into that unit; edges and thickness may be unknown factors of
what the file states. Dimensions refer to the unloaded or to the mounted state:

    unloaded dimensions:  f_k = A0_k P_k = A0_k s_k / (l_k lm_k)
    mounted dimensions:   f_k = Am_k s_k / l_k              (Am_k = A0_k / lm_k)

with the Cauchy stress s_k at the total stretch l_k lm_k, l_k the measured stretch and lm_k the
mounting stretch. The mounted state is the first point of it:

    unloaded dimensions:  P_k(theta, lm) = p0_k,  that is  s_k(theta, lm) - p0_k lm_k = 0
    mounted dimensions:   s_k(theta, lm) = p0_k

with p0_k the mounting force over the section that the file's dimensions give. Both are solved
by Newton's method in log stretch, where the Jacobian is the symmetric Hessian of the energy
(less the work of the dead load for unloaded dimensions). A solution counts only where that
Jacobian is positive definite, which is where the balance is stable and locally unique.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from biaxbayes.compilation import compiled, inlined
from biaxbayes.laws.materials import STEP, MaterialResponse, cauchy_stress, stress_and_slope

# --- what the load cell reads of a stress: the load law and the sections of a specimen -----------

N_PER_KPA_MM2 = 1e-3


def newtons_per_kPa(edge_x_mm: float, edge_y_mm: float, thickness_mm: float) -> np.ndarray:
    """Force per nominal stress in x and y: the section, edge of the other direction x thickness."""
    return np.array([edge_y_mm, edge_x_mm]) * thickness_mm * N_PER_KPA_MM2


@inlined
def mounted_section(section, mounting, mounted_dimensions):
    """Section of the mounted state in a direction, g of f = g s / l; arguments broadcast."""
    if mounted_dimensions:
        # f = Am s / l
        return section
    # f = A0 s / (l lm)
    return section / mounting


@inlined
def sections(area, edge_x, edge_y, thickness):
    """Load per kPa in (x, y): sections of the file times the factors of its dimensions."""
    # the section in x is edge_y * thickness
    return area[0] * edge_y * thickness, area[1] * edge_x * thickness


# --- the mounted state ---------------------------------------------------------------------------

BRACKET = (0.3, 4.0)
"""Range of mounting stretches that is searched for a root; wider than any realistic one, so that
wide priors are not truncated."""

LOG_LOW, LOG_HIGH = float(np.log(BRACKET[0])), float(np.log(BRACKET[1]))
MAX_NEWTON_STEPS = 40
MAX_STEP = 0.1  # in log stretch; keeps the exponential from overflowing on the way
FREE_SIDE_TOLERANCE = 1e-9  # of the step of the log stretch, whose error is its square
TOLERANCE = 1e-13  # of the log stretch; Newton's last step is quadratically smaller still


@inlined
def balance(constants, px, py, mounted_dimensions, x, y):
    """Residual (2) and Jacobian (3) of the force balance at log stretches (x, y)."""
    sx, sy, jxx, jxy, jyy = stress_and_slope(constants, x, y)
    if mounted_dimensions:
        return sx - px, sy - py, jxx, jxy, jyy
    # s - p0 lm, with d(p0 lm)/d ln lm = p0 lm
    lx, ly = np.exp(x), np.exp(y)
    return sx - px * lx, sy - py * ly, jxx - px * lx, jxy, jyy - py * ly


@compiled(error_model="numpy", nogil=True, forceinline=True)
def solve_balance(constants, px, py, mounted_dimensions):
    """Newton's method from the unloaded state, for a mounting force over the section (kPa).

    (ok, x, y, jxx, jxy, jyy): if there is a stable root inside the bracket, its log mounting
    stretches, and the Jacobian of the balance with respect to these.
    """
    x = y = 0.0
    for _ in range(MAX_NEWTON_STEPS):
        rx, ry, jxx, jxy, jyy = balance(constants, px, py, mounted_dimensions, x, y)
        det = jxx * jyy - jxy * jxy
        if not (np.isfinite(det) and np.isfinite(rx) and np.isfinite(ry)):
            return False, x, y, jxx, jxy, jyy
        if det > 0.0 and jxx > 0.0:
            dx = -(jyy * rx - jxy * ry) / det
            dy = -(jxx * ry - jxy * rx) / det
        else:
            # Not convex here (a soft fibre in compression, a large dead load): go downhill.
            scale = 1.0 / (abs(jxx) + abs(jxy) + abs(jyy) + 1e-300)
            dx, dy = -rx * scale, -ry * scale
        size = max(abs(dx), abs(dy))
        if size > MAX_STEP:
            dx *= MAX_STEP / size
            dy *= MAX_STEP / size
        x += dx
        y += dy
        if not (LOG_LOW < x < LOG_HIGH and LOG_LOW < y < LOG_HIGH):
            return False, x, y, jxx, jxy, jyy
        if size < 1e-7:
            # The error of the next step is below size^2: one more Jacobian and done.
            rx, ry, jxx, jxy, jyy = balance(constants, px, py, mounted_dimensions, x, y)
            det = jxx * jyy - jxy * jxy
            stable = det > 0.0 and jxx > 0.0 and np.isfinite(det)
            return stable, x, y, jxx, jxy, jyy
    return False, x, y, jxx, jxy, jyy


def mounting_stretches(
    material: MaterialResponse, x_kPa: float, y_kPa: float, *, geometry: str = "unloaded"
) -> np.ndarray:
    """Those (2,) that balance a force over the stated section; NaN without a stable root."""
    ok, x, y, *_ = solve_balance(material.constants, x_kPa, y_kPa, geometry == "mounted")
    return np.exp([x, y]) if ok else np.full(2, np.nan)


@inlined
def log_change_of_variables(x, y, jxx, jxy, jyy, mounted_dimensions):
    """Log determinant ln |det d p0 / d lm| from the Jacobian of the balance in log stretch."""
    # unloaded: dP_i/dlm_j = J_ij / (lm_i lm_j);  mounted: ds_i/dlm_j = J_ij / lm_j
    power = 1.0 if mounted_dimensions else 2.0
    return np.log(jxx * jyy - jxy * jxy) - power * (x + y)


# --- strips: a side without load -----------------------------------------------------------------

FREE_SIDE_STEPS = 60


def with_free_side(cauchy: Any, total: np.ndarray, side: int) -> np.ndarray:
    """Total stretches (..., 2) with that of a free side where it is NaN: a stable root of s = 0."""
    loaded = total[..., 1 - side]
    unknown = np.isnan(total[..., side])
    if not unknown.any():
        return total
    y = -0.5 * np.log(loaded)
    done = np.zeros(y.shape, dtype=bool)
    with np.errstate(all="ignore"):
        for _ in range(FREE_SIDE_STEPS):
            across = np.exp(y) * (1.0 + 1j * STEP)
            s = cauchy(*((loaded, across) if side == 1 else (across, loaded)))[side]
            s, slope = np.real(s), np.imag(s) / STEP
            # downhill where the energy is not convex
            step = np.where(slope > 0.0, -s / slope, -np.sign(s) * MAX_STEP)
            y = y + np.clip(step, -MAX_STEP, MAX_STEP)
            done = (np.abs(step) < FREE_SIDE_TOLERANCE) & (slope > 0.0)
            if done.all():
                break
    # one state for many materials becomes one of each
    out = np.broadcast_to(total, (*y.shape, 2)).copy()
    out[..., side] = np.where(unknown, np.where(done, np.exp(y), np.nan), total[..., side])
    return out


@compiled(error_model="numpy", nogil=True)
def solve_free_side(constants, x, y, side):
    """Newton's method for the log stretch of a free side (0, 1), from its value; ok if stable."""
    for _ in range(MAX_NEWTON_STEPS):
        # one complex step gives stress and slope
        if side == 1:
            X, Y = np.exp(2.0 * (x + 0j)), np.exp(2.0 * (y + 1j * STEP))
        else:
            X, Y = np.exp(2.0 * (x + 1j * STEP)), np.exp(2.0 * (y + 0j))
        sx, sy = cauchy_stress(constants, X, Y, 1.0 / (X * Y))
        stress = sy.real if side == 1 else sx.real
        slope = (sy.imag if side == 1 else sx.imag) / STEP
        if not (np.isfinite(stress) and np.isfinite(slope)):
            return False, x, y
        # downhill where the energy is not convex
        step = -stress / slope if slope > 0.0 else -np.sign(stress) * MAX_STEP
        step = min(max(step, -MAX_STEP), MAX_STEP)
        if side == 1:
            y += step
        else:
            x += step
        if abs(step) < FREE_SIDE_TOLERANCE:
            return slope > 0.0, x, y
    return False, x, y


@inlined
def log_change_at_free_side(x, y, jxx, jxy, jyy, mounted_dimensions, side):
    """Log derivative ln |d p0 / d lm| along a strip, from the Jacobian of the balance."""
    # J along the strip with the free side following: det J / J_ff
    j_ff, along = (jyy, x) if side == 1 else (jxx, y)
    power = 1.0 if mounted_dimensions else 2.0
    return np.log((jxx * jyy - jxy * jxy) / j_ff) - power * along
