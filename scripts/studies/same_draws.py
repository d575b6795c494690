"""Whether two states of the code draw the same, byte for byte, and say the same of it.

    python scripts/study.py same_draws BEFORE            against the commit checked out
    python scripts/study.py same_draws BEFORE AFTER --write

What makes a run faster or its code simpler and leaves every draw where it was makes no measured
figure older. Here both states of the code sample shipped specimens with every error model, way of
mounting and law, and some seeds more; draws, evaluations, the state of convergence and the verdicts
with all their evidence are compared, and the processor time from the fit to the draws is measured.
``--write`` records the change for ``scripts/evidence.py --check`` if all are the same. Needs git.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from datetime import date
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.identifiability.held_edges import held_table
from biaxbayes.identifiability.identify import identify
from biaxbayes.model.preparation import prepare
from biaxbayes.model.search import draw_posterior
from biaxbayes.options.model import MOUNTING
from biaxbayes.runs.archive import flatten
from biaxbayes.sampling.sampler import Plan
from biaxbayes.specimens.specimen_file import read_specimen
from studies.page import ROOT

RECORD = ROOT / "scripts" / "same_draws.csv"
HEADER = "before,after,day,runs,time_ratio"
NOISES = ("independent", "effective")
NAMES = ("donor1", "donor2", "donor2-intima", "donor2-media", "donor2-adventitia", "hooked-media")
LAWS = ("goh-exponential", "holzapfel-2005", "may-newman", "hgo", "fung", "four-fibre", "lee-sacks")
SEEDS = range(1, 9)
"""Of the specimen whose runs differ most in how they warm up."""

Case = tuple[str, dict[str, Any], int]
"""A specimen, the options of its posterior, and a seed."""
Digest = tuple[str, float]
"""What stands for everything that a run draws and says, and the processor time that it drew (s)."""


def cases() -> list[Case]:
    """What is sampled."""
    shipped: list[Case] = [(n, {"noise": noise}, 1) for n in NAMES for noise in NOISES]
    mounted: list[Case] = [("donor2-media", {"mounting": m}, 1) for m in MOUNTING]
    laws: list[Case] = [(n, {"law": law}, 1) for n in ("donor1", "donor2-media") for law in LAWS]
    seeds: list[Case] = [("donor2-media", {}, seed) for seed in SEEDS[1:]]
    return shipped + mounted + laws + seeds


def digest(case: Case) -> Digest:
    """A run of the imported package."""
    name, options, seed = case
    posterior = prepare(read_specimen(ROOT / "data" / f"{name}.csv"), **options)
    clock = time.process_time()
    draws = draw_posterior(posterior, Plan(max_steps=2000, seed=seed))
    seconds = time.process_time() - clock
    found = hashlib.sha256(draws.chain.tobytes())
    found.update(f"{draws.evaluations} {draws.convergence.state}".encode())
    table = pd.DataFrame({n: flatten(v).ravel() for n, v in draws.quantities.items()})
    state = draws.convergence.state
    run = SimpleNamespace(posterior=lambda: posterior, draws=table, state=state)
    verdicts = identify(run)
    for said in (verdicts.to_frame(), held_table(verdicts.held)):
        found.update(said.to_csv().encode())  # every digit of every number
    return found.hexdigest(), seconds


def digests(workers: int) -> list[Digest]:
    """Digests of all cases, by the package that this process imports."""
    with ProcessPoolExecutor(workers) as pool:
        return list(pool.map(digest, cases()))


@contextmanager
def source_of(commit: str) -> Iterator[Path]:
    """The package as it is at a commit."""
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        git = ["git", "-C", str(ROOT), "worktree"]
        subprocess.run([*git, "add", "--quiet", "--detach", str(tree), commit], check=True)
        try:
            yield tree / "src"
        finally:
            subprocess.run([*git, "remove", "--force", str(tree)], check=True)


def digests_at(commit: str, workers: int) -> list[Digest]:
    """Digests of all cases, by the package at a commit."""
    with source_of(commit) as source:
        command = [sys.executable, str(ROOT / "scripts" / "study.py"), "same_draws", "--digests"]
        environment = os.environ | {"PYTHONPATH": str(source), "OMP_NUM_THREADS": "1"}
        told = subprocess.run(
            [*command, "--workers", str(workers)],
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
            check=True,
        )
    return [(digest, seconds) for digest, seconds in json.loads(told.stdout)]


def commit_of(name: str) -> str:
    """The short id of a commit."""
    command = ["git", "-C", str(ROOT), "rev-parse", "--short", f"{name}^{{commit}}"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def main() -> int:
    """Compare two states of the code; exit code 1 where a run differs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("before", nargs="?", default="HEAD", help="a commit")
    parser.add_argument("after", nargs="?", default="HEAD", help="a later commit")
    parser.add_argument("--workers", type=int, default=2, help="runs at a time")
    parser.add_argument("--write", action="store_true", help=f"record it in {RECORD.name}")
    parser.add_argument("--digests", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.digests:
        print(json.dumps(digests(options.workers)))
        return 0
    change = commit_of(options.before), commit_of(options.after)
    before, after = (digests_at(commit, options.workers) for commit in change)
    pairs = list(zip(cases(), before, after, strict=True))
    other = [case for case, (old, _), (new, _) in pairs if old != new]
    ratio = float(np.median([new / old for _, (_, old), (_, new) in pairs]))
    for case in other:
        print("draws or verdicts differ:", *_words(case))
    print(f"{len(pairs) - len(other)} of {len(pairs)} runs are the same at {' and '.join(change)}")
    print(f"processor time of the later one: {ratio:.3f} of that of the earlier (median)")
    if other:
        return 1
    if options.write:
        text = RECORD.read_text(encoding="utf-8") if RECORD.exists() else f"{HEADER}\n"
        row = f"{','.join(change)},{date.today().isoformat()},{len(pairs)},{ratio:.3f}\n"
        RECORD.write_text(text + row, encoding="utf-8")
    return 0


def _words(case: Case) -> list[Any]:
    name, options, seed = case
    return [name, *(f"{key} {value}" for key, value in options.items()), f"seed {seed}"]


if __name__ == "__main__":
    sys.exit(main())
