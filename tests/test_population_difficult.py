"""Studies that are hard to pool, through the command line: words, tables and exit codes."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

import quick_posteriors
import shared
from biaxbayes.identifiability.verdict import FIXED, NO_VERDICT, NOT_IDENTIFIED, VERDICTS
from biaxbayes.laws.goh import GOH
from biaxbayes.populations.sampler import PopulationPlan
from biaxbayes.specimens.specimen_file import write_specimen
from biaxbayes.studies.study_file import read_study
from biaxbayes.verbs import population as job
from biaxbayes.verbs import population_files
from biaxbayes.verbs.batch import run_study
from commands import run

MATERIALS = {
    **{f"m{k}": GOH(13.0 + 0.4 * k, 60.0 - 2.0 * k, 8.0, 38.0 + k, 0.1) for k in range(5)},
    "odd": GOH(45.0, 240.0, 9.0, 14.0, 0.1),
}
STUDY = """
ess = 60
max_steps = 800
options = { noise = "independent", mounting = "exact" }
priors = { kappa = 0.1 }
"""
DRAW_FIGURES = population_files.draw_figures
QUICK = {
    **{"ensembles": 4, "chains": 16, "rounds": 2, "round_sweeps": 20},
    **{"first_block": 40, "max_steps": 240, "ess": 50.0},
}
SHARP = "C1 = 0.1\nk1 = 0.1\nk2 = 0.1\nalpha = 3\n"
PRIORS = f"[sd_donors]\n{SHARP}[sd_specimens]\n{SHARP}"


def made_study(folder: Path) -> None:
    folder.mkdir()
    text = STUDY
    for k, (name, material) in enumerate(MATERIALS.items()):
        ratios = ((1.0, 1.0), (1.0, 0.5)) if name == "m3" else quick_posteriors.THREE_RATIOS
        top = 1.1 if name == "m4" else 1.2
        data = quick_posteriors.specimen(
            material, total_stretch=top, ratios=ratios, increments=8, seed=k, noise_N=0.001
        )
        write_specimen(replace(data, name=name, layer="media"), folder / f"{name}.csv")
        text += f'\n[[specimen]]\nfile = "{name}.csv"\ndonor = "D{k}"\nlayer = "media"\n'
    (folder / "study.toml").write_text(text)
    with quick_posteriors.runs_without_figures():
        run_study(read_study(folder / "study.toml"), folder / "study")


@pytest.fixture(scope="module")
def whole(session_folder) -> Path:
    return shared.made_once("difficult-study", made_study) / "study"


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(job, "PopulationPlan", lambda **k: PopulationPlan(**(k | QUICK)))
    # the figures, which other tests look at, would cost most of the time
    monkeypatch.setattr(population_files, "draw_figures", lambda *arguments: None)


@pytest.fixture
def pool(whole, tmp_path, capsys):
    """Run the command on some of the specimens, with columns of study.csv changed by specimen."""

    def pooled(names, *arguments, out="out", **columns):
        study = tmp_path / f"study-{out}"
        if not study.exists():
            shutil.copytree(whole, study)
        table = pd.read_csv(whole / "study.csv", dtype=str, keep_default_na=False)
        table = table[table["specimen"].isin(names)]
        for column, by_name in columns.items():
            new = table["specimen"].map(by_name)
            table[column] = new.where(new.notna(), table[column])
        table.to_csv(study / "study.csv", index=False)
        words = ("population", study, "--out", tmp_path / out, "--anyway", *arguments)
        return *run(capsys, *words), tmp_path / out

    return pooled


def tables(folder: Path) -> tuple[pd.DataFrame, pd.DataFrame]:
    return pd.read_csv(folder / "population.csv"), pd.read_csv(folder / "specimens.csv")


@pytest.mark.long
def test_one_donor_has_the_priors_spread_of_donors(pool):
    code, out, _, folder = pool(["m0", "m1", "m2"], donor=dict.fromkeys(MATERIALS, "D"))
    assert code == 0
    assert "media: 3 specimens of 1 donor\n" in out
    assert "all specimens are of one donor" in out and "sd_donors is the prior's" in out
    groups, _ = tables(folder)
    pooled = groups[groups["in_words"].notna()]
    assert set(pooled["quantity"]) == {"C1", "k1", "k2", "alpha"}
    assert (pooled["sd_donors_verdict"] == NOT_IDENTIFIED).all()
    assert (pooled["sd_donors_contraction"] < 0.5).all()
    assert "* not identified" in out
    for r in pooled.to_dict("records"):
        line = next(x for x in out.splitlines() if x.startswith(f"{r['quantity']} "))
        assert f" {r['verdict']}" in line and "*" in line
    page = (folder / "population.html").read_text(encoding="utf-8")
    assert "all specimens are of one donor" in page and "<small>not identified</small>" in page


@pytest.mark.long
def test_two_specimens_rest_on_the_priors(pool):
    code, out, _, folder = pool(["m0", "m1"])
    assert code == 0 and "there are 2 specimens: the sds depend much on their priors" in out
    groups, specimens = tables(folder)
    assert set(groups["verdict"]) <= {*VERDICTS, FIXED}
    pooled = groups[groups["in_words"].notna()]
    assert (pooled[["sd_donors_verdict", "sd_specimens_verdict"]] == NOT_IDENTIFIED).all(axis=None)
    for column in ("single_verdict", "pooled_verdict"):
        assert set(specimens[column].dropna()) <= {*VERDICTS, FIXED}
    # the specimens' own records are sharp here, and pooling takes nothing away
    C1 = specimens[specimens["quantity"] == "C1"]
    assert list(C1["single_verdict"]) == list(C1["pooled_verdict"]) == ["identified"] * 2
    assert groups.set_index("quantity").loc["Hz", "verdict"] == "fixed"  # as kappa is
    fixed = specimens[specimens["quantity"] == "kappa"]
    assert list(fixed["pooled_verdict"]) == ["fixed"] * 2


@pytest.mark.long
def test_other_protocols_and_stretches_are_pooled_with_a_note(pool):
    code, out, _, folder = pool(["m0", "m3", "m4"])
    assert code == 0
    assert "specimens were tested with 2 to 3 protocols (2: m3)" in out
    [output] = [line for line in out.splitlines() if "specimens were stretched to" in line]
    assert "least: m4" in output
    low = float(output.split("stretched to ")[1].split()[0])
    assert low == pytest.approx(1.1, abs=0.01)
    groups, _ = tables(folder)
    at = groups["quantity"].str.extract(r"cauchy_x at (.*)")[0].dropna().astype(float)
    assert at.max() == pytest.approx(low, abs=1e-3)  # nobody is extrapolated


@pytest.mark.long
def test_specimens_that_did_not_converge_are_left_out_by_name(pool):
    states = {"m1": "unusable", "m2": "failed"}
    reasons = {"m1": "R-hat of k1 is 1.31", "m2": "m2.csv: is no table"}
    code, _, err, folder = pool(["m0", "m1", "m2", "m3"], state=states, reason=reasons)
    assert code == 0
    assert "left out: m1: did not converge: R-hat of k1 is 1.31" in err
    assert "left out: m2: failed: m2.csv: is no table" in err
    record = json.loads((folder / "population.json").read_text())
    assert list(record["left_out"]) == ["m1", "m2"]
    _, specimens = tables(folder)
    assert set(specimens["specimen"]) == {"m0", "m3"}
    page = (folder / "population.html").read_text(encoding="utf-8")
    assert "left out: <bdi>m1</bdi>" in page and "Left out: m1 and m2." in page


def test_one_specimen_that_can_be_used_is_no_population(pool):
    code, _, err, folder = pool(["m0", "m1"], state={"m1": "unusable"}, reason={"m1": "short"})
    assert code == 2 and not folder.exists()
    assert err.count("\n") == 1 and "1 of 2 specimens can be pooled" in err and "m1" in err


@pytest.mark.long
def test_a_specimen_that_contradicts_its_group_is_named(pool, tmp_path):
    priors = tmp_path / "priors.toml"
    priors.write_text(PRIORS)
    _, out, _, folder = pool([*MATERIALS], "--priors", str(priors))
    output = [line for line in out.splitlines() if "contradicts its group" in line]
    [line] = output
    assert line.startswith("note: odd contradicts its group media (posterior predictive p 0.0")
    _, specimens = tables(folder)
    p = specimens.groupby("specimen")["specimen_predictive_p"].first()
    assert p.idxmin() == "odd" and (p.drop("odd") > 0.05).all()
    assert "odd contradicts" in (folder / "population.html").read_text(encoding="utf-8")


def test_not_converged_gives_exit_three_and_no_verdict(pool, monkeypatch):
    short = QUICK | {"first_block": 20, "max_steps": 20, "ess": 1e5}
    monkeypatch.setattr(job, "PopulationPlan", lambda **k: PopulationPlan(**(k | short)))
    code, out, _, folder = pool(["m0", "m1"])
    assert code == 3
    assert "TENTATIVE" in out or "UNUSABLE" in out
    groups, specimens = tables(folder)
    assert set(groups["verdict"]) == {NO_VERDICT}
    assert set(specimens["pooled_verdict"]) <= {NO_VERDICT, "fixed"}
    assert set(specimens["single_verdict"]) - {NO_VERDICT, "fixed"}
    page = (folder / "population.html").read_text(encoding="utf-8")
    assert "no verdict on any number" in page


def test_runs_of_other_laws_or_fixed_parameters_are_refused(whole):
    from biaxbayes.errors import InputError
    from biaxbayes.populations.specimens import Source, pooled_names
    from biaxbayes.runs.run import open_run

    first, second = (Source.from_run(n, open_run(whole / "runs" / n)) for n in ("m0", "m1"))
    fixed = second.posterior.replaced(priors={**second.posterior.priors, "k2": 8.0})
    with pytest.raises(InputError, match="k2 was sampled in m0 and fixed or tied in m1") as output:
        pooled_names([first, replace(second, posterior=fixed)])
    assert "fix the same parameters in all specimens" in str(output.value)


@pytest.mark.long
def test_pooled_mounting_stretches_are_judged_and_drawn(pool, monkeypatch):
    monkeypatch.setattr(population_files, "draw_figures", DRAW_FIGURES)
    code, _, _, folder = pool(["m0", "m1"], "--pool-mounting", "--spread", "by-group")
    assert code in (0, 3)
    groups, specimens = tables(folder)
    for table, column in ((groups, "verdict"), (specimens, "pooled_verdict")):
        of = table[table["quantity"].str.startswith("mounting_stretch")]
        assert len(of) and set(of[column]) <= set(VERDICTS)
    assert (folder / "population-pairs.png").is_file()
