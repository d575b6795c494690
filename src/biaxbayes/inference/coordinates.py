r"""Coordinates in which the posterior is easy to walk.

Data pin the ratio of the in-plane structure tensor, the fibre stress and the exponent at the
largest stretch far better than they pin k1, k2 and kappa one by one. The sampler therefore works
in

    ln C1,   ln S,   ln q,   d = ln(Hx / Hy),   v,   ...

with q = k2 E*^2 and S = k1 E* exp(q) sqrt(gx gy), gk = Hk lk*^2 - Hz lz*^2, at one fixed
reference stretch l* a specimen. v stands for h = (1 - 3 kappa) sin 2 alpha, twice the in-plane
shear component of each fibre family's structure tensor: what an axis-aligned test does not see.
With R = 1 - 3 kappa and X = Hx - Hy = R cos 2 alpha, the pair (X, h) are Cartesian coordinates of
the polar pair (R, 2 alpha). At a given d, h runs from 0, where alpha is 0 or 90 degrees, to
h_max = 2 sqrt(t (1 - t)), t = Hx / (Hx + Hy), where kappa is 0;

    v = asinh(h / s) / asinh(h_max / s)

runs from 0 to 1. The density is regular on both edges, and both are straight in v, which the
independence move folds its proposals at. The softening s, a constant of the specimen near its
|X|, makes the density 1/R of the polar coordinates flat in v, however close to isotropy (R = 0) the
tissue is. One chart thus serves every specimen; (alpha, kappa) themselves are used where one of
the two is fixed.
"""

from __future__ import annotations

import numpy as np
from numba.extending import register_jitable

__all__ = [
    "ANGULAR",
    "DEFAULT_SOFTENING",
    "SHEAR",
    "angles_from_shear",
    "reference_state",
    "shear_from_angles",
    "softening_of",
]

SHEAR = 0
"""Chart (d, v)."""
ANGULAR = 1
"""Chart (alpha, kappa)."""
DEFAULT_SOFTENING = 0.3


@register_jitable
def angles_from_shear(d, v, softening):
    """(alpha, kappa, ln |d(alpha, kappa)/d(d, v)|); ``alpha`` in radians."""
    t = 1.0 / (1.0 + np.exp(-d))
    tt = 1.0 / ((1.0 + np.exp(-d)) * (1.0 + np.exp(d)))  # t (1 - t), without cancellation
    h_max = 2.0 * np.sqrt(tt)
    span = np.arcsinh(h_max / softening)
    h = softening * np.sinh(v * span)
    # X = Hx - Hy = g (2 + R) with g = (2 t - 1) / 3, since Hx + Hy = 1 - kappa = (2 + R) / 3
    g = (2.0 * t - 1.0) / 3.0
    g2 = g * g
    # R^2 = X^2 + h^2:  (1 - g^2) R^2 - 4 g^2 R - 4 g^2 - h^2 = 0
    R = (2.0 * g2 + np.sqrt(4.0 * g2 * g2 + (1.0 - g2) * (4.0 * g2 + h * h))) / (1.0 - g2)
    R = min(R, 1.0)
    X = g * (2.0 + R)
    # d kappa d alpha = dX dh / (6 R);  dX/dd = (2 + R) R / (R - g X) * (2/3) t (1 - t) at fixed h
    # dh/dv = span sqrt(h^2 + s^2) at fixed d
    slope = span * np.sqrt(h * h + softening * softening)
    log_jacobian = np.log((2.0 + R) * tt * slope / (9.0 * (R - g * X)))
    return 0.5 * np.arctan2(h, X), (1.0 - R) / 3.0, log_jacobian


def softening_of(alpha, kappa):
    """Softening for tissue around these angles (radians) and dispersions: |Hx - Hy|, not tiny."""
    X = (1.0 - 3.0 * np.asarray(kappa)) * np.cos(2.0 * np.asarray(alpha))
    return float(np.clip(np.median(np.abs(X)), 0.02, 1.0))


def shear_from_angles(alpha, kappa, softening):
    """(d, v) from the angle (radians) and the dispersion; arrays broadcast."""
    R = 1.0 - 3.0 * kappa
    X = R * np.cos(2.0 * alpha)
    # Hx / Hy = (1 - kappa + X) / (1 - kappa - X)
    d = np.log((1.0 - kappa + X) / (1.0 - kappa - X))
    h = R * np.sin(2.0 * alpha)
    h_max = 1.0 / np.cosh(0.5 * d)  # 2 sqrt(t (1 - t))
    v = np.arcsinh(h / softening) / np.arcsinh(h_max / softening)
    return d, np.clip(v, 0.0, 1.0)


@register_jitable
def reference_state(Hx, Hy, Hz, ax, ay, az):
    """(ln E*^2, ln(E* sqrt(gx gy))) at the reference stretch, given squared."""
    E = Hx * ax + Hy * ay + Hz * az - 1.0
    gx = Hx * ax - Hz * az
    gy = Hy * ay - Hz * az
    # S = k1 E* exp(q) sqrt(gx gy),  q = k2 E*^2
    return 2.0 * np.log(E), np.log(E) + 0.5 * np.log(gx * gy)
