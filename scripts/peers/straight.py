"""The posterior in coordinates in which it is nearly a round Gaussian, written in JAX.

From straightened coordinates r by the triangular trend of the package (its equations written once
more, differentiable) to y: logs of C1, k1, k2 and the noise sd, the logit of alpha within its
range, kappa folded at the ends of its own, and the mounting loads. From the loads to the mounting
stretches by Newton's method, differentiated by one step at the root. A map that follows the
posterior changes how fast a sampler moves in it, never the posterior.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from biaxbayes.inference.trend import CROSSED, SATURATION, WIDEST, Trend, fit_trend

__all__ = ["Straight"]

ALPHA, KAPPA = 3, 4
TOP_ALPHA, TOP_KAPPA = 0.5 * np.pi, 1.0 / 3.0
NEWTON_STEPS, LONGEST_STEP = 40, 0.02
TOLERANCE = 1e-9


class Straight:
    """Coordinates fitted to draws, and the density in them.

    Parameters
    ----------
    target : callable
        Log density of (C1, k1, k2, alpha, kappa, lm_x, lm_y, noise sd).
    mounted : callable
        Mounting loads of (C1, k1, k2, alpha, kappa) and (lm_x, lm_y).
    draws : ndarray, shape (n, 8)
        What the map is fitted to.
    """

    def __init__(self, target: Any, mounted: Any, draws: np.ndarray) -> None:
        import jax
        import jax.numpy as jnp

        self.target, self.mounted = target, mounted
        self.middle = jnp.asarray(np.median(draws[:, 5:7], axis=0))
        y = np.log(draws)
        y[:, ALPHA] = np.log(draws[:, ALPHA] / (TOP_ALPHA - draws[:, ALPHA]))
        y[:, KAPPA] = draws[:, KAPPA] / TOP_KAPPA
        loads = jax.vmap(mounted)(jnp.asarray(draws[:, :5]), jnp.asarray(draws[:, 5:7]))
        y[:, 5:7] = np.asarray(loads)
        self.trend = fit_trend(y, np.arange(y.shape[1]) == KAPPA)
        r, _ = self.trend.straighten(y)
        self.centre, self.scale = r.mean(axis=0), r.std(axis=0)

    def natural(self, r: Any) -> tuple[Any, Any]:
        """Natural parameters of one point r, and ln |d natural / d r| less the loads' part."""
        import jax
        import jax.numpy as jnp

        y, log_jacobian = _bend(self.trend, self.centre + self.scale * r)
        theta = [jnp.exp(y[0]), jnp.exp(y[1]), jnp.exp(y[2])]
        theta += [TOP_ALPHA * jax.nn.sigmoid(y[ALPHA]), TOP_KAPPA * y[KAPPA]]
        log_jacobian = log_jacobian + y[0] + y[1] + y[2] + y[7]
        log_jacobian = log_jacobian + jax.nn.log_sigmoid(y[ALPHA]) + jax.nn.log_sigmoid(-y[ALPHA])
        lm, slope, miss = self._root(jnp.stack(theta), y[5:7])
        # d lm = J^-1 d load
        determinant = slope[0, 0] * slope[1, 1] - slope[0, 1] * slope[1, 0]
        log_jacobian = log_jacobian - jnp.log(jnp.abs(determinant))
        log_jacobian = jnp.where(miss < TOLERANCE, log_jacobian, -jnp.inf)
        return jnp.concatenate([jnp.stack(theta), lm, jnp.exp(y[7:])]), log_jacobian

    def _root(self, theta: Any, load: Any) -> tuple[Any, Any, Any]:
        import jax
        import jax.numpy as jnp

        slope = jax.jacfwd(self.mounted, argnums=1)
        held, wanted = jax.lax.stop_gradient(theta), jax.lax.stop_gradient(load)

        def step(_: int, lm: Any) -> Any:
            by = jnp.linalg.solve(slope(held, lm), self.mounted(held, lm) - wanted)
            return lm - jnp.clip(by, -LONGEST_STEP, LONGEST_STEP)

        lm = jax.lax.stop_gradient(jax.lax.fori_loop(0, NEWTON_STEPS, step, self.middle))
        by = jnp.linalg.solve(
            jax.lax.stop_gradient(slope(theta, lm)), self.mounted(theta, lm) - load
        )
        lm = lm - by
        return lm, slope(theta, lm), jnp.abs(jax.lax.stop_gradient(by)).max()

    def potential(self, r: Any) -> Any:
        """Minus the log density of r."""
        import jax.numpy as jnp

        x, log_jacobian = self.natural(r)
        out = self.target(x) + log_jacobian
        return jnp.where(jnp.isfinite(out), -out, jnp.inf)


def _bend(trend: Trend, r: Any) -> tuple[Any, Any]:
    """Inverse of :meth:`Trend.straighten` for one point, and ln |dx/dr|."""
    import jax.numpy as jnp

    d = len(trend.order)
    y: list[Any] = [None] * d
    features: list[Any] = [1.0]
    log_jacobian = float(np.log(trend.scale).sum())
    near: list[Any] = []
    for k in range(d):
        coefficients, widths = trend.coefficients[k], trend.widths[k]
        used = min(len(features), len(coefficients))
        # z_k = p_k(z_1 ... z_{k-1}) + r_k exp(s_k(z_1 ... z_{k-1}))
        middle = sum(c * f for c, f in zip(coefficients[:used], features, strict=False))
        width = sum(
            widths[1 + i] * x + widths[1 + d + i] * (x * x - 1.0) for i, x in enumerate(near)
        )
        width = jnp.clip(width, -WIDEST, WIDEST)
        z = r[k] * jnp.exp(width) + middle
        log_jacobian = log_jacobian + width
        value = z * trend.scale[k] + trend.centre[k]
        if trend.order[k] == KAPPA:
            # reflected at 0 and 1 as often as needed; the density is that of all images
            value = jnp.abs(jnp.mod(value + 1.0, 2.0) - 1.0)
            z = (value - trend.centre[k]) / trend.scale[k]
        y[int(trend.order[k])] = value
        x = jnp.clip(z, -SATURATION, SATURATION)
        features += [x, x * x - 1.0]
        if k < CROSSED:
            features += [x * other for other in near]
        near.append(x)
    return jnp.stack(y), log_jacobian
