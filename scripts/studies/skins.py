"""Are mounting stretches right on tissue where they were measured? 37 mouse skins.

    git clone https://github.com/tajtac/Anisotropic_NN_UMAT
    python scripts/study.py skins --checkout Anisotropic_NN_UMAT --workers 2

``docs/measured-mounting.md`` quotes the tables. ``Data/Murine`` of the repository has the records
of Meador et al., Acta Biomaterialia 101 (2020) 403-413: squares of mouse skin, photographed
unloaded and again after a preload of 50 mN, then stretched equibiaxially and off-biaxially (x and
y). Each record stands there twice, with stretches from the unloaded and from the preloaded state;
their ratio is the mounting stretch, measured from images. The conversion:

- the first row of each table, stretch 1 at stress 0, was put in by the authors and is left out; the
  next one is the preloaded state, which is our mounted state, with its stress;
- stresses are Cauchy stresses (MPa to kPa), so the sections are those of the mounted state;
- the measured stretch is that of the unloaded table over its value in the preloaded state.

Each skin is sampled three times: with the defaults, with a wide prior of the mounting stretch, and
with the measured one stated in the header. Skins are numbered by their folders in alphabetic order.
Nothing was tuned on those with even numbers.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes import fit, prepare, read_specimen
from biaxbayes.errors import BiaxbayesError
from biaxbayes.identifiability.identify import identify_draws
from biaxbayes.identifiability.verdict import BOUNDED, IDENTIFIED
from biaxbayes.model.draw import draw_posterior
from biaxbayes.runs.archive import draw_table
from biaxbayes.sampling.sampler import Plan
from studies.common import options_of, parser, print_table, run_all, write_table

TABLES = Path("Data", "Murine", "AllStressStretchDataCSVs", "InVitroUnloaded")
PROTOCOLS = {"Equibiaxial": "equibiaxial", "OffbiaxialX": "off x", "OffbiaxialY": "off y"}
COLUMNS = ["Lambda11(-)", "Lambda22(-)", "Sigma11(MPa)", "Sigma22(MPa)"]
MEASURED_SD = 0.01
"""Of a mounting stretch from images: about a tenth of a pixel in 8 mm at the authors' images."""
PLAN = Plan(ess=200, max_steps=3000, ensembles=2, walkers=32, population=2048)
STRETCHES = ("mounting_stretch_x", "mounting_stretch_y")
PRIORS: dict[str, dict[str, Any]] = {
    "default": {},
    "skin": {"mounting_sd": 0.3},
    "measured": {},
}
"""Options of the posterior; ``measured`` has the stretch in the header of the file."""


def skins(checkout: Path) -> list[Path]:
    """Folders of the skins, in alphabetic order."""
    found = sorted(p for p in (checkout / TABLES).glob("Subject*") if p.is_dir())
    if not found:
        raise SystemExit(f"{checkout / TABLES}: no such folders; name a checkout with --checkout")
    return found


def record(folder: Path) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Rows of each protocol from the mounted state, (n, 4), and the measured mounting stretch."""
    rows, mounting = {}, []
    for name, protocol in PROTOCOLS.items():
        table = pd.read_csv(folder / f"{folder.name}_{name}.csv")[COLUMNS].to_numpy()[1:]
        mounting.append(table[0, :2])
        rows[protocol] = np.hstack([table[:, :2] / table[0, :2], 1e3 * table[:, 2:]])
    return rows, np.mean(mounting, axis=0)


def write_specimen(folder: Path, path: Path, *, measured: bool) -> np.ndarray:
    """Write the specimen file of a skin, and return its measured mounting stretch."""
    rows, mounting = record(folder)
    head = {"specimen": folder.name, "axis_x": "lateral", "axis_y": "cranial-caudal"}
    head |= {"geometry": "mounted"}
    if measured:
        for name, value in zip(STRETCHES, mounting, strict=True):
            head[name] = f"{value:.4f} +- {MEASURED_SD}"
    lines = [f"# {key}: {value}" for key, value in head.items()]
    lines.append("protocol,stretch_x,stretch_y,cauchy_x_kPa,cauchy_y_kPa")
    for protocol, table in rows.items():
        lines += [f"{protocol},{','.join(f'{v:.6g}' for v in row)}" for row in table]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")
    return mounting


def sampled(checkout: str, number: int, prior: str) -> dict[str, Any]:
    """What the tool says of a skin with a prior, and least squares of the same file."""
    folder = skins(Path(checkout))[number - 1]
    with tempfile.TemporaryDirectory() as place:
        path = Path(place, f"skin-{number}.csv")
        mounting = write_specimen(folder, path, measured=prior == "measured")
        specimen = read_specimen(path)
    found: dict[str, Any] = {"skin": folder.name, "measured": mounting.tolist()}
    try:
        posterior = prepare(specimen, **PRIORS[prior])
        drawn = draw_posterior(posterior, PLAN)
        state = drawn.convergence.state
        rows = identify_draws(posterior, draw_table(drawn.quantities), state).reported
        fits = [posterior.fit, fit(specimen, "standard")]
    except BiaxbayesError as error:
        return found | {"state": str(error)}
    return found | {
        "state": state,
        "report": {r.name: [r.median, r.low, r.high, r.verdict, r.bound] for r in rows},
        "fits": {f.method: [float(f.material.k1_kPa), f.rms / specimen.peak_load] for f in fits},
    }


# --- tables --------------------------------------------------------------------------------------


def verdict_is(row: list[Any], truth: float) -> str:
    """Whether a row of the report is right, wrong or silent about a mounting stretch.

    An identified one states its 90 % interval, a bounded one the end that it names.
    """
    _, low, high, verdict, bound = row
    if verdict == BOUNDED:
        low, high = (low, np.inf) if bound == "low" else (-np.inf, high)
    elif verdict != IDENTIFIED:
        return "silent"
    return "right" if low <= truth <= high else "wrong"


def rows_of(records: list[dict[str, Any]]) -> pd.DataFrame:
    """A row for each mounting stretch of each skin and prior."""
    out = []
    for record in records:
        _, number, prior = record["case"]
        for name, truth in zip(STRETCHES, record["measured"], strict=True):
            row = {"number": number, "skin": record["skin"], "prior": prior, "stretch": name[-1]}
            row |= {"measured": truth, "state": record["state"]}
            if record["state"] == "converged":
                said = record["report"][name]
                row |= dict(zip(("median", "low", "high", "verdict"), said, strict=False))
                row["holds"] = row["low"] <= truth <= row["high"]
                row["says"] = verdict_is(said, truth)
                row["k1_kPa"] = record["report"]["k1"][0]
                for method, (k1, miss) in record["fits"].items():
                    row |= {f"k1_{method}_kPa": k1, f"miss_{method}_percent": 100.0 * miss}
            out.append(row)
    return pd.DataFrame(out)


def halves(table: pd.DataFrame) -> Iterator[tuple[dict[str, Any], pd.DataFrame]]:
    """Rows of skins with odd and with even numbers and of each prior, sampled to the end."""
    converged = table[table["state"] == "converged"]
    half = np.where(converged["number"] % 2 == 1, "odd", "even")
    for (which, prior), group in converged.groupby([half, "prior"], sort=False):
        yield {"skins": which, "prior": prior}, group


def intervals(table: pd.DataFrame) -> pd.DataFrame:
    """Intervals that hold, and verdicts that are right."""
    out = []
    for row, group in halves(table):
        row |= {"stretches": len(group), "in the 90 % interval": int(group["holds"].sum())}
        row |= {word: int((group["says"] == word).sum()) for word in ("right", "wrong", "silent")}
        row["median error"] = (group["median"] - group["measured"]).abs().median()
        row["median width"] = (group["high"] - group["low"]).median()
        out.append(row)
    return pd.DataFrame(out)


def materials(table: pd.DataFrame) -> pd.DataFrame:
    """Medians over the skins of k1 and of the miss of least squares, % of the largest load."""
    kinds = ("k1_kPa", "k1_constrained_kPa", "k1_standard_kPa")
    columns = [*kinds, "miss_constrained_percent", "miss_standard_percent"]
    return pd.DataFrame([row | dict(group[columns].median()) for row, group in halves(table)])


def main() -> None:
    """Sample the skins and print what holds."""
    arguments = parser(__doc__)
    arguments.add_argument("--checkout", type=Path, required=True)
    arguments.add_argument("--which", choices=("odd", "even", "all"), default="all")
    arguments.add_argument("--every", type=int, default=1, metavar="N", help="one in N of them")
    arguments.add_argument("--priors", nargs="*", choices=tuple(PRIORS), default=list(PRIORS))
    options = options_of(arguments)
    count = len(skins(options.checkout))
    numbers = [n for n in range(1, count + 1) if options.which in ("all", ("even", "odd")[n % 2])]
    numbers = numbers[:: options.every]
    cases = [(str(options.checkout), n, prior) for prior in options.priors for n in numbers]
    table = rows_of(run_all(sampled, cases, options.records / "skins.jsonl", options.workers))
    write_table(options.out, "measured-mounting", table)
    print_table("mounting stretches", intervals(table))
    print_table("materials, medians", materials(table))


if __name__ == "__main__":
    main()
