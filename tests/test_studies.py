"""The studies behind the pages find what they ask for of the package, run or not."""

from __future__ import annotations

import ast
import importlib
import pkgutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import studies
import study
from biaxbayes.laws.published import MATERIALS, PublishedMaterial
from studies.intervals import drawn_material

SCRIPTS = Path(study.__file__).resolve().parent
OWN = {"biaxbayes", "studies", *(path.stem for path in SCRIPTS.glob("*.py"))}
MODULES = sorted(
    [m.name for m in pkgutil.walk_packages(studies.__path__, "studies.") if not m.ispkg]
    + [path.stem for path in SCRIPTS.glob("*.py")]
)


def source(module: str) -> str:
    return SCRIPTS.joinpath(*module.split(".")).with_suffix(".py").read_text(encoding="utf-8")


def asked_for(text: str) -> Iterator[tuple[str, str | None]]:
    """Modules of ours, and names in them, that any line of a module imports."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            found: list[tuple[str, str | None]] = [(alias.name, None) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            found = [(node.module or "", alias.name) for alias in node.names]
        else:
            continue
        yield from ((module, name) for module, name in found if module.split(".")[0] in OWN)


def imported(module: str) -> str:
    """What is wrong with a module; nothing where it only lacks a package of somebody else."""
    try:
        importlib.import_module(module)
    except ModuleNotFoundError as error:
        return f"no {error.name}" if str(error.name).split(".")[0] in OWN else ""
    except ImportError as error:
        return str(error) if str(error.name).split(".")[0] in OWN else ""
    return ""


def problems(module: str, text: str) -> list[str]:
    """Imports of a module that fail, those inside functions as well."""
    found = [imported(module)]
    for place, name in asked_for(text):
        found.append(wrong := imported(place))
        if wrong or name is None or hasattr(importlib.import_module(place), name):
            continue
        if imported(f"{place}.{name}"):
            found.append(f"{place} has no {name}")
    return [f"{module}: {wrong}" for wrong in found if wrong]


def test_every_study_finds_what_it_imports():
    assert len(MODULES) > 25 and "studies.benchmark.nuts" in MODULES
    assert [wrong for module in MODULES for wrong in problems(module, source(module))] == []


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(study.studies().keys() - {"benchmark", "mutation"}))
def test_a_study_runs_in_its_quick_form(name, tmp_path):
    folders = ["--out", str(tmp_path / "out"), "--records", str(tmp_path / "records")]
    done = subprocess.run(
        [sys.executable, SCRIPTS / "study.py", name, "--quick", *folders],
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.long
def test_the_paper_is_recomputed_in_its_quick_form(tmp_path):
    command = [sys.executable, SCRIPTS / "reproduce_paper.py", "--quick", "--out", str(tmp_path)]
    assert subprocess.run(command).returncode == 0
    for folder in ("tables", "figures"):
        made = {path.name for path in (tmp_path / folder).iterdir()}
        known = {path.name for path in (SCRIPTS.parent / "docs" / folder).glob("paper-*")}
        assert made == known


def test_truths_drawn_around_a_printed_material_lie_inside_their_ranges():
    """And make curves as stiff and as bent, their exponent taken from the strain energy."""

    def exponent_and_stress(of: PublishedMaterial) -> tuple[float, float]:
        lx, ly = np.array(of.mounting_stretch) * of.measured_stretch
        fibres = replace(of.material, C1_kPa=0.0)
        stiffer = replace(fibres, k1_kPa=2.0 * fibres.k1_kPa)
        # W = (k1 / k2) (exp(k2 E^2) - 1): linear in k1
        assert np.isclose(stiffer.strain_energy(lx, ly), 2.0 * fibres.strain_energy(lx, ly))
        growth = fibres.k2 * fibres.strain_energy(lx, ly) / fibres.k1_kPa
        return float(np.log1p(growth)), float(np.sum(fibres.cauchy(lx, ly)))

    logs = []
    for seed in range(40):
        printed, drawn = MATERIALS["donor2"], drawn_material("donor2", seed)
        assert 20.0 < drawn.material.alpha_deg < 70.0 and 0.05 < drawn.material.kappa < 0.28
        assert all(1.005 < lm < 1.03 for lm in drawn.mounting_stretch)
        pairs = zip(exponent_and_stress(drawn), exponent_and_stress(printed), strict=True)
        logs.append([np.log(a / b) for a, b in pairs])
    # sd of the log 0.3; of 40, the error of mean and sd is 0.047 and 0.034
    assert np.all(np.abs(np.mean(logs, axis=0)) < 0.17)
    assert np.all(np.abs(np.std(logs, axis=0) - 0.3) < 0.12)
