"""Simulation-based calibration of a population: truths from its own priors, ranks of what it finds.

Truths of a study are drawn from the model that is sampled, cut as it is cut: means, sds and donor
effects are drawn until every location of a specimen is allowed, specimens until they are inside
their ranges, and a study in which a specimen has no stable mounted state is drawn anew as a whole.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import norm

from biaxbayes.calibration.simulated_specimen import draw_truth, simulate_specimen
from biaxbayes.laws.goh import GOH, GOHLaw
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.priors import Prior
from biaxbayes.populations.hierarchy import MIN_INSIDE_PROBABILITY
from biaxbayes.populations.model import PooledValue, PopulationPriors, pooled_values
from biaxbayes.populations.population_result import Population
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.virtual_specimen import Machine, virtual_specimen
from studies.population.pooling import pool, sampled

GROUPS, DONORS = ("media", "adventitia"), 4
PRIORS = PopulationPriors(
    mean={
        "C1": (np.log(12.0), 0.4),
        "k1": (np.log(50.0), 0.5),
        "k2": (np.log(8.0), 0.4),
        "alpha": (45.0, 10.0),
        "kappa": (0.15, 0.05),
    },
    sd_donors={"C1": 0.3, "k1": 0.3, "k2": 0.3, "alpha": 5.0, "kappa": 0.03},
    sd_specimens={"C1": 0.3, "k1": 0.3, "k2": 0.3, "alpha": 5.0, "kappa": 0.03},
)
"""Tighter than the defaults, so that truths are tissue that the protocols below can test."""
RATIOS = ((1.0, 1.0), (1.0, 0.5), (0.5, 1.0))
TOP, ROWS, NOISE_N = 1.18, 10, 0.003
OWN = {
    "mounting_stretch_x": Prior("normal", 1.02, 0.01, low=0.5),
    "mounting_stretch_y": Prior("normal", 1.02, 0.01, low=0.5),
    "noise_sd": Prior("lognormal", NOISE_N, 0.3),
}
"""Priors of the runs; those of the pooled values are the defaults, which pooling takes out."""
BAND = (1.05, 1.10, 1.15, 1.20)
"""Equibiaxial stretches at which the stress of a new specimen is ranked."""
RANKED_DRAWS = 127


def values_of(priors: PopulationPriors) -> list[PooledValue]:
    """The pooled values of GOH with these priors."""
    law = GOHLaw()
    return priors.apply_to(pooled_values(law, law.names))


class Truths:
    """One draw of means, sds, donor effects and specimens from the model's priors.

    Written without the package's own code for cut normals, so that it can find that wrong.
    """

    def __init__(self, values: list[PooledValue], rng: np.random.Generator) -> None:
        p, G = len(values), len(GROUPS)
        self.values, self.rng = values, rng
        self.group = np.tile(np.arange(G), DONORS)
        self.donor = np.repeat(np.arange(DONORS), G)
        self.mu, self.effect = np.empty((G, p)), np.empty((DONORS, p))
        self.sd_donors, self.sd = np.empty(p), np.empty(p)
        for k, v in enumerate(values):
            self._draw(k, v)
        location = self.mu[self.group] + self.effect[self.donor]
        self.theta = np.array([self.specimen(m) for m in location])

    def _draw(self, k: int, v: PooledValue) -> None:
        """Everything of one value, until all locations of its specimens are allowed."""
        rng = self.rng
        while True:
            self.mu[:, k] = rng.normal(v.mean, v.mean_sd, len(GROUPS))
            self.sd_donors[k] = abs(rng.normal(0.0, v.donor_scale))
            self.sd[k] = abs(rng.normal(0.0, v.specimen_scale))
            self.effect[:, k] = rng.normal(0.0, self.sd_donors[k], DONORS)
            location = self.mu[self.group, k] + self.effect[self.donor, k]
            if np.all(self._inside(k, location) >= MIN_INSIDE_PROBABILITY):
                return

    def _inside(self, k: int, location: np.ndarray) -> np.ndarray:
        low, high = self.values[k].limits
        of = norm(location, self.sd[k])
        return np.asarray(of.cdf(high) - of.cdf(low))

    def specimen(self, location: np.ndarray) -> np.ndarray:
        """A specimen at a location (p,), thrown again while it is outside."""
        out = np.empty(len(location))
        for k, v in enumerate(self.values):
            low, high = v.limits
            while True:
                out[k] = self.rng.normal(location[k], self.sd[k])
                if low <= out[k] <= high:
                    break
        return out

    def new_specimen(self, g: int) -> np.ndarray:
        """A specimen of a new donor whose location is allowed."""
        location = np.empty(len(self.values))
        for k in range(len(self.values)):
            while True:
                location[k] = self.rng.normal(self.mu[g, k], self.sd_donors[k])
                if self._inside(k, location[k]) >= MIN_INSIDE_PROBABILITY:
                    break
        return self.specimen(location)

    def named(self) -> dict[str, float]:
        """Hyperparameters by name."""
        out: dict[str, float] = {}
        for k, v in enumerate(self.values):
            out |= {f"mean {v.name}, {g}": self.mu[i, k] for i, g in enumerate(GROUPS)}
            out[f"sd_donors {v.name}"] = self.sd_donors[k]
            out[f"sd_specimens {v.name}"] = self.sd[k]
        return {name: float(x) for name, x in out.items()}


def template() -> Specimen:
    """Protocols, dimensions and noise that all specimens have."""
    found, _ = virtual_specimen(
        GOH(12.0, 50.0, 8.0, 45.0, 0.15),
        name="virtual",
        mounting_stretch=(1.02, 1.02),
        measured_stretch=TOP,
        ratios=RATIOS,
        increments=ROWS,
        machine=Machine(noise_N=NOISE_N),
        seed=1,
    )
    return found


def natural(values: list[PooledValue], theta: np.ndarray) -> dict[str, float]:
    """A material (p,) on the scale as natural values."""
    return {v.name: float(v.from_scale(theta[k])) for k, v in enumerate(values)}


def drawn_study(rng: np.random.Generator) -> tuple[Truths, list[Specimen], int]:
    """Truths and records of a study, and how many were thrown away before it."""
    values = values_of(PRIORS)
    specimen = template()
    posterior = Posterior(specimen, noise="independent", priors=OWN)
    for rejected in range(1000):
        truths = Truths(values, rng)
        found: list[Specimen] = []
        for theta in truths.theta:
            priors = posterior.priors | natural(values, theta)
            truth, again = draw_truth(posterior, rng, priors)
            if again:
                break
            found.append(simulate_specimen(posterior, truth, rng))
        else:
            return truths, found, rejected
    raise ValueError("the priors have next to no mass where specimens have a mounted state")


def band_stress(materials: pd.DataFrame) -> np.ndarray:
    """Equibiaxial Cauchy stress (kPa) of materials, shape (2, M, stretches)."""
    at = np.array(BAND)[None]
    with np.errstate(over="ignore", invalid="ignore"):
        found = GOHLaw().material(materials).cauchy(at, at)
    return np.nan_to_num(np.array(found), nan=np.inf)


def calibrate(seed: int) -> dict[str, Any]:
    """One study: ranks of its truths, and shares of the draws below them."""
    clock, wall = time.process_time(), time.perf_counter()
    rng = np.random.default_rng([seed, 11])
    truths, specimens, rejected = drawn_study(rng)
    names = [f"s{i}" for i in range(len(specimens))]
    runs = {
        name: sampled(s, int(rng.integers(2**31)), noise="independent", priors=OWN)
        for name, s in zip(names, specimens, strict=True)
    }
    alone = time.process_time() - clock
    group = [GROUPS[g] for g in truths.group]
    donor = [f"D{d}" for d in truths.donor]
    found = pool(runs, group, donor, int(rng.integers(2**31)), PRIORS)
    draws, true = hyper_draws(found), truths.named()
    theta = found.specimen_values(10**9)
    for k, v in enumerate(truths.values):
        draws[f"{v.name} of s0"], true[f"{v.name} of s0"] = theta[:, 0, k], truths.theta[0, k]
    hyper = found.hyper()
    for g, name in enumerate(GROUPS):
        new, own = hyper.new_specimens(g, rng), truths.new_specimen(g)
        for k, v in enumerate(truths.values):
            draws[f"new {v.name}, {name}"], true[f"new {v.name}, {name}"] = new[:, k], own[k]
        theirs = band_stress(found.materials(new))
        ours = band_stress(found.materials(own[None]))
        for axis, side in enumerate("xy"):
            for j, stretch in enumerate(BAND):
                label = f"new stress_{side} at {stretch:g}, {name}"
                draws[label], true[label] = theirs[axis, :, j], ours[axis, 0, j]
    judged = found.sampled.convergence
    out: dict[str, Any] = {"state": found.state, "reason": found.reason}
    out["singles"] = [r.state for r in runs.values()]
    out |= {"rejected": rejected, "ess": judged.worst_ess, "rhat": judged.worst_rhat}
    out |= {"rank": {}, "below": {}}
    for name, x in draws.items():
        kept = rng.choice(len(x), RANKED_DRAWS, replace=False)
        out["rank"][name] = int(np.count_nonzero(x[kept] < true[name]))
        out["below"][name] = round(float(np.mean(x < true[name])), 5)
    out["cpu"] = [round(alone, 1), round(time.process_time() - clock, 1)]
    out["wall"] = round(time.perf_counter() - wall, 1)
    return out


def hyper_draws(found: Population) -> dict[str, np.ndarray]:
    """Draws of the hyperparameters by the names of :meth:`Truths.named`."""
    hyper = found.hyper()
    out: dict[str, np.ndarray] = {}
    for k, v in enumerate(found.values):
        out |= {f"mean {v.name}, {g}": hyper.mu[:, i, k] for i, g in enumerate(GROUPS)}
        out[f"sd_donors {v.name}"] = hyper.sd_donors[:, k]
        out[f"sd_specimens {v.name}"] = hyper.sd[:, 0, k]
    return out
