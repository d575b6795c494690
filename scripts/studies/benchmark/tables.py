"""docs/benchmark.md from the figures of one run."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import ndtri

__all__ = ["page"]

COSTS = """# Benchmark

What an evaluation and whole commands cost, on a two-core virtual machine, with a warm compile
cache unless said. Made with

    OMP_NUM_THREADS=1 python scripts/study.py benchmark --costs --write docs/benchmark.md

The same script without `--costs` compares with other samplers on the same posteriors.
"""
HEAD = """# Benchmark

Made with

    export OMP_NUM_THREADS=1
    python scripts/study.py benchmark --samplers --jobs 2 --json samplers.json
    python scripts/study.py benchmark --samplers --plain --jobs 2 --json plain.json
    python scripts/study.py benchmark --costs --json costs.json
    python scripts/study.py benchmark --from-json samplers.json plain.json costs.json \\
        --write docs/benchmark.md

on a two-core virtual machine, every sampler on one core (without these options one command does
all). Ours and plain emcee are those of the second run, in which only they ran; the other samplers,
and the agreement of ours with them, those of the first. Ratios carry over to other machines,
seconds do not. *Effective draws* are those of the worst parameter by one estimator
(rank-normalised bulk ESS over all chains), for nested samplers Kish's from their weights. Where
emcee's stretch move has not converged (R-hat above 1.01), its ESS is the estimate that it reports,
which is too large.
"""


NOTES = (
    "NUTS in logs and logits does not converge here in 4 x 600 draws (R-hat up to 1.9, an ESS of a "
    "few dozen): its errors are then larger than they say, and its disagreement says little.",
    "",
    "dynesty's slice steps from the prior are too few to find all of the ridge: its evidence is "
    "off by more than its stated error, and more steps would only slow it further.",
)


def page(found: dict[str, Any]) -> str:
    """The page as Markdown."""
    cases = found["cases"]
    parts = [HEAD if cases else COSTS]
    if "density" in found:
        parts += [*_density(found), *_commands(found["commands"])]
    for section in (_rates, _convergence):
        parts += section(cases) if cases else []
    if cases and all("NUTS" in case for case in cases):  # not ours and plain emcee alone
        for section in (_others, _agreement, _evidence):
            parts += section(cases)
    return "\n".join(parts) + "\n"


def _section(title: str, text: str, *table_head: str) -> list[str]:
    """Heading, text, and the head of the table that follows."""
    return ["", f"## {title}", "", text, "", *table_head]


def _mean(ratios: list[float]) -> float:
    return float(np.exp(np.mean(np.log(ratios))))


def _rates(cases: list[dict[str, Any]]) -> list[str]:
    lines = _section(
        "Effective draws a second, warm-up excluded",
        "The stretch move in natural parameters runs on the same compiled density, in four "
        "ensembles of 64.",
        "| specimen | noise | ours | an evaluation | emcee | an evaluation | R-hat of emcee "
        "| ours / emcee |",
        "|---|---|---:|---:|---:|---:|---:|---:|",
    )
    for c in cases:
        ours, plain = c["ours"], c["emcee"]
        lines.append(
            f"| {c['specimen']} | {c['noise']} | {ours['rate']:,.0f} "
            f"| {ours['ess'] / ours['evaluations']:.3f} | {plain['rate']:.1f} "
            f"| {plain['ess'] / plain['evaluations']:.5f} | {plain['rhat']:.3f} "
            f"| {ours['rate'] / plain['rate']:.0f} |"
        )
    for noise in dict.fromkeys(c["noise"] for c in cases):
        ratios = [c["ours"]["rate"] / c["emcee"]["rate"] for c in cases if c["noise"] == noise]
        lines.append(
            f"\n{noise}: {_mean(ratios):.0f} times plain emcee in the geometric mean, "
            f"{min(ratios):.0f} at least."
        )
    return lines


def _convergence(cases: list[dict[str, Any]]) -> list[str]:
    lines = _section(
        "Wall time to a converged posterior",
        "From the deterministic fit to R-hat below 1.01 over four ensembles and an ESS of 2,000, "
        "warm-up included, seconds; both are judged after short blocks by the same function, whose "
        "own time is left out. Medians over five seeds, in brackets the fastest and the slowest; "
        "plain emcee had 20 times as long as ours, 20 s at least, and one seed only where that is "
        "over 30 s and the seed did not get there.",
        "| specimen | noise | ours | emcee | ratio |",
        "|---|---|---:|---:|---:|",
    )
    for c in cases:
        ours, plain = c["ours"], c["emcee"]
        told = f"{ours['to_criterion']:.2f} ({ours['fastest']:.2f} to {ours['slowest']:.2f})"
        if np.isfinite(plain["to_criterion"]):
            slowest = f"{plain['slowest']:.1f}" if np.isfinite(plain["slowest"]) else "never"
            other = f"{plain['to_criterion']:.1f} ({plain['fastest']:.1f} to {slowest})"
            ratio = f"{plain['to_criterion'] / ours['to_criterion']:.0f}"
        else:
            other = f"not in {plain['limit']:.0f}"
            if np.isfinite(plain["fastest"]):
                other += f" (the fastest in {plain['fastest']:.1f})"
            ratio = f"over {plain['limit'] / ours['to_criterion']:.0f}"
        lines.append(f"| {c['specimen']} | {c['noise']} | {told} | {other} | {ratio} |")
    return lines


def _others(cases: list[dict[str, Any]]) -> list[str]:
    lines = _section(
        "Other samplers",
        "Effective draws a second, warm-up included on both sides (ours: at the length of the run "
        "timed above). NUTS: numpyro, dense mass matrix, four chains; it compiles its loops "
        "within these times, some seconds of them. "
        "dynesty: from the prior, slice steps, the compiled density. *Script*: stretch move, NumPy "
        "stress and `scipy.optimize.root`, one walker at a time, and *pyMechT*: its mechanics in "
        "the same sampler; both are the time of one evaluation with the effective draws an "
        "evaluation of plain emcee, warm-up excluded.",
        "| specimen | noise | ours | NUTS | ratio | dynesty | ratio | script, ms | ratio "
        "| pyMechT, ms | ratio |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
    )
    ratios: dict[str, list[float]] = {"NUTS": [], "dynesty": [], "script": [], "pyMechT": []}
    for c in cases:
        ours = c["ours"]["rate_with_warmup"]
        row = f"| {c['specimen']} | {c['noise']} | {ours:,.0f} "
        for key in ("NUTS", "dynesty"):
            if key not in c:
                row += "| | "
                continue
            rate = c[key]["rate_with_warmup"]
            ratios[key].append(ours / rate)
            row += f"| {rate:.2g} | {ours / rate:,.0f} "
        per_evaluation = c["emcee"]["ess"] / c["emcee"]["evaluations"]
        for key, name in (("script", "lab_script_seconds"), ("pyMechT", "pymecht_seconds")):
            ratio = c["ours"]["rate"] / (per_evaluation / c[name])
            ratios[key].append(ratio)
            row += f"| {1e3 * c[name]:.2f} | {ratio:,.0f} "
        lines.append(row + "|")
    means = ", ".join(f"{k} {_mean(v):,.0f} (least {min(v):,.0f})" for k, v in ratios.items() if v)
    return [*lines, "", f"Geometric means of the ratios: {means}."]


def _agreement(cases: list[dict[str, Any]]) -> list[str]:
    lines = _section(
        "Agreement",
        "Quantiles of 5, 50 and 95 % of all eight unknowns: difference from ours in standard "
        "errors of both, from the effective draws that each sampler reports. *Straightened* NUTS "
        "runs for 4 x 2,000 draws, on a density written once more in JAX, in coordinates in which "
        "the posterior is nearly a round Gaussian: a normalising flow fitted to our draws, which "
        "changes how fast a sampler moves, not what it samples. nautilus runs in the same "
        "coordinates from a wider Student t to the posterior, and keeps no point of its "
        "exploration. The other NUTS is the one above, 4 x 600 draws.",
        "| specimen | noise | NUTS: ESS | R-hat | rms | straightened NUTS: ESS | R-hat "
        "| divergences | rms | largest | nautilus: rms | largest |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|---|---:|---|",
    )
    for c in cases:
        nuts, long = c["NUTS"], c["straightened"]
        lines.append(
            f"| {c['specimen']} | {c['noise']} | {nuts['ess']:.0f} | {nuts['rhat']:.3f} "
            f"| {c['agreement']['NUTS']['rms']:.2f} | {long['ess']:.0f} | {long['rhat']:.3f} "
            f"| {long['note'].split()[0]} | {' | '.join(_compared(c))} |"
        )
    return [*lines, "", _summed_up(cases), "", *NOTES]


def _summed_up(cases: list[dict[str, Any]]) -> str:
    straight = [c["straightened"] for c in cases]
    told = [
        f"Straightened NUTS: R-hat at most {max(s['rhat'] for s in straight):.4f}, "
        f"at least {min(s['ess'] for s in straight):,.0f} effective draws."
    ]
    for key, name in (("straightened", "straightened NUTS"), ("nautilus", "nautilus")):
        found = [c["agreement"][key] for c in cases]
        count = sum(a["count"] for a in found)
        rms = np.sqrt(sum(a["rms"] ** 2 * a["count"] for a in found) / count)
        largest = max(abs(a["largest"]) for a in found)
        # of so many independent comparisons the largest is beyond this once in twenty
        limit = ndtri(1.0 - 0.5 * (1.0 - 0.95 ** (1.0 / count)))
        told.append(
            f"Of {count} quantiles, {name} and ours differ by {largest:.1f} standard errors at "
            f"most (95 % of such sets stay below {limit:.1f}), {rms:.2f} in the root mean square."
        )
    return " ".join(told)


def _compared(case: dict[str, Any]) -> list[str]:
    cells = []
    for key in ("straightened", "nautilus"):
        a = case["agreement"][key]
        unfinished = " not finished" if "not finished" in case[key]["note"] else ""
        cells.append(f"{a['rms']:.2f} | {a['largest']:+.1f} ({a['where']}){unfinished}")
    return cells


def _evidence(cases: list[dict[str, Any]]) -> list[str]:
    lines = _section(
        "Evidence",
        "Log marginal likelihood by bridge sampling, by nautilus in the narrowed prior, and by "
        "dynesty from the prior (independent noise; differences from ours).",
        "| specimen | ours | nautilus | difference | dynesty | difference |",
        "|---|---:|---:|---:|---:|---:|",
    )
    for c in cases:
        if not c["ours"]["log_evidence"]:
            continue
        a, ea = c["ours"]["log_evidence"]
        row = f"| {c['specimen']} | {a:.3f} ± {ea:.3f} "
        for key in ("nautilus", "dynesty"):
            b, eb = c[key]["log_evidence"]
            row += f"| {b:.3f} ± {eb:.3f} | {b - a:+.3f} ± {np.hypot(ea, eb):.3f} "
        lines.append(row + "|")
    return lines


def _density(found: dict[str, Any]) -> list[str]:
    d = found["density"]
    points = ", ".join(f"{n} rows {1e6 * s:.2f}" for n, s in found["by_points"].items())
    walkers = ", ".join(f"{n} {1e6 * s:.2f}" for n, s in found["by_walkers"].items())
    return [
        "",
        "## One evaluation of the density",
        "",
        f"{d['rows']} rows, both directions, the mounting root inside: "
        f"{1e6 * d['evaluation']:.2f} us; "
        f"{d['rows']} bare exponentials in a compiled loop: {1e6 * d['exponentials']:.2f} us "
        f"(ratio {d['evaluation'] / d['exponentials']:.1f}).",
        "",
        f"Growth with the readings, us: {points}.",
        "",
        f"Growth with the walkers of one call, us a walker: {walkers}.",
    ]


def _commands(commands: list[dict[str, Any]]) -> list[str]:
    names = ("imports", "compile", "reading and n_eff", "fit", "warm-up", "sampling", "output")
    lines = _section(
        "Whole commands",
        "Wall time in seconds, two workers where a command has them, and peak memory.",
        "| command | total | " + " | ".join(names) + " | peak memory, MB |",
        "|---|---:|" + "---:|" * len(names) + "---:|",
    )
    for c in commands:
        cells = " | ".join(f"{c['parts'][n]:.1f}" if n in c["parts"] else "" for n in names)
        lines.append(f"| {c['text']} | {c['seconds']:.1f} | {cells} | {c['peak_MB']:.0f} |")
    return lines
