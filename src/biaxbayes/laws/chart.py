r"""The chart that angle and dispersion of fibres (:mod:`.dispersed_fibres`) are sampled in.

The chart is (d, v). Data determine d = ln(Hx / Hy). v stands for h = (1 - 3 kappa) sin 2 alpha,
twice the in-plane shear component of each family's structure tensor: what an axis-aligned test does
not see. With R = 1 - 3 kappa and D = Hx - Hy = R cos 2 alpha, the pair (D, h) are Cartesian
coordinates of the polar pair (R, 2 alpha). At a given d, h runs from 0, where alpha is 0 or 90
degrees, to h_max = 2 sqrt(t (1 - t)), t = Hx / (Hx + Hy), where kappa is 0;

    v = asinh(h / s) / asinh(h_max / s)

runs from 0 to 1. The density is regular at both ends, and both are straight in v, which the
independence move folds its proposals at. The scale s, a constant of the specimen near its
|D|, makes the density 1/R of the polar coordinates flat in v, however close to isotropy (R = 0) the
tissue is. Where one of the two is fixed, (alpha, kappa) themselves are used.
"""

from __future__ import annotations

import numpy as np

from biaxbayes.compilation import inlined


@inlined
def angles_from_chart(d, v, scale):
    """(alpha, kappa, ln |d(alpha, kappa)/d(d, v)|); ``alpha`` in radians."""
    t = 1.0 / (1.0 + np.exp(-d))
    tt = 1.0 / ((1.0 + np.exp(-d)) * (1.0 + np.exp(d)))  # t (1 - t), without cancellation
    h_max = 2.0 * np.sqrt(tt)
    span = np.arcsinh(h_max / scale)
    h = scale * np.sinh(v * span)
    # D = Hx - Hy = g (2 + R) with g = (2 t - 1) / 3, since Hx + Hy = 1 - kappa = (2 + R) / 3
    g = (2.0 * t - 1.0) / 3.0
    g2 = g * g
    # R^2 = D^2 + h^2:  (1 - g^2) R^2 - 4 g^2 R - 4 g^2 - h^2 = 0
    R = (2.0 * g2 + np.sqrt(4.0 * g2 * g2 + (1.0 - g2) * (4.0 * g2 + h * h))) / (1.0 - g2)
    R = min(R, 1.0)
    D = g * (2.0 + R)
    # d kappa d alpha = dD dh / (6 R);  dD/dd = (2 + R) R / (R - g D) * (2/3) t (1 - t) at fixed h
    # dh/dv = span sqrt(h^2 + s^2) at fixed d
    slope = span * np.sqrt(h * h + scale * scale)
    log_jacobian = np.log((2.0 + R) * tt * slope / (9.0 * (R - g * D)))
    return 0.5 * np.arctan2(h, D), (1.0 - R) / 3.0, log_jacobian


def chart_from_angles(alpha, kappa, scale):
    """(d, v) from the angle (radians) and the dispersion; arrays broadcast."""
    R = 1.0 - 3.0 * kappa
    D = R * np.cos(2.0 * alpha)
    # Hx / Hy = (1 - kappa + D) / (1 - kappa - D)
    d = np.log((1.0 - kappa + D) / (1.0 - kappa - D))
    h = R * np.sin(2.0 * alpha)
    h_max = 1.0 / np.cosh(0.5 * d)  # 2 sqrt(t (1 - t))
    v = np.arcsinh(h / scale) / np.arcsinh(h_max / scale)
    return d, np.clip(v, 0.0, 1.0)
