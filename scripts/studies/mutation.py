#!/usr/bin/env python3
"""Mutation testing of parts of the package: their modules, and the tests that should notice.

    python scripts/study.py mutation --sample 100 --workers 2
    python scripts/study.py mutation --part verdicts --sample 100 --workers 2

Every mutant of a module (a sign, an operator, a number, a comparison changed) is tested with the
tests of its part. Those of the density are the quick ones that know the answer without the product:
of the laws, of the mounted state and the posterior written a second time; they run without
compilation. One mutant in one copy of the repository a worker, so that this tree is never touched.
A folder that holds a study already is continued. The survivors are listed in ``survivors.md``: each
is a hole in the tests or a change that changes nothing, and is to be explained.

Needs ``pip install 'biaxbayes[mutation]'``.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import subprocess
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from cosmic_ray.work_db import WorkDB, use_db
from cosmic_ray.work_item import TestOutcome, WorkItem

ROOT = Path(__file__).resolve().parents[2]
COPIED = ("src", "tests", "data", "pyproject.toml")


@dataclass(frozen=True)
class Part:
    """A part of the package that is mutated.

    Attributes
    ----------
    modules : tuple of str
        Globs below ``src/biaxbayes``.
    tests : tuple of str
        What should notice a mutant, the quickest first: most mutants die in the first seconds.
    compiled : bool
        Whether the tests run compiled code; where that is mutated itself, plain Python is quicker.
    """

    modules: tuple[str, ...]
    tests: tuple[str, ...]
    compiled: bool = True


PARTS = {
    "density": Part(
        (
            "laws/*.py",
            "mechanics/mounting.py",
            "model/priors.py",
            "model/error_model.py",
            "model/density.py",
        ),
        (
            "tests/test_laws.py",
            "tests/test_law_statements.py",
            "tests/test_goh.py",
            "tests/test_priors.py",
            "tests/test_error_model.py",
            "tests/test_posterior.py",
            "tests/test_fit.py::test_stress_response_against_complex_step",
            "tests/test_fit.py::test_stress_response_is_regular_at_90_degrees",
            "tests/test_hostile_priors.py",
            # of thousands of random boxes: no use at a hundredth the speed
            "--deselect",
            "tests/test_posterior.py::test_density_is_finite_or_minus_infinity",
        ),
        compiled=False,
    ),
    "verdicts": Part(
        (
            "identifiability/*.py",
            "identifiability/mounting_stretch/stated.py",
            "identifiability/mounting_stretch/law_range.py",
        ),
        (
            "tests/test_verdict.py",
            "tests/test_marginals.py",
            "tests/test_tissue_stress.py",
            "tests/test_law_statements.py",
            "tests/test_mounting_refits.py",
            "tests/test_noise_worth.py",
            "tests/test_words.py",
            "tests/test_stated.py",
            "tests/test_compare_laws.py",
            "tests/test_told.py",
            "tests/test_held_edges.py",
            "tests/test_identifiability.py",
        ),
    ),
    "sampling": Part(
        ("sampling/*.py",),
        (
            "tests/test_modes.py",
            "tests/test_population_monte_carlo.py",
            "tests/test_mixture_weights.py",
            "tests/test_convergence.py",
            "tests/test_mixture_fit.py",
            "tests/test_mixture_proposal.py",
            "tests/test_moves.py",
            "tests/test_sampling_alone.py",
            "tests/test_sampler.py",
        ),
    ),
    "comparison": Part(
        ("comparison/*.py",),
        ("tests/test_compare_laws.py", "tests/test_ledger.py", "tests/test_compare.py"),
    ),
}
SECONDS = 300.0
"""How long the tests of a mutant may take."""
NO_EQUATIONS = ("__init__.py", "published.py")
TRIVIAL = ("FloorDiv", "Mod", "Shift", "Bit", "_Is", "IsNot_")
"""Replacements that end with an error at once: they only raise the score."""


def modules(patterns: list[str]) -> list[Path]:
    """Modules to mutate, relative to the root."""
    package = ROOT / "src" / "biaxbayes"
    found = sorted({p for pattern in patterns for p in package.glob(pattern)})
    return [p.relative_to(ROOT) for p in found if p.name not in NO_EQUATIONS]


def environment(copy: Path, kept: Path, *, compiled: bool) -> dict[str, str]:
    """The copy's own package, densities of the second posterior and compiled code kept.

    Compiled code is found again by its own file: what it calls of the laws is not mutated with it.
    """
    return os.environ | {
        "NUMBA_CACHE_DIR": str(copy / "compiled"),
        "NUMBA_DISABLE_JIT": str(int(not compiled)),
        "OMP_NUM_THREADS": "1",
        "MPLBACKEND": "Agg",
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONPATH": str(copy / "src"),
        "BIAXBAYES_PLAIN_DENSITIES": str(kept),
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
    }


def prepared(copy: Path, paths: list[Path], tests: tuple[str, ...], seconds: float) -> None:
    """Copy the repository and write the configuration for these modules and tests."""
    for name in COPIED:
        source = ROOT / name
        if source.is_dir():
            ignored = shutil.ignore_patterns("__pycache__")
            shutil.copytree(source, copy / name, ignore=ignored, dirs_exist_ok=True)
        else:
            copy.mkdir(parents=True, exist_ok=True)
            shutil.copy(source, copy / name)
    # Plain NumPy warns of overflow where compiled code does not.
    options = "-x -n 0 -p no:cacheprovider -W ignore::RuntimeWarning -q"
    settings = {
        "module-path": [p.as_posix() for p in paths],
        "timeout": seconds,
        "excluded-modules": [],
        "test-command": f"python -m pytest {options} {' '.join(tests)}",
    }
    # lists, numbers and texts are written in TOML as in JSON
    lines = [f"{key} = {json.dumps(value)}" for key, value in settings.items()]
    distributor = ["[cosmic-ray.distributor]", 'name = "local"']
    text = "\n".join(["[cosmic-ray]", *lines, *distributor]) + "\n"
    (copy / "mutation.toml").write_text(text, encoding="utf-8")


def pointless(item: WorkItem) -> bool:
    """Whether a mutant says nothing: what no number survives, a type, a decorator that compiles."""
    spec = item.mutations[0]
    if any(word in spec.operator_name for word in TRIVIAL):
        return True
    lines = (ROOT / spec.module_path).read_text(encoding="utf-8").splitlines()
    return lines[spec.start_pos[0] - 1].strip().startswith(("@", "def ", ") ->"))


def dealt(
    folder: Path, copies: list[Path], sample: int | None, seed: int, env: dict[str, str]
) -> int:
    """Deal the mutants out to the workers' sessions; how many there are."""
    whole = folder / "all.sqlite"
    subprocess.run(
        ["cosmic-ray", "init", "mutation.toml", str(whole)],
        cwd=copies[0],
        env=env,
        check=True,
    )
    with use_db(str(whole), WorkDB.Mode.open) as db:
        items = sorted(
            (i for i in db.work_items if not pointless(i)), key=lambda i: str(i.mutations)
        )
    random.Random(seed).shuffle(items)
    items = items[:sample]
    for i, copy in enumerate(copies):
        with use_db(str(copy / "session.sqlite"), WorkDB.Mode.create) as db:
            db.add_work_items(items[i :: len(copies)])
    return len(items)


def outcomes(copies: list[Path]) -> tuple[Counter[str], list[str]]:
    """Number of mutants by outcome, and the survivors in words."""
    counts: Counter[str] = Counter()
    survivors = []
    for copy in copies:
        with use_db(str(copy / "session.sqlite"), WorkDB.Mode.open) as db:
            for item, result in db.completed_work_items:
                outcome = result.test_outcome or TestOutcome.INCOMPETENT
                counts[outcome.value] += 1
                if outcome is TestOutcome.SURVIVED:
                    spec = item.mutations[0]
                    place = f"{spec.module_path.as_posix()}:{spec.start_pos[0]}"
                    changed = [
                        line
                        for line in (result.diff or "").splitlines()
                        if line[:1] in "+-" and line[:3] not in ("+++", "---")
                    ]
                    survivors.append("\n".join([f"## {place}", "", "```diff", *changed, "```"]))
    return counts, sorted(survivors)


def main() -> int:
    """Run or continue the study; exit code 1 if too many mutants survive."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("modules", nargs="*", help="globs below src/biaxbayes, not all of the part")
    parser.add_argument("--part", choices=PARTS, default="density")
    parser.add_argument("--out", type=Path, default=Path("mutation"), help="folder of the study")
    parser.add_argument("--sample", type=int, help="so many mutants, drawn at random; else all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=SECONDS, help="a mutant, at most")
    parser.add_argument("--least", type=float, default=0.95, help="share to be killed")
    chosen = parser.parse_args()
    part = PARTS[chosen.part]
    folder = chosen.out.resolve()
    copies = [folder / f"copy-{i}" for i in range(chosen.workers)]
    if not (folder / "dealt").exists():
        (folder / "kept").mkdir(parents=True, exist_ok=True)
        paths = modules(chosen.modules or list(part.modules))
        for copy in copies:
            prepared(copy, paths, part.tests, chosen.seconds)
        first = environment(copies[0], folder / "kept", compiled=part.compiled)
        # also fills the folder of kept densities
        subprocess.run(
            ["cosmic-ray", "--verbosity", "INFO", "baseline", "mutation.toml"],
            cwd=copies[0],
            env=first,
            check=True,
        )
        count = dealt(folder, copies, chosen.sample, chosen.seed, first)
        (folder / "dealt").write_text(f"{count} mutants of {len(paths)} modules\n")
    running = [
        subprocess.Popen(
            ["cosmic-ray", "exec", "mutation.toml", "session.sqlite"],
            cwd=copy,
            env=environment(copy, folder / "kept", compiled=part.compiled),
        )
        for copy in copies
    ]
    for process in running:
        process.wait()
    counts, survivors = outcomes(copies)
    total = sum(counts.values())
    killed = 1.0 - counts["survived"] / max(total, 1)
    print(f"{total} mutants, {counts['survived']} survived: {100.0 * killed:.1f} % killed")
    (folder / "survivors.md").write_text("\n\n".join(["# Survivors", *survivors]) + "\n")
    return int(killed < chosen.least)


if __name__ == "__main__":
    sys.exit(main())
