"""The studies behind the pages: what they import, their truths, records and other samplers."""

import ast
import importlib
import pkgutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm

import studies
import study
from biaxbayes.model.preparation import prepare
from biaxbayes.populations.hierarchy import MIN_INSIDE_PROBABILITY
from biaxbayes.specimens.specimen_file import read_specimen
from studies.benchmark.natural_density import NaturalDensity
from studies.common import DATA
from studies.population.calibration import GROUPS, PRIORS, Truths, values_of
from studies.population.virtual import PARAMETERS

SCRIPTS = Path(study.__file__).resolve().parent
OWN = {"biaxbayes", "studies", *(path.stem for path in SCRIPTS.glob("*.py"))}
MODULES = sorted(
    [m.name for m in pkgutil.walk_packages(studies.__path__, "studies.") if not m.ispkg]
    + [path.stem for path in SCRIPTS.glob("*.py")]
)


def test_every_study_finds_what_it_imports():
    """Modules, those that functions import as well; names in them are seen by mypy."""
    assert len(MODULES) > 20 and "studies.benchmark.nested" in MODULES
    wanted = set(MODULES)
    for module in MODULES:
        source = SCRIPTS.joinpath(*module.split(".")).with_suffix(".py")
        nodes = ast.walk(ast.parse(source.read_text(encoding="utf-8")))
        wanted |= {str(node.module) for node in nodes if isinstance(node, ast.ImportFrom)}
    for module in sorted(m for m in wanted if m.split(".")[0] in OWN):
        try:
            importlib.import_module(module)
        except ModuleNotFoundError as error:  # of a package of somebody else
            assert str(error.name).split(".")[0] not in OWN, f"{module}: no {error.name}"


NOT_RUN = {"benchmark", "mutation", "skins"}
"""Studies that take hours in any form, or records that are fetched."""
MINUTES = {"crashes", "grips", "laws"}
"""Studies that take minutes in any form, of what `test_resume`, `test_grips` and
`test_compare_laws` run at less cost."""


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow if name in MINUTES else pytest.mark.long)
        for name in sorted(study.studies().keys() - NOT_RUN)
    ],
)
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


@pytest.mark.parametrize(
    "noise", [pytest.param("correlated", marks=pytest.mark.long), "independent"]
)
def test_the_natural_density_is_that_of_the_posterior(noise):
    """In C1 rather than ln C1, and in mounting stretches rather than forces."""
    posterior = prepare(read_specimen(DATA / "donor2-media.csv"), noise=noise)
    density = NaturalDensity(posterior)
    points = density.starts(6, np.random.default_rng(0), 0.05)
    found = density(points)
    assert np.ptp(found) > 10.0  # points that differ
    values = density.summaries(points)
    logs = np.log(points[:, density.logs]).sum(axis=1)
    stretches = posterior.replaced(mounting="free")
    np.testing.assert_allclose(found + logs, stretches.log_density(values), rtol=1e-9)


def test_truths_are_cut_as_the_model_cuts_them():
    values = values_of(PRIORS)
    drawn = [Truths(values, np.random.default_rng(seed)) for seed in range(120)]
    kappa = PARAMETERS.index("kappa")
    low, high = values[kappa].limits
    for t in drawn:
        assert t.theta.shape == (8, 5) and list(t.group[:3]) == [0, 1, 0]
        assert np.all((t.theta[:, kappa] >= low) & (t.theta[:, kappa] <= high))
        location = (t.mu[t.group] + t.effect[t.donor])[:, kappa]
        of = norm(location, t.sd[kappa])
        assert np.all(of.cdf(high) - of.cdf(low) >= MIN_INSIDE_PROBABILITY)
        assert len(t.named()) == 5 * (len(GROUPS) + 2)
    # what is not cut keeps its prior: mean and sd of 240 means, sds half-normal
    C1 = np.array([t.mu[:, 0] for t in drawn]).ravel()
    assert abs(C1.mean() - values[0].mean) < 4 * values[0].mean_sd / np.sqrt(C1.size)
    assert C1.std() == pytest.approx(values[0].mean_sd, rel=0.2)
    sd = np.array([t.sd[0] for t in drawn])
    assert np.sqrt((sd**2).mean()) == pytest.approx(values[0].specimen_scale, rel=0.25)
    # specimens scatter about their location by the sd between specimens
    off = np.array([(t.theta - t.mu[t.group] - t.effect[t.donor])[:, 0] / t.sd[0] for t in drawn])
    assert off.std() == pytest.approx(1.0, rel=0.1)
