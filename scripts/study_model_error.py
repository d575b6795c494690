"""Which error model is to be believed? Many specimens that GOH cannot represent.

    python scripts/study_model_error.py run --specimens 120 --out model-error.csv
    python scripts/study_model_error.py table --out model-error.csv [--page docs/model-error.md]

Several shares (--first 0 --step 2 and --first 1 --step 2, each with its own --out) run side by
side; ``table`` takes them all.

Each specimen has three protocols of 40 rows and one of five truths: four fibre families; two
layers of different GOH tissue in parallel; fibres that are recruited gradually, so that the toe is
not GOH; a stiff, concave start as of tissue that was not preconditioned enough; a GOH tissue with a
smooth relative misfit. A third of them are mounted at stretches of 1.1 to 1.3. Every candidate
samples every specimen; rows are appended, and a study that was stopped goes on.
"""

from __future__ import annotations

import argparse
import csv
import os
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pandas as pd

from biaxbayes.errors import BiaxbayesError
from biaxbayes.findings.bands import bands
from biaxbayes.mechanics.goh import cauchy_stress
from model_error.candidates import CANDIDATES, Answer
from model_error.page import put
from model_error.truths import HELD_OUT, Case, make_case, path

SHARES = (0.25, 0.5, 0.75, 1.0)
FIELDS = ("seed", "truth", "candidate", "quantity", "true", "low", "high", "state", "beta", "cpu_s")


def judged(case: Case, answer: Answer) -> list[tuple[str, float, float, float]]:
    """(quantity, truth, 5 %, 95 %) of everything with a truth.

    Credible intervals hold the model's stress; those called ``with error`` hold it plus the
    error that the run inferred, which is mostly the model's.
    """
    draws = answer.draws
    out = []
    for axis, name in enumerate("xy"):
        out.append((f"mounting {name}", case.mounting[axis], draws[f"mounting_stretch_{name}"]))
    theta = [draws[k].to_numpy()[:, None] for k in ("C1", "k1", "k2", "alpha", "kappa")]
    theta[3] = np.deg2rad(theta[3])
    errors = np.random.default_rng(0).standard_normal((len(draws), 2, len(SHARES)))
    growth = draws.get("noise_growth", pd.Series(np.zeros(len(draws)))).to_numpy()[:, None]
    lm = np.column_stack([draws["mounting_stretch_x"], draws["mounting_stretch_y"]])

    def error(load: np.ndarray, axis: int, j: int) -> np.ndarray:
        # sd^2 = w^2 + (b f)^2
        sd = np.hypot(draws["noise_sd"].to_numpy(), growth[:, 0] * load)
        return sd * errors[:, axis, j]

    for ratio, label in (((1.0, 1.0), "1to1"), (HELD_OUT, "held-out")):
        total = path(case.top, case.mounting, ratio, SHARES)
        truth = case.stress(total)
        model = cauchy_stress(*theta, *total.T[:, None, :])
        seen = (total / case.mounting)[None] * lm[:, None, :]
        at_seen = cauchy_stress(*theta, seen[..., 0], seen[..., 1])
        for axis, name in enumerate("xy"):
            for j, share in enumerate(SHARES):
                what = f"{name} {label} {share:g}"
                stress = model[axis][:, j]
                out.append((f"stress {what}", truth[j, axis], stress))
                stress = stress + total[j, axis] * error(stress / total[j, axis], axis, j)
                out.append((f"stress with error {what}", truth[j, axis], stress))
                load = at_seen[axis][:, j] / seen[:, j, axis]
                true = truth[j, axis] / total[j, axis]
                out.append((f"load {what}", true, load))
                out.append((f"load with error {what}", true, load + error(load, axis, j)))
    rows = [(n, float(t), *(float(q) for q in np.quantile(v, [0.05, 0.95]))) for n, t, v in out]
    table = bands(case.held_out, draws, max_draws=400)
    table = table[table["row"] > 0]
    for name, part in table.groupby("direction"):
        inside = (part["measured"] >= part["predictive_q05"]) & (
            part["measured"] <= part["predictive_q95"]
        )
        width = (part["predictive_q95"] - part["predictive_q05"]).mean()
        rows.append((f"predictive {name}", float(inside.mean()), 0.0, float(width)))
        rows.append((f"peak {name}", float(part["measured"].max()), 0.0, 0.0))
    return rows


def run(out: Path, specimens: int, ess: float, first: int, step: int) -> None:
    done = set()
    if out.exists():
        old = pd.read_csv(out)
        done = set(zip(old["seed"], old["candidate"].fillna(""), strict=True))
    else:
        out.write_text(",".join(FIELDS) + "\n")
    for seed in range(first, specimens, step):
        case = make_case(seed)
        for candidate, sampler in CANDIDATES.items():
            if (seed, candidate) in done:
                continue
            clock = time.process_time()
            try:
                answers = sampler(case.specimen, ess)
            except (BiaxbayesError, np.linalg.LinAlgError) as error:
                print(f"{seed} {case.kind} {candidate}: {error}", flush=True)
                continue
            cpu = time.process_time() - clock
            rows = [
                (seed, case.kind, name or candidate, *row, a.state, f"{a.beta:.4g}", f"{cpu:.1f}")
                for name, a in answers.items()
                for row in judged(case, a)
            ]
            with out.open("a", newline="") as file:
                csv.writer(file).writerows(rows)
            print(f"{seed} {case.kind} {candidate}: {cpu:.1f} s", flush=True)


ORDER = (
    "effective",
    "growth",
    "growth, looser mounting",
    "growth, looser, one a curve",
    "independent",
    "sandwich",
)
GROUPS = {
    "stress at total stretches": "stress [xy]",
    "the same with the inferred error": "stress with",
    "load at measured stretches, 1:1": "load [xy] 1to1",
    "the same with the inferred error ": "load with error [xy] 1to1",
    "load at measured stretches, held-out path": "load [xy] held",
    "the same with the inferred error  ": "load with error [xy] held",
    "mounting stretch": "mounting ",
}


def table(out: list[Path]) -> str:
    """The table of docs/model-error.md."""
    data = pd.concat([pd.read_csv(path) for path in out])
    data["inside"] = (data["true"] >= data["low"]) & (data["true"] <= data["high"])
    data["width"] = (data["high"] - data["low"]) / data["true"].abs()
    common = data.groupby("candidate")["seed"].agg(set)
    seeds = set.intersection(*common)
    data = data[data["seed"].isin(seeds)]
    names = [c for c in ORDER if c in set(data["candidate"])]
    lines = [
        f"{len(seeds)} specimens. Share of 90 % intervals that hold the truth (median width, as "
        "a share of it).",
        "",
        "| 90 % intervals of | " + " | ".join(names) + " |",
        "|---|" + "---|" * len(names),
    ]

    def cells(part: pd.DataFrame) -> str:
        return " | ".join(
            f"{part[part.candidate == c].inside.mean():.2f} "
            f"({100 * part[part.candidate == c].width.median():.2g} %)"
            for c in names
        )

    for label, pattern in GROUPS.items():
        chosen = data[data["quantity"].str.match(pattern)]
        lines.append(f"| {label} | {cells(chosen)} |")
        if pattern in ("stress [xy]", "load [xy] held", "mounting "):
            strong = data[data["quantity"] == "mounting x"].set_index("seed")["true"] > 1.09
            far = chosen["seed"].isin(strong[strong].index)
            lines.append(f"| - mounted at up to 1.08 | {cells(chosen[~far])} |")
            lines.append(f"| - mounted at 1.1 to 1.3 | {cells(chosen[far])} |")
            for kind, part in chosen.groupby("truth"):
                lines.append(f"| - {kind} | {cells(part)} |")
    held = data[data["quantity"].str.startswith("predictive")]
    inside = " | ".join(f"{held[held.candidate == c].true.mean():.2f}" for c in names)
    lines.append(f"| readings of the held-out path inside the predictive band | {inside} |")
    states = data[data["quantity"] == "mounting x"]
    bad = " | ".join(f"{(states[states.candidate == c].state != 'reliable').sum()}" for c in names)
    lines.append(f"| runs that did not converge | {bad} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["run", "table"])
    parser.add_argument("--out", type=Path, nargs="+", default=[Path("model-error.csv")])
    parser.add_argument("--page", type=Path, help="Put the table into this page.")
    parser.add_argument("--specimens", type=int, default=120)
    parser.add_argument("--ess", type=float, default=200.0)
    parser.add_argument("--first", type=int, default=0, help="First seed, for a share of the work.")
    parser.add_argument("--step", type=int, default=1)
    options = parser.parse_args()
    if options.what == "run":
        run(options.out[0], options.specimens, options.ess, options.first, options.step)
        return
    text = table(options.out)
    print(text)
    if options.page:
        put(options.page, "model-error", text)


if __name__ == "__main__":
    main()
