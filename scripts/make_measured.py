"""Make specimen files of measured tissue from a checkout of the repository that has the numbers.

    git clone https://github.com/DylanArmfield/AnisotropicHyperelastic_Calibration
    python scripts/make_measured.py AnisotropicHyperelastic_Calibration

writes ``data/measured/caballero.csv`` and ``data/measured/li.csv``. The folder ``test_data`` of
the repository (MIT licence, copyright 2025 Dylan Armfield) has two tables for each protocol,
``E11`` and ``E22``: points of printed curves of strain and stress, read off one by one. No two
points of x and y belong together. The conversion:

- stretch is the exponential of the strain, which the program in the repository takes as the
  logarithmic one; stress is Cauchy stress in kPa, and nominal stress is it over the stretch;
- points at which the stress does not rise are left out: they are scatter of reading them off;
- both loads of a protocol rise together, so x and y are taken at equal shares of their own largest
  nominal stress: at the shares of the points of x, and y by straight lines between its points;
- the origin of the printed axes, stretch 1 and stress 0, is the first row.

``data/measured/README.md`` says what is known of the tissue and what this assumes.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parents[1] / "data" / "measured"
PROTOCOLS = {
    "03_1": "1:0.3",
    "05_1": "1:0.5",
    "075_1": "1:0.75",
    "1_1": "1:1",
    "1_075": "0.75:1",
    "1_05": "0.5:1",
    "1_03": "0.3:1",
}
"""Protocols by the names in the files, which are y to x; ours are x to y."""
NOISE_KPA = 10
"""Sd of a stress from reading it off: a dot of the figures is some 2 kPa high, and its width is
worth 25 kPa where the curves are steepest."""
REPOSITORY = "DylanArmfield/AnisotropicHyperelastic_Calibration"
SPECIMENS = {"caballero": "Caballero", "li": "Li"}


def points(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Stretch and nominal stress (kPa) of the points of a curve, from the origin and rising."""
    stretch, nominal = [1.0], [0.0]
    with path.open(encoding="utf-8-sig", newline="") as lines:
        for row in csv.DictReader(lines):
            if not row["Strain"].strip():  # rows of commas at the end of a table
                continue
            at = float(np.exp(float(row["Strain"])))
            if float(row["Stress"]) / at > nominal[-1]:
                stretch.append(at)
                nominal.append(float(row["Stress"]) / at)
    return np.array(stretch), np.array(nominal)


def rows(folder: Path, source: str) -> dict[str, np.ndarray]:
    """Rows of stretch and Cauchy stress in x and y by protocol."""
    found = {}
    for name, protocol in PROTOCOLS.items():
        files = [folder / f"{source}_{axis}_{name}.csv" for axis in ("E11", "E22")]
        if not all(file.is_file() for file in files):
            continue
        (x, load_x), (y, load_y) = (points(file) for file in files)
        share = load_x / load_x[-1]
        stretch_y = np.interp(share, load_y / load_y[-1], y)
        table = np.column_stack([x, stretch_y, load_x * x, share * load_y[-1] * stretch_y])
        found[protocol] = table
    return found


def write(folder: Path, name: str) -> Path:
    """Write the specimen file of one source."""
    head = {
        "specimen": f"{name}, digitised",
        "axis_x": "E11",
        "axis_y": "E22",
        "geometry": "mounted",
        "load_noise_kPa": NOISE_KPA,
        "source": f"points of printed curves, {SPECIMENS[name]}_E*.csv of test_data in "
        f"{REPOSITORY}, MIT licence, copyright 2025 Dylan Armfield",
        "conversion": "logarithmic strain and Cauchy stress; x and y paired at equal shares of "
        "their largest nominal stress; first rows are the origin of the printed axes; no mounting "
        "force",
    }
    lines = [f"# {key}: {value}" for key, value in head.items()]
    lines.append("protocol,stretch_x,stretch_y,cauchy_x_kPa,cauchy_y_kPa")
    for protocol, table in rows(folder, SPECIMENS[name]).items():
        ends = table[-1, 2:] / table[-1, :2]
        print(f"{name} {protocol}: {len(table)} rows, largest nominal stress {ends.round()} kPa")
        lines += [f"{protocol},{','.join(f'{v:.6g}' for v in row)}" for row in table]
    path = HERE / f"{name}.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")
    return path


def main() -> None:
    folder = Path(sys.argv[1] if len(sys.argv) == 2 else "") / "test_data"
    if not folder.is_dir():
        sys.exit(f"{folder}: no such folder; name a checkout of the repository")
    for name in SPECIMENS:
        print(write(folder, name))


if __name__ == "__main__":
    main()
