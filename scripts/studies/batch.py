"""Measure studies on two local workers against one, and check that the results are equal.

Needs a quiet machine with two processors:

    python scripts/study.py batch --specimens 10 100 --folder /tmp/batch

--write puts the table into a page between its marks.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil

from biaxbayes.laws.goh import GOH
from biaxbayes.specimens.specimen_file import write_specimen
from biaxbayes.specimens.virtual_specimen import Machine, virtual_specimen
from studies.page import put, table

LAYERS = {
    "intima": GOH(C1_kPa=30.0, k1_kPa=60.0, k2=20.0, alpha_deg=60.0, kappa=0.15),
    "media": GOH(C1_kPa=14.0, k1_kPa=140.0, k2=11.9, alpha_deg=38.4, kappa=0.21),
    "adventitia": GOH(C1_kPa=7.0, k1_kPa=8.0, k2=30.0, alpha_deg=50.0, kappa=0.05),
}
INCREMENTS = 50
WORKERS = (1, 2)
EXTRAPOLATED = 1000
SPREAD = 0.15
"""Of the stiffnesses between donors, in logs."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--specimens", type=int, nargs="+", default=[10, 100])
    parser.add_argument("--folder", type=Path, required=True, help="made, and overwritten")
    parser.add_argument("--ess", type=float, default=2000.0)
    parser.add_argument("--write", type=Path, help="Markdown page whose table is replaced")
    arguments = parser.parse_args()
    sizes = sorted(arguments.specimens)
    found, differing, compared_files = [], [], 0
    for size in sizes:
        folder = arguments.folder / str(size)
        shutil.rmtree(folder, ignore_errors=True)
        write_specimens(folder, size, arguments.ess)
        if size == sizes[0]:  # what is compiled for the first time is compiled here
            run(folder, "study.toml", "warm", 1, only=1)
        found += [run(folder, "study.toml", f"on-{workers}", workers) for workers in WORKERS]
        differing += [name for name in compared(folder) if not equal(folder, name)]
        compared_files += len(compared(folder))
    seconds = np.array([f[0] for f in found]).reshape(len(sizes), len(WORKERS))
    held_MB, own_MB = (max(f[k] for f in found) for k in (1, 2))
    bytes_of = f"other bytes in {', '.join(differing)}" if differing else "the same bytes"
    beyond = f"{EXTRAPOLATED:,} specimens are extrapolated from the last two rows. "
    text = scaling(sizes, seconds) + (
        f"\nWall time in seconds on a machine with {os.cpu_count()} processors; specimens of "
        f"{INCREMENTS + 1} rows in each of three protocols, figures included. "
        f"{beyond if len(sizes) > 1 else ''}No process held more than {held_MB} MB, or more than "
        f"{own_MB} MB that it shared with no other: what a further worker takes. One and two "
        f"workers wrote {bytes_of} in {compared_files} tables.\n"
    )
    print(text)
    if arguments.write:
        put(arguments.write, "batch", text)
    return int(bool(differing))


def scaling(sizes: list[int], seconds: np.ndarray) -> str:
    """Table of wall times by the number of specimens and workers."""
    rows = [*zip(sizes, seconds, strict=True)]
    if len(sizes) > 1:
        slope = (seconds[-1] - seconds[-2]) / (sizes[-1] - sizes[-2])
        rows.append((EXTRAPOLATED, seconds[-1] + slope * (EXTRAPOLATED - sizes[-1])))
    heads = ["specimens", "one worker", "two workers", "times as fast", "a specimen, two workers"]
    return table(
        heads,
        [
            [f"{n:,}", f"{t[0]:.0f}", f"{t[1]:.0f}", f"{t[0] / t[1]:.2f}", f"{t[1] / n:.1f}"]
            for n, t in rows
        ],
    )


def write_specimens(folder: Path, count: int, ess: float) -> None:
    """Virtual specimens of three layers a donor, and the study file."""
    folder.mkdir(parents=True)
    lines = [f"ess = {ess}"]
    for number in range(count):
        donor, layer = f"donor{number // 3 + 1}", list(LAYERS)[number % 3]
        rng = np.random.default_rng([7, number])
        base = LAYERS[layer]
        material = GOH(
            C1_kPa=base.C1_kPa * float(np.exp(rng.normal(0.0, SPREAD))),
            k1_kPa=base.k1_kPa * float(np.exp(rng.normal(0.0, SPREAD))),
            k2=base.k2,
            alpha_deg=base.alpha_deg,
            kappa=base.kappa,
        )
        made, _ = virtual_specimen(
            material,
            name=f"{donor}-{layer}",
            mounting_stretch=(1.01, 1.02),
            total_stretch=1.2,
            ratios=((1.0, 1.0), (1.0, 0.5), (0.5, 1.0)),
            increments=INCREMENTS,
            machine=Machine(noise_N=0.002),
            seed=number,
        )
        write_specimen(made, folder / f"{donor}-{layer}.csv")
        lines += ["", "[[specimen]]", f'file = "{donor}-{layer}.csv"']
        lines += [f'donor = "{donor}"', f'layer = "{layer}"']
    (folder / "study.toml").write_text("\n".join(lines) + "\n")


def run(folder: Path, study: str, out: str, workers: int, only: int = 0) -> tuple[float, int, int]:
    """Wall time (s) of a study from the command to its end.

    With it the most that a process held, and the most that was its own alone (both MB).
    """
    if only:
        first = sorted(folder.glob("*.csv"))[:only]
        sources = [str(path) for path in first]
    else:
        sources = [str(folder / study)]
    command = [sys.executable, "-m", "biaxbayes", "batch", *sources]
    command += ["--workers", str(workers), "--out", str(folder / out), "--quiet"]
    clock = time.perf_counter()
    process, held, own = subprocess.Popen(command, stdout=subprocess.DEVNULL), 0, 0
    looks = 0
    while process.poll() is None:
        time.sleep(0.2)
        looks += 1
        with contextlib.suppress(psutil.Error):
            tree = [psutil.Process(process.pid)]
            tree += tree[0].children(recursive=True)
            held = max(held, *(p.memory_info().rss for p in tree))
            if looks % 5 == 0:  # the system counts page by page
                own = max(own, *(p.memory_full_info().uss for p in tree))
    seconds = time.perf_counter() - clock
    if process.returncode not in (0, 3):
        raise SystemExit(f"the study ended with {process.returncode}")
    held_MB, own_MB = held >> 20, own >> 20
    told = f"{held_MB} MB, {own_MB} MB its own"
    print(f"{folder.name} specimens, {out}: {seconds:.1f} s, {told}", flush=True)
    return seconds, held_MB, own_MB


def compared(folder: Path) -> list[str]:
    """Files whose bytes must not depend on the workers."""
    found = sorted((folder / "on-1").glob("study*.csv"))
    found += sorted((folder / "on-1" / "runs").glob("*/summary.csv"))
    found += sorted((folder / "on-1" / "runs").glob("*/identifiability.csv"))
    return [str(path.relative_to(folder / "on-1")) for path in found]


def equal(folder: Path, name: str) -> bool:
    """Whether one and two workers wrote the same."""
    return (folder / "on-1" / name).read_bytes() == (folder / "on-2" / name).read_bytes()


if __name__ == "__main__":
    raise SystemExit(main())
