"""Draw reference posteriors of biaxbayes's default model by two samplers that share no code.

    python benchmark/references.py                  all specimens (hours)
    python benchmark/references.py 05-1-plane       some; rows of the others stay

biaxbayes's own sampler (moves of emcee in coordinates that suit the posterior) and the nested
sampler nautilus (extra ``bench``). ``references.csv`` has their quantiles and, as a probability,
the largest difference between them.
"""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "scripts"))

import numpy as np
import pandas as pd

from biaxbayes import prepare
from biaxbayes.model.draw import draw_posterior
from biaxbayes.runs.archive import draw_table
from biaxbayes.sampling.sampler import Plan
from run import LEVELS, tasks
from studies.benchmark.nested import in_a_narrowed_prior
from studies.benchmark.outcome import weighted_quantiles

STORED = HERE / "references.csv"
ESS, LIVE, LIMIT_S = 4000, 1500, 1800


def reference(name: str) -> pd.DataFrame:
    """Quantiles of one posterior by both samplers, and the share below ours of nautilus."""
    posterior = prepare(tasks(name)[name].specimen)
    drawn = draw_posterior(posterior, Plan(ess=ESS, workers=1))
    draws = draw_table(drawn.quantities)
    some = {n: draws[n].to_numpy()[:: max(1, len(draws) // 4000)] for n in posterior.free}
    nested = in_a_narrowed_prior(posterior, posterior.coordinates(some), live=LIVE, limit=LIMIT_S)
    weight, rows = nested.draws["weight"], []
    for parameter in posterior.parameter_names:
        ours = np.quantile(draws[parameter], LEVELS)
        theirs = nested.draws[parameter]
        q = weighted_quantiles(theirs, weight, LEVELS)
        below = [float(weight[theirs <= value].sum() / weight.sum()) for value in ours]
        differs = float(np.abs(np.subtract(below, LEVELS)).max())
        for sampler, values, ess in (("biaxbayes", ours, ESS), ("nautilus", q, nested.ess)):
            row = {"specimen": name, "sampler": sampler, "parameter": parameter}
            row |= dict(zip(("q05", "q50", "q95"), values, strict=True))
            rows.append(row | {"effective_draws": int(ess), "largest_difference": differs})
    print(f"{name}: largest difference {max(r['largest_difference'] for r in rows):.3f}, "
          f"nautilus {nested.ess:.0f} effective draws {nested.note}")  # fmt: skip
    return pd.DataFrame(rows)


def store(new: pd.DataFrame) -> None:
    """Put the rows of a specimen into the table, in place of those that it had."""
    old = pd.read_csv(STORED) if STORED.exists() else new[:0]
    rows = pd.concat([old[~old["specimen"].isin(new["specimen"])], new])
    rows = rows.sort_values("specimen", kind="stable")
    rows.to_csv(STORED, index=False, float_format="%.6g", lineterminator="\n")


if __name__ == "__main__":
    for wanted in sys.argv[1:] or tasks():
        store(reference(wanted))
