"""What intervals are worth on tissue that GOH cannot represent, by error model.

    python scripts/study.py model_error --workers 2
    python scripts/study.py model_error --candidates effective growth independent

Each specimen has three protocols of 40 rows and one of five truths: four fibre families; two
layers of different GOH tissue in parallel; fibres that are recruited gradually, so that the toe is
not GOH; a stiff, concave start as of tissue that was not preconditioned enough; GOH with a smooth
relative misfit. A third of them are mounted at stretches of 1.1 to 1.3. ``docs/model-error.md``
quotes the tables.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from biaxbayes.errors import BiaxbayesError
from studies.common import (
    BLUE,
    GREEN,
    RED,
    options_of,
    parser,
    run_all,
    save_figure,
    write_table,
)
from studies.model_error.candidates import CANDIDATES, sampled
from studies.model_error.judge import FAR, judged
from studies.model_error.truths import make_case

GROUPS = (
    "tissue at measured stretches",
    "model at measured stretches",
    "tissue at total stretches",
    "model at total stretches",
    "held-out readings",
    "mounting",
    "mounting, stated value",
    "mounting, stated low end",
    "parameters",
)


def judge(candidate: str, seed: int) -> dict[str, Any]:
    """Every interval of one specimen and candidate beside its truth."""
    case = make_case(seed)
    try:
        answer = sampled(case.specimen, candidate)
    except (BiaxbayesError, np.linalg.LinAlgError) as error:
        return {"state": str(error), "rows": []}
    rows = judged(case, seed, answer)
    rows["inside"] = (rows["true"] >= rows["low"]) & (rows["true"] <= rows["high"])
    # of a low end alone: how far it lies below the truth
    high = rows["high"].where(np.isfinite(rows["high"]), rows["true"])
    rows["width_percent"] = 100.0 * (high - rows["low"]) / rows["true"].abs()
    rows["kind"], rows["far"] = case.kind, bool(case.mounting.mean() > FAR)
    kept = rows[["group", "kind", "far", "inside", "width_percent"]]
    return {"state": answer.state, "rows": kept.to_dict("records")}


def coverage(records: list[dict[str, Any]]) -> pd.DataFrame:
    """Share of 90 % intervals that contain the truth, by candidate, group and part."""
    every = pd.concat(
        [
            pd.DataFrame(record["rows"]).assign(candidate=candidate, seed=seed)
            for record in records
            for candidate, seed in [record["case"]]
            if record["rows"]
        ]
    )
    rows = []
    for (candidate, group), part in every.groupby(["candidate", "group"], sort=False):
        parts = {"": part, "mounted at up to 1.08": part[~part["far"]]}
        parts |= {"mounted at 1.1 to 1.3": part[part["far"]]}
        parts |= {str(kind): own for kind, own in part.groupby("kind")}
        for name, own in parts.items():
            row = {"candidate": candidate, "group": group, "part": name}
            row |= {"share_inside": own["inside"].mean(), "intervals": len(own)}
            row |= {"specimens": own["seed"].nunique()}
            rows.append({**row, "median_width_percent": own["width_percent"].median()})
    return pd.DataFrame(rows)


def draw_coverage(found: pd.DataFrame, out: Path) -> None:
    """Draw the share of intervals that contain the truth, by truth and of all quantities."""
    drawing, axes = plt.subplots(1, 2, figsize=(6.9, 2.9), sharex=True)
    found = found[found["candidate"] == found["candidate"].iloc[0]]
    parts = list(dict.fromkeys(found["part"]))
    for group, marker, colour in zip(
        (GROUPS[0], GROUPS[2], GROUPS[7]), "osv", (BLUE, RED, GREEN), strict=True
    ):
        part = found[found["group"] == group]
        at = [parts.index(name) for name in part["part"]]
        look = {"color": colour, "mfc": "none", "ms": 5, "label": group}
        axes[0].plot(part["share_inside"], at, marker, **look)
    axes[0].set_yticks(range(len(parts)), [name or "all specimens" for name in parts])
    together = found[found["part"] == ""].set_index("group")["share_inside"].reindex(GROUPS)
    axes[1].plot(together, range(len(GROUPS)), "ok", ms=4)
    axes[1].set_yticks(range(len(GROUPS)), GROUPS)
    for ax in axes:
        ax.axvline(0.9, color="0.6", lw=0.8, zorder=0)
        ax.invert_yaxis()
        ax.set(xlim=(0.3, 1.02), xlabel="share of 90 % intervals")
    drawing.legend(*axes[0].get_legend_handles_labels(), loc="outside upper left", ncols=3)
    save_figure(drawing, out, "model-error")


def main() -> None:
    """Sample and judge all specimens with the candidates."""
    arguments = parser(__doc__)
    arguments.add_argument("--specimens", type=int, default=105)
    arguments.add_argument(
        "--candidates", nargs="+", choices=CANDIDATES, default=["effective"], metavar="NAME"
    )
    options = options_of(arguments)
    seeds = range(3 if options.quick else options.specimens)
    cases = [(candidate, seed) for candidate in options.candidates for seed in seeds]
    records = run_all(judge, cases, options.records / "model-error.jsonl", options.workers)
    found = coverage(records)
    several = len(options.candidates) > 1
    write_table(options.out, "model-error-candidates" if several else "model-error", found)
    if not several:
        draw_coverage(found, options.out)


if __name__ == "__main__":
    main()
