"""How often the verdicts are right: specimens of known answer, many seeds.

    python scripts/study.py verdicts [--seeds 12]

Prints, for every kind of specimen, how often each parameter got which verdict; --write puts the
table into a page between its marks.
"""

from __future__ import annotations

import argparse
from collections import Counter
from fractions import Fraction
from pathlib import Path

import pandas as pd

from biaxbayes.identifiability.identify import ParameterVerdict, identify_draws
from biaxbayes.identifiability.verdict import Thresholds
from biaxbayes.identifiability.verdict_names import ONE_SIDED
from biaxbayes.laws.goh import GOH, GOHLaw
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.search import draw_posterior
from biaxbayes.sampling.sampler import Plan
from biaxbayes.specimens.virtual_specimen import Machine, virtual_specimen
from studies.page import put, table

THREE_RATIOS = ((1.0, 1.0), (1.0, 0.5), (0.5, 1.0))
FIRST_SEED = 100
PARAMETERS = GOHLaw().names
# material, largest total stretch, ratios, noise of the load cell in N
KINDS = {
    "three ratios to a stretch of 1.25, sd 1 mN": (
        GOH(10, 40, 5, 40, 0.15),
        1.25,
        THREE_RATIOS,
        0.001,
    ),
    "isotropic, three ratios": (GOH(10, 40, 5, 30, 1 / 3), 1.25, THREE_RATIOS, 0.002),
    "aligned fibres, three ratios": (GOH(10, 20, 5, 40, 0.0), 1.2, THREE_RATIOS, 0.002),
    "three ratios to a stretch of 1.05": (GOH(10, 50, 5, 40, 0.2), 1.05, THREE_RATIOS, 0.002),
    "equibiaxial to 1.2": (GOH(10, 40, 5, 40, 0.15), 1.2, ((1.0, 1.0),), 0.005),
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
    return {name: told(found[name], found.thresholds) for name in PARAMETERS}


def told(found: ParameterVerdict, thresholds: Thresholds) -> str:
    """A verdict, with the end of the range that a one-sided one does not exclude."""
    if found.verdict != ONE_SIDED or found.evidence is None:
        return found.verdict
    end = found.evidence.open_edges(thresholds)[0].value
    return f"{found.verdict} ({Fraction(end).limit_denominator(3)})"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=12)
    parser.add_argument("--write", type=Path, help="Markdown page whose table is replaced")
    options = parser.parse_args()
    seeds = range(FIRST_SEED, FIRST_SEED + options.seeds)
    counts: Counts = {}
    for kind in KINDS:
        found = [verdicts(kind, seed) for seed in seeds]
        counts[kind] = {name: Counter(f[name] for f in found) for name in PARAMETERS}
        print(*row(kind, counts[kind]), sep=" | ", flush=True)
    if options.write:
        write_place(options.write, counts)


Counts = dict[str, dict[str, Counter[str]]]
"""How often each parameter of each kind got which verdict."""


def row(kind: str, counts: dict[str, Counter[str]]) -> list[str]:
    """A kind of specimen with the verdicts on its parameters, the most frequent first."""
    return [kind, *(", ".join(f"{v} {n}" for v, n in c.most_common()) for c in counts.values())]


def result(counts: Counts) -> str:
    """What the richest and the poorest test tell of the parameters."""
    richest, *_, poorest = KINDS
    seeds = counts[richest][PARAMETERS[0]].total()
    known, unknown = (
        [name for name, of in counts[kind].items() if of["identified"] == wanted]
        for kind, wanted in ((richest, seeds), (poorest, 0))
    )
    return (
        f"**Verdicts on specimens of known answer: of {richest}, {', '.join(known)} are identified "
        f"on all of {seeds} seeds; of {poorest}, {', '.join(unknown)} on none.**"
    )


def write_place(page: Path, counts: Counts) -> None:
    """Put the table, and what it comes to, into a page."""
    rows = [row(kind, of) for kind, of in counts.items()]
    put(page, "result verdicts", result(counts))
    put(page, "verdicts", table(["specimen", *PARAMETERS], rows, left=1 + len(PARAMETERS)))


if __name__ == "__main__":
    main()
