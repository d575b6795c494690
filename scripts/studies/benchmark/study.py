"""biaxbayes against emcee and a nested sampler (nautilus) on the same posteriors.

    python scripts/study.py benchmark --workers 2          needs the extra ``bench``
    python scripts/study.py benchmark --plain              ours and emcee alone

The five shipped specimens with both kinds of errors, one core for each posterior: effective draws
a second of our sampler and of emcee's stretch move in natural parameters on the same density, and
the agreement of quantiles and log evidence with nautilus. ``docs/benchmark.md`` quotes the tables.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

# one core each: set before NumPy starts its threads
os.environ.setdefault("OMP_NUM_THREADS", "1")

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from biaxbayes import prepare, read_specimen
from studies.benchmark.agreement import agreement
from studies.benchmark.natural_density import NaturalDensity
from studies.benchmark.samplers import emcee_reseeded, ours
from studies.common import (
    BLUE,
    DATA,
    RED,
    SPECIMENS,
    options_of,
    parser,
    run_all,
    save_figure,
    write_table,
)

NOISES = ("independent", "correlated")
TIMES_OURS, LEAST_LIMIT = 20.0, 20.0
"""Plain emcee may take so many times as long as ours to converge, and so many seconds at least."""
FULL = {"steps": 384, "live": 3000, "limit": 300}
QUICK = {"steps": 64, "live": 300, "limit": 20}
FITTED_EVERY = 20
"""Every so many draws are used to place the narrowed prior."""
CONVERGED = 1.01
"""R-hat above this is not."""


def one_posterior(name: str, noise: str, plain: bool, quick: bool) -> dict[str, Any]:
    """All samplers on one posterior."""
    size = QUICK if quick else FULL
    specimen = read_specimen(DATA / f"{name}.csv")
    posterior = prepare(specimen, noise=noise)
    posterior.log_prob(np.zeros((1, len(posterior.bounds))))  # compiled before it is timed
    density = NaturalDensity(posterior)
    mine = ours(posterior, steps=size["steps"])
    limit = max(TIMES_OURS * mine.extra["to_criterion"], LEAST_LIMIT)
    emcee = emcee_reseeded(density, limit=0.1 * limit if quick else limit)
    record: dict[str, Any] = {"rates": {"ours_over_emcee": mine.rate / emcee.rate}}
    for key, outcome in (("ours", mine), ("emcee", emcee)):
        times = {k: outcome.extra[k] for k in ("to_criterion", "fastest", "slowest")}
        values = {"per_s": outcome.rate, "rhat": outcome.rhat, **times}
        record["rates"] |= {f"{key}_{k}": float(v) for k, v in values.items()}
    if plain:
        return record
    from studies.benchmark.nested import in_a_narrowed_prior

    points = posterior.coordinates(
        {name: mine.draws[name].ravel()[::FITTED_EVERY] for name in posterior.free}
    )
    nested = in_a_narrowed_prior(posterior, points, live=size["live"], limit=size["limit"])
    a = agreement(mine, nested)
    row = {"nautilus_ess": nested.ess, "nautilus_largest": a.largest, "nautilus_where": a.where}
    row |= {"nautilus_rms": a.rms, "nautilus_quantiles": a.count, "note": nested.note}
    record["agreement"] = row
    if mine.log_evidence and nested.log_evidence:
        pairs = {"ours": mine.log_evidence, "nautilus": nested.log_evidence}
        record["evidence"] = {k: v[0] for k, v in pairs.items()}
        record["evidence"] |= {f"{k}_error": v[1] for k, v in pairs.items()}
    return record


def table_of(records: list[dict[str, Any]], part: str) -> pd.DataFrame:
    """A part of the records, a row per posterior."""
    rows = [
        {"specimen": record["case"][0], "noise": record["case"][1], **record[part]}
        for record in records
        if part in record
    ]
    return pd.DataFrame(rows)


def draw_rates(rates: pd.DataFrame, out: Path) -> None:
    """Effective draws a second of ours and of plain emcee, warm-up excluded."""
    drawing, ax = plt.subplots(figsize=(4.5, 2.9))
    for key, marker, colour in (("ours", "o", BLUE), ("emcee", "s", RED)):
        for part, fill in (
            (rates[rates[f"{key}_rhat"] <= CONVERGED], colour),
            (rates[rates[f"{key}_rhat"] > CONVERGED], "none"),
        ):
            ax.plot(part[f"{key}_per_s"], part.index, marker, color=colour, mfc=fill, ms=4.5)
        ax.plot([], [], marker, color=colour, label=key)
    ax.set(xscale="log", xlabel="effective draws a second")
    ax.set_yticks(rates.index, rates["specimen"] + ", " + rates["noise"])
    ax.invert_yaxis()
    ax.legend()
    save_figure(drawing, out, "benchmark")


def main() -> None:
    """Run all posteriors and write the tables."""
    arguments = parser(__doc__)
    arguments.add_argument("--plain", action="store_true", help="ours and emcee alone")
    options = options_of(arguments)
    names = SPECIMENS[-1:] if options.quick else SPECIMENS
    cases = [(name, noise, options.plain, options.quick) for name in names for noise in NOISES]
    records = run_all(one_posterior, cases, options.records / "benchmark.jsonl", options.workers)
    for part, name in (("rates", "samplers"), ("agreement", "agreement"), ("evidence", "evidence")):
        if len(table := table_of(records, part)):
            write_table(options.out, f"benchmark-{name}", table)
    draw_rates(table_of(records, "rates"), options.out)


if __name__ == "__main__":
    main()
