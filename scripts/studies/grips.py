"""The correction for hooks: coverage on virtual specimens, and what a wrong geometry costs.

    python scripts/study.py grips --first 200 --count 40     coverage, about half an hour
    python scripts/study.py grips --count 2                  wrong geometry, r along the posterior

``docs/grips.md`` quotes the tables; its figure is the one in the run folder of hooked-weisbecker.
Every virtual specimen is computed on a finer mesh of other elements, and has load noise alone.
It is sampled three times: corrected, as measured, and as it would be without hooks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import emcee
import numpy as np
import pandas as pd

from biaxbayes import GOH, Dimensions, prepare, read_specimen
from biaxbayes.errors import BiaxbayesError
from biaxbayes.fem.sheet_tester import Hooks
from biaxbayes.fitting.fit import fit
from biaxbayes.fitting.fit_result import FitResult
from biaxbayes.grips.correction import (
    COARSE_ELEMENTS,
    GripCorrection,
    RowRatios,
    correct_for_grips,
    grip_ratios,
    mark_grip_corrected,
)
from biaxbayes.model import density
from biaxbayes.model.draw import draw_posterior
from biaxbayes.sampling.sampler import Plan
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.virtual_specimen import Machine, virtual_specimen
from studies.common import DATA, options_of, parser, print_table, run_all

FINE: dict[str, Any] = {"elements": 44, "serendipity": True}
THREE = ((1.0, 1.0), (1.0, 0.5), (0.5, 1.0))
LARGEST_STRESS_KPA = (40.0, 120.0)
QUANTITIES = ("C1", "k1", "k2", "alpha", "kappa", "mounting_stretch_x", "mounting_stretch_y")
STATED: dict[str, Any] = {"grips": "hooks 5", "grip_inset_mm": 1.5}
WRONG: dict[str, dict[str, Any]] = {
    "as it is": {},
    "inset 0.5 mm too small": {"grip_inset_mm": 1.0, "grip_width_mm": 2.0},
    "inset 0.5 mm too large": {"grip_inset_mm": 2.0},
    "4 hooks stated for 5": {"grips": "hooks 4"},
    "6 hooks stated for 5": {"grips": "hooks 6"},
    "patch 1 mm instead of 2": {"grip_width_mm": 1.0},
}


def stated(specimen: Specimen, hooks: dict[str, Any]) -> Specimen:
    """The specimen with its grips in the header."""
    return replace(specimen, metadata={**specimen.metadata, **hooks})


def fitted(specimen: Specimen):
    """The fit that a correction goes with."""
    return fit(specimen, "constrained")


def moved(fit: FitResult, other: FitResult) -> dict[str, float]:
    """What another fit finds less what a fit finds, by quantity."""
    first, second = ((*f.material.values, *f.mounting_stretch[0]) for f in (fit, other))
    return {q: float(b - a) for q, a, b in zip(QUANTITIES, first, second, strict=True)}


# --- virtual specimens ---------------------------------------------------------------------------


def drawn(case: int) -> tuple[GOH, tuple[float, float], Dimensions, Hooks, float]:
    """Material, mounting stretches, dimensions, hooks and largest equibiaxial stretch of a case."""
    rng = np.random.default_rng([50, case])
    material = GOH(
        *np.exp(rng.uniform(np.log([3.0, 10.0, 2.0]), np.log([30.0, 150.0, 30.0]))),
        rng.uniform(25.0, 65.0),
        rng.uniform(0.02, 0.28),
    )
    mounting = tuple(rng.uniform(1.005, 1.03, 2))
    edge = rng.uniform(10.0, 25.0)
    hooks = Hooks(int(rng.integers(4, 8)), rng.uniform(0.06, 0.1) * edge, 0.05 * edge)
    stress = np.exp(rng.uniform(*np.log(LARGEST_STRESS_KPA)))
    tops = np.linspace(1.03, 1.35, 400)
    largest = np.max(material.cauchy(tops * mounting[0], tops * mounting[1]), axis=0)
    top = tops[min(int(np.searchsorted(largest, stress)), tops.size - 1)]
    return material, mounting, Dimensions(edge, edge, 0.05 * edge), hooks, float(top)


def tested(case: int, protocols: int, misfit: float = 0.0) -> tuple[Specimen, Specimen]:
    """A virtual specimen on hooks with its keys, and as it would be without hooks."""
    material, mounting, dimensions, hooks, top = drawn(case)
    # 0.002 C1 times the section, about that of the shipped specimens; five times that with misfit
    share = 1e-5 if misfit else 2e-6
    noise = float(share * material.C1_kPa * 1e3 * dimensions.area.mean())
    test: dict[str, Any] = {
        "mounting_stretch": mounting,
        "measured_stretch": top,
        "ratios": THREE[:protocols],
        "increments": 25,
        "dimensions": dimensions,
        "machine": Machine(noise_N=noise, misfit=misfit),
        "seed": case,
        "name": f"case {case}" + (" with misfit" if misfit else ""),
    }
    measured, _ = virtual_specimen(material, hooks=hooks, **FINE, **test)
    twin, _ = virtual_specimen(material, **test)
    keys = {"grips": f"hooks {hooks.count}", "grip_inset_mm": hooks.inset_mm}
    return stated(measured, keys | {"grip_width_mm": 2.0 * hooks.radius_mm}), twin


def one_specimen(case: int, protocols: int) -> dict[str, Any]:
    """Which 90 % intervals contain the true value: corrected, as measured, without hooks."""
    material, mounting, *_ = drawn(case)
    record: dict[str, Any] = {"state": "done"}
    try:
        measured, twin = tested(case, protocols)
        correction = correct_for_grips(measured, fitted)
    except BiaxbayesError as error:
        return {"state": str(error)}
    record |= {"seconds": correction.seconds, "rounds": correction.rounds}
    record |= {"mesh": correction.mesh_difference, "ratio": correction.range.tolist()}
    record["coarse"] = moved(correction.fit, correction.coarse_fit)
    truth = dict(zip(QUANTITIES, (*material.values, *mounting), strict=True))
    samples = {
        "corrected": correction.specimen,
        "as measured": mark_grip_corrected(measured),
        "without hooks": twin,
    }
    for name, specimen in samples.items():
        posterior = prepare(specimen, seed=case)
        draws = draw_posterior(posterior, Plan(ess=500.0, seed=case))
        low, high = (
            {q: float(np.quantile(draws.quantities[q], share)) for q in QUANTITIES}
            for share in (0.05, 0.95)
        )
        record[name] = {
            "state": draws.convergence.state,
            "holds": {q: bool(low[q] <= truth[q] <= high[q]) for q in QUANTITIES},
            "width": {q: high[q] - low[q] for q in QUANTITIES},
        }
    return record


def coverage(records: Iterable[dict[str, Any]]) -> pd.DataFrame:
    """Share of 90 % intervals that contain the true value, and their widths without hooks = 1."""
    rows = []
    for record in records:
        for name in ("corrected", "as measured", "without hooks"):
            for q in QUANTITIES:
                width = record[name]["width"][q] / record["without hooks"]["width"][q]
                kind = "mounting" if q.startswith("mounting") else "material"
                rows.append((record["case"][1], name, kind, record[name]["holds"][q], width))
    table = pd.DataFrame(rows, columns=["protocols", "data", "parameters", "coverage", "width"])
    grouped = table.groupby(["protocols", "data", "parameters"])
    out = grouped.agg(intervals=("coverage", "size"), coverage=("coverage", "mean"))
    return out.assign(median_width=grouped["width"].median()).reset_index()


# --- r at every material of the posterior --------------------------------------------------------

RUNS, WALKERS, STEPS = 50, 64, 4000


def following_r(specimen: Specimen, runs: int = RUNS, steps: int = STEPS) -> pd.DataFrame:
    """What the posterior would be if r followed the material, against r at the fit.

    ln r of every row is linear in ln k1/C1, ln k2, alpha, kappa and the mounting stretches, fitted
    to finite elements at draws of the posterior. Both posteriors are sampled by emcee.
    """
    correction = correct_for_grips(specimen, fitted)
    posterior = prepare(correction.specimen, max_rows="none")
    draws = draw_posterior(posterior, Plan(ess=500.0))
    columns = {name: np.ravel(values) for name, values in draws.quantities.items()}
    at_fit = log_ratios(correction.ratios)
    surface, error = linear_surface(correction, columns, runs)
    problem = posterior.assembly.problem
    tests = correction.specimen.protocols
    later = np.concatenate([np.arange(p.rows) >= p.rest_rows for p in tests])
    load = np.concatenate([np.column_stack([p.load_x, p.load_y]) for p in tests])[later]
    readings = posterior.readings

    def log_prob(u: np.ndarray, follow: bool) -> np.ndarray:
        at = density.evaluate(problem, u)
        inside = np.isfinite(at.log_prior)
        for i in np.flatnonzero(inside) if follow else ():
            theta, mounting = at.values[i, :5].copy(), at.values[i, -2:]
            theta[3] = np.degrees(theta[3])
            # loads are f / r(fit) in the run, f / r(theta, lm) here
            more = np.exp(at_fit - surface(*theta, *mounting)) - 1.0
            at.residual[i] += readings.means(more[later] * load)
            at.residual[i, : readings.mounting_count] += (
                more[0] * posterior.rows.mounting_load.ravel()
            )
        out = np.full(len(u), -np.inf)
        noise_sd = at.values[inside, problem.size][:, None]
        out[inside] = at.log_prior[inside]
        out[inside] += posterior.log_likelihood(at.residual[inside], noise_sd)
        return out

    rng = np.random.default_rng(0)
    chosen = rng.choice(columns["C1"].size, WALKERS, replace=False)
    start = posterior.coordinates({name: columns[name][chosen] for name in posterior.free})
    samples = []
    for follow in (False, True):
        moves = [(emcee.moves.DEMove(), 0.6), (emcee.moves.StretchMove(), 0.4)]
        sampler = emcee.EnsembleSampler(
            *start.shape, log_prob, args=(follow,), vectorize=True, moves=moves
        )
        sampler.random_state = np.random.RandomState(0).get_state()
        sampler.run_mcmc(start, steps)
        samples.append(posterior.natural(sampler.get_chain(discard=steps // 2, thin=10, flat=True)))
    constant, followed = samples
    rows = []
    for q in QUANTITIES:
        widths = [np.subtract(*np.quantile(x[q], (0.95, 0.05))) for x in samples]
        shift = (followed[q].mean() - constant[q].mean()) / constant[q].std()
        coarse = moved(correction.fit, correction.coarse_fit)[q] / constant[q].std()
        row = {"specimen": specimen.name, "quantity": q, "shift_sd": shift}
        row |= {"width": widths[1] / widths[0], "coarse_mesh_sd": coarse}
        rows.append(row | {"surface_error": error})
    return pd.DataFrame(rows)


def followed_specimens() -> list[Specimen]:
    """Both shipped specimens, and virtual ones with one and three protocols, two with misfit."""
    names = ("hooked-media", "hooked-weisbecker")
    shipped = [stated(read_specimen(DATA / f"{name}.csv"), STATED) for name in names]
    cases = ((200, 1, 0.0), (200, 1, 0.01), (201, 3, 0.01))
    return shipped + [tested(*case)[0] for case in cases]


def log_ratios(ratios: tuple[RowRatios, ...]) -> np.ndarray:
    """Logarithms of r of all rows in x and y."""
    return np.log(np.concatenate([r.force for r in ratios]))


def linear_surface(
    correction: GripCorrection, columns: dict[str, np.ndarray], runs: int
) -> tuple[Callable[..., np.ndarray], float]:
    """A linear function for ln r of all rows, and its largest held-out error."""
    measured, fit = correction.measured, correction.fit
    count = len(measured.protocols)

    def computed(*values: float) -> np.ndarray:
        mounting = [np.array(values[5:])] * count
        return log_ratios(grip_ratios(measured, GOH(*values[:5]), mounting, COARSE_ELEMENTS))

    def features(C1, k1, k2, alpha, kappa, lm_x, lm_y) -> np.ndarray:
        terms = np.log(k1 / C1), np.log(k2), alpha, kappa, lm_x, lm_y
        return np.stack([np.ones_like(terms[0]), *terms], axis=-1)

    size = columns["C1"].size
    points = np.array([columns[q][np.linspace(0, size - 1, runs).astype(int)] for q in QUANTITIES])
    # the coarse mesh tells how ln r changes, the fine one what it is at the fit
    centre = computed(*fit.material.values, *fit.mounting_stretch[0])
    logs = np.array([computed(*p) for p in points.T]) - centre + log_ratios(correction.ratios)
    X, held_out = features(*points), np.arange(runs) % 4 == 0
    some = np.linalg.lstsq(X[~held_out], logs[~held_out].reshape((~held_out).sum(), -1))[0]
    error = float(np.abs(X[held_out] @ some - logs[held_out].reshape(held_out.sum(), -1)).max())
    coefficients = np.linalg.lstsq(X, logs.reshape(runs, -1))[0]
    return lambda *q: (features(*q) @ coefficients).reshape(logs.shape[1:]), error


# --- wrong geometry ------------------------------------------------------------------------------


def wrong_geometry(wrong: dict[str, dict[str, Any]]) -> pd.DataFrame:
    """The corrected fit of the shipped hooked specimens where the header misstates the hooks."""
    rows = []
    for name in ("hooked-media", "hooked-weisbecker"):
        specimen = read_specimen(DATA / f"{name}.csv")
        for label, change in wrong.items():
            correction = correct_for_grips(stated(specimen, STATED | change), fitted)
            material, lm = correction.fit.material, correction.fit.mounting_stretch[0]
            values = dict(zip(QUANTITIES, (*material.values, *lm), strict=True))
            rows.append({"specimen": name, "stated": label, **values})
    return pd.DataFrame(rows)


def main() -> None:
    """Print the tables; the coverage by specimen goes into a file."""
    arguments = parser(__doc__)
    arguments.add_argument("--first", type=int, default=0, help="number of the first specimen")
    arguments.add_argument("--count", type=int, default=40, help="specimens")
    options = options_of(arguments)
    if options.quick:
        print_table("grips-wrong-geometry", wrong_geometry({"as it is": {}}))
        print_table("grips-following-r", following_r(followed_specimens()[1], runs=12, steps=50))
    elif options.first == 0:
        print_table("grips-wrong-geometry", wrong_geometry(WRONG))
        print_table("grips-following-r", pd.concat([following_r(s) for s in followed_specimens()]))
    count = 1 if options.quick else options.count
    cases = [(i, 3 if i % 2 else 1) for i in range(options.first, options.first + count)]
    records = run_all(one_specimen, cases, options.records / "grips.jsonl", options.workers)
    done = [r for r in records if r["state"] == "done"]
    print(f"\n{len(done)} of {len(records)} specimens")
    print_table("grips-coverage", coverage(done))
    columns = ("case", "seconds", "rounds", "mesh")
    table = pd.DataFrame([{key: r[key] for key in columns} for r in done])
    print_table("grips-specimens", table)


if __name__ == "__main__":
    main()
