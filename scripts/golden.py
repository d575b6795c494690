"""Record what the package computes, and compare a later state of the code with the record.

    python scripts/golden.py record              writes scripts/golden.json (some minutes)
    python scripts/golden.py compare             says what is equal, within Monte Carlo error, moved

A section can be named: densities, fits, paper, runs, batch, population, laws. Runs and studies are
sampled anew, so that they are compared by their quantiles: the Monte Carlo error of a quantile
follows from the effective sample size of both records. The exit code of ``compare`` is 1 where
something moved.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import biaxbayes
from biaxbayes.laws import LAWS
from biaxbayes.laws.published import MATERIALS

ROOT = Path(__file__).resolve().parent.parent
RECORD = ROOT / "scripts" / "golden.json"

SHIPPED = ("donor1", "donor2", "donor2-intima", "donor2-media", "donor2-adventitia", "hooked-media")
OTHER_LAWS = tuple(LAWS)[1:]
MOUNTINGS = ("noisy", "exact", "free", "ignored", "zeroed")
PRESTRETCHES = (1.005, 1.010, 1.015, 1.020)

EQUAL = 1e-9
"""Relative difference up to which two numbers are the same: rounding in another order."""
FIT_TOLERANCE = 1e-4
"""Relative difference up to which two least-squares optima are the same."""
SCORE = 4.5
"""Standard errors up to which two quantiles agree; some 1,000 are compared."""
DEFAULT_ESS = 400.0
"""Effective draws of a table that does not print them."""

Table = dict[str, dict[str, float | str]]
"""Values by row and column."""


# --- what is run ---------------------------------------------------------------------------------


def specimen(name: str) -> biaxbayes.Specimen:
    """A shipped specimen; ``NAME@mounted`` has its dimensions measured in the mounted state."""
    stem, _, geometry = name.partition("@")
    read = biaxbayes.read_specimen(ROOT / "data" / f"{stem}.csv")
    if not geometry:
        return read
    values = {field: getattr(read, field) for field in read.__dataclass_fields__}
    return biaxbayes.Specimen(**values | {"geometry": geometry})


def run_cases() -> dict[str, tuple[str, dict[str, Any], int]]:
    """Specimen, options and seed of every run, by name."""
    cases: list[tuple[str, dict[str, Any], int]] = []
    cases += [(name, {"noise": n}, 1) for name, n in product(SHIPPED, ("independent", "effective"))]
    cases += [("donor2-media", {"mounting": mounting}, 1) for mounting in MOUNTINGS[1:]]
    cases += [("donor2-media", {"noise_growth": True}, 1)]
    cases += [("donor2-media@mounted", {"mounting": m}, 1) for m in ("noisy", "exact")]
    cases += [
        (name, {"law": law}, 1) for name, law in product(("donor2-media", "donor1"), OTHER_LAWS)
    ]
    cases += [("donor2-media", {}, seed) for seed in (2, 3)]
    return {
        " ".join([name, *(f"{k}={v}" for k, v in options.items()), f"seed={seed}"]): (
            name,
            options,
            seed,
        )
        for name, options, seed in cases
    }


def run(case: tuple[str, dict[str, Any], int]) -> dict[str, Any]:
    """Summary and verdicts of a run, and log densities at a few of its draws."""
    name, options, seed = case
    with tempfile.TemporaryDirectory() as folder:
        result = biaxbayes.sample(
            specimen(name), out=Path(folder) / "run", seed=seed, max_steps=2000, **options
        )
        posterior = result.posterior()
        names = [*posterior.free]
        draws = result.draws[[n for n in names if n in result.draws]]
        points = draws.iloc[:: max(1, len(draws) // 5)][:5].to_dict("list")
        summary = table(result.path / "summary.csv")
        for parameter, row in table(result.path / "report.csv").items():
            summary[parameter]["verdict"] = row["verdict"]
        return {"summary": summary, "beta": posterior.beta, "points": points}


def density(case: tuple[str, dict[str, Any], int], record: dict[str, Any]) -> list[float]:
    """Log densities at recorded points under the recorded weight, up to a constant."""
    name, options, _ = case
    posterior = biaxbayes.Posterior(specimen(name), **options, beta=record["beta"])
    values = posterior.log_density({k: np.array(v) for k, v in record["points"].items()})
    return [float(v) for v in np.atleast_1d(values - values[0])]


def fits(name: str) -> Table:
    """Every deterministic fit of a shipped specimen."""
    return {
        str(fit.record()["method"]): {
            k: v
            for k, v in fit.record().items()
            if isinstance(v, float | int) and k not in ("iterations", "converged")
        }
        for fit in biaxbayes.fit_all(specimen(name))
    }


def paper_cells() -> Table:
    """Fits of the eight virtual experiments of the paper's Tables 3 and 4."""
    cells: Table = {}
    for name, stretch in product(("smoljkic-m55", "weisbecker-media"), PRESTRETCHES):
        virtual, _ = biaxbayes.virtual_specimen(
            MATERIALS[name].material,
            name=name,
            mounting_stretch=(stretch, stretch),
            total_stretch=1.2,
            machine=biaxbayes.Machine(noise_N=0.0),
            seed=1,
        )
        for method in ("standard", "zeroed", "fip", "linden"):
            values = biaxbayes.fit(virtual, method).record()
            cells[f"{name} {stretch:.3f} {method}"] = {
                k: v for k, v in values.items() if isinstance(v, float)
            }
    return cells


STUDY = """
[[specimen]]
file = "{data}/donor2-intima.csv"
donor = "D2"

[[specimen]]
file = "{data}/donor2-media.csv"
donor = "D2"

[[specimen]]
file = "{data}/donor2-adventitia.csv"
donor = "D2"
"""


def virtual_study(folder: Path) -> Path:
    """Six virtual specimens of three donors, whose parameters the data determine, as a study."""
    entries = []
    for number in range(6):
        C1, k1, k2, alpha, kappa = MATERIALS["weisbecker-media"].material.values
        factor = 1.0 + 0.1 * (number - 2.5)
        virtual, _ = biaxbayes.virtual_specimen(
            biaxbayes.GOH(C1 * factor, k1 / factor, k2, alpha + number, kappa),
            name=f"media-{number}",
            mounting_stretch=(1.01 + 0.002 * number, 1.012),
            measured_stretch=1.2,
            increments=50,
            ratios=((1.0, 1.0), (1.0, 0.6), (0.6, 1.0)),
            machine=biaxbayes.Machine(noise_N=5e-3),
            seed=number,
        )
        path = folder / f"media-{number}.csv"
        biaxbayes.write_specimen(virtual, path)
        entries.append(f'[[specimen]]\nfile = "{path}"\ndonor = "P{number // 2}"\n')
    study = folder / "study.toml"
    study.write_text("\n".join(entries), encoding="utf-8")
    return study


def batch() -> Table:
    """Rows of study.csv of the three layers of a donor."""
    with tempfile.TemporaryDirectory() as folder:
        study = Path(folder) / "study.toml"
        study.write_text(STUDY.format(data=ROOT / "data"), encoding="utf-8")
        biaxbayes.batch(study, out=Path(folder) / "out", workers=2)
        return table(Path(folder) / "out" / "study.csv", rows=("specimen", "quantity"))


def population() -> Table:
    """Rows of population.csv of six virtual specimens."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        study = virtual_study(folder)
        biaxbayes.population(study, out=folder / "out", runs=folder / "runs", workers=2, seed=1)
        return table(folder / "out" / "population.csv", rows=("group", "quantity"))


def laws() -> Table:
    """Rows of laws.csv of two laws on a virtual specimen of three protocols."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        virtual_study(folder)
        biaxbayes.compare_laws(
            folder / "media-0.csv", out=folder / "out", laws=["goh", "fung"], workers=2, seed=1
        )
        return table(folder / "out" / "laws.csv", rows=("law",))


def table(path: Path, rows: tuple[str, ...] = ("parameter",)) -> Table:
    """A CSV of the package by the names in its first columns."""
    frame = pd.read_csv(path)
    used = [column for column in rows if column in frame] or [frame.columns[0]]
    out: Table = {}
    for record in frame.to_dict("records"):
        key = " ".join(str(record[column]) for column in used)
        words = [k for k in ("verdict", "state") if isinstance(record.get(k), str)]
        numbers = [k for k, v in record.items() if isinstance(v, float | int) and v == v]
        out[key] = {str(k): record[k] for k in words + numbers}
    return out


def compute(sections: list[str], before: dict[str, Any]) -> dict[str, Any]:
    """All that is asked for; densities are computed at the points of an earlier record."""
    cases = run_cases()
    new: dict[str, Any] = {}
    with ProcessPoolExecutor(2) as pool:
        if "runs" in sections:
            new["runs"] = dict(zip(cases, pool.map(run, cases.values()), strict=True))
        if "fits" in sections:
            new["fits"] = dict(zip(SHIPPED, pool.map(fits, SHIPPED), strict=True))
    points = before.get("runs") or new.get("runs") or {}
    if "densities" in sections:
        known = {name: case for name, case in cases.items() if name in points}
        new["densities"] = {name: density(case, points[name]) for name, case in known.items()}
    single = {"paper": paper_cells, "batch": batch, "population": population, "laws": laws}
    return new | {name: work() for name, work in single.items() if name in sections}


# --- comparison ----------------------------------------------------------------------------------


def relative(a: float, b: float) -> float:
    """Difference of two numbers over the larger; infinite where one is missing."""
    if math.isnan(a) and math.isnan(b):
        return 0.0
    return abs(a - b) / max(abs(a), abs(b), 1e-12) if math.isfinite(a - b) else math.inf


def compare_numbers(where: str, old: Table, new: Table, tolerance: float) -> list[tuple[str, str]]:
    """Verdict on each row of numbers that do not depend on random draws."""
    out = []
    for row in old:
        if row not in new:
            out.append((f"{where} {row}", "moved: is missing"))
            continue
        # a fraction of one where a number is near zero (a kappa at its edge)
        gaps = {
            key: min(relative(float(a), float(new[row].get(key, math.nan))), _gap(a, new[row], key))
            for key, a in old[row].items()
            if isinstance(a, float | int)
        }
        worst = max(gaps, key=gaps.__getitem__, default="")
        gap = gaps.get(worst, 0.0)
        word = "equal" if gap <= EQUAL else f"same optimum ({worst} {gap:.1e})"
        if gap > tolerance:
            word = f"moved: {worst} {old[row][worst]} -> {new[row].get(worst)} ({gap:.1e})"
        out.append((f"{where} {row}", word))
    return out


def _gap(a: Any, row: dict[str, Any], key: str) -> float:
    return abs(float(a) - float(row.get(key, math.inf)))


def compare_draws(where: str, old: Table, new: Table) -> list[tuple[str, str]]:
    """Verdict on each row of quantiles, by Monte Carlo error; words are compared as they are."""
    out = []
    for row, before in old.items():
        after = new.get(row)
        if after is None:
            out.append((f"{where} {row}", "moved: is missing"))
            continue
        changes = [
            f"{key} {before[key]!r} -> {after.get(key)!r}"
            for key in ("verdict", "state", "convergence")
            if key in before and before[key] != after.get(key)
        ]
        worst, score = worst_score(before, after)
        numbers = [k for k in before if isinstance(before[k], float | int) and k in after]
        same = all(relative(float(before[k]), float(after[k])) <= EQUAL for k in numbers)
        if score > SCORE:
            changes.append(f"{worst} {before[worst]} -> {after[worst]} ({score:.1f} se)")
        word = "equal" if same else f"within Monte Carlo error ({worst} {score:.1f} se)"
        out.append((f"{where} {row}", f"moved: {'; '.join(changes)}" if changes else word))
    return out


def worst_score(before: dict[str, Any], after: dict[str, Any]) -> tuple[str, float]:
    """The quantile that differs most in standard errors, of every triple of quantiles of a row."""
    worst, most = "", 0.0
    for low in [k for k in before if k.endswith("q05")]:
        keys = [low, low[:-3] + "q50", low[:-3] + "q95"]
        width = abs(float(before.get(keys[2], math.nan)) - float(before[low]))
        sizes = [
            min(float(r.get("ess_bulk", DEFAULT_ESS)), float(r.get("ess_tail", DEFAULT_ESS)))
            for r in (before, after)
        ]
        # A 5 % quantile of a normal sample has the error 2.1 sd / sqrt(n), a width is 3.3 sd.
        error = 0.64 * width * math.sqrt(sum(1.0 / size for size in sizes))
        for key in keys:
            if key in before and key in after and error > 0.0:
                score = abs(float(before[key]) - float(after[key])) / error
                worst, most = (key, score) if score > most else (worst, most)
    return worst, most


def compare(old: dict[str, Any], new: dict[str, Any]) -> list[tuple[str, str]]:
    """Verdicts on everything that both records hold."""
    out: list[tuple[str, str]] = []
    for name, values in new.get("densities", {}).items():
        before = {"log density": dict(enumerate(old["densities"][name]))}
        after = {"log density": dict(enumerate(values))}
        out += compare_numbers(f"density, {name}:", before, after, 1e-7)  # type: ignore[arg-type]
    for name, after in new.get("fits", {}).items():
        out += compare_numbers(f"fit, {name}:", old["fits"][name], after, FIT_TOLERANCE)
    out += compare_numbers("paper,", old["paper"], new.get("paper", old["paper"]), FIT_TOLERANCE)
    for name, result in new.get("runs", {}).items():
        out += compare_draws(f"run, {name}:", old["runs"][name]["summary"], result["summary"])
    for section in ("batch", "population", "laws"):
        if section in new:
            out += compare_draws(f"{section},", old[section], new[section])
    return out


def main() -> int:
    """Record or compare; exit code 1 where something moved."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("action", choices=["record", "compare"])
    known = ["densities", "fits", "paper", "runs", "batch", "population", "laws"]
    parser.add_argument("sections", nargs="*", help=f"of {', '.join(known)}; default all")
    parser.add_argument("--record", type=Path, default=RECORD)
    parser.add_argument("--all", action="store_true", help="print what is equal, too")
    options = parser.parse_args()
    sections = options.sections or known
    if unknown := set(sections) - set(known):
        parser.error(f"no section {sorted(unknown)}: choose of {', '.join(known)}")
    old = json.loads(options.record.read_text("utf-8")) if options.record.exists() else {}
    if options.action == "record":
        new = old | compute(sections, {})
        options.record.write_text(json.dumps(new, indent=1, default=float) + "\n", "utf-8")
        return 0
    verdicts = compare(old, compute(sections, old))
    for what, word in verdicts:
        if options.all or word.startswith("moved"):
            print(f"{what} {word}")
    counts = pd.Series([word.partition(":")[0].partition(" (")[0] for _, word in verdicts])
    print("; ".join(f"{count} {word}" for word, count in counts.value_counts().items()))
    return int(any(word.startswith("moved") for _, word in verdicts))


if __name__ == "__main__":
    sys.exit(main())
