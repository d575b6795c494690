"""A homogeneous virtual test: known material, known mounting stretch, known forces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from biaxbayes.laws.materials import MaterialResponse
from biaxbayes.mechanics.mounting import newtons_per_kPa, with_free_side
from biaxbayes.normal_errors import squared_exponential


@dataclass(frozen=True)
class VirtualTest:
    """Noise-free result of a virtual test, one protocol; all of shape (n, 2), x and y."""

    measured: np.ndarray  # stretch relative to the mounted state; the first is one
    total: np.ndarray  # relative to the unloaded state
    force_N: np.ndarray
    piola_kPa: np.ndarray  # nominal (first Piola-Kirchhoff) stress, of the unloaded section


def virtual_test(
    material: MaterialResponse,
    *,
    mounting_stretch: tuple[float, float] = (1.0, 1.0),
    total_stretch: float | tuple[float, float] | None = None,
    measured_stretch: float | tuple[float, float] | None = None,
    ratio: tuple[float, float] = (1.0, 1.0),
    increments: int = 100,
    edge_x_mm: float = 20.0,
    edge_y_mm: float = 20.0,
    thickness_mm: float = 1.0,
    free_side: int | None = None,
) -> VirtualTest:
    """Stretch a homogeneous specimen from its mounted state in equal increments.

    The test ends at ``total_stretch``, relative to the unloaded state, or at ``measured_stretch``,
    relative to the mounted one: give one of them. ``ratio`` scales the stretch beyond the mounted
    state in each direction. The dimensions are unloaded ones. Across a strip, whose ``free_side``
    is a direction, the stretches are those that carry no load, whatever is given.
    """
    if (total_stretch is None) == (measured_stretch is None):
        raise ValueError("give one of total_stretch and measured_stretch")
    if increments < 1:
        raise ValueError("a test needs at least one increment")
    lm = np.array(mounting_stretch, dtype=float)
    given = total_stretch if measured_stretch is None else measured_stretch
    top = np.broadcast_to(np.asarray(given, dtype=float), 2)
    if measured_stretch is None:
        top = top / lm
    # The mounted state is the first point; equal increments of total stretch follow.
    path = np.linspace(0.0, 1.0, increments + 1)[:, None]
    measured = 1.0 + path * (top - 1.0) * np.asarray(ratio, dtype=float)
    total = measured * lm
    if free_side is not None:
        total[:, free_side] = np.nan
        total = with_free_side(material.cauchy, total, free_side)
        measured[:, free_side] = total[:, free_side] / total[0, free_side]
    cauchy = np.column_stack(material.cauchy(total[:, 0], total[:, 1]))
    if free_side is not None:
        cauchy[:, free_side] = 0.0
    piola = cauchy / total
    # f_x = P_x * edge_y * thickness
    force = piola * newtons_per_kPa(edge_x_mm, edge_y_mm, thickness_mm)
    return VirtualTest(measured, total, force, piola)


def simulate_smooth_misfit(
    stretch: np.ndarray, relative_sd: float, rng: np.random.Generator, *, length: float = 0.25
) -> np.ndarray:
    """Relative model error (n,), a Gaussian process over a path (n,) of a length of 1."""
    span = np.ptp(stretch)
    s = (stretch - stretch[0]) / (span if span > 0 else 1.0)
    covariance = squared_exponential((s[:, None] - s[None, :]) / length)
    # The kernel is of low numerical rank; the eigendecomposition is stable where Cholesky is not.
    values, vectors = np.linalg.eigh(covariance)
    # The symmetric root, V sqrt(D) V^T, does not depend on the library's choice of signs.
    root = (vectors * np.sqrt(np.clip(values, 0.0, None))) @ vectors.T
    return relative_sd * root @ rng.standard_normal(stretch.size)
