"""Sentences of the paper that its own tables, or ours, can check."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from studies.page import write_table
from studies.paper.printed import TABLE5, TABLE6, TRUTH, VIRTUAL
from studies.paper.table6 import bias

__all__ = ["section"]

LAYERS = {"donor2-intima": 0.16, "donor2-media": 0.52, "donor2-adventitia": 0.32}


def _mean_prestretch() -> tuple[str, bool]:
    lms = np.array([row["fip"].mounting_stretch for row in TABLE6.values()])
    mean, most = 100 * (lms - 1).mean(), 100 * (lms - 1).max()
    return f"mean {mean:.2f} %, largest {most:.1f} %", abs(mean - 1.24) < 0.005


def _layers() -> tuple[str, bool]:
    from biaxbayes.laws.published import MATERIALS

    pairs = [(share * 1.69, MATERIALS[name].thickness_mm or 0.0) for name, share in LAYERS.items()]
    shown = ", ".join(f"{value:.3f} (prints {printed})" for value, printed in pairs)
    return shown + " mm", all(abs(value - printed) < 0.005 for value, printed in pairs)


def _k1_rises() -> tuple[str, bool]:
    rises = [
        name
        for name, rows in TABLE6.items()
        if float(rows["zeroed"].theta[1]) > float(rows["standard"].theta[1])
    ]
    return "k1 rises for " + ", ".join(rises), set(TABLE6) - set(rises) == {"donor1"}


def _order_of_magnitude() -> tuple[str, bool]:
    ratios = [
        float(rows["standard", p].mae) / float(rows["zeroed", p].mae)
        for rows in VIRTUAL.values()
        for p in ("1.005", "1.010", "1.015", "1.020")
    ]
    return f"{min(ratios):.1f} to {max(ratios):.0f} times lower", min(ratios) >= 10.0


def _linear() -> tuple[str, bool]:
    scores = []
    for rows in VIRTUAL.values():
        y = np.array([float(rows["zeroed", p].mae) for p in ("1.005", "1.010", "1.015", "1.020")])
        scores.append(float(np.corrcoef(np.arange(4.0), y)[0, 1] ** 2))
    shown = " and ".join(f"{score:.4f}" for score in scores)
    return f"R2 of a straight line {shown} (M55, media)", min(scores) > 0.99


def _bounds() -> tuple[str, bool]:
    inside = [
        f"{name} {method}"
        for name, rows in TABLE6.items()
        for method, row in rows.items()
        if row.theta[3] not in ("90.00", "0") and row.theta[4] != "0"
    ]
    return f"{15 - len(inside)} of 15 rows", not inside


def _underestimated() -> tuple[str, bool]:
    truth = [float(v) for v in TRUTH["weisbecker-media"]]
    rows = [r for (m, _), r in VIRTUAL["weisbecker-media"].items() if m == "standard"]
    low = all(r.values[1] < truth[1] and r.values[2] < truth[2] for r in rows)
    return "k1 and k2 below the truth in all four rows" if low else "not in all rows", low


def _ovine() -> tuple[str, bool]:
    most = max(max(r.mounting_stretch) for rows in TABLE5.values() for r in rows.values())
    return f"largest {100 * (most - 1):.1f} %", 0.095 <= most - 1 <= 0.105


def _five_times() -> tuple[str, bool]:
    most = max(bias(name, "standard").overestimate for name in TABLE6)
    return f"{most:.1f} times (donor1)", most > 5.0


def _good_fits() -> tuple[str, bool]:
    scores = [bias(name, m).own.r2 for name in TABLE6 for m in ("standard", "zeroed")]
    return f"least R2 of the virtual specimens {min(scores):.3f}", min(scores) > 0.98


def _matrix() -> tuple[str, bool]:
    high = all(r["standard"].values[0] > r["fip"].values[0] for r in TABLE6.values())
    low = all(r["zeroed"].values[0] < r["fip"].values[0] for r in TABLE6.values())
    virtual = [
        n for n in TABLE6 if bias(n, "zeroed").own.material.C1_kPa > TABLE6[n]["fip"].values[0]
    ]
    shown = "true of every printed row; without noise zeroed overestimates for " + ", ".join(
        virtual
    )
    return shown, high and low


CHECKS = (
    ("Donor layers are 16, 52 and 32 % of 1.69 mm", _layers),
    ("Prestretch up to about 2.8 %, mean 1.24 % (Table 6)", _mean_prestretch),
    ("Ovine prestretches up to 10 % (Table 5)", _ovine),
    ("k1 greater by zeroed than by standard, except Donor 1 (Table 6)", _k1_rises),
    ("Every fit of Table 6 has a structural parameter on its bound", _bounds),
    ("Standard overestimates C1, zeroed underestimates it (Table 6)", _matrix),
    ("Standard fits their own data with R2 > 0.98 (Table 6)", _good_fits),
    ("Stresses overestimated more than five times", _five_times),
    ("Standard underestimates k1 and k2 (Table 4)", _underestimated),
    ("MAE of zeroed lower by an order of magnitude than of standard", _order_of_magnitude),
    ("MAE of zeroed almost linear in prestretch (Figure 8)", _linear),
)


def section(folder: Path) -> tuple[str, list[str]]:
    """Markdown, and the disagreements for the summary."""
    rows, disagreements = [], []
    for claim, check in CHECKS:
        found, holds = check()
        rows.append([claim, found, "yes" if holds else "no"])
        if not holds:
            disagreements.append(f"- Text: **{claim}**: {found}.")
    link = write_table(folder, "paper-statements", ["the_paper_says", "found", "holds"], rows)
    held = sum(holds == "yes" for *_, holds in rows)
    text = (
        f"### Smaller statements\n\n{held} of {len(rows)}, on prestretches, layers, bounds and the "
        f"direction of the bias, [hold]({link}).\n"
    )
    return text, disagreements
