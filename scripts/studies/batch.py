"""Measure a study on two local workers against one, and check that the results are equal.

Needs a quiet machine with two processors:

    python scripts/study.py batch --specimens 20 --folder /tmp/batch

--write puts the outcome into a page between its marks.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from textwrap import wrap

from biaxbayes.laws.goh import GOH
from biaxbayes.specimens.specimen_file import write_specimen
from biaxbayes.specimens.virtual_specimen import Machine, virtual_specimen
from studies.page import put

LAYERS = {
    "intima": GOH(C1_kPa=30.0, k1_kPa=60.0, k2=20.0, alpha_deg=60.0, kappa=0.15),
    "media": GOH(C1_kPa=14.0, k1_kPa=140.0, k2=11.9, alpha_deg=38.4, kappa=0.21),
    "adventitia": GOH(C1_kPa=7.0, k1_kPa=8.0, k2=30.0, alpha_deg=50.0, kappa=0.05),
}
INCREMENTS = 50
WANTED = 1.8
"""Times as fast on two workers as on one."""
SPREAD = 0.15
"""Of the stiffnesses between donors, in logs."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--specimens", type=int, default=20)
    parser.add_argument("--folder", type=Path, required=True, help="made, and overwritten")
    parser.add_argument("--ess", type=float, default=2000.0)
    parser.add_argument("--write", type=Path, help="Markdown page whose sentence is replaced")
    arguments = parser.parse_args()
    folder = arguments.folder
    shutil.rmtree(folder, ignore_errors=True)
    write_specimens(folder, arguments.specimens, arguments.ess)
    # What is compiled for the first time is compiled here.
    run(folder, "study.toml", "warm", 1, only=1)
    seconds = {workers: run(folder, "study.toml", f"on-{workers}", workers) for workers in (1, 2)}
    differing = [name for name in compared(folder) if not equal(folder, name)]
    ratio = seconds[1] / seconds[2]
    print(
        json.dumps(
            {
                "specimens": arguments.specimens,
                "processors": os.cpu_count(),
                "seconds_one_worker": round(seconds[1], 1),
                "seconds_two_workers": round(seconds[2], 1),
                "ratio": round(ratio, 2),
                "files_compared": len(compared(folder)),
                "differing": differing,
            },
            indent=2,
        )
    )
    if arguments.write:
        bytes_of = f"other bytes in {', '.join(differing)}" if differing else "the same bytes"
        text = (
            f"{arguments.specimens} specimens of {INCREMENTS + 1} rows in each of three protocols "
            f"took {seconds[1]:.1f} s with one worker and {seconds[2]:.1f} s with two on a machine "
            f"with {os.cpu_count()} processors ({ratio:.2f} times as fast), with {bytes_of} in "
            f"{len(compared(folder))} tables."
        )
        put(arguments.write, "batch", "\n".join(wrap(text, 100)))
    return 0 if ratio >= WANTED and not differing else 1


def write_specimens(folder: Path, count: int, ess: float) -> None:
    """Virtual specimens of three layers a donor, and the study file."""
    import numpy as np

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


def run(folder: Path, study: str, out: str, workers: int, only: int = 0) -> float:
    """Wall time of a study from the command to its end."""
    if only:
        first = sorted(folder.glob("*.csv"))[:only]
        sources = [str(path) for path in first]
    else:
        sources = [str(folder / study)]
    command = [sys.executable, "-m", "biaxbayes.cli", "batch", *sources]
    command += ["--workers", str(workers), "--out", str(folder / out), "--quiet"]
    clock = time.perf_counter()
    ended = subprocess.run(command, check=False)
    if ended.returncode not in (0, 3):
        raise SystemExit(f"the study ended with {ended.returncode}")
    seconds = time.perf_counter() - clock
    print(f"{out}: {seconds:.1f} s", flush=True)
    return seconds


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
