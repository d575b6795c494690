"""biaxbayes against other samplers on the same posteriors, in one run, one core each.

    OMP_NUM_THREADS=1 python scripts/study.py benchmark --write docs/benchmark.md
    python scripts/study.py benchmark --quick

The five shipped specimens with both noise models: effective draws a second and a density
evaluation of our sampler, of emcee's stretch move in natural parameters on the same compiled
density, of NUTS (numpyro) and of nested samplers (dynesty, nautilus); the cost of the densities
that a script of today and pyMechT would use; the cost of ours; wall time and memory of whole
commands. Needs the extra ``bench``.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
from pathlib import Path
from typing import Any

# One core each: set before NumPy and JAX start their threads.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault(
    "XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
)

from dataclasses import asdict

import numpy as np

from biaxbayes.model.preparation import prepare
from biaxbayes.model.search import draw_posterior
from biaxbayes.sampling.sampler import Plan
from biaxbayes.specimens.specimen_file import read_specimen
from biaxbayes.text_files import atomic_write_text
from studies.benchmark.agreement import agreement
from studies.benchmark.costs import (
    cost_of_laws,
    density_cost,
    growth_with_points,
    growth_with_walkers,
)
from studies.benchmark.natural_density import NAMES, NaturalDensity
from studies.benchmark.nested import from_the_prior, in_a_narrowed_prior
from studies.benchmark.nuts import nuts, straightened, straightened_nuts
from studies.benchmark.outcome import Outcome
from studies.benchmark.samplers import emcee_reseeded, ours
from studies.benchmark.scalar_codes import lab_script, pymecht_density, seconds_of
from studies.benchmark.tables import page, write_page
from studies.benchmark.whole import whole_commands
from studies.page import DATA, SPECIMENS

NOISES = ("independent", "effective")
ALL, PLAIN, OTHERS = "all", "plain", "others"
"""Which samplers beside ours: all, plain emcee alone, or all but plain emcee."""
PLAIN_LIMIT = 20.0
"""Plain emcee may take so many times as long as ours to converge."""
LEAST_LIMIT = 20.0  # seconds
SLICES = 8
"""Slice steps of dynesty between two points; with few its evidence is off by several units."""
FULL = {
    "steps": 384,
    "warmup": 600,
    "draws": 600,
    "long_warmup": 500,
    "long": 2000,
    "live": 500,
    "narrowed": 3000,
    "limit": 300,
    "mapped": 50_000,
}
QUICK = {
    "steps": 128,
    "warmup": 150,
    "draws": 100,
    "long_warmup": 150,
    "long": 200,
    "live": 100,
    "narrowed": 1000,
    "limit": 30,
    "mapped": 5000,
}


def _told(outcome: Outcome) -> dict[str, Any]:
    """What the page needs of an outcome, without the draws."""
    return {
        "ess": outcome.ess,
        "evaluations": outcome.evaluations,
        "seconds": outcome.seconds,
        "warmup_seconds": outcome.warmup_seconds,
        "rate": outcome.rate,
        "rate_with_warmup": outcome.rate_with_warmup,
        "rhat": outcome.rhat,
        "note": outcome.note,
        "log_evidence": outcome.log_evidence,
        **outcome.extra,
    }


def one_case(task: tuple[str, str, bool, str]) -> dict[str, Any]:
    """All samplers on one posterior, ours and plain emcee only, or all but plain emcee."""
    name, noise, quick, which = task
    size = QUICK if quick else FULL
    specimen = read_specimen(DATA / f"{name}.csv")
    posterior = prepare(specimen, noise=noise)
    draw_posterior(
        posterior, Plan(ess=50.0, workers=1, seed=9)
    )  # everything is compiled before it is timed
    density = NaturalDensity(specimen, posterior.beta)
    mine = ours(posterior, steps=size["steps"])
    found: dict[str, Any] = {"specimen": name, "noise": noise, "ours": _told(mine)}
    others: dict[str, Outcome] = {}
    if which != OTHERS:
        limit = max(PLAIN_LIMIT * mine.extra["to_criterion"], LEAST_LIMIT)
        others["emcee"] = emcee_reseeded(density, limit=0.1 * limit if quick else limit)
        found["emcee"] = _told(others["emcee"])
    if which == PLAIN:
        return found
    others["NUTS"] = nuts(density, warmup=size["warmup"], draws=size["draws"])
    if noise == "independent":  # a tempered likelihood has no evidence to compare
        others["dynesty"] = from_the_prior(density, live=size["live"], slices=SLICES)
    points = np.column_stack([mine.draws[key].ravel() for key in NAMES])
    few = np.random.default_rng(1).choice(len(points), size["mapped"], replace=False)
    straight = straightened(density, points[few])
    others["straightened"] = straightened_nuts(
        density, straight, warmup=size["long_warmup"], draws=size["long"]
    )
    others["nautilus"] = in_a_narrowed_prior(
        density, straight, live=size["narrowed"], limit=size["limit"]
    )
    found |= {key: _told(value) for key, value in others.items()}
    compared = {key: others[key] for key in ("NUTS", "straightened", "nautilus") if key in others}
    found["agreement"] = {key: asdict(agreement(mine, other)) for key, other in compared.items()}
    points = density.starts(50, np.random.default_rng(2))
    forces = points.copy()
    forces[:, 5:7] = density.problem.reading[0]
    found["lab_script_seconds"] = seconds_of(lab_script(density), forces, least=0.5)
    found["pymecht_seconds"] = seconds_of(pymecht_density(density), points, least=0.5)
    print(
        f"{name}, {noise}: ours {mine.rate:.0f}/s, "
        + ", ".join(f"{key} {value.rate:.1f}/s" for key, value in others.items()),
        flush=True,
    )
    return found


def main() -> None:
    """Run the cases, then the costs and the whole commands, and tell."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="one specimen, short runs")
    parser.add_argument("--only", default="", help="specimens whose name contains this")
    parts = parser.add_mutually_exclusive_group()
    parts.add_argument("--costs", action="store_true", help="leave the other samplers out")
    parts.add_argument("--samplers", action="store_true", help="leave costs and commands out")
    which = parser.add_mutually_exclusive_group()
    chosen: dict[str, Any] = {"dest": "which", "action": "store_const", "default": ALL}
    which.add_argument("--plain", const=PLAIN, help="ours and plain emcee only", **chosen)
    which.add_argument("--others", const=OTHERS, help="all but plain emcee", **chosen)
    parser.add_argument("--json", type=Path, help="write the figures to this file as well")
    parser.add_argument(
        "--resume", action="store_true", help="keep the posteriors that are in this file already"
    )
    parser.add_argument(
        "--from-json", type=Path, nargs="+", help="write the page of earlier runs, joined"
    )
    parser.add_argument("--jobs", type=int, default=1, help="posteriors at a time, one core each")
    parser.add_argument("--write", type=Path, help="write the page")
    options = parser.parse_args()
    if options.resume and not options.json:
        parser.error("--resume goes on with a file: say which with --json")
    if options.write and options.which == OTHERS:
        parser.error("a page needs plain emcee, too: join the two runs with --from-json")
    if options.from_json:
        found = joined(options.from_json)
    else:
        found = measured(options)
    if options.json:
        atomic_write_text(options.json, json.dumps(found, indent=1) + "\n")
    if all("emcee" in case for case in found["cases"]):  # else there is no page of this alone
        print(page(found))
    if options.write:
        write_page(found, options.write)


def joined(paths: list[Path]) -> dict[str, Any]:
    """Figures of several runs; where they overlap, those of the last."""
    found: dict[str, Any] = {}
    cases: dict[tuple[str, str], dict[str, Any]] = {}
    for path in paths:
        read = json.loads(path.read_text())
        for case in read.pop("cases", []):
            cases.setdefault((case["specimen"], case["noise"]), {}).update(case)
        found |= {key: value for key, value in read.items() if value}
    return found | {"cases": list(cases.values())}


def cases_of(path: Path, asked: dict[str, Any]) -> list[dict[str, Any]]:
    """Posteriors of an earlier run with the same options; none where there was no such run."""
    if not path.exists():
        return []
    read = json.loads(path.read_text())
    return list(read["cases"]) if all(read.get(key) == asked[key] for key in asked) else []


def measured(options: argparse.Namespace) -> dict[str, Any]:
    """All figures."""
    names = SPECIMENS[-1:] if options.quick else [n for n in SPECIMENS if options.only in n]
    tasks = [(name, noise, options.quick, options.which) for name in names for noise in NOISES]
    asked = {"quick": options.quick, "which": options.which}
    kept = cases_of(options.json, asked) if options.resume else []
    done = {(case["specimen"], case["noise"]) for case in kept}
    tasks = [task for task in tasks if task[:2] not in done]
    found: dict[str, Any] = {**asked, "cases": kept}
    if not options.samplers:
        specimen = read_specimen(DATA / "donor2-media.csv")
        evaluation, exponentials, rows = density_cost(specimen)
        found |= {
            "density": {"evaluation": evaluation, "exponentials": exponentials, "rows": rows},
            "by_points": growth_with_points(),
            "by_walkers": growth_with_walkers(specimen),
            "by_law": cost_of_laws(specimen),
            "commands": [asdict(c) for c in whole_commands(DATA, cold=not options.quick)],
        }
    if options.costs or not tasks:
        return found
    context = multiprocessing.get_context("spawn")
    with context.Pool(options.jobs, maxtasksperchild=1) as pool:
        for case in pool.imap(one_case, tasks):
            found["cases"].append(case)
            if options.json:
                atomic_write_text(options.json, json.dumps(found, indent=1) + "\n")
    return found


if __name__ == "__main__":
    main()
