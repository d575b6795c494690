"""Six specimens in two groups: the population beside NUTS on all of it at once.

The density is written again in JAX from the equations, specimens, means, donor effects and sds in
one vector; specimens in coordinates whitened by the draws of their runs, which changes the work and
not the posterior.
"""

from __future__ import annotations

import json
import math
import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import logit

import biaxbayes
from biaxbayes.populations.hierarchy import MIN_INSIDE_PROBABILITY
from studies.population.virtual import LOGS, PARAMETERS, PLANS, made, on_scale, write

SEED = 5
OWN = (*PARAMETERS, "mounting_stretch_x", "mounting_stretch_y", "noise_sd")
"""Coordinates of a specimen."""
IN_LOGS, IN_LOGITS, TOPS = [0, 1, 2, 7], [3, 4], np.array([90.0, 1.0 / 3.0])
"""Those that are sampled as logs, and as logits within their ranges."""
CHAINS = 4


def make_six(folder: Path) -> None:
    """Specimens, their runs, and the population of them."""
    plan = PLANS["six"]
    study = write(made(plan, SEED), folder, plan.noise)
    biaxbayes.batch(study, out=folder / "study")
    biaxbayes.population(folder / "study", out=folder / "population", seed=1, workers=1)


def nuts(folder: Path, draws: int, warmup: int) -> dict[str, Any]:
    """Draws of NUTS, judged beside those of the population's folder."""
    import jax
    from numpyro.infer import MCMC, NUTS

    jax.config.update("jax_enable_x64", True)
    model = _Model(folder)
    clock = time.process_time()
    sampler = MCMC(
        NUTS(potential_fn=model.potential, dense_mass=True, target_accept_prob=0.95),
        num_warmup=warmup,
        num_samples=draws,
        num_chains=CHAINS,
        chain_method="vectorized",
        progress_bar=False,
    )
    extra = ("diverging", "num_steps")
    sampler.run(jax.random.PRNGKey(1), init_params=model.starts(), extra_fields=extra)
    v = np.asarray(sampler.get_samples(group_by_chain=True))
    told = sampler.get_extra_fields()
    rows = compared(folder, model.hyperparameters(v))
    return {
        "cpu": round(time.process_time() - clock, 1),
        "draws": draws * CHAINS,
        "steps": int(np.asarray(told["num_steps"]).sum()),
        "divergences": int(np.asarray(told["diverging"]).sum()),
        "rows": rows,
    }


class _Model:
    """The hierarchical model in JAX."""

    def __init__(self, folder: Path) -> None:
        import jax
        import jax.numpy as jnp

        from studies.benchmark.natural_density import NaturalDensity
        from studies.benchmark.nuts import jax_readings

        identity = json.loads((folder / "population" / "population.json").read_text())["identity"]
        members = identity["runs"]
        self.groups = list(dict.fromkeys(r["group"] for r in members.values()))
        donors = list(dict.fromkeys(r["donor"] for r in members.values()))
        self.group = np.array([self.groups.index(r["group"]) for r in members.values()])
        self.donor = np.array([donors.index(r["donor"]) for r in members.values()])
        self.n, self.G, self.D = len(members), len(self.groups), len(donors)
        self.m0, self.s0, self.donor_scale, self.specimen_scale = (
            jnp.array([identity["priors"][n][key] for n in PARAMETERS])
            for key in ("mean", "mean_sd", "donor_scale", "specimen_scale")
        )
        readings, means, centres, roots = [], [], [], []
        for label in members:
            run = biaxbayes.open_run(folder / "study" / "runs" / label)
            readings.append(jax_readings(NaturalDensity(run.specimen)))
            x = run.draws[list(OWN)].to_numpy(copy=True)
            means.append(on_scale(x[:, :5]).mean(axis=0))
            x[:, IN_LOGS] = np.log(x[:, IN_LOGS])
            x[:, IN_LOGITS] = logit(x[:, IN_LOGITS] / TOPS)
            centres.append(x.mean(axis=0))
            roots.append(np.linalg.cholesky(np.cov(x.T)))
        # specimens were tested alike: one compiled density for all of them
        self.readings = jax.tree.map(lambda *a: jnp.stack(a), *readings)
        self.centres, self.roots = jnp.array(centres), jnp.array(roots)
        theta = np.array(means)
        # means in units of the spread, around those of the runs
        self.middle = jnp.array([theta[self.group == g].mean(axis=0) for g in range(self.G)])
        self.sizes = np.cumsum([self.n * 8, self.G * 5, self.D * 5, 5])

    def _means(self, z: Any) -> Any:
        """Means of the groups (..., groups, 5) from their own coordinates."""
        shape = (*z.shape[:-1], self.G, 5)
        return self.middle + self.specimen_scale * z.reshape(shape)

    def _likelihoods(self, x: Any) -> Any:
        """Of all specimens (n, 8), the runs' priors of the pooled logs taken out; one number."""
        import jax
        import jax.numpy as jnp

        from studies.benchmark.nuts import log_density_of

        def one(given: Any, own: Any) -> Any:
            c1k = jnp.exp(own[:LOGS])
            alpha = jnp.deg2rad(own[3:4])
            natural = jnp.concatenate([c1k, alpha, own[4:7], jnp.exp(own[7:])])
            z = (own[:LOGS] - given["log"][0, :LOGS]) / given["log"][1, :LOGS]
            # from densities of natural values to those of logs: + log of each
            return log_density_of(given, natural) + (0.5 * z * z + own[:LOGS]).sum() + own[7]

        return jax.vmap(one)(self.readings, x).sum()

    def potential(self, v: Any) -> Any:
        """Minus the log density of the stacked coordinates."""
        import jax.numpy as jnp
        from jax.nn import sigmoid
        from jax.scipy.stats import norm

        z, mu, e, log_tau, log_sigma = jnp.split(v, self.sizes)
        mu, e = self._means(mu), e.reshape(self.D, 5)
        tau, sigma = jnp.exp(log_tau), jnp.exp(log_sigma)
        x = self.centres + jnp.einsum("nij,nj->ni", self.roots, z.reshape(self.n, 8))
        shares = sigmoid(x[:, 3:5])
        total = jnp.log(TOPS * shares * (1.0 - shares)).sum()  # d theta / d logit
        x = jnp.concatenate([x[:, :3], TOPS * shares, x[:, 5:]], axis=1)
        theta = x[:, :5]
        m = mu[self.group] + (tau * e)[self.donor]
        share = norm.cdf((TOPS - m[:, 3:]) / sigma[3:]) - norm.cdf(-m[:, 3:] / sigma[3:])
        total += norm.logpdf(theta, m, sigma).sum() - jnp.log(jnp.maximum(share, 1e-9)).sum()
        total += norm.logpdf(mu, self.m0, self.s0).sum() + norm.logpdf(e).sum()
        total += (norm.logpdf(tau, 0.0, self.donor_scale) + log_tau).sum()
        total += (norm.logpdf(sigma, 0.0, self.specimen_scale) + log_sigma).sum()
        total += self._likelihoods(x)
        return jnp.where(
            (share >= MIN_INSIDE_PROBABILITY).all() & jnp.isfinite(total), -total, jnp.inf
        )

    def starts(self) -> Any:
        """A dispersed start for each chain."""
        import jax.numpy as jnp

        rng = np.random.default_rng(1)
        out = []
        for _ in range(CHAINS):
            own = [0.3 * rng.standard_normal(self.n * 8 + (self.G + self.D) * 5)]
            scales = (self.donor_scale, self.specimen_scale)
            own += [np.log(rng.uniform(0.3, 0.9, 5) * np.asarray(s)) for s in scales]
            out.append(np.concatenate(own))
        return jnp.array(out)

    def hyperparameters(self, v: np.ndarray) -> dict[str, tuple[str, dict[str, str], np.ndarray]]:
        """By label: name and selection in population.nc, and draws (chains, draws)."""
        _, mu, _, tau, sigma = np.split(v, self.sizes, axis=-1)
        mu = np.asarray(self._means(mu))
        out: dict[str, tuple[str, dict[str, str], np.ndarray]] = {}
        for k, name in enumerate(PARAMETERS):
            for i, g in enumerate(self.groups):
                where = {"quantity": name, "group": g}
                out[f"mean {name}, {g}"] = ("mean", where, mu[..., i, k])
            where = {"quantity": name}
            out[f"sd_donors {name}"] = ("sd_donors", where, np.exp(tau[..., k]))
            where = where | {"spread": "all"}
            out[f"sd_specimens {name}"] = ("sd_specimens", where, np.exp(sigma[..., k]))
        return out


def compared(
    folder: Path, theirs: dict[str, tuple[str, dict[str, str], np.ndarray]]
) -> list[dict[str, Any]]:
    """Means and sds of both, and their differences in Monte Carlo errors."""
    import arviz
    import xarray as xr

    ours = xr.open_datatree(folder / "population" / "population.nc", engine="h5netcdf").load()
    record = json.loads((folder / "population" / "population.json").read_text())
    walkers = record["identity"]["sampler"]["chains"]
    rows = []
    for label, (which, where, other) in theirs.items():
        own = ours["posterior"][which].sel(where).to_numpy()
        shaped = own.reshape(own.shape[0], walkers, -1).transpose(0, 2, 1)
        ess = _effective(shaped, other)
        errors = (x.std() / math.sqrt(e) for x, e in zip((own, other), ess, strict=True))
        # of the sd: what the squared deviations are worth
        squares = _effective((shaped - own.mean()) ** 2, (other - other.mean()) ** 2)
        of_sd = (_error_of_sd(x, e) for x, e in zip((own, other), squares, strict=True))
        row: dict[str, Any] = {"quantity": label, "ess": ess, "rhat": arviz.rhat(np.asarray(other))}
        row |= {"mean": [own.mean(), other.mean()], "sd": [own.std(), other.std()]}
        row["z_mean"] = (own.mean() - other.mean()) / math.hypot(*errors)
        row["z_sd"] = (own.std() - other.std()) / math.hypot(*of_sd)
        rows.append(row)
    found: list[dict[str, Any]] = json.loads(json.dumps(rows, default=float))
    return found


def _effective(own: np.ndarray, other: np.ndarray) -> list[float]:
    """Effective draws for the means of ours (ensembles, steps, walkers) and theirs."""
    import arviz

    from biaxbayes.sampling.convergence import effective_sample_size

    theirs = float(arviz.ess(np.asarray(other), method="mean"))
    return [effective_sample_size(own), min(theirs, other.size)]


def _error_of_sd(x: np.ndarray, ess: float) -> float:
    """Monte Carlo error of a sample's sd, by its kurtosis."""
    fourth = ((x - x.mean()) ** 4).mean()
    return float(x.std() * math.sqrt((fourth / x.var() ** 2 - 1.0) / (4.0 * ess)))
