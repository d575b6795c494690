"""Draw the figures of docs/identifiability.md from the shipped specimens.

    python scripts/draw_identifiability.py

The kappa profiles are the method paper's demonstration (kappa fixed over a range, the others
fitted again), one layer a row.
"""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from biaxbayes.findings.identifiability import identify_draws
from biaxbayes.findings.profile import profile_likelihood
from biaxbayes.inference.posterior import Posterior
from biaxbayes.inference.sampler import Plan, draw
from biaxbayes.output.figures.identifiability import identifiability_figure
from biaxbayes.output.figures.profile import profile_figure
from biaxbayes.output.style import save_figure
from biaxbayes.specimens.specimen_file import read_specimen

ROOT = Path(__file__).resolve().parents[1]
LAYERS = ("donor2-intima", "donor2-media", "donor2-adventitia")


def main() -> None:
    figures = ROOT / "docs" / "figures"
    found, titles = [], []
    for name in LAYERS:
        specimen = read_specimen(ROOT / "data" / f"{name}.csv")
        profile = profile_likelihood(Posterior(specimen), "kappa")
        print(f"{name}: {profile.in_words()}")
        found.append(profile)
        titles.append(f"{specimen.layer}")
    save_figure(profile_figure(found, titles=titles), figures / "kappa-profiles.png")
    posterior = Posterior(read_specimen(ROOT / "data" / "donor2-adventitia.csv"))
    drawn = draw(posterior, Plan(seed=1))
    draws = pd.DataFrame({n: q.ravel() for n, q in drawn.quantities.items()})
    verdicts = identify_draws(posterior, draws, drawn.convergence.state)
    print("\n".join(verdicts.in_words()))
    save_figure(identifiability_figure(verdicts), figures / "identifiability-adventitia.png")


if __name__ == "__main__":
    main()
