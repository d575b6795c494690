"""Do the 90 % intervals hold the truth? The shipped specimens, and seeds that are not shipped.

    python scripts/study.py intervals --seeds 50 --workers 2

Writes the tables between the markers of data/README.md, with every interval in docs/tables. A truth
at the end of a range (kappa 0, alpha 90 degrees) is judged by the one-sided 90 % interval that
starts there. Truths that are drawn around the printed ones, and inside all ranges, are judged by
central intervals.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pandas as pd

from biaxbayes import read_specimen
from biaxbayes.calibration.ranks import coverage
from biaxbayes.errors import BiaxbayesError
from biaxbayes.laws.dispersed_fibres import fibre_strain
from biaxbayes.laws.goh import GOH, GOHLaw
from biaxbayes.laws.published import MATERIALS, PublishedMaterial
from biaxbayes.model.preparation import prepare
from biaxbayes.model.search import draw_posterior
from biaxbayes.parameters import mounting_names
from biaxbayes.sampling.sampler import Draws, Plan
from biaxbayes.specimens.virtual_specimen import Truth
from make_specimens import MISFIT, table6_specimen
from studies.figure import figure
from studies.page import DATA, SPECIMENS, put, table, write_table

HOOKED = ("hooked-media", "hooked-weisbecker")
NOISES = ("effective", "independent")
LAW = GOHLaw()
PARAMETERS = (*LAW.names, *mounting_names("stretch"))
FIRST_SEED = 1000  # far from the shipped ones
LEVEL = 0.9
# Truths, the smooth misfit of the records, and the noise models that are sampled with
PRINTED, DRAWN, EXACT = "printed", "drawn", "drawn, no misfit"
STUDIES = {PRINTED: (MISFIT, NOISES), DRAWN: (MISFIT, NOISES), EXACT: (0.0, ("independent",))}


def truth_of(name: str) -> dict[str, float]:
    """True values of a shipped specimen."""
    return values_of(Truth(**json.loads((DATA / "truth.json").read_text())[name]))


def values_of(truth: Truth) -> dict[str, float]:
    """True values by the names of the summary."""
    material = {p.name: float(truth.material[p.label]) for p in LAW.parameters}
    pair = (truth.mounting_stretch_x, truth.mounting_stretch_y)
    return material | dict(zip(mounting_names("stretch"), pair, strict=True))


SD_LOG = 0.3
ALPHA_DEG, KAPPA, MOUNTING = (20.0, 70.0), (0.05, 0.28), (1.005, 1.03)


def drawn_material(name: str, seed: int) -> PublishedMaterial:
    """A material around a printed one, inside all ranges, and a mounting stretch.

    Angle, dispersion and mounting stretches are uniform. C1, and exponent and stress of the fibres
    at the largest stretch, are those of the printed material times lognormal factors: drawn one by
    one, k1 and k2 would make stresses of any size.
    """
    rng = np.random.default_rng([seed, SPECIMENS.index(name), 20])
    printed = MATERIALS[name]
    assert printed.measured_stretch is not None
    mounting = (float(rng.uniform(*MOUNTING)), float(rng.uniform(*MOUNTING)))
    alpha, kappa = float(rng.uniform(*ALPHA_DEG)), float(rng.uniform(*KAPPA))
    C1, exponent, stress = np.exp(SD_LOG * rng.standard_normal(3))

    def at_top(material: GOH, stretch: tuple[float, float]) -> tuple[float, float]:
        """(E^2, stress of the fibres in x and y together) at the largest total stretch."""
        top = np.array(stretch) * printed.measured_stretch
        X, Y = top**2
        E = fibre_strain(material.constants, X, Y, 1.0 / (X * Y))
        return float(E) ** 2, float(np.sum(replace(material, C1_kPa=0.0).cauchy(*top)))

    m = printed.material
    strain2, load = at_top(m, printed.mounting_stretch)
    one = GOH(m.C1_kPa * float(C1), 1.0, 0.0, alpha, kappa)
    own, _ = at_top(one, mounting)
    one = replace(one, k2=m.k2 * strain2 * float(exponent) / own)
    _, unit = at_top(one, mounting)
    drawn = replace(one, k1_kPa=load * float(stress) / unit)
    return replace(printed, material=drawn, mounting_stretch=mounting)


def on_edge(name: str, truth: float) -> bool:
    """Whether a truth is the end of a range: a one-sided interval starts there and cannot miss."""
    return (name, truth) in {("kappa", 0.0), ("alpha", 90.0)}


def interval(name: str, draws: np.ndarray, truth: float) -> tuple[float, float]:
    """The 90 % interval, one-sided from the edge that the truth lies on."""
    if on_edge(name, truth):
        return (
            (0.0, float(np.quantile(draws, 0.9)))
            if name == "kappa"
            else (float(np.quantile(draws, 0.1)), 90.0)
        )
    low, high = np.quantile(draws, [0.05, 0.95])
    return float(low), float(high)


CHEAP = Plan(ess=200, max_steps=1500, ensembles=2, walkers=32)
"""For counts over many seeds: enough draws for a 5 % quantile."""


def sampled(specimen, noise: str, plan: Plan) -> Draws:
    return draw_posterior(prepare(specimen, noise=noise), plan)


Task = tuple[str, str, str, int]
"""Study, specimen, noise, seed."""


def one_seed(task: Task) -> tuple[Task, dict[str, float] | None]:
    """Share of each posterior below the truth; of printed truths, whether an interval holds it."""
    study, name, noise, seed = task
    drawn = None if study == PRINTED else drawn_material(name, seed)
    try:
        specimen, made = table6_specimen(name, seed, drawn, STUDIES[study][0])
        result = sampled(specimen, noise, CHEAP)
    except BiaxbayesError:
        return task, None
    if result.convergence.state == "unusable":
        return task, None
    found = {}
    for parameter, truth in values_of(made).items():
        draws = result.quantities[parameter]
        if study == PRINTED:
            low, high = interval(parameter, draws, truth)
            found[parameter] = float(low <= truth <= high)
        else:
            found[parameter] = float(np.mean(draws < truth))
    return task, found


def shipped_intervals() -> pd.DataFrame:
    """Every interval of the shipped specimens beside its truth, and how well the chains did."""
    rows: list[dict[str, object]] = []
    for name in (*SPECIMENS, *HOOKED):
        truth = truth_of(name)
        for noise in NOISES:
            found = sampled(read_specimen(DATA / f"{name}.csv"), noise, Plan(workers=2))
            judged = found.convergence
            print(f"{name}, {noise}: {judged.state}", flush=True)
            for parameter in PARAMETERS:
                low, high = interval(parameter, found.quantities[parameter], truth[parameter])
                rows.append(
                    {
                        "specimen": name,
                        "noise": noise,
                        "parameter": parameter,
                        "truth": truth[parameter],
                        "low": low,
                        "high": high,
                        "held": "yes" if low <= truth[parameter] <= high else "no",
                        "state": judged.state,
                        "rhat": judged.worst_rhat,
                        "ess": round(judged.worst_ess),
                    }
                )
    return pd.DataFrame(rows)


def shipped_table(found: pd.DataFrame) -> str:
    """How many truths of each shipped specimen are held, and which are not."""
    rows = []
    for name, of_specimen in found.groupby("specimen", sort=False):
        cells = [str(name)]
        for noise in NOISES:
            held = of_specimen[of_specimen["noise"] == noise].set_index("parameter")["held"]
            missed = ", ".join(p for p in held.index if held[p] == "no")
            cells += [f"{(held == 'yes').sum()} of {len(held)}", missed]
        rows.append(cells)
    header = ["specimen", *(cell for noise in NOISES for cell in (noise, "missed"))]
    return table(header, rows, left=len(header))


Found = dict[Task, dict[str, float] | None]


def _finished(record: Path) -> Found:
    """Runs of an interrupted study, from its record."""
    if not record.exists():
        return {}
    rows = [json.loads(line) for line in record.read_text().splitlines()]
    return {(study, name, noise, seed): found for study, name, noise, seed, found in rows}


def sampled_seeds(seeds: int, workers: int, record: Path) -> Found:
    """All studies over so many seeds."""
    tasks = [
        (study, name, noise, FIRST_SEED + s)
        for s in range(seeds)
        for name in SPECIMENS
        for study, (_, noises) in STUDIES.items()
        for noise in noises
    ]
    known = _finished(record)
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        left = [task for task in tasks if task not in known]
        for task, found in pool.imap_unordered(one_seed, left):
            known[task] = found
            with record.open("a") as file:
                file.write(json.dumps([*task, found]) + "\n")
    return {task: known[task] for task in tasks}


def _of(found: Found, study: str, noise: str, names: Sequence[str]) -> list[dict[str, float]]:
    """What was found of some specimens in one study, the runs that could be used."""
    return [
        values
        for (s, name, n, _), values in found.items()
        if (s, n) == (study, noise) and name in names and values is not None
    ]


def _lost(found: Found, study: str, noise: str, names: Sequence[str]) -> int:
    """How many runs could not be used."""
    all_of = [k for k in found if (k[0], k[2]) == (study, noise) and k[1] in names]
    return len(all_of) - len(_of(found, study, noise, names))


def printed_shares(found: Found) -> pd.DataFrame:
    """How many intervals hold a printed truth, of every specimen, noise model and parameter."""
    rows = []
    for name in SPECIMENS:
        for noise in NOISES:
            held = _of(found, PRINTED, noise, [name])
            shares = {p: int(sum(h[p] for h in held)) for p in PARAMETERS}
            lost = _lost(found, PRINTED, noise, [name])
            rows.append(
                {"specimen": name, "noise": noise, **shares, "seeds": len(held), "not_used": lost}
            )
    return pd.DataFrame(rows)


def printed_table(shares: pd.DataFrame) -> str:
    """How many intervals hold a printed truth that no edge gives away, all specimens together."""
    rows = []
    for noise, of in shares.groupby("noise", sort=False):
        cells = []
        for parameter in PARAMETERS:
            inside = of[[not on_edge(parameter, truth_of(n)[parameter]) for n in of["specimen"]]]
            cells.append(f"{inside[parameter].sum() / inside['seeds'].sum():.2f}")
        rows.append([str(noise), *cells, int(of["not_used"].sum())])
    return table(["noise", *PARAMETERS, "not converged"], rows)


def result(shipped: pd.DataFrame) -> str:
    """How many truths of the shipped specimens are held, those on an edge left out."""
    edge = [on_edge(*of) for of in zip(shipped["parameter"], shipped["truth"], strict=True)]
    judged = shipped[~np.array(edge)]
    held = (judged["held"] == "yes").groupby(judged["noise"], sort=False).agg(["sum", "count"])
    count = int(held["count"].iloc[0])
    return RESULT.format(
        specimens=shipped["specimen"].nunique(),
        count=count,
        told=" and ".join(f"{of['sum']} with `--noise {noise}`" for noise, of in held.iterrows()),
        stated=round(LEVEL * count),
        edge=sum(edge) // shipped["noise"].nunique(),
    )


def draw_shares(shares: pd.DataFrame, path: Path) -> None:
    """Draw the share of printed truths that intervals hold, a marker a specimen."""
    with figure(path, 1, len(NOISES), height=2.5, sharey=True) as (drawing, axes):
        for ax, noise in zip(axes[0], NOISES, strict=True):
            for k, (_, of) in enumerate(shares[shares["noise"] == noise].iterrows()):
                at = np.arange(len(PARAMETERS)) + 0.13 * (k - 2)
                held = [of[p] / of["seeds"] for p in PARAMETERS]
                ax.plot(
                    at, held, "osv^D"[k], ms=4, mfc="none", color=COLOURS[k], label=of["specimen"]
                )
            ax.axhline(LEVEL, color="0.6", lw=0.8, zorder=0)
            ax.set_xticks(range(len(PARAMETERS)), SHORT)
            ax.set(title=f"{noise} noise", ylim=(0.0, 1.04))
        axes[0, 0].set_ylabel("share of seeds whose\n90 % interval holds the truth")
        drawing.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=5)


def write_place(page: Path, shipped: pd.DataFrame, shares: pd.DataFrame, drawn: str) -> None:
    """Put the short tables into a page, all intervals and the figure beside the documentation."""
    docs = page.parent.parent / "docs"
    digits = {"truth": "{:g}", "rhat": "{:.4f}"}
    told = shipped.assign(**{c: shipped[c].map(text.format) for c, text in digits.items()})
    links = [
        f"../docs/{write_table(docs, name, list(rows.columns), rows)}"
        for name, rows in (("shipped-intervals", told), ("seed-intervals", shares))
    ]
    draw_shares(shares, docs / "figures" / "seed-intervals.png")
    seeds = int((shares["seeds"] + shares["not_used"]).max())
    converged = (shipped["state"] == "converged").all()
    middle = [
        SHIPPED_WORDS.format(
            link=links[0],
            seeds=seeds,
            all_runs="all runs converged" if converged else "not all runs converged",
            rhat=shipped["rhat"].max(),
            ess=shipped["ess"].min(),
        ),
        shipped_table(shipped),
        PRINTED_WORDS.format(seeds=seeds, link=links[1]),
        printed_table(shares),
        drawn,
    ]
    put(page, "result", result(shipped))
    put(page, "intervals", "\n".join(middle))


COLOURS = ("#000000", "#E69F00", "#0072B2", "#009E73", "#D55E00")
SHORT = (*LAW.names, *(rf"$\lambda_{{\mathrm{{m}},{axis}}}$" for axis in "xy"))
"""The parameters as the figure has them."""


def drawn_table(found: Found) -> str:
    """Coverage of truths inside their ranges, in per cent with its 95 % binomial interval."""
    rows = []
    for study in (DRAWN, EXACT):
        misfit, noises = STUDIES[study]
        for noise in noises:
            below = _of(found, study, noise, SPECIMENS)
            cells = []
            for parameter in PARAMETERS:
                share = np.array([b[parameter] for b in below])
                c = coverage(share, LEVEL) if share.size else None
                told = (
                    f"{100 * c.observed:.0f} ({100 * c.low:.0f}-{100 * c.high:.0f})" if c else "-"
                )
                cells.append(told)
            lost = _lost(found, study, noise, SPECIMENS)
            rows.append([f"{100 * misfit:g} %", noise, *cells, len(below), lost])
    header = ["misfit", "noise", *PARAMETERS, "specimens", "not converged"]
    return table(header, rows, left=2)


RESULT = """**{specimens} specimens of known material whose records, like those of tissue, are not
quite those of GOH: of {count} true values 90 % intervals hold {told}, where {stated} would be
90 %.** ({edge} more are ends of their ranges, which one-sided intervals cannot miss.)
[The calibration](../docs/calibration.md) shows what intervals are worth where the model holds,
[Model error](../docs/model-error.md) what can be stated where it does not.
"""
SHIPPED_WORDS = """How many 90 % intervals of the shipped specimens hold the truth, made by
`python scripts/study.py intervals --seeds {seeds}`: [all intervals]({link}); {all_runs}, R-hat at
most {rhat:.4f}, at least {ess:.0f} effective draws. The counts include truths at the end of a range
(kappa = 0, alpha = 90 degrees): their one-sided intervals start there and hold it always.
"""
PRINTED_WORDS = """The same intervals over {seeds} seeds that are not shipped: share that hold the
truth ([by specimen]({link})), truths on an edge left out. The materials are those of the paper.
Where kappa is 0, the truth is at the end of a ridge: k1, k2 and alpha are at the end of their
intervals too, and a central interval can fail however good the inference is. So this table shows
what happens to tissue like the paper's, not whether intervals are what they say.
"""
DRAWN_WORDS = f"""Truths inside their ranges: how many 90 % intervals hold them, per cent with a
95 % binomial interval, all five specimens together. Dimensions and protocols are those of the
shipped specimens. alpha is uniform from {ALPHA_DEG[0]:g} to {ALPHA_DEG[1]:g} degrees, kappa from
{KAPPA[0]:g} to {KAPPA[1]:g}, mounting stretches from {MOUNTING[0]:g} to {MOUNTING[1]:g}; C1, and
exponent and stress of the fibres at the largest stretch, are those of the printed material times
lognormal factors (sd of the log {SD_LOG:g}). The posterior's own prior is the default one and
wider, so 90 % is expected nearly and not exactly; [the calibration](../docs/calibration.md) draws
truths from the very prior. The row without misfit shows density and sampler. The rows with a smooth
misfit of {100 * MISFIT:g} %, which GOH cannot represent, show what intervals are worth on tissue
that is not quite GOH: what they fall short of the last row by is the misfit's doing. Take an
interval as what this model and this record allow.
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--record", type=Path, default=Path("intervals.jsonl"))
    parser.add_argument("--page", type=Path, default=DATA / "README.md")
    options = parser.parse_args()
    found = sampled_seeds(options.seeds, options.workers, options.record)
    drawn = f"{DRAWN_WORDS}\n{drawn_table(found)}"
    write_place(options.page, shipped_intervals(), printed_shares(found), drawn)


if __name__ == "__main__":
    main()
