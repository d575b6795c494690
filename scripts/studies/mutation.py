"""Break the code on purpose, one mutant at a time, and count what the tests notice.

    python scripts/study.py mutation --part density --sample 200 --workers 2

Needs the extra ``mutation`` (cosmic-ray). Mutants change signs, operators, numbers and comparisons.
The same command continues; survivors are printed as patches. Workers have copies of the repository.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

from studies.common import ROOT, options_of, parser

PARTS: dict[str, tuple[str, str]] = {
    "density": (
        "laws/*.py mechanics/mounting.py model/priors.py normal_errors.py model/density.py",
        "laws law_statements law_file goh priors forward posterior pieces hostile_inputs",
    ),
    "verdicts": (
        "identifiability/*.py derived/*.py profiles/*.py",
        "verdict marginals tissue_stress smooth_misfit profile reported reported_everywhere "
        "compare identifiability records pieces",
    ),
    "sampling": (
        "sampling/*.py",
        "modes population_monte_carlo convergence evidence mixture moves sampling_alone sampler",
    ),
    "comparison": ("comparison/*.py", "compare_laws compare"),
}
"""Modules that are mutated, and the tests that should notice, the quickest first."""
SECONDS = 300.0
"""How long the tests of a mutant may take."""
TRIVIAL = ("FloorDiv", "Mod", "Shift", "Bit", "_Is", "IsNot_")
"""Replacements that end with an error at once: they only raise the score."""


def prepare_copy(copy: Path, part: str) -> None:
    """Copy the repository and write the configuration of cosmic-ray."""
    for name in ("src", "tests", "data", "scripts"):
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / name, copy / name, ignore=ignored, dirs_exist_ok=True)
    shutil.copy(ROOT / "pyproject.toml", copy)
    patterns, tests = PARTS[part]
    package = copy / "src" / "biaxbayes"
    modules = sorted({p for pattern in patterns.split() for p in package.glob(pattern)})
    names = [f"tests/test_{name}.py" for name in tests.split()]
    options = "-x -n 0 -p no:cacheprovider -W ignore::RuntimeWarning -q"
    settings = {
        "module-path": [p.relative_to(copy).as_posix() for p in modules if p.name != "__init__.py"],
        "timeout": SECONDS,
        "excluded-modules": [],
        "test-command": f"{sys.executable} -m pytest {options} "
        + " ".join(name for name in names if (copy / name).exists()),
    }
    # lists, numbers and texts are written in TOML as in JSON
    lines = ["[cosmic-ray]", *(f"{key} = {json.dumps(value)}" for key, value in settings.items())]
    lines += ["[cosmic-ray.distributor]", 'name = "local"']
    (copy / "mutation.toml").write_text("\n".join(lines) + "\n")


def environment(copy: Path) -> dict[str, str]:
    """The copy's own package and its own compiled code."""
    return os.environ | {
        "NUMBA_CACHE_DIR": str(copy / "compiled"),
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONPATH": str(copy / "src"),
    }


def check_unmutated(copy: Path) -> None:
    """End the study where the tests fail without a mutant: every mutant would count as killed."""
    settings = tomllib.loads((copy / "mutation.toml").read_text())["cosmic-ray"]
    command = settings["test-command"].split()
    if subprocess.run(command, cwd=copy, env=environment(copy)).returncode:
        sys.exit("the tests fail without a mutant: mend them first")


def deal(copies: list[Path], sample: int | None, environment: dict[str, str]) -> int:
    """Deal the mutants out to the sessions of the workers; how many there are."""
    from cosmic_ray.work_db import WorkDB, use_db

    every = copies[0] / "all.sqlite"
    command = ["cosmic-ray", "init", "mutation.toml", str(every)]
    subprocess.run(command, cwd=copies[0], env=environment, check=True)
    with use_db(str(every), WorkDB.Mode.open) as db:
        items = sorted(db.work_items, key=lambda item: str(item.mutations))
    items = [i for i in items if not any(t in i.mutations[0].operator_name for t in TRIVIAL)]
    random.Random(1).shuffle(items)
    items = items[:sample]
    for k, copy in enumerate(copies):
        with use_db(str(copy / "session.sqlite"), WorkDB.Mode.create) as db:
            db.add_work_items(items[k :: len(copies)])
    return len(items)


def survivors(copies: list[Path]) -> tuple[int, list[str]]:
    """How many mutants are done, and the patches of those that no test noticed."""
    from cosmic_ray.work_db import WorkDB, use_db
    from cosmic_ray.work_item import TestOutcome

    count, found = 0, []
    for copy in copies:
        with use_db(str(copy / "session.sqlite"), WorkDB.Mode.open) as db:
            for _, result in db.completed_work_items:
                count += 1
                if result.test_outcome is TestOutcome.SURVIVED:
                    found.append(result.diff or "")
    return count, sorted(found)


def main() -> None:
    """Run or continue the study."""
    arguments = parser(__doc__)
    arguments.add_argument("--part", choices=PARTS, default="density")
    arguments.add_argument("--sample", type=int, help="mutants drawn at random  [all]")
    options = options_of(arguments)
    folder = options.records.resolve() / f"mutation-{options.part}"
    copies = [folder / f"copy-{i}" for i in range(options.workers)]
    if not (folder / "dealt").exists():
        for copy in copies:
            prepare_copy(copy, options.part)
        check_unmutated(copies[0])
        sample = 2 if options.quick else options.sample
        count = deal(copies, sample, environment(copies[0]))
        (folder / "dealt").write_text(f"{count} mutants\n")
    command = ["cosmic-ray", "exec", "mutation.toml", "session.sqlite"]
    running = [subprocess.Popen(command, cwd=copy, env=environment(copy)) for copy in copies]
    for process in running:
        process.wait()
    count, left = survivors(copies)
    print("\n\n".join(left))
    print(f"{count} mutants, {len(left)} survived: {100.0 * (1 - len(left) / count):.1f} % killed")


if __name__ == "__main__":
    main()
