"""What the studies share: folders, options, tables, figures, and records of finished cases.

A study prints its tables, and writes long ones to ``tables/`` and figures to ``figures/`` of the
folder ``--out`` (the documentation, by default). The pages are written by hand and quote them.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import pandas as pd

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / "data"
SPECIMENS = ("donor1", "donor2", "donor2-intima", "donor2-media", "donor2-adventitia")
"""The shipped specimens without hooks."""
# Okabe and Ito: told apart by colour-blind readers
BLACK, ORANGE, SKY, GREEN, BLUE, RED, PINK = COLOURS = (
    "#000000", "#E69F00", "#56B4E9", "#009E73", "#0072B2", "#D55E00", "#CC79A7",
)  # fmt: skip

plt.switch_backend("Agg")
plt.rcParams.update(
    {
        "font.size": 8,
        "axes.titlesize": 8,
        "legend.fontsize": 7.5,
        "legend.frameon": False,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "lines.linewidth": 1.2,
        "figure.constrained_layout.use": True,
        "savefig.dpi": 200,
    }
)


def parser(doc: str | None) -> argparse.ArgumentParser:
    """The options that every study has."""
    found = argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    found.add_argument("--quick", action="store_true", help="a small trial of the whole study")
    found.add_argument("--out", type=Path, help="folder of tables and figures  [docs; quick]")
    found.add_argument("--records", type=Path, default=Path("records"), help="finished cases")
    found.add_argument("--workers", type=int, default=1)
    return found


def options_of(arguments: argparse.ArgumentParser) -> argparse.Namespace:
    """The options given; a quick trial does not overwrite the documentation."""
    options = arguments.parse_args()
    if options.out is None:
        options.out = Path("quick") if options.quick else ROOT / "docs"
    return options


def print_table(name: str, table: pd.DataFrame) -> None:
    """Print a short table, which stands on the page itself."""
    text = table.to_string(index=False, float_format="{:.5g}".format)
    print(f"\n{name}\n{text}", flush=True)


def write_table(out: Path, name: str, table: pd.DataFrame) -> None:
    """Print a table and write it to ``tables/NAME.csv``."""
    print_table(name, table)
    path = out / "tables" / f"{name}.csv"
    path.parent.mkdir(parents=True, exist_ok=True)
    table.to_csv(path, index=False, float_format="%.5g")


def save_figure(figure: Any, out: Path, name: str) -> None:
    """Write a figure to ``figures/NAME.png``."""
    path = out / "figures" / f"{name}.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    # without the name of the software the same numbers give the same bytes
    figure.savefig(path, metadata={"Software": None})
    plt.close(figure)


# --- records ------------------------------------------------------------------------------------


def read_records(path: Path) -> list[dict[str, Any]]:
    """Records of a JSON-lines file; a line that was cut short is left out."""
    found = {}
    for line in path.read_text().splitlines() if path.exists() else []:
        try:
            record = json.loads(line)
        except ValueError:
            continue
        found[json.dumps(record["case"])] = record
    return list(found.values())


def run_all(
    study: Callable[..., dict[str, Any]], cases: Sequence[tuple], path: Path, workers: int
) -> list[dict[str, Any]]:
    """``study(*case)`` of all cases; those with a record in the file are not run again."""
    path.parent.mkdir(parents=True, exist_ok=True)
    records = {json.dumps(r["case"]): r for r in read_records(path)}
    missing = [case for case in cases if json.dumps(case) not in records]
    with ProcessPoolExecutor(workers) as pool, path.open("a") as file:
        running = {pool.submit(study, *case): case for case in missing}
        for future in as_completed(running):
            record = {"case": list(running[future]), **future.result()}
            records[json.dumps(record["case"])] = record
            file.write("\n" * (file.tell() > 0) + json.dumps(record))
            file.flush()
            print(path.stem, *record["case"], record.get("state", ""), flush=True)
    return [records[json.dumps(case)] for case in cases]
