"""What the compiled density needs of a specimen and its settings: slots, codes and arrays.

A walker's coordinates are spread over *slots*, which hold a number each whether it is sampled,
fixed or tied to another.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

__all__ = ["Problem"]

# Slots: what a walker may hold. Natural values are kept in the same order.
C1, K1, K2, ALPHA, KAPPA, NOISE, GROWTH, EDGE_X, EDGE_Y, THICKNESS, OFFSET_X, OFFSET_Y = range(12)
MOUNTING = 12  # then two a mounted state

# How the mounted state enters.
REFERENCE, FORCE, STRETCH = 0, 1, 2  # lm = 1 | sample p0, root-find lm | sample lm

# Kinds of prior; the last two are stated for exp(x) where the slot holds a logarithm x.
FIXED, NORMAL, UNIFORM, NORMAL_NATURAL, UNIFORM_NATURAL = range(5)

# Why a density is zero; counted for the diagnostics.
INSIDE, OUT_OF_RANGE, NO_ROOT, OVERFLOW = range(4)


class Problem(NamedTuple):
    """Everything the compiled density needs; arrays are float64 unless said.

    Attributes
    ----------
    slot : int64 ndarray, shape (s,)
        Index of each slot in a walker's coordinates, or -1 where the slot is fixed.
    fixed : ndarray, shape (s,)
        Value of a fixed slot, in the slot's own scale (logs for positive quantities).
    tie : int64 ndarray, shape (s,); tie_log_factor : ndarray, shape (s,)
        A tied slot takes the value of another plus a log factor; -1 where free.
    chart : int
        ``coordinates.SHEAR`` or ``ANGULAR`` for slots ALPHA and KAPPA.
    softening : float
        Scale s of the chart SHEAR.
    structural : bool
        Whether slots K1 and K2 hold ln S and ln q rather than ln k1 and ln k2.
    reference : ndarray, shape (3,)
        Squared reference stretch l*.
    prior_kind : int64 ndarray, shape (s,); prior : ndarray, shape (s, 5)
        Kind, and location, scale, lower, upper, log normaliser of each slot's prior. For
        mounting slots the prior is on the mounting stretch.
    mounting_mode, mounted, fibre_switch : int, bool, float
    determinant : bool
        Whether the change of variables from mounting force to mounting stretch counts (always,
        but for the tests that show why).
    reading, reading_sd : ndarray, shape (m, 2)
        Mounting readings; an sd of zero leaves the reading out (exact).
    area : ndarray, shape (2,)
    start : int64 ndarray, shape (p + 1,); mount : int64 ndarray, shape (p,)
        First row of each protocol; the mounted state it belongs to.
    ax, ay, az, ilx, ily : ndarray, shape (n,)
        Squared measured stretches, and reciprocals of the in-plane ones.
    fx, fy : ndarray, shape (n,)
        Readings after the mounted state, in the unit of the file.
    vx, vy : ndarray, shape (n,)
        Mean square scatter of the readings that a row is the mean of; zero for single readings.
    beta : ndarray, shape (p, 2)
        Weight of each curve's log likelihood.
    has_growth : bool
        Whether the sd grows with the load: sd^2 = w^2 + (b f)^2.
    """

    slot: np.ndarray
    fixed: np.ndarray
    tie: np.ndarray
    tie_log_factor: np.ndarray
    chart: int
    softening: float
    structural: bool
    reference: np.ndarray
    prior_kind: np.ndarray
    prior: np.ndarray
    mounting_mode: int
    mounted: bool
    fibre_switch: float
    determinant: bool
    reading: np.ndarray
    reading_sd: np.ndarray
    area: np.ndarray
    start: np.ndarray
    mount: np.ndarray
    ax: np.ndarray
    ay: np.ndarray
    az: np.ndarray
    ilx: np.ndarray
    ily: np.ndarray
    fx: np.ndarray
    fy: np.ndarray
    vx: np.ndarray
    vy: np.ndarray
    beta: np.ndarray
    has_growth: bool
