"""Structural coordinates of the posterior, written in JAX for the samplers of others.

    ln C1,  ln S,  ln q,  d,  w,  p0_x,  p0_y,  ln noise sd

S and q are the fibre stress and the exponent at one reference stretch, d = ln(Hx / Hy), and
Phi(w) in (0, 1) is the softened shear of the fibre families from aligned fibres to no dispersion
(:mod:`biaxbayes.laws.dispersed_fibres` gives the formulas); p0 are the mounting loads. Here every
coordinate runs over the whole line, and Jacobians come from automatic differentiation.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import ndtri

from biaxbayes.laws.dispersed_fibres import chart_from_angles, median_softening

REFERENCE = 0.95
"""Squared reference stretch over the largest squared total stretch."""
NEWTON_STEPS, LONGEST_STEP, TOLERANCE = 60, 0.03, 1e-11
FURTHEST = 4.0
"""The guess of the mounting stretches is held fast beyond so many standard deviations."""


class Structural:
    """Coordinates laid out around draws.

    Parameters
    ----------
    squared : tuple of two floats
        Largest squared stretch of the protocols in x and y, from the mounted state.
    mounted : callable
        Mounting loads (2,) of theta (5,) and mounting stretches (2,).
    draws : ndarray, shape (n, 8)
        Of (C1, k1, k2, alpha, kappa, lm_x, lm_y, noise sd), alpha in radians.
    """

    def __init__(self, squared: tuple[float, float], mounted: Any, draws: np.ndarray) -> None:
        self._mounted = mounted
        self._softening = median_softening(draws[:, 3], draws[:, 4])
        x, y = REFERENCE * np.array(squared) * np.median(draws[:, 5:7], axis=0) ** 2
        self._reference = (x, y, 1.0 / (x * y))
        self.draws = self._of(draws)
        self._lay_guess(draws[:, 5:7])

    def _of(self, draws: np.ndarray) -> np.ndarray:
        import jax
        import jax.numpy as jnp

        d, v = chart_from_angles(draws[:, 3], draws[:, 4], self._softening)
        angles, lm = jnp.asarray(draws[:, 3:5]), jnp.asarray(draws[:, 5:7])
        log_E2, log_EG = (np.asarray(a) for a in jax.vmap(self._at_reference)(angles))
        loads = np.asarray(jax.vmap(self._mounted)(jnp.asarray(draws[:, :5]), lm))
        log_q = np.log(draws[:, 2]) + log_E2
        log_S = np.log(draws[:, 1]) + np.exp(log_q) + log_EG
        w = ndtri(np.clip(v, 1e-12, 1.0 - 1e-12))
        columns = [np.log(draws[:, 0]), log_S, log_q, d, w, loads, np.log(draws[:, 7])]
        return np.column_stack(columns)

    def _at_reference(self, angles: Any) -> tuple[Any, Any]:
        """(ln E*^2, ln(E* sqrt(gx gy))) of (alpha, kappa)."""
        import jax.numpy as jnp

        kappa, t = angles[1], jnp.cos(angles[0]) ** 2
        hx, hy = kappa + (1.0 - 3.0 * kappa) * t, kappa + (1.0 - 3.0 * kappa) * (1.0 - t)
        ax, ay, az = self._reference
        E = hx * ax + hy * ay + kappa * az - 1.0
        gx, gy = hx * ax - kappa * az, hy * ay - kappa * az
        return 2.0 * jnp.log(E), jnp.log(E) + 0.5 * jnp.log(gx * gy)

    def _angles(self, dw: Any) -> Any:
        """(alpha, kappa) of (d, w)."""
        import jax
        import jax.numpy as jnp
        from jax.scipy.special import ndtr

        t, s = jax.nn.sigmoid(dw[0]), self._softening
        span = jnp.arcsinh(2.0 * jnp.sqrt(t * (1.0 - t)) / s)
        h = s * jnp.sinh(ndtr(dw[1]) * span)
        g = (2.0 * t - 1.0) / 3.0
        # (1 - g^2) R^2 - 4 g^2 R - 4 g^2 - h^2 = 0,  R = 1 - 3 kappa
        root = jnp.sqrt(4.0 * g**4 + (1.0 - g**2) * (4.0 * g**2 + h**2))
        R = (2.0 * g**2 + root) / (1.0 - g**2)
        return jnp.stack([0.5 * jnp.arctan2(h, g * (2.0 + R)), (1.0 - R) / 3.0])

    def natural(self, y: Any) -> tuple[Any, Any]:
        """Natural parameters of one point, and ln |d natural / d y|; NaN where there are none."""
        import jax
        import jax.numpy as jnp

        angles = self._angles(y[3:5])
        log_E2, log_EG = self._at_reference(angles)
        log_k2, log_k1 = y[2] - log_E2, y[1] - jnp.exp(y[2]) - log_EG
        theta = jnp.concatenate([jnp.exp(jnp.stack([y[0], log_k1, log_k2])), angles])
        lm, slope = self._mounting_stretches(theta, y[5:7], self._guess(y))
        log_jacobian = y[0] + log_k1 + log_k2 + y[7]
        log_jacobian += jnp.log(jnp.abs(_determinant(jax.jacfwd(self._angles)(y[3:5]))))
        # d lm = J^-1 d p0; a mounted state is stable, so J is positive definite
        log_jacobian -= jnp.log(jnp.where(slope[0, 0] > 0.0, _determinant(slope), jnp.nan))
        return jnp.concatenate([theta, lm, jnp.exp(y[7:])]), log_jacobian

    def _mounting_stretches(self, theta: Any, load: Any, guess: Any) -> tuple[Any, Any]:
        """Root by Newton's method, differentiated by one more step, and d load / d lm there."""
        import jax
        import jax.numpy as jnp

        hold = jax.lax.stop_gradient
        slope = jax.jacfwd(self._mounted, argnums=1)
        held, wanted = hold(theta), hold(load)

        def step(state: Any) -> Any:
            lm, count, _ = state
            by = _solve(slope(held, lm), self._mounted(held, lm) - wanted)
            by = jnp.clip(by, -LONGEST_STEP, LONGEST_STEP)
            return lm - by, count + 1, jnp.abs(by).max()

        def unfinished(state: Any) -> Any:
            return (state[1] < NEWTON_STEPS) & (state[2] > TOLERANCE)

        lm, _, last = jax.lax.while_loop(unfinished, step, (hold(guess), 0, jnp.inf))
        lm = hold(jnp.where(last < 1e-6, lm, jnp.nan))
        lm = lm - _solve(hold(slope(theta, lm)), self._mounted(theta, lm) - load)
        return lm, slope(theta, lm)

    def _lay_guess(self, lm: np.ndarray) -> None:
        """A quadratic regression of the mounting stretches on the coordinates starts the root."""
        self._centre, self._scale = self.draws.mean(axis=0), self.draws.std(axis=0)
        features = np.array(self._features(self.draws.T)).T
        self._slopes = np.linalg.lstsq(features, lm, rcond=None)[0]
        self._range = lm.min(axis=0), lm.max(axis=0)

    def _features(self, y: Any) -> list[Any]:
        import jax.numpy as jnp

        z = [
            jnp.clip((v - c) / s, -FURTHEST, FURTHEST)
            for v, c, s in zip(y, self._centre, self._scale, strict=True)
        ]
        crossed = [a * b for i, a in enumerate(z) for b in z[: i + 1]]
        return [jnp.ones_like(z[0]), *z, *crossed]

    def _guess(self, y: Any) -> Any:
        import jax.numpy as jnp

        return jnp.clip(jnp.stack(self._features(y)) @ self._slopes, *self._range)


def _determinant(a: Any) -> Any:
    return a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]


def _solve(a: Any, b: Any) -> Any:
    import jax.numpy as jnp

    x = a[1, 1] * b[0] - a[0, 1] * b[1], a[0, 0] * b[1] - a[1, 0] * b[0]
    return jnp.stack(x) / _determinant(a)
