"""Leave-one-protocol-out on a measured specimen, for every error model.

    biaxbayes convert ... --out aorta.csv
    python scripts/study_leave_out.py aorta.csv [--page docs/model-error.md]

Prints the tables of docs/model-error.md. Rows are thinned with every error model, which for
independent errors too leaves the posterior as it is (biaxbayes.specimens.thinning).
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import pandas as pd

from biaxbayes import read_specimen
from biaxbayes.findings.leave_out import leave_out
from biaxbayes.inference.sampler import Plan
from model_error.page import put

MODELS = {
    "effective": {},
    "independent": {"noise": "independent"},
    "effective, growing": {"noise_growth": True},
    "effective, per-protocol mounting": {"mounting_stretch": "per-protocol"},
    "systematic, growing": {"noise": "systematic", "noise_growth": True},
    "systematic, growing, per-protocol mounting": {
        "noise": "systematic",
        "noise_growth": True,
        "mounting_stretch": "per-protocol",
    },
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("specimen", type=Path)
    parser.add_argument("--out", type=Path, default=Path("leave-out.csv"))
    parser.add_argument("--ess", type=float, default=400.0)
    parser.add_argument("--page", type=Path, help="Put the table into this page.")
    options = parser.parse_args()
    specimen = read_specimen(options.specimen)
    done = pd.read_csv(options.out) if options.out.exists() else pd.DataFrame()
    for model, chosen in MODELS.items():
        for protocol in specimen.protocols:
            if len(done) and ((done.model == model) & (done.protocol == protocol.name)).any():
                continue
            clock = time.process_time()
            plan = Plan(ess=options.ess, workers=1, max_steps=8000)
            table = leave_out(specimen, protocol.name, plan=plan, **{"thin": 100, **chosen})
            table.insert(0, "model", model)
            table["cpu_s"] = round(time.process_time() - clock, 1)
            done = pd.concat([done, table], ignore_index=True)
            done.to_csv(options.out, index=False)
            print(table.to_string(header=False), flush=True)
    text = report(done)
    print(text)
    if options.page:
        put(options.page, "leave-out", text)


def report(done: pd.DataFrame) -> str:
    curves = done.assign(curve=done["protocol"] + " " + done["direction"])
    models = [m for m in MODELS if m in set(done["model"])]
    wide = curves.pivot(index="curve", columns="model", values="inside")[models]
    lines = ["| left out | " + " | ".join(models) + " |", "|---|" + "---|" * len(models)]
    for curve, row in wide.iterrows():
        lines.append(f"| {curve} | " + " | ".join(f"{v:.2f}" for v in row) + " |")
    lines.append("| **mean** | " + " | ".join(f"**{v:.2f}**" for v in wide.mean()) + " |")
    for label, column in (("rms miss", "rms"), ("mean width of the band", "width")):
        means = curves.groupby("model")[column].mean()[models]
        lines.append(f"| {label} | " + " | ".join(f"{v:.2g}" for v in means) + " |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
