"""The posterior in coordinates in which it is nearly a round Gaussian, written in JAX.

A normalising flow (affine coupling layers, flowjax) is fitted by maximum likelihood to draws in
structural coordinates, after a whitening. A map that follows the posterior changes how fast a
sampler moves in it, never the posterior: the density of r is that of the natural parameters
times |d natural / d r|, whatever the flow has learnt.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from studies.benchmark.natural_density import NaturalDensity
from studies.benchmark.structural import Structural

LAYERS, WIDTH, DEPTH = 12, 48, 2
EPOCHS, BATCH, RATE = 40, 1000, 2e-3
CHUNK = 500
"""Points evaluated at a time: one compilation for every number of points."""


class Straight:
    """Coordinates r fitted to draws.

    Parameters
    ----------
    density : NaturalDensity
    mounted : callable
        Mounting loads of (C1, k1, k2, alpha, kappa) and (lm_x, lm_y).
    draws : ndarray, shape (n, 8)
        What the map is fitted to.
    """

    def __init__(self, density: NaturalDensity, mounted: Any, draws: np.ndarray) -> None:
        problem = density.problem
        top = float(np.max(problem.X)), float(np.max(problem.Y))
        self.structural = Structural(top, mounted, draws)
        y = self.structural.draws
        self.centre, self.factor = y.mean(axis=0), np.linalg.cholesky(np.cov(y.T))
        self._flow = _fitted_flow(np.linalg.solve(self.factor, (y - self.centre).T).T)
        self._compiled: Any = None

    def natural(self, r: Any) -> tuple[Any, Any]:
        """Natural parameters of one point r, and ln |d natural / d r|."""
        z, log_jacobian = self._flow.transform_and_log_det(r)
        x, more = self.structural.natural(self.centre + self.factor @ z)
        return x, log_jacobian + more + np.log(np.diag(self.factor)).sum()

    def natural_points(self, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """:meth:`natural` of points of shape (n, d)."""
        import jax

        if self._compiled is None:
            self._compiled = jax.jit(jax.vmap(self.natural))
        padded = np.zeros((-(-len(r) // CHUNK) * CHUNK, r.shape[1]))
        padded[: len(r)] = r
        found = [self._compiled(part) for part in padded.reshape(-1, CHUNK, r.shape[1])]
        x, log_jacobian = (np.concatenate([np.asarray(f[k]) for f in found]) for k in (0, 1))
        return x[: len(r)], log_jacobian[: len(r)]


def _fitted_flow(z: np.ndarray) -> Any:
    """Bijection from standard normal points to whitened draws z, shape (n, d)."""
    import jax
    import jax.numpy as jnp
    import optax
    import paramax
    from flowjax.distributions import Normal
    from flowjax.flows import coupling_flow
    from flowjax.train import fit_to_data

    first, second = jax.random.split(jax.random.PRNGKey(0))
    flow = coupling_flow(
        first,
        base_dist=Normal(jnp.zeros(z.shape[1])),
        flow_layers=LAYERS,
        nn_width=WIDTH,
        nn_depth=DEPTH,
        nn_activation=jax.nn.silu,  # smooth: gradients steer NUTS
    )
    steps = EPOCHS * (9 * len(z) // 10 // BATCH)
    fitted, _ = fit_to_data(
        second,
        flow,
        data=jnp.asarray(z),
        optimizer=optax.adam(optax.cosine_decay_schedule(RATE, steps)),
        max_epochs=EPOCHS,
        max_patience=EPOCHS,
        batch_size=BATCH,
        show_progress=False,
    )
    return paramax.unwrap(fitted.bijection)
