"""How often the verdicts are right: specimens of known answer, many seeds.

    python scripts/study.py verdicts [--seeds 12]

Prints, for every kind of specimen, how often each parameter got which verdict: the table at the end
of docs/identifiability.md.
"""

from __future__ import annotations

import argparse
from collections import Counter

import pandas as pd

from biaxbayes.identifiability.identify import identify_draws
from biaxbayes.laws.goh import GOH, GOHLaw
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.search import draw_posterior
from biaxbayes.sampling.sampler import Plan
from biaxbayes.specimens.virtual_specimen import Machine, virtual_specimen

THREE_RATIOS = ((1.0, 1.0), (1.0, 0.5), (0.5, 1.0))
FIRST_SEED = 100
PARAMETERS = GOHLaw().names
# material, largest total stretch, ratios, noise of the load cell in N
KINDS = {
    "three ratios to 1.25, 1 mN": (GOH(10, 40, 5, 40, 0.15), 1.25, THREE_RATIOS, 0.001),
    "isotropic, three ratios": (GOH(10, 40, 5, 30, 1 / 3), 1.25, THREE_RATIOS, 0.002),
    "aligned, three ratios": (GOH(10, 20, 5, 40, 0.0), 1.2, THREE_RATIOS, 0.002),
    "three ratios to 1.05": (GOH(10, 50, 5, 40, 0.2), 1.05, THREE_RATIOS, 0.002),
    "equibiaxial": (GOH(10, 40, 5, 40, 0.15), 1.2, ((1.0, 1.0),), 0.005),
}


def verdicts(kind: str, seed: int) -> dict[str, str]:
    """Verdicts on the five parameters of one virtual specimen."""
    material, top, ratios, noise = KINDS[kind]
    specimen, _ = virtual_specimen(
        material,
        name=kind,
        mounting_stretch=(1.01, 1.02),
        total_stretch=top,
        ratios=ratios,
        increments=20,
        machine=Machine(noise_N=noise),
        seed=seed,
    )
    posterior = Posterior(specimen, noise="independent")
    drawn = draw_posterior(posterior, Plan(ess=100.0, seed=1))
    draws = pd.DataFrame({name: q.ravel() for name, q in drawn.quantities.items()})
    found = identify_draws(posterior, draws, drawn.convergence.state)
    return {name: found[name].verdict for name in PARAMETERS}


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--seeds", type=int, default=12)
    seeds = range(FIRST_SEED, FIRST_SEED + arguments.parse_args().seeds)
    for kind in KINDS:
        found = [verdicts(kind, seed) for seed in seeds]
        told = [
            f"{name}: "
            + ", ".join(f"{v} {n}" for v, n in Counter(f[name] for f in found).most_common())
            for name in PARAMETERS
        ]
        print(f"{kind}\n  " + "\n  ".join(told), flush=True)


if __name__ == "__main__":
    main()
