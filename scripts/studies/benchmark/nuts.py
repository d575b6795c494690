"""NUTS on the same posterior, the density written once more in JAX."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from biaxbayes.parameters import mounting_names
from studies.benchmark.natural_density import LOGS, NAMES, NaturalDensity, summaries
from studies.benchmark.outcome import Outcome, judged
from studies.benchmark.straight import Straight


def jax_log_density(density: NaturalDensity) -> Any:
    """Log posterior of (C1, k1, k2, alpha, kappa, lm_x, lm_y, noise sd), up to a constant.

    Independent of the package's own: written from the equations, for NUTS and as a check.
    """
    given = jax_readings(density)
    return lambda x: log_density_of(given, x)


def jax_readings(density: NaturalDensity) -> dict[str, Any]:
    """What :func:`log_density_of` needs of a specimen, as arrays."""
    import jax.numpy as jnp

    problem, priors = density.problem, density.priors
    rows = np.diff(problem.start)
    logs = [priors[name] for name in LOGS]
    lm = [priors[name] for name in mounting_names("stretch")]
    arrays = {
        "squared": (problem.X, problem.Y, problem.Z),
        "inverse": (problem.ilx, problem.ily),
        "read": (problem.fx, problem.fy),
        "beta": np.repeat(problem.beta, rows, axis=0).T,
        # N per kPa is area, or area over the mounting stretch
        "area": problem.area,
        "mounted": 1.0 if problem.mounted else 0.0,
        "reading": problem.reading[0],
        "reading_sd": problem.reading_sd[0],
        "stretch": ([p.location for p in lm], [p.scale for p in lm]),
        "log": ([np.log(p.location) for p in logs], [p.scale for p in logs]),
    }
    return {name: jnp.asarray(np.array(values, dtype=float)) for name, values in arrays.items()}


def log_density_of(given: dict[str, Any], x: Any) -> Any:
    """The density of :func:`jax_log_density` at x (8,), of what :func:`jax_readings` gave."""
    import jax.numpy as jnp

    theta, lm, w = x[:5], x[5:7], x[7]
    lz2 = 1.0 / (lm[0] * lm[1]) ** 2
    mounted = _stress(theta, lm[0] ** 2, lm[1] ** 2, lz2)
    squared = given["squared"]
    loads = _stress(theta, lm[0] ** 2 * squared[0], lm[1] ** 2 * squared[1], lz2 * squared[2])
    total = 0.0
    for k in range(2):
        section = given["area"][k] * jnp.where(given["mounted"] > 0.0, 1.0, 1.0 / lm[k])
        residual = given["read"][k] - section * given["inverse"][k] * loads[k]
        total += (given["beta"][k] * (-0.5 * (residual / w) ** 2 - jnp.log(w))).sum()
        p0 = section * mounted[k]
        total -= 0.5 * ((given["reading"][k] - p0) / given["reading_sd"][k]) ** 2
    total -= 0.5 * (((lm - given["stretch"][0]) / given["stretch"][1]) ** 2).sum()
    logs = jnp.log(jnp.stack([x[0], x[1], x[2], w]))
    return total - (0.5 * ((logs - given["log"][0]) / given["log"][1]) ** 2 + logs).sum()


def _stress(theta: Any, lx2: Any, ly2: Any, lz2: Any) -> tuple[Any, Any]:
    import jax.numpy as jnp

    c1, k1, k2, alpha, kappa = theta
    t = jnp.cos(alpha) ** 2
    hx, hy, hz = kappa + (1 - 3 * kappa) * t, kappa + (1 - 3 * kappa) * (1 - t), kappa
    # E = H : C - 1,  s_k = 2 C1 (l_k^2 - l_z^2) + 4 k1 E exp(k2 E^2) (H_k l_k^2 - H_z l_z^2)
    e = hx * lx2 + hy * ly2 + hz * lz2 - 1.0
    w = 4.0 * k1 * e * jnp.exp(jnp.minimum(k2 * e * e, 300.0))
    return (
        2.0 * c1 * (lx2 - lz2) + w * (hx * lx2 - hz * lz2),
        2.0 * c1 * (ly2 - lz2) + w * (hy * ly2 - hz * lz2),
    )


def jax_mounting_load(density: NaturalDensity) -> Any:
    """Mounting loads (2,) of theta (5,) and mounting stretches (2,)."""
    import jax.numpy as jnp

    problem = density.problem

    def load(theta, lm):
        lz2 = 1.0 / (lm[0] * lm[1]) ** 2
        stress = jnp.stack(_stress(theta, lm[0] ** 2, lm[1] ** 2, lz2))
        return jnp.asarray(problem.area) * (1.0 if problem.mounted else 1.0 / lm) * stress

    return load


def straightened(density: NaturalDensity, draws: np.ndarray) -> Straight:
    """Coordinates fitted to draws of ours, shape (n, 8)."""
    import jax

    jax.config.update("jax_enable_x64", True)
    return Straight(density, jax_mounting_load(density), draws)


def straightened_nuts(
    density: NaturalDensity, straight: Straight, *, warmup: int, draws: int, chains: int = 4
) -> Outcome:
    """NUTS in coordinates that follow the posterior (:class:`.Straight`), for agreement.

    The chains start at standard normal
    points of the straightened space.
    """
    import jax
    import jax.numpy as jnp

    target = jax_log_density(density)

    def potential(r):
        x, log_jacobian = straight.natural(r)
        out = target(x) + log_jacobian
        return jnp.where(jnp.isfinite(out), -out, jnp.inf)

    rng = np.random.default_rng(2)
    r0 = np.empty((0, len(NAMES)))
    while len(r0) < chains:
        r = rng.standard_normal((1, len(NAMES)))
        if np.isfinite(float(potential(r[0]))):
            r0 = np.vstack([r0, r])
    natural = jax.jit(jax.vmap(jax.vmap(lambda r: straight.natural(r)[0])))
    return _run(potential, natural, r0, warmup, draws)


def _run(potential: Any, natural: Any, start: np.ndarray, warmup: int, draws: int) -> Outcome:
    """Chains in step with one another, on one core."""
    import jax
    import jax.numpy as jnp
    from numpyro.infer import MCMC, NUTS

    sampler = MCMC(
        NUTS(potential_fn=potential, dense_mass=True, target_accept_prob=0.9),
        num_warmup=warmup,
        num_samples=draws,
        num_chains=len(start),
        chain_method="vectorized",
        progress_bar=False,
    )
    jax.block_until_ready(jax.jit(jax.value_and_grad(potential))(jnp.asarray(start[0])))
    clock = time.perf_counter()
    sampler.warmup(jax.random.PRNGKey(1), init_params=jnp.asarray(start), collect_warmup=False)
    jax.block_until_ready(sampler.last_state)
    middle = time.perf_counter()
    sampler.run(jax.random.PRNGKey(2), extra_fields=("num_steps", "diverging"))
    u = np.asarray(jax.block_until_ready(sampler.get_samples(group_by_chain=True)))
    end = time.perf_counter()
    extra = sampler.get_extra_fields()
    chain = np.asarray(natural(jnp.asarray(u)))[:, :, None, :]
    ess, rhat = judged(summaries(chain))
    return Outcome(
        ess,
        int(np.asarray(extra["num_steps"]).sum()),
        end - middle,
        middle - clock,
        rhat,
        summaries(chain),
        f"{int(np.asarray(extra['diverging']).sum())} divergences",
    )
