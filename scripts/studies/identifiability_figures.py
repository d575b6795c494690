"""Draw the figures of docs/identifiability.md from the shipped specimens.

    python scripts/study.py identifiability_figures

The kappa profiles are the method paper's demonstration (kappa fixed over a range, the others
fitted again), one layer a row.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import pandas as pd

from biaxbayes.figures.run.identifiability import identifiability_figure
from biaxbayes.figures.run.profile import profile_figure
from biaxbayes.figures.style import save_figure
from biaxbayes.identifiability.identify import identify_draws
from biaxbayes.identifiability.profile.profile import profile_likelihood
from biaxbayes.model.preparation import prepare
from biaxbayes.model.search import draw_posterior
from biaxbayes.sampling.sampler import Plan
from biaxbayes.specimens.specimen_file import read_specimen
from studies.page import DATA, DOCS

LAYERS = ("donor2-intima", "donor2-media", "donor2-adventitia")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=DOCS / "figures")
    figures = parser.parse_args().out
    found, titles = [], []
    for name in LAYERS:
        specimen = read_specimen(DATA / f"{name}.csv")
        profile = profile_likelihood(prepare(specimen), "kappa")
        print(f"{name}: {profile.in_words()}")
        found.append(profile)
        titles.append(f"{specimen.layer}")
    save_figure(profile_figure(found, titles=titles), figures / "kappa-profiles.png")
    posterior = prepare(read_specimen(DATA / "donor2-adventitia.csv"))
    drawn = draw_posterior(posterior, Plan(seed=1))
    draws = pd.DataFrame({n: q.ravel() for n, q in drawn.quantities.items()})
    verdicts = identify_draws(posterior, draws, drawn.convergence.state)
    print("\n".join(verdicts.in_words()))
    save_figure(identifiability_figure(verdicts), figures / "identifiability-adventitia.png")


if __name__ == "__main__":
    main()
