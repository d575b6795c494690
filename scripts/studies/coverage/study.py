"""Whether reported intervals, bounds and bands hold, on specimens of another generator.

    python scripts/study.py coverage --count 40
    python scripts/study.py coverage --products new=src old=OLD/src --count 4
    python scripts/study.py coverage --families noise-0.1 noise-2 --independent --count 12

Families of specimens (:mod:`.specimens`), each with one protocol and three:

- GOH with a smooth misfit of 2 %: of three lengths along the path, the same in x and y, a function
  of the plane of stretches, a toe, a gain of each curve
- GOH with load noise alone, 0.1 to 5 % of the largest load
- GOH with an error that is no random process: a polynomial of the path (2 %), friction (2 % of the
  largest load), a viscous branch (2 to 8 %), loads read late by a row, slip in the grips (2 %)
- tissue of other laws, mounted at up to 1.12, and at 1.2 to 1.6; a law of the package that is the
  truth is not asked

A product is a version of the package, by the folder that it is imported from; each runs in a
process of its own (:mod:`.answers`) and sees nothing but the files. Cases that have a record are
not run again. Beside the records, ``coverage-rows.csv`` has a row per specimen and parameter, and
``coverage-bands.csv`` one per specimen with a left-out path.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from studies.common import ROOT, options_of, parser, print_table, read_records, run_all
from studies.coverage import tables
from studies.coverage.specimens import FAMILIES, make_case
from studies.coverage.tables import INDEPENDENT

FIRST = 500


# --- one specimen --------------------------------------------------------------------------------

_running: dict[str, subprocess.Popen[str]] = {}


def _product(folder: str) -> subprocess.Popen[str]:
    """The process of a version of the package, started when it is first asked."""
    known = _running.get(folder)
    if known is None or known.poll() is not None:
        known = subprocess.Popen(
            [sys.executable, "-W", "ignore", str(Path(__file__).with_name("answers.py"))],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": folder},
        )
        _running[folder] = known
    return known


def judge(
    products: dict[str, str], product: str, family: str, protocols: int, seed: int
) -> dict[str, Any]:
    """What a product says of a specimen, beside the truth."""
    case = make_case(family, protocols, seed)
    options: dict[str, Any] = {} if case.mounting_sd is None else {"mounting_sd": case.mounting_sd}
    if product.endswith(INDEPENDENT):
        options["noise"] = "independent"
    path = None if case.left_out is None else case.left_out[:, :2].tolist()
    process = _product(products[product.removesuffix(INDEPENDENT)])
    assert process.stdin is not None and process.stdout is not None
    with tempfile.NamedTemporaryFile("w", suffix=".csv", encoding="utf-8") as file:
        file.write(case.text)
        file.flush()
        request = {"file": file.name, "options": options, "path": path}
        process.stdin.write(json.dumps(request) + "\n")
        process.stdin.flush()
        line = process.stdout.readline()
    if not line:
        return {"state": "the process ended", "rows": [], "seconds": {}}
    answer = json.loads(line)
    for row in answer["rows"]:
        row["true"] = case.truth.get(row["parameter"])
    rows = [row for row in answer["rows"] if row["true"] is not None]
    out = {"state": answer["state"], "seconds": answer["seconds"], "rows": rows}
    if case.left_out is not None and "bands" in answer:
        out["bands"] = judge_bands(case.left_out, answer["bands"])
    return out


def judge_bands(left_out: np.ndarray, bands: dict[str, list[float]]) -> dict[str, float]:
    """Shares of a left-out path inside both bands, and the width of the band of the tissue."""
    true, read = left_out[:, 2:4], left_out[:, 4:6]

    def ends(band: str, end: str) -> np.ndarray:
        columns = [f"piola_{axis}_kPa_{band}_{end}" for axis in "xy"]
        return np.column_stack([bands[name] for name in columns])

    out = {}
    for band, values in (("credible", true), ("predictive", read)):
        low, high = ends(band, "low"), ends(band, "high")
        out[band] = float(np.mean((values >= low) & (values <= high)))
        out[f"{band}_width"] = float(np.mean((high - low) / np.abs(true).max(axis=0)))
    return out


# --- all of them ---------------------------------------------------------------------------------


def tabulate(records: list[dict[str, Any]], folder: Path, beside: str) -> None:
    """Write the rows, print what holds."""
    rows, bands = tables.row_table(records), tables.band_table(records)
    for name, table in (("rows", rows), ("bands", bands)):
        table.to_csv(folder / f"coverage-{name}.csv", index=False, float_format="%.6g")
    if rows.empty:
        return
    parts = {"parameters": rows[~rows["mounting"]], "mounting stretches": rows[rows["mounting"]]}
    shown = [
        *(
            (what, tables.what_holds(part, beside, by))
            for what, part in parts.items()
            for by in (["product", "family"], ["product", "family", "protocols"])
        ),
        ("each parameter", tables.what_holds(rows, beside, ["product", "parameter"])),
        ("widths over those of independent errors", tables.cost(rows)),
        ("left-out path", tables.band_means(bands)),
        ("not converged", tables.unfinished(records)),
    ]
    for name, table in shown:
        if len(table):
            print_table(name, table)


def main() -> None:
    """Run the study."""
    arguments = parser(__doc__)
    arguments.add_argument(
        "--products", nargs="+", default=[f"new={ROOT / 'src'}"], metavar="NAME=FOLDER"
    )
    arguments.add_argument("--beside", default="old", help="product whose widths are compared with")
    arguments.add_argument("--families", nargs="+", choices=FAMILIES, metavar="NAME")
    arguments.add_argument("--protocols", nargs="+", type=int, choices=(1, 3), default=(1, 3))
    arguments.add_argument("--first", type=int, default=FIRST, help="first seed")
    arguments.add_argument("--count", type=int, default=40, help="seeds of each family")
    arguments.add_argument("--independent", action="store_true", help="independent errors as well")
    arguments.add_argument("--tabulate", action="store_true", help="only what is recorded")
    options = options_of(arguments)
    products = dict(text.split("=", 1) for text in options.products)
    file = options.records / "coverage.jsonl"
    if options.tabulate:
        tabulate(read_records(file), options.records, options.beside)
        return
    families = options.families or FAMILIES[: 1 if options.quick else None]
    seeds = range(options.first, options.first + (1 if options.quick else options.count))
    names = [*products, *(p + INDEPENDENT for p in products if options.independent)]
    for seed in seeds:
        cases = [
            (product, family, protocols, seed)
            for family in families
            for protocols in options.protocols
            for product in names
        ]
        run_all(partial(judge, products), cases, file, options.workers)
    tabulate(read_records(file), options.records, options.beside)


if __name__ == "__main__":
    main()
