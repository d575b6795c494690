"""docs/benchmark.md from the figures of one run: short tables, all rows in CSV files, a figure."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import ndtri

from biaxbayes.text_files import atomic_write_text
from studies.figure import figure
from studies.page import image, number, table, write_table

__all__ = ["page", "write_page"]

FIGURE = "benchmark.png"
COSTS = """# Benchmark

What an evaluation and whole commands cost, on a two-core virtual machine, with a warm compile
cache unless said. Made with

    OMP_NUM_THREADS=1 python scripts/study.py benchmark --costs --write docs/benchmark.md

The same script without `--costs` compares with other samplers on the same posteriors.
"""
HEAD = """## How it is measured

    export OMP_NUM_THREADS=1
    python scripts/study.py benchmark --samplers --others --jobs 2 --json others.json
    python scripts/study.py benchmark --samplers --plain --jobs 2 --json plain.json
    python scripts/study.py benchmark --costs --json costs.json
    python scripts/study.py benchmark --from-json others.json plain.json costs.json \\
        --write docs/benchmark.md

on a two-core virtual machine, every sampler on one core (without these options one command does
all), with two [noise models](model.md#errors). Ours and plain emcee are those of the second run, in
which only they ran; the other samplers, and the agreement of ours with them, those of the first.
Ratios carry over to other machines, seconds do not. *Effective draws* are those of the worst
parameter by one estimator (rank-normalised bulk ESS over all chains), for nested samplers Kish's
from their weights. Where emcee's stretch move has not converged (R-hat above 1.01), its ESS is the
estimate that it reports, which is too large.
"""
SAMPLERS = {
    "NUTS": "numpyro in logs and logits of the parameters, dense mass matrix, four chains of 600 "
    "draws; some seconds of its times are compilation",
    "dynesty": "nested sampling from the prior, slice steps, on our compiled density",
    "script": "the stretch move as a script has it: NumPy stress and `scipy.optimize.root`, one "
    "walker at a time",
    "pyMechT": "the same with the mechanics of pyMechT",
}
"""What ours is compared with, beyond emcee on the same density."""
CONVERGED = 1.01
"""R-hat above this is not."""


# --- what was found, a row a posterior -----------------------------------------------------------


def frames(cases: list[dict[str, Any]]) -> dict[str, pd.DataFrame]:
    """The tables of the samplers by name: ``samplers`` and, of all samplers, two more."""
    found = {"samplers": pd.DataFrame([_rates(case) for case in cases])}
    if cases and all("NUTS" in case for case in cases):  # not ours and plain emcee alone
        found["agreement"] = pd.DataFrame([_agreement(case) for case in cases])
        evidence = [_evidence(case) for case in cases if case["ours"]["log_evidence"]]
        found["evidence"] = pd.DataFrame(evidence)
    return found


def _rates(case: dict[str, Any]) -> dict[str, Any]:
    """Rates and times of a posterior; what was not reached is not a number."""
    mine, plain = case["ours"], case["emcee"]
    row = {"specimen": case["specimen"], "noise": case["noise"]}
    for name, of in (("ours", mine), ("emcee", plain)):
        row[f"{name}_per_s"] = of["rate"]
        row[f"{name}_per_evaluation"] = of["ess"] / of["evaluations"]
    row |= {f"ours_{end}_per_s": mine[f"{end}_rate"] for end in ("lowest", "highest")}
    row |= {"emcee_rhat": plain["rhat"], "ours_over_emcee": mine["rate"] / plain["rate"]}
    for name, of in (("ours", mine), ("emcee", plain)):
        row[f"{name}_converged_s"] = of["to_criterion"]
        row[f"{name}_fastest_s"], row[f"{name}_slowest_s"] = of["fastest"], of["slowest"]
    row |= {"emcee_limit_s": plain["limit"]}
    if "NUTS" not in case:
        return row
    row["ours_with_warmup_per_s"] = mine["rate_with_warmup"]
    for key in ("NUTS", "dynesty"):
        rate = case[key]["rate_with_warmup"] if key in case else np.nan
        row |= {f"{key}_per_s": rate, f"ours_over_{key}": mine["rate_with_warmup"] / rate}
    for key, name in (("script", "lab_script_seconds"), ("pyMechT", "pymecht_seconds")):
        row[f"{key}_ms"] = 1e3 * case[name]
        row[f"ours_over_{key}"] = mine["rate"] / (row["emcee_per_evaluation"] / case[name])
    return row


def _agreement(case: dict[str, Any]) -> dict[str, Any]:
    """How far quantiles of the others are from ours, in standard errors of both."""
    nuts, straight = case["NUTS"], case["straightened"]
    row = {"specimen": case["specimen"], "noise": case["noise"]}
    row |= {"NUTS_ess": nuts["ess"], "NUTS_rhat": nuts["rhat"]}
    row |= {"NUTS_rms": case["agreement"]["NUTS"]["rms"]}
    row |= {"straightened_ess": straight["ess"], "straightened_rhat": straight["rhat"]}
    row |= {"straightened_divergences": int(straight["note"].split()[0])}
    for key in ("straightened", "nautilus"):
        of = case["agreement"][key]
        row |= {f"{key}_quantiles": of["count"], f"{key}_rms": of["rms"]}
        row |= {f"{key}_largest": of["largest"], f"{key}_where": of["where"]}
    row["nautilus_finished"] = "no" if "not finished" in case["nautilus"]["note"] else "yes"
    return row


def _evidence(case: dict[str, Any]) -> dict[str, Any]:
    """Log marginal likelihoods with their errors."""
    row: dict[str, Any] = {"specimen": case["specimen"]}
    for key in ("ours", "nautilus", "dynesty"):
        row[key], row[f"{key}_error"] = case[key]["log_evidence"]
    return row


# --- the page ------------------------------------------------------------------------------------


def write_page(found: dict[str, Any], path: Path) -> None:
    """Write the page, its CSV files and its figure."""
    tables = frames(found["cases"])
    atomic_write_text(path, page(found))
    if found["cases"]:
        write_beside(tables, path.parent)


def write_beside(tables: dict[str, pd.DataFrame], folder: Path) -> None:
    """Write every row of the tables beside the page, and draw the rates."""
    for name, rows in tables.items():
        of = "{:.3f}".format if name == "evidence" else number
        reached = rows.replace(np.inf, np.nan)
        told = reached.map(lambda v, of=of: of(v) if isinstance(v, float) and np.isfinite(v) else v)
        write_table(folder, f"benchmark-{name}", list(rows.columns), told)
    draw_rates(tables, folder / "figures" / FIGURE)


def page(found: dict[str, Any]) -> str:
    """The page as Markdown."""
    parts = [samplers_text(frames(found["cases"]))] if found["cases"] else [COSTS]
    if "density" in found:
        parts += [*_density(found), *_commands(found["commands"])]
    return "\n".join(parts).rstrip("\n") + "\n"


def samplers_text(tables: dict[str, pd.DataFrame]) -> str:
    """All sections on samplers."""
    samplers = tables["samplers"]
    parts = ["# Benchmark", "", _result(tables), "", _image(), HEAD, *_rates_text(samplers)]
    if "agreement" in tables:
        parts += [*_others_text(tables), *_agreement_text(tables["agreement"])]
        parts += _evidence_text(tables["evidence"])
    return "\n".join(parts)


def _section(title: str, *text: str) -> list[str]:
    return ["", f"## {title}", "", *text]


def _mean(ratios: pd.Series) -> float:
    return float(np.exp(np.log(ratios.dropna()).mean()))


def _result(tables: dict[str, pd.DataFrame]) -> str:
    """What was found, in two sentences."""
    samplers = tables["samplers"]
    means = [
        f"{_mean(of['ours_over_emcee']):,.0f} times ({noise} noise)"
        for noise, of in samplers.groupby("noise", sort=False)
    ]
    ratios = samplers["ours_over_emcee"]
    told = (
        f"**In effective draws a second, warm-up excluded, the sampler is {' and '.join(means)} as "
        "fast as emcee's stretch move in natural parameters on the same compiled density, in the "
        "geometric mean over "
        f"{samplers['specimen'].nunique()} shipped specimens; {ratios.min():.0f} times at least."
    )
    if "agreement" in tables:
        a = tables["agreement"]
        most = max(np.abs(a[f"{k}_largest"]).max() for k in ("straightened", "nautilus"))
        told += (
            " Straightened NUTS and nautilus find the same posteriors: of "
            f"{a['nautilus_quantiles'].sum()} quantiles each none differs by more than {most:.1f} "
            "standard errors."
        )
    return told + "**"


def _image() -> str:
    return image(
        FIGURE,
        f"Left: warm-up excluded. Right: included. Open: not converged (R-hat above "
        f"{CONVERGED:g}).",
        "Effective draws a second of every sampler",
    )


def _rates_text(samplers: pd.DataFrame) -> list[str]:
    rows = []
    for _, row in samplers.iterrows():
        rate = f"{row['ours_per_s']:,.0f} ({row['ours_lowest_per_s']:,.0f} to "
        rate += f"{row['ours_highest_per_s']:,.0f})"
        mine = f"{row['ours_converged_s']:.2f} ({row['ours_fastest_s']:.2f} to "
        mine += f"{row['ours_slowest_s']:.2f})"
        rows.append(
            [row["specimen"], row["noise"], rate, f"{row['emcee_per_s']:.1f}"]
            + [f"{row['ours_over_emcee']:,.0f}", mine, _emcee(row)]
        )
    header = ["specimen", "noise", "draws a second: ours", "emcee", "ratio", "seconds: ours"]
    return _section(
        "Ours and emcee",
        "Draws a second exclude warm-up; the stretch move in natural parameters runs on the same "
        "compiled density, in four ensembles of 64. Seconds are wall time from the deterministic "
        "fit to R-hat below 1.01 over four ensembles and an ESS of 2,000, both judged after short "
        "blocks by the same function, whose own time is left out. Both are medians over five "
        "seeds, with the lowest and the highest; draws a second of plain emcee are of one seed. "
        "Plain emcee had 20 times as long as ours, 20 s at least, and one seed only where that is "
        "over 30 s and the seed did not get there. [All figures of all "
        "samplers](tables/benchmark-samplers.csv)",
        "",
        table([*header, "emcee"], rows, left=2),
    )


def _emcee(row: pd.Series) -> str:
    """When plain emcee converged, if it did."""
    if np.isfinite(row["emcee_converged_s"]):
        slowest = row["emcee_slowest_s"]
        end = f"{slowest:.1f}" if np.isfinite(slowest) else "never"
        return f"{row['emcee_converged_s']:.1f} ({row['emcee_fastest_s']:.1f} to {end})"
    told = f"not in {row['emcee_limit_s']:.0f}"
    if np.isfinite(row["emcee_fastest_s"]):
        told += f" (the fastest in {row['emcee_fastest_s']:.1f})"
    return told


def _others_text(tables: dict[str, pd.DataFrame]) -> list[str]:
    rows = []
    for key, what in SAMPLERS.items():
        ratios = tables["samplers"][f"ours_over_{key}"]
        if ratios.notna().any():
            rows.append([f"{key}: {what}", f"{_mean(ratios):,.0f}", f"{ratios.min():,.0f}"])
    nuts = tables["agreement"]
    short = int((nuts["NUTS_rhat"] > CONVERGED).sum())
    return _section(
        "Other samplers",
        table(["effective draws a second, ours over theirs", "geometric mean", "least"], rows),
        f"NUTS has not converged on {short} of {len(nuts)} posteriors (R-hat up to "
        f"{nuts['NUTS_rhat'].max():.1f}); where it has not, its rate and its agreement with ours "
        "say little. Straightened (below) it converges. Warm-up is included on both sides for NUTS "
        "and dynesty (ours: at the length of the run timed above), and excluded for the others: "
        "the time of one evaluation with the effective draws an evaluation of plain emcee.",
    )


def _agreement_text(found: pd.DataFrame) -> list[str]:
    told = [
        f"Straightened NUTS: R-hat at most {found['straightened_rhat'].max():.4f}, at least "
        f"{found['straightened_ess'].min():,.0f} effective draws, divergent transitions at most "
        f"{found['straightened_divergences'].max()} a posterior."
    ]
    for key, name in (("straightened", "straightened NUTS"), ("nautilus", "nautilus")):
        each = found[f"{key}_quantiles"]
        count = int(each.sum())
        rms = np.sqrt((found[f"{key}_rms"] ** 2 * each).sum() / count)
        largest = np.abs(found[f"{key}_largest"]).max()
        # of so many independent comparisons the largest is beyond this once in twenty
        limit = ndtri(1.0 - 0.5 * (1.0 - 0.95 ** (1.0 / count)))
        told.append(
            f"Of {count} quantiles, {name} and ours differ by {largest:.1f} standard errors at "
            f"most (95 % of such sets stay below {limit:.1f}), {rms:.2f} in the root mean square."
        )
    if (found["nautilus_finished"] == "no").any():
        told.append("Some runs of nautilus were not finished.")
    return _section(
        "Agreement",
        "Quantiles of 5, 50 and 95 % of all eight unknowns: difference from ours in standard "
        "errors of both, from the effective draws that each sampler reports ([by "
        "posterior](tables/benchmark-agreement.csv)). *Straightened* NUTS "
        "runs for 4 x 2,000 draws, on a density written once more in JAX, in coordinates in which "
        "the posterior is nearly a round Gaussian: a normalising flow fitted to our draws, which "
        "changes how fast a sampler moves, not what it samples. nautilus runs in the same "
        "coordinates from a wider Student t to the posterior, and keeps no point of its "
        "exploration.",
        "",
        " ".join(told),
    )


def _evidence_text(found: pd.DataFrame) -> list[str]:
    rows = []
    off = (found["dynesty"] - found["ours"]).abs() > 3.0 * found["dynesty_error"]
    for _, row in found.iterrows():
        cells = [row["specimen"], f"{row['ours']:.3f} ± {row['ours_error']:.3f}"]
        for key in ("nautilus", "dynesty"):
            error = np.hypot(row["ours_error"], row[f"{key}_error"])
            cells.append(f"{row[key] - row['ours']:+.3f} ± {error:.3f}")
        rows.append(cells)
    return _section(
        "Evidence",
        "Log marginal likelihood, independent noise: ours by bridge sampling, nautilus in the "
        "narrowed prior, dynesty from the prior ([all](tables/benchmark-evidence.csv)).",
        "",
        table(["specimen", "ours", "nautilus less ours", "dynesty less ours"], rows),
        f"dynesty is off by more than three of its stated errors on {off.sum()} of {len(off)}: its "
        "slice steps from the prior are too few to find all of the ridge.",
    )


def draw_rates(tables: dict[str, pd.DataFrame], path: Path) -> None:
    """Draw the effective draws a second of every sampler and posterior."""
    samplers = tables["samplers"]
    labels = [f"{r['specimen']}, {r['noise']}" for _, r in samplers.iterrows()]
    at = np.arange(len(labels))
    settled = {"emcee_per_s": samplers["emcee_rhat"].to_numpy() <= CONVERGED}
    if "agreement" in tables:
        settled["NUTS_per_s"] = tables["agreement"]["NUTS_rhat"].to_numpy() <= CONVERGED
    panels: list[list[tuple[str, str, str, str]]] = [
        [("ours_per_s", "o", "#0072B2", "ours"), ("emcee_per_s", "s", "#D55E00", "emcee")],
        [
            ("ours_with_warmup_per_s", "o", "#0072B2", "ours"),
            ("dynesty_per_s", "v", "#009E73", "dynesty"),
            ("NUTS_per_s", "D", "#000000", "NUTS"),
        ],
    ]
    panels = [p for p in panels if all(column in samplers for column, *_ in p)]
    with figure(path, 1, len(panels), height=2.9, sharey=True) as (_, axes):
        for ax, drawn in zip(axes[0], panels, strict=True):
            for column, marker, colour, label in drawn:
                values = samplers[column].to_numpy(dtype=float)
                full = settled.get(column, np.ones(len(at), bool))
                style = {"color": colour, "ms": 4.5, "ls": ""}
                ax.plot(values[full], at[full], marker, **style)
                ax.plot(values[~full], at[~full], marker, mfc="none", **style)
                ax.plot([], [], marker, label=label, mfc=None if full.any() else "none", **style)
            ax.set(xscale="log", xlabel="effective draws a second")
            ax.grid(axis="y", color="0.92", lw=0.6)
            ax.set_axisbelow(True)
            ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=len(drawn))
        axes[0, 0].set_yticks(at, labels)
        axes[0, 0].invert_yaxis()


# --- costs ---------------------------------------------------------------------------------------


def _density(found: dict[str, Any]) -> list[str]:
    d = found["density"]
    points, walkers = (
        ", ".join(f"{1e6 * s:.2f} us with {int(n):,}" for n, s in found[key].items())
        for key in ("by_points", "by_walkers")
    )
    return [
        "",
        "## One evaluation of the density",
        "",
        f"{d['rows']} rows, both directions, the mounting root inside: "
        f"{1e6 * d['evaluation']:.2f} us; "
        f"{d['rows']} bare exponentials in a compiled loop: {1e6 * d['exponentials']:.2f} us "
        f"(ratio {d['evaluation'] / d['exponentials']:.1f}).",
        "",
        f"Growth with the rows: {points}.",
        "",
        f"A walker of a call with many walkers: {walkers}.",
        *(["", _laws(found["by_law"])] if "by_law" in found else []),
    ]


def _laws(seconds: dict[str, float]) -> str:
    """Cost of the laws beside that of GOH."""
    told = ", ".join(f"`{k}` {s / seconds['goh']:.2f}" for k, s in seconds.items() if k != "goh")
    return f"Laws, times `goh`: {told}."


def _commands(commands: list[dict[str, Any]]) -> list[str]:
    names = ("imports", "compile", "reading and n_eff", "fit", "warm-up", "sampling", "output")
    rows = [["total, s", *(f"{c['seconds']:.1f}" for c in commands)]]
    for n in names:
        rows.append(
            [f"{n}, s", *(f"{c['parts'][n]:.1f}" if n in c["parts"] else "" for c in commands)]
        )
    rows.append(["peak memory, MB", *(f"{c['peak_MB']:.0f}" for c in commands)])
    return _section(
        "Whole commands",
        "Wall time, two workers where a command has them.",
        "",
        table(["", *(c["text"] for c in commands)], rows),
    )
