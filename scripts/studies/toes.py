"""What is stated of mounting stretches where the toe is softer than that of every fitted law.

    OMP_NUM_THREADS=1 python scripts/study.py toes --first 300 --count 15 --sharp 60

Virtual specimens of seven kinds, mounted at 1.02 to 1.6, with one and three protocols and load
noise of 0.25 % of the peak; the law of the truth is withheld from the laws that are fitted. A value
has two ends, a one-sided statement has one, an open end none. A second table is of specimens of GOH
and Fung mounted at 1.005 to 1.05, three protocols, 0.2 % noise, their law among the others. With
``--fits`` the fits of the laws, which take the time, are kept in a folder and read again.

The interval within the law of a run, which `sample` adds, needs a posterior; here the statement is
that of the least-squares fits alone.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from biaxbayes.identifiability.mounting_stretch.law_range import LawRange, law_fits
from biaxbayes.identifiability.mounting_stretch.stated import stated_by_laws
from biaxbayes.laws import LAWS, law_named
from biaxbayes.model.priors import Prior
from biaxbayes.specimens.specimen import Protocol, Specimen
from studies.figure import figure
from studies.model_error.truths import RATIOS, Stress, four_families, path, recruited
from studies.page import put, table

ROWS = 40
PEAK_KPA = 100.0
MOST_AT_MOUNTING = 0.5  # share of the largest stress that the mounted state may carry
TUNED = (*range(14), *range(200, 230))
"""Seeds that chose the constants of the rule."""


def of_law(name: str) -> Callable[..., Stress]:
    """Materials of a law from its calibration prior, that carry load like tissue."""

    def make(rng: np.random.Generator, mounting: np.ndarray, top: np.ndarray) -> Stress:
        law = law_named(name)
        prior = law.scaled_prior(float(top.mean()), PEAK_KPA)
        while True:
            values = {
                n: float(Prior.stated(*stated).sample(rng, 1)[0]) for n, stated in prior.items()
            }
            if not law.holds(values):
                continue
            material = law.scalar([values[n] for n in law.names])
            at_rest, last = (np.array(material.cauchy(*s)) for s in (mounting, top))
            if np.all(at_rest > 0.0) and np.all(at_rest < MOST_AT_MOUNTING * last):
                return lambda total: np.column_stack(material.cauchy(*total.T))

    return make


KINDS: dict[str, tuple[Callable[..., Stress], tuple[str, ...]]] = {
    "recruited fibres": (recruited, ()),
    "four families": (four_families, ("four-fibre",)),
    "fung": (of_law("fung"), ("fung",)),
    "goh-exponential": (of_law("goh-exponential"), ("goh-exponential",)),
    "goh": (of_law("goh"), ("goh", "goh-exponential")),
    "holzapfel-2005": (of_law("holzapfel-2005"), ("holzapfel-2005",)),
    "may-newman": (of_law("may-newman"), ("may-newman",)),
}
"""Makers of the true stress, and the laws that are withheld."""
SHARP = ("goh", "fung")


@dataclass(frozen=True)
class Case:
    """A specimen with its true mounting stretches, and the laws that may be fitted."""

    kind: str
    specimen: Specimen
    mounting: np.ndarray
    laws: tuple[str, ...]


def make_case(kind: str, seed: int, protocols: int, *, sharp: bool) -> Case:
    """The specimen of a kind and seed."""
    rng = np.random.default_rng([seed, list(KINDS).index(kind), protocols, 7])
    base = rng.uniform(*((1.005, 1.05) if sharp else (1.02, 1.6)))
    mounting = np.clip(base + rng.uniform(-0.25, 0.25, 2) * (base - 1.0), 1.002, 1.7)
    top = mounting * (1.0 + rng.uniform(0.08, 0.2))
    make, withheld = KINDS[kind]
    stress = make(rng, mounting, top)
    peak = float(np.max(stress(top[None]) / top))
    noise = (0.002 if sharp else 0.0025) * peak
    made = []
    for name, ratio in list(RATIOS.items())[:protocols]:
        total = path(top, mounting, ratio, np.linspace(0.0, 1.0, ROWS + 1))
        load = stress(total) / total
        load = load + noise * rng.standard_normal(load.shape)
        made.append(Protocol(name, *(total / mounting).T, *load.T))
    specimen = Specimen(kind, tuple(made), stress_pair="piola", load_noise=noise)
    laws = tuple(LAWS) if sharp else tuple(n for n in LAWS if n not in withheld)
    return Case(kind, specimen, mounting, laws)


def fitted(case: Case, path: Path | None) -> LawRange | None:
    """Fits of the laws to a specimen, read where they are kept."""
    if path is not None and path.exists():
        with np.load(path, allow_pickle=True) as kept:
            return LawRange.of(list(kept["fits"]), case.specimen) if kept["fits"].size else None
    found = law_fits(case.specimen, case.laws)
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez(path, fits=np.array(found.fits if found else (), dtype=object))
    return found


def judge(
    task: tuple[str, int, int], *, sharp: bool, kept: Path | None = None
) -> list[dict[str, object]]:
    """Both mounting stretches of a specimen: truth and stated ends."""
    kind, seed, protocols = task
    try:
        case = make_case(kind, seed, protocols, sharp=sharp)
    except ValueError:  # no material of the kind suits the mounted state
        return []
    name = f"{'sharp' if sharp else 'soft'} {kind} {seed} {protocols}.npz"
    found = fitted(case, None if kept is None else kept / name)
    return [
        {
            "kind": kind,
            "seed": seed,
            "protocols": protocols,
            "axis": "xy"[axis],
            "true": float(case.mounting[axis]),
            "low": (said := stated_by_laws(found, 0, axis)).low,
            "high": said.high,
        }
        for axis in (0, 1)
    ]


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """Per kind and over all: what is stated, what of it is wrong, how far low ends lie below."""
    out = []
    groups = [*rows.groupby("kind", sort=False), ("all", rows)]
    for kind, part in groups:
        low, high = part["low"].notna(), part["high"].notna()
        wrong = int((part["true"] < part["low"]).sum() + (part["true"] > part["high"]).sum())
        ends, value = int(low.sum() + high.sum()), part[low & high]
        covered = ((value["true"] >= value["low"]) & (value["true"] <= value["high"])).mean()
        alone = part[low & ~high]
        out.append(
            {
                "kind": kind,
                "mounting stretches": len(part),
                "with an end": f"{low.mean():.2f}",
                "values": f"{len(value) / len(part):.2f}",
                "coverage of values": f"{covered:.2f}" if len(value) else "",
                "median width": f"{(value['high'] - value['low']).median():.4f}"
                if len(value)
                else "",
                "wrong ends": f"{wrong} of {ends}",
                "low end below the truth, median": f"{(alone['true'] - alone['low']).median():.3f}"
                if len(alone)
                else "",
            }
        )
    return pd.DataFrame(out)


PICTURE = "mounting-stretch-stated.png"


def draw(rows: pd.DataFrame, path: Path) -> None:
    """What is stated, over the truth: low ends, values, and where nothing is."""
    with figure(path, 1, 2, height=2.9) as (_, (axes,)):
        for ax, (name, part) in zip(axes, rows.groupby("study", sort=False), strict=True):
            value = part["high"].notna()
            alone = part["low"].notna() & ~value
            none = part["low"].isna()
            most = part["true"].max() + 0.02 * (part["true"].max() - 1.0)
            ax.plot([1.0, most], [1.0, most], color="0.6", linewidth=0.7)
            ax.vlines(
                part["true"][value], part["low"][value], part["high"][value], color="#d55e00",
                linewidth=1.4, label=f"stated as a value ({value.sum()})",
            )  # fmt: skip
            if alone.any():
                ax.plot(
                    part["true"][alone], part["low"][alone], "o", markersize=2.2, color="#0072b2",
                    label=f"a low end alone ({alone.sum()})",
                )  # fmt: skip
            if none.any():
                ax.plot(
                    part["true"][none], np.full(none.sum(), 1.0), "|", markersize=4.0,
                    color="0.5", label=f"nothing is stated ({none.sum()})",
                )  # fmt: skip
            ax.set_xlabel("true mounting stretch")
            law = "withheld" if name == "soft toes" else "among those that are fitted"
            ax.set_title(f"law of the truth {law}", loc="left")
            ax.legend(loc="upper left")
        axes[0].set_ylabel("stated")


def main() -> int:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=100, help="first seed")
    parser.add_argument("--count", type=int, default=15, help="seeds")
    parser.add_argument("--sharp", type=int, help="seeds of the second table (default: --count)")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--fits", type=Path, help="keep the fits of the laws in this folder")
    parser.add_argument("--csv", help="keep every mounting stretch in this file")
    parser.add_argument("--page", type=Path, help="write the tables between the marks of this page")
    given = parser.parse_args()
    seeds = range(given.first, given.first + given.count)
    sharp_seeds = range(given.first, given.first + (given.sharp or given.count))
    if not {*seeds, *sharp_seeds}.isdisjoint(TUNED):
        print("these seeds chose the constants of the rule\n")
    soft = [(kind, seed, n) for seed in seeds for kind in KINDS for n in (1, 3)]
    sharp = [(kind, seed, 3) for seed in sharp_seeds for kind in SHARP]
    kept = []
    with ProcessPoolExecutor(given.workers) as pool:
        for name, tasks, is_sharp in (("soft toes", soft, False), ("sharp", sharp, True)):
            found = pool.map(partial(judge, sharp=is_sharp, kept=given.fits), tasks)
            rows = pd.DataFrame([row for part in found for row in part])
            kept.append(rows.assign(study=name))
            said = summary(rows)
            text = table(list(said.columns), said.values.tolist(), left=1)
            print(f"{name}\n\n{text}\n")
            if given.page:
                put(given.page, f"toes-{name.split()[0]}", text)
    rows = pd.concat(kept)
    if given.csv:
        rows.to_csv(given.csv, index=False)
    if given.page:
        draw(rows, given.page.parent / "figures" / PICTURE)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
