"""Verdicts are monotone: worse data and looser priors never tell more.

Over virtual specimens of random materials, protocols, noise and smooth misfit.
"""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.stats import norm

from biaxbayes.identifiability.identify import Identifiability, identify_draws
from biaxbayes.identifiability.verdict import ParameterVerdict
from biaxbayes.laws.goh import GOH
from biaxbayes.model.draw import draw_posterior
from biaxbayes.model.preparation import prepare
from biaxbayes.sampling.sampler import Plan
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.virtual_specimen import Machine, virtual_specimen

MOUNTING = ("mounting_stretch_x", "mounting_stretch_y")
STRENGTH = {"identified": 3, "bounded": 2, "only in combination": 1, "not identified": 0}
ESS = 1500.0


def random_specimen(seed: int) -> Specimen:
    rng = np.random.default_rng([seed, 23])
    C1, k1, k2 = np.exp(rng.normal(np.log([8.0, 15.0, 4.0]), 0.5))
    made, _ = virtual_specimen(
        GOH(C1, k1, k2, rng.uniform(20.0, 70.0), rng.uniform(0.0, 0.3)),
        name=f"random {seed}",
        mounting_stretch=(rng.uniform(1.005, 1.1), rng.uniform(1.005, 1.1)),
        total_stretch=1.25,
        ratios=((1.0, 1.0), (1.0, 0.5), (0.5, 1.0))[: rng.integers(1, 4)],
        increments=30,
        machine=Machine(
            noise_N=float(rng.choice([0.001, 0.003, 0.01])),
            misfit=float(rng.choice([0.0, 0.01, 0.02])),
        ),
        seed=seed,
    )
    return made


def judged(specimen: Specimen, seed: int = 4, **options: object) -> Identifiability:
    posterior = prepare(specimen, **options)
    drawn = draw_posterior(posterior, Plan(ess=ESS, seed=seed))
    draws = pd.DataFrame({name: q.ravel() for name, q in drawn.quantities.items()})
    return identify_draws(posterior, draws, drawn.convergence.state)


def end_error(sd: float) -> float:
    """Monte Carlo error of the 5 % point of normal draws: sqrt(p (1 - p) / ESS) / density there."""
    z = norm.ppf(0.05)
    return float(np.sqrt(0.05 * 0.95 / ESS) / norm.pdf(z) * sd)


def strength(verdict: ParameterVerdict) -> int:
    """How much a verdict says; an open or a missing one nothing."""
    return STRENGTH.get(verdict.verdict, -1)


def check_monotone(seed: int) -> None:
    specimen = random_specimen(seed)
    base = judged(specimen)
    worse = judged(replace(specimen, load_noise=2.0 * specimen.noise_sd))
    loose = judged(specimen, mounting_sd=0.2)
    for name in MOUNTING:
        first, second, wide = base[name], worse[name], loose[name]
        output = (seed, name, first.assessment, second.assessment, wide.assessment)
        if strength(second) > strength(first):
            # close to a threshold the Monte Carlo error decides: other draws of the same posterior
            first = judged(specimen, seed=5)[name]
        assert strength(second) <= strength(first), output
        assert first.diagnostics is not None and wide.diagnostics is not None
        # four ends, each with its error
        error = 2.0 * end_error((first.diagnostics.high - first.diagnostics.low) / 3.3)
        width = wide.diagnostics.high - wide.diagnostics.low
        assert width > first.diagnostics.high - first.diagnostics.low - 3.0 * error, output


@pytest.mark.long
@pytest.mark.parametrize("seed", [700, 701])
def test_worse_data_and_wider_priors_never_tell_more(seed):
    check_monotone(seed)
