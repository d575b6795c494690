"""Populations of virtual specimens whose truth is known, and NUTS on the same hierarchical model.

    python scripts/study.py population --make six --folder FOLDER
    python scripts/study.py population --make ridge --folder FOLDER
    biaxbayes population FOLDER/study.toml --runs FOLDER/study --out FOLDER/population
    python scripts/study.py population --judge --folder FOLDER
    python scripts/study.py population --nuts --folder FOLDER      (needs the extra bench)

``--make six``: six specimens of three protocols in two groups, three donors. ``--make ridge``:
twelve of one group, nine with an equibiaxial test only. Both write truth.json. ``--judge`` compares
intervals with it; ``--nuts`` samples all specimens, means, donors and spreads at once and compares
every mean and sd with its Monte Carlo error. The numbers are on docs/population.md.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import biaxbayes
from biaxbayes.laws.goh import GOH, GOHLaw
from studies.page import table

RATIOS: tuple[tuple[float, float], ...] = ((1.0, 1.0), (1.0, 0.5), (0.5, 1.0))
CENTRES = {"media": (14.0, 140.0, 11.9, 38.4, 0.16), "adventitia": (8.0, 60.0, 6.0, 52.0, 0.2)}
SD_DONORS = np.array([0.2, 0.2, 0.2, 3.5, 0.02])
SD_SPECIMENS = np.array([0.22, 0.22, 0.22, 3.5, 0.02])
PARAMETERS = GOHLaw().names
LOGS = 3
NOISE = {"six": 0.0006, "ridge": 0.01}
EQUIBIAXIAL_BUT = (1, 5, 9)
"""Specimens of the ridge study with three protocols."""


def make(kind: str, folder: Path, seed: int) -> None:
    """Write the specimens, the study file and the truth."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    if kind == "six":
        plan = [(group, f"D{d}", RATIOS) for d in range(3) for group in CENTRES]
    else:
        plan = [
            ("media", f"D{k // 2}", RATIOS if k in EQUIBIAXIAL_BUT else RATIOS[:1])
            for k in range(12)
        ]
    effects = {donor: SD_DONORS * rng.standard_normal(5) for _, donor, _ in plan}
    lines = ['name = "virtual"', "ess = 1000", "[options]", 'noise = "independent"']
    truth = {}
    for k, (group, donor, ratios) in enumerate(plan):
        while True:
            theta = np.array(CENTRES[group])
            theta[:LOGS] = np.log(theta[:LOGS])
            theta = theta + effects[donor] + SD_SPECIMENS * rng.standard_normal(5)
            if 0.0 <= theta[3] <= 90.0 and 0.0 <= theta[4] <= 1.0 / 3.0:
                break
        name = f"s{k:02d}-{group}"
        biaxbayes.simulate(
            folder / f"{name}.csv",
            overwrite=True,
            material=GOH(*np.exp(theta[:LOGS]), *theta[LOGS:]),
            prestretch=tuple(1.0 + 0.02 * rng.random(2)),
            total_stretch=1.2,
            ratios=ratios,
            noise_N=NOISE[kind],
            increments=20,
            seed=100 * seed + k,
            name=name,
        )
        truth[name] = {"theta": theta.tolist(), "protocols": len(ratios)}
        lines += ["[[specimen]]", f'file = "{name}.csv"', f'donor = "{donor}"']
        lines += [f'layer = "{group}"']
    (folder / "study.toml").write_text("\n".join(lines) + "\n")
    (folder / "truth.json").write_text(json.dumps(truth))


def on_scale(k: int, values: Any) -> Any:
    """Natural values of a parameter on the model's scale."""
    return np.log(values) if k < LOGS else np.asarray(values)


def judge(folder: Path) -> None:
    """Widths and coverage of the specimens with the fewest protocols, alone and pooled."""
    truth = json.loads((folder / "truth.json").read_text())
    found = pd.read_csv(folder / "population" / "specimens.csv")
    fewest = min(t["protocols"] for t in truth.values())
    labels = [name for name, t in truth.items() if t["protocols"] == fewest]
    rows = []
    for k, name in enumerate(PARAMETERS):
        own = found[found["quantity"] == name].set_index("specimen").loc[labels]
        ends = {c: on_scale(k, own[f"{c}_q05"].to_numpy()) for c in ("single", "pooled")}
        tops = {c: on_scale(k, own[f"{c}_q95"].to_numpy()) for c in ("single", "pooled")}
        at = np.array([truth[label]["theta"][k] for label in labels])
        share = (tops["pooled"] - ends["pooled"]) / (tops["single"] - ends["single"])
        held = [int(((ends[c] <= at) & (at <= tops[c])).sum()) for c in ("single", "pooled")]
        rows.append([name, f"{np.median(share):.2f}", *(f"{h} of {len(labels)}" for h in held)])
    print(table(["parameter", "width pooled / alone", "held alone", "held pooled"], rows))


# --- one-stage NUTS ------------------------------------------------------------------------------


def nuts(folder: Path, draws: int, warmup: int) -> None:
    """The whole hierarchical model at once, independent code, and how far apart the answers are."""
    import jax
    import jax.numpy as jnp
    from jax.scipy.stats import norm
    from numpyro.infer import MCMC, NUTS

    from studies.benchmark.natural_density import NaturalDensity
    from studies.benchmark.nuts import jax_log_density

    jax.config.update("jax_enable_x64", True)
    record = json.loads((folder / "population" / "population.json").read_text())
    runs = record["identity"]["runs"]
    groups = list(dict.fromkeys(r["group"] for r in runs.values()))
    donors = list(dict.fromkeys(r["donor"] for r in runs.values()))
    group = np.array([groups.index(r["group"]) for r in runs.values()])
    donor = np.array([donors.index(r["donor"]) for r in runs.values()])
    priors = record["identity"]["priors"]
    m0, s0, donor_scale, specimen_scale = (
        jnp.array([priors[n][key] for n in PARAMETERS])
        for key in ("mean", "mean_sd", "donor_scale", "specimen_scale")
    )
    densities, centres, roots = [], [], []
    for label in runs:
        run = biaxbayes.open_run(folder / "study" / "runs" / label)
        density = NaturalDensity(run.specimen)
        densities.append((jax_log_density(density), density.posterior.priors))
        names = [*PARAMETERS, "mounting_stretch_x", "mounting_stretch_y", "noise_sd"]
        x = run.draws[names].to_numpy(copy=True)
        x[:, [0, 1, 2, 7]] = np.log(x[:, [0, 1, 2, 7]])
        centres.append(x.mean(axis=0))
        roots.append(np.linalg.cholesky(np.cov(x.T)))
    centres, roots = jnp.array(centres), jnp.array(roots)
    n, G, D = len(runs), len(groups), len(donors)

    def likelihood(i, x):
        """Of one specimen, the run's prior of the pooled values taken out."""
        log_density, own = densities[i]
        natural = jnp.concatenate([jnp.exp(x[:3]), jnp.deg2rad(x[3:4]), x[4:7], jnp.exp(x[7:])])
        total = log_density(natural) + x[7]
        for k, name in enumerate(PARAMETERS[:LOGS]):
            z = (x[k] - math.log(own[name].location)) / own[name].scale
            total += 0.5 * z * z + x[k]
        return total

    def parts(v):
        z = v[: n * 8].reshape(n, 8)
        mu, e, tau, sigma = jnp.split(v[n * 8 :], np.cumsum([G * 5, D * 5, 5]))
        return z, mu.reshape(G, 5), e.reshape(D, 5), tau, sigma

    low, high = jnp.array([0.0, 0.0]), jnp.array([90.0, 1.0 / 3.0])

    def potential(v):
        z, mu, e, log_tau, log_sigma = parts(v)
        tau, sigma = jnp.exp(log_tau), jnp.exp(log_sigma)
        x = centres + jnp.einsum("nij,nj->ni", roots, z)
        theta = x[:, :5]
        m = mu[group] + (tau * e)[donor]
        total = norm.logpdf(theta, m, sigma).sum()
        at = [(edge - m[:, 3:]) / sigma[3:] for edge in (low, high)]
        total -= jnp.log(norm.cdf(at[1]) - norm.cdf(at[0])).sum()
        total += norm.logpdf(mu, m0, s0).sum() + norm.logpdf(e).sum()
        total += (norm.logpdf(tau, 0.0, donor_scale) + log_tau).sum()
        total += (norm.logpdf(sigma, 0.0, specimen_scale) + log_sigma).sum()
        for i in range(n):
            total += likelihood(i, x[i])
        inside = ((theta[:, 3:] > low) & (theta[:, 3:] < high)).all()
        return jnp.where(inside & jnp.isfinite(total), -total, jnp.inf)

    rng = np.random.default_rng(1)
    start = []
    for _ in range(4):
        theta = np.asarray(centres)[:, :5]
        mu = np.array([theta[group == g].mean(axis=0) for g in range(G)])
        own = [0.1 * rng.standard_normal(n * 8), mu.ravel(), 0.3 * rng.standard_normal(D * 5)]
        own += [np.log(0.5 * np.asarray(donor_scale)), np.log(0.5 * np.asarray(specimen_scale))]
        start.append(np.concatenate(own))
    sampler = MCMC(
        NUTS(potential_fn=potential, dense_mass=True, target_accept_prob=0.9),
        num_warmup=warmup,
        num_samples=draws,
        num_chains=4,
        chain_method="vectorized",
        progress_bar=False,
    )
    sampler.run(jax.random.PRNGKey(1), init_params=jnp.array(start), extra_fields=("diverging",))
    v = np.asarray(sampler.get_samples(group_by_chain=True))
    print("divergences", int(np.asarray(sampler.get_extra_fields()["diverging"]).sum()))
    _compare(folder, v[..., n * 8 :], groups, D)


def _compare(folder: Path, v: np.ndarray, groups: list[str], D: int) -> None:
    import xarray as xr
    from arviz_stats.base import array_stats

    from biaxbayes.sampling.convergence import autocorrelation_time

    tree = xr.open_datatree(folder / "population" / "population.nc", engine="h5netcdf").load()
    ours = tree["posterior"]
    G = len(groups)
    rows, worst = [], 0.0
    for k, name in enumerate(PARAMETERS):
        of = {
            f"mean {name}, {g}": (("mean", {"group": g}), v[..., i * 5 + k])
            for i, g in enumerate(groups)
        }
        at = G * 5 + D * 5 + k
        of[f"sd_donors {name}"] = (("sd_donors", {}), np.exp(v[..., at]))
        of[f"sd_specimens {name}"] = (("sd_specimens", {"spread": "all"}), np.exp(v[..., at + 5]))
        for label, ((which, where), theirs) in of.items():
            own = ours[which].sel({"quantity": name, **where}).to_numpy()
            chains = 64
            shaped = own.reshape(own.shape[0], chains, -1).transpose(0, 2, 1)
            ess = [own.size / autocorrelation_time(shaped), float(array_stats.ess(theirs))]
            ess = [min(e, s) for e, s in zip(ess, (own.size, theirs.size), strict=True)]
            errors = [x.std() / math.sqrt(e) for x, e in zip((own, theirs), ess, strict=True)]
            of_mean = (own.mean() - theirs.mean()) / math.hypot(*errors)
            # the sd of a sample's sd, by its kurtosis
            spread = [
                x.std() * math.sqrt((((x - x.mean()) ** 4).mean() / x.var() ** 2 - 1) / (4 * e))
                for x, e in zip((own, theirs), ess, strict=True)
            ]
            of_sd = (own.std() - theirs.std()) / math.hypot(*spread)
            worst = max(worst, abs(of_mean), abs(of_sd))
            numbers = [own.mean(), theirs.mean(), own.std(), theirs.std()]
            rows.append(
                [
                    label,
                    *(f"{x:.4g}" for x in numbers),
                    f"{of_mean:.1f}",
                    f"{of_sd:.1f}",
                    f"{ess[0]:.0f}",
                    f"{ess[1]:.0f}",
                ]
            )
    head = ["quantity", "mean", "NUTS", "sd", "NUTS", "z mean", "z sd", "ESS", "ESS NUTS"]
    print(table(head, rows))
    print(f"worst difference: {worst:.1f} Monte Carlo errors")


def main() -> None:
    arguments = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    arguments.add_argument("--folder", type=Path, required=True)
    arguments.add_argument("--make", choices=tuple(NOISE))
    arguments.add_argument("--seed", type=int, default=5)
    arguments.add_argument("--judge", action="store_true")
    arguments.add_argument("--nuts", action="store_true")
    arguments.add_argument("--draws", type=int, default=1000)
    arguments.add_argument("--warmup", type=int, default=500)
    arguments.add_argument("--packages", help="a folder of further packages, such as jax")
    asked = arguments.parse_args()
    if asked.packages:
        sys.path.append(asked.packages)
    if asked.make:
        make(asked.make, asked.folder, asked.seed)
    if asked.judge:
        judge(asked.folder)
    if asked.nuts:
        nuts(asked.folder, asked.draws, asked.warmup)


if __name__ == "__main__":
    main()
