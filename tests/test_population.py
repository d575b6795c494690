"""A population from a study folder: files, words for difficult studies, resume, exit codes."""

import json
import re
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy.stats import norm

import biaxbayes
import quick_posteriors
import shared
from biaxbayes.errors import InputError, Interrupted, RunError
from biaxbayes.identifiability.verdict import (
    COMBINATION,
    FIXED,
    NO_VERDICT,
    NOT_IDENTIFIED,
    VERDICTS,
)
from biaxbayes.laws.goh import GOH
from biaxbayes.model.posterior import Posterior
from biaxbayes.options import PopulationOptions
from biaxbayes.populations.grouping import group_sources, open_sources
from biaxbayes.populations.model import PopulationPriors, pooled_values
from biaxbayes.populations.sampler import PopulationPlan
from biaxbayes.populations.specimens import (
    Source,
    is_cut_short,
    pooled_names,
    run_draws,
    sample_again,
)
from biaxbayes.populations.tables import contradictions
from biaxbayes.report_table import DASH, as_text
from biaxbayes.reports.population_page import (
    FIGURE_TEXTS,
    TABLES,
    closing_message,
    contrast_table,
    group_differences,
    group_table,
    population_latex,
)
from biaxbayes.runs.folder import POPULATION, manifest
from biaxbayes.sampling.sampler import Plan
from biaxbayes.studies.record import members_of_study
from biaxbayes.verbs import population as job
from biaxbayes.verbs.population import sample_population
from commands import refused, run
from made_population import MATERIALS, QUICK, quick_job, sample_study


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr(job, "PopulationPlan", lambda **k: PopulationPlan(**(k | QUICK)))


def test_a_run_that_is_sampled_again_has_the_draws_that_weights_give(study):
    """The run's draws, weighted by the new prior over the run's, are those under the new prior."""
    source = Source.from_run("a", biaxbayes.open_run(study / "runs" / "a"))
    names = pooled_names([source])
    assert names == ("C1", "k1", "k2", "alpha")
    values = pooled_values(source.run.law, names)
    assert not is_cut_short(source, values)
    draws = run_draws(source, source.chains, source.posterior.priors, values, 2)
    assert np.exp(draws.theta[..., 0] + values[0].mean) == pytest.approx(draws.natural["C1"])
    assert draws.theta[..., 3] + values[3].mean == pytest.approx(draws.natural["alpha"])
    theta = draws.theta.reshape(-1, 4)
    mean, sd = theta.mean(axis=0), 5.0 * theta.std(axis=0)
    mean[0], sd[0] = mean[0] + theta[:, 0].std(), 0.7 * theta[:, 0].std()
    weights = draws.log_weights(0, mean[None], np.diag(sd**-2.0)[None])[:, 0]
    weights = np.exp(weights - weights.max())
    plan = Plan(ess=300, ensembles=2, seed=3)
    again = sample_again(source, values, mean, sd, plan, lambda: False).theta.reshape(-1, 4)
    known = np.average(draws.theta[0], axis=0, weights=weights)
    spread = np.sqrt(np.average((draws.theta[0] - known) ** 2, axis=0, weights=weights))
    assert (np.abs(again.mean(axis=0) - known) < 0.3 * spread).all()
    assert again.std(axis=0) == pytest.approx(spread, rel=0.3)
    # the prior matters: without it the draws are elsewhere
    assert (np.abs(theta.mean(axis=0) - known) > 0.3 * spread).any()
    assert sample_again(source, values, mean, sd, plan, lambda: True) is None


def test_ensembles_of_unequal_shares_of_a_run_have_as_many_draws(study):
    source = Source.from_run("a", biaxbayes.open_run(study / "runs" / "a"))
    values = pooled_values(source.run.law, pooled_names([source]))
    # of three ensembles the first of two shares has twice as many draws
    chains = {
        name: np.concatenate([v[:1], v[:1], v[:1]])[:, :40] for name, v in source.chains.items()
    }
    draws = run_draws(source, chains, source.posterior.priors, values, 2)
    first, second = draws.natural["C1"]
    assert {*first} <= {*chains["C1"].ravel()} and {*second} <= {*chains["C1"].ravel()}


def test_the_prior_of_a_specimen_that_is_sampled_again_is_that_of_its_group(monkeypatch):
    """In place of its own priors of what is pooled; others and fixed parameters stay."""
    seen = []

    def stopped(posterior, plan, *, stop):
        seen.append(posterior.priors)
        return SimpleNamespace(interrupted=True)

    monkeypatch.setattr("biaxbayes.populations.specimens.draw_posterior", stopped)
    own = {"kappa": 0.1, "alpha": {"distribution": "normal", "mean": 20.0, "sd": 1.0}}
    data = quick_posteriors.small_specimen()
    posterior = Posterior(data, noise="independent", mounting="exact", priors=own)
    values = pooled_values(posterior.law, ("C1", "alpha"))
    mean, sd = np.array([0.3, -5.0]), np.array([0.2, 4.0])
    source = SimpleNamespace(posterior=posterior)
    assert sample_again(source, values, mean, sd, Plan(), lambda: True) is None
    (priors,) = seen
    levels = np.array([0.05, 0.5, 0.95])
    z = norm.ppf(levels)
    assert priors["C1"].ppf(levels) == pytest.approx(np.exp(values[0].mean + 0.3 + 0.2 * z))
    assert priors["alpha"].ppf(levels) == pytest.approx(values[1].mean - 5.0 + 4.0 * z, rel=1e-4)
    assert (priors["alpha"].low, priors["alpha"].high) == (0.0, 90.0)
    assert priors["kappa"] == 0.1 and priors["k1"] == posterior.priors["k1"]


def test_runs_whose_prior_is_narrower_than_the_range_are_cut_short(study):
    source = Source.from_run("a", biaxbayes.open_run(study / "runs" / "a"))
    values = pooled_values(source.run.law, pooled_names([source]))
    for prior, short in (
        ({"distribution": "uniform", "low": 0.0, "high": 90.0}, False),
        ({"distribution": "uniform", "low": 20.0, "high": 90.0}, True),
        ({"distribution": "normal", "mean": 45.0, "sd": 9.0, "high": 60.0}, True),
    ):
        priors = {**source.posterior.settings.priors, "alpha": prior}
        other = replace(source, posterior=source.posterior.replaced(priors=priors))
        assert is_cut_short(other, values) == short


def test_tables_have_their_columns_and_hold_together(population):
    table = population.groups
    assert list(dict.fromkeys(table["group"])) == ["healthy", "aneurysm"]
    for part in ("mean", "sd_donors", "sd_specimens", "sd_total", "new_specimen", "new_donor"):
        q05, q50, q95 = (table[f"{part}_{q}"] for q in ("q05", "q50", "q95"))
        assert (q05 <= q50).all() and (q50 <= q95).all()
    C1 = table[table["quantity"] == "C1"].set_index("group")
    assert C1.loc["healthy", "scale"] == "log" and C1.loc["healthy", "unit"] == "kPa"
    assert 8.0 < C1.loc["healthy", "mean_q50"] < 20.0
    assert C1.loc["aneurysm", "mean_q50"] < C1.loc["healthy", "mean_q50"]
    # a new specimen scatters more than the mean of its group
    wider = table["new_specimen_q95"] - table["new_specimen_q05"]
    narrower = table["mean_q95"] - table["mean_q05"]
    assert (wider >= narrower).all() and (wider > 1.1 * narrower).sum() > 0.9 * len(table) - 2
    contrast = population.contrasts.set_index("quantity")
    assert contrast.loc["C1", "probability_positive"] < 0.2
    alpha = contrast.loc["alpha", "difference_q50"]
    means = table[table["quantity"] == "alpha"].set_index("group")["mean_q50"]
    assert alpha == pytest.approx(means["aneurysm"] - means["healthy"], abs=1.0)
    assert {"Hx", "stiffness_x at 1"} <= set(table["quantity"])


def test_files_say_the_same(population):
    record = json.loads((population.folder / POPULATION).read_text())
    for name, (file, _) in TABLES.items():
        written, table = pd.read_csv(population.folder / file), getattr(population, name)
        numbers = table.select_dtypes("number")
        assert np.allclose(written[numbers.columns], numbers, rtol=1e-6, equal_nan=True)
        stored = pd.DataFrame(record[name])[numbers.columns].astype(float)
        assert np.allclose(stored, numbers, rtol=1e-10, equal_nan=True)
    tree = xr.open_datatree(population.folder / "population.nc", engine="h5netcdf").load()
    draws = tree["posterior"]["mean"].sel(group="healthy", quantity="C1").to_numpy()
    row = population.groups.iloc[0]
    assert np.exp(np.median(draws)) == pytest.approx(row["mean_q50"], rel=1e-6)
    for stem in FIGURE_TEXTS:
        assert (population.folder / f"{stem}.pdf").stat().st_size > 2000
    assert (population.reason or "R-hat") in (population.folder / "population.html").read_text()


def test_folders_of_another_kind_are_named(study, population, tmp_path, capsys):
    verbs = (("identify",), ("report",), ("plot", "--figure", "trace"), ("predict",))
    for verb, *options in (*verbs, ("export", "--to", "abaqus"), ("design",)):
        for folder, message in (
            (population.folder, "a population's folder"),
            (study, f"a study's folder, not a run's; give one of the runs in {study / 'runs'}"),
            (tmp_path / "absent", f"{tmp_path / 'absent'}: does not exist"),
        ):
            assert message in refused(capsys, verb, folder, *options)
    assert not list(tmp_path.iterdir())
    cards = ("--to", "abaqus", "--population", "healthy")
    (tmp_path / "damaged").mkdir()
    (tmp_path / "damaged" / POPULATION).write_text("{}")
    for folder, message in (
        (study / "runs" / "a", "a run's folder, not a population's"),
        (study, "a study's folder, not a population's"),
        (tmp_path, "is not a population folder"),
        (tmp_path / "absent", "does not exist"),
        (tmp_path / "damaged", "population.nc: no such file"),
    ):
        assert message in refused(capsys, "export", folder, *cards)


def test_a_finished_population_is_refused_and_stays(study, population, tmp_path, capsys):
    folder = shutil.copytree(population.folder, tmp_path / "out")
    before = manifest(folder)
    output = refused(capsys, "population", study, "--out", folder)
    assert "holds a finished population; choose another --out, or replace it" in output
    # before the specimens of a study file are sampled
    runs = tmp_path / "runs"
    file = study.parent / "study.toml"
    assert "--overwrite" in refused(capsys, "population", file, "--out", folder, "--runs", runs)
    with pytest.raises(RunError, match="holds a finished population"):
        quick_job(study, folder)()
    assert manifest(folder) == before and not runs.exists()


@pytest.mark.long
def test_a_population_is_replaced_whole(study, population, tmp_path, quick, monkeypatch):
    monkeypatch.setattr(job, "draw_figures", lambda *arguments: None)
    folder = shutil.copytree(population.folder, tmp_path / "out")
    biaxbayes.export(folder, "abaqus", population="healthy", draws=2)
    (folder / "notes.txt").write_text("mine\n")
    steps = []
    again = quick_job(study, folder, options=PopulationOptions(seed=2))(
        overwrite=True, progress=steps.append
    )
    (output,) = [p.note for p in steps if p.note.startswith("removed with the previous population")]
    assert output.endswith(": cards-abaqus-kPa-mm")
    assert again.folder == folder
    record = json.loads((folder / POPULATION).read_text())
    assert record["identity"]["options"]["seed"] == 2
    # what belonged to the draws before is gone, and what is the user's stays
    kept = {p.name for p in folder.iterdir() if not p.name.startswith((".", "checkpoint"))}
    assert kept == {*record["files"], POPULATION, "notes.txt"}


def test_a_contrast_says_whether_the_groups_differ(population):
    ends = [f"difference_{q}" for q in ("q05", "q50", "q95")]
    table = population.contrasts.iloc[:3].copy()
    table["scale"] = ["log", "log", "linear"]
    table["direction"] = ["smaller", "open", "open"]
    table[ends] = [[-0.9, -0.7, -0.5], [-0.9, 0.1, 0.4], [-3.0, 1.0, 4.0]]
    rows = contrast_table("a", "b", table).cells()
    assert [row[4] for row in rows] == ["smaller", "includes 1", "includes 0"]
    ends = f"{np.exp(-0.9):.3g} to {np.exp(-0.5):.3g}"
    assert rows[0][1:4] == ["ratio", f"{np.exp(-0.7):.3g}", ends]
    own = population.contrasts
    if population.state == "converged":
        assert list(own["direction"] == "larger") == list(own["difference_q05"] > 0.0)
        assert list(own["direction"] == "smaller") == list(own["difference_q95"] < 0.0)
    else:
        assert own["direction"].isna().all()


def test_what_is_not_identified_on_its_own_is_marked(population):
    """With a note where there is a mark; no mark without a verdict or a number."""
    tables = {"groups": population.groups, "contrasts": population.contrasts}
    record = json.loads((population.folder / POPULATION).read_text())
    marked = population.groups["mean_q50"].notna().sum()
    verdicts = (("identified", 0), (NOT_IDENTIFIED, 1), (COMBINATION, 1), (NO_VERDICT, 0))
    for verdict, marks in verdicts:
        groups = population.groups.assign(verdict=verdict)
        cells = [as_text(row[2]) for row in group_table("a", groups).cells()]
        assert sum(cell.endswith("*") for cell in cells) == marks * marked, verdict
        text = population_latex(tables | {"groups": groups}, record).partition("\\begin{tabular}")[
            2
        ]
        assert text.count("*") == marks * (marked + 1), verdict
    unknown = groups.iloc[:1].assign(verdict=NOT_IDENTIFIED, mean_q50=np.nan)
    assert as_text(group_table("a", unknown).cells()[0][2]) == DASH


@pytest.mark.long
def test_one_specimen_per_donor_has_a_total_spread_only(study, tmp_path, quick):
    name, members = members_of_study(study)
    apart = [replace(m, donor=f"D{k}") for k, m in enumerate(members)]
    result = sample_population(name, apart, tmp_path / "out", anyway=True)
    written = pd.read_csv(tmp_path / "out" / "population.csv")
    for table in (result.groups, written):
        for part in ("sd_donors", "sd_specimens", "new_donor"):
            assert table[[f"{part}_{q}" for q in ("q05", "q50", "q95")]].isna().all(axis=None)
        assert (table["sd_total_q50"] > 0.0).any() and table["sd_total_q50"].notna().all()
    out = closing_message(result)
    assert "Specimens of different donors differ by" in out and "Donors differ by" not in out


@pytest.mark.long
def test_stopped_and_resumed_writes_the_same_bytes(study, population, tmp_path, quick):
    arguments = []

    def stop():
        arguments.append(1)
        return 2 if len(arguments) > 1 else 0

    whole = quick_job(study, tmp_path / "out")
    with pytest.raises(Interrupted, match="`resume=True` continues") as error:
        whole(stop=stop)
    assert error.value.exit_code == 130
    whole(resume=True)
    for name in ("population.csv", "specimens.csv", "contrasts.csv"):
        assert (tmp_path / "out" / name).read_bytes() == (population.folder / name).read_bytes()
    other = quick_job(study, tmp_path / "out", options=PopulationOptions(seed=2))
    with pytest.raises(RunError, match="seed"):
        other(resume=True)


@pytest.mark.long
def test_a_population_that_did_not_converge_says_what_to_do_and_continues_with_more_steps(
    study, tmp_path, monkeypatch
):
    def with_budget(steps):
        few = {**QUICK, "warm_up": 1, "chains": 1, "ess": 1e5, "max_steps": steps}
        monkeypatch.setattr(job, "PopulationPlan", lambda **k: PopulationPlan(**(k | few)))
        result = quick_job(study, tmp_path / "out")(resume=steps > 6)
        record = json.loads((tmp_path / "out" / POPULATION).read_text())
        return result, record["convergence"]["kept_sweeps"]

    first, kept = with_budget(6)
    assert kept == 6 and first.state == "unusable"
    output = closing_message(first)
    assert "--resume" in output and "--max-steps" in output and "k1" not in output.splitlines()[2:]
    page = (tmp_path / "out" / "population.html").read_text(encoding="utf-8")
    assert DASH not in output and 'id="groups"' not in page and 'id="contrasts"' not in page
    assert with_budget(20)[1] == 20


def test_words_for_difficult_studies(study):
    _, members = members_of_study(study)
    sources, _ = open_sources(members, anyway=True)

    def changed(**values):
        rows = (dict(zip(values, row, strict=True)) for row in zip(*values.values(), strict=True))
        return [replace(m, **row) for m, row in zip(members, rows, strict=True)]

    for values, words in (
        ({"donor": "DDDD"}, "one donor"),
        ({"donor": "pqrs"}, "split"),
        ({"donor": ["", "D", "D", "D"]}, "no donor is given"),
        ({"group": "xyyy"}, "group x has one specimen"),
        ({"donor": "ppqq"}, "no donor in common"),
    ):
        assert words in " | ".join(group_sources(changed(**values), sources)[1])
    assert "the runs differ" not in " | ".join(group_sources(members, sources)[1])
    other = replace(sources[0], posterior=sources[0].posterior.replaced(noise="correlated"))
    notes = group_sources(members, [other, *sources[1:]])[1]
    assert "the runs differ in noise: correlated, independent" in notes
    states = ["converged", "unusable", "converged", "converged"]
    _, left_out = open_sources(changed(state=states), anyway=True)
    assert list(left_out) == ["b"] and "did not converge" in left_out["b"]


def test_columns_of_the_study_file(study, tmp_path, capsys):
    text = (study.parent / "study.toml").read_text()
    for name in MATERIALS:
        shutil.copy(study.parent / f"{name}.csv", tmp_path)
    bad = tmp_path / "study.toml"
    for change, message in (
        ('columns = ["disease"]', "'disease' is not a key of specimen 1"),
        ('disease = "healthy"\n', "disease is missing, which columns declares"),
    ):
        bad.write_text(text.replace(change, "", 1))
        assert message in refused(capsys, "population", bad, "--out", tmp_path / "out")


def test_what_cannot_be_pooled_is_refused(study, tmp_path, capsys):
    assert "finished study" in refused(capsys, "population", tmp_path, "--out", tmp_path / "out")
    priors = tmp_path / "priors.toml"
    priors.write_text("[sd_donors]\nkappa = 0.1\n")
    with pytest.raises(InputError, match=r"\[sd_donors\] 'kappa' is not a pooled parameter"):
        quick_job(study, tmp_path / "out", priors=PopulationPriors.read(priors))()
    for text, message in (
        ("[spread]\nC1 = 1", "is not a table of population priors; tables are"),
        ("[sd_donors]\nC1 = -1", "above zero"),
        ("[correlations]\nC1 = 0.3", r"\[correlations\] has no 'C1'"),
        (
            '[mean]\nC1 = { distribution = "cauchy" }',
            r"\[mean\] C1 must be a normal or a lognormal",
        ),
    ):
        priors.write_text(text)
        with pytest.raises(InputError, match=message):
            PopulationPriors.read(priors)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    with pytest.raises(RunError, match="is not a population folder"):
        quick_job(study, tmp_path / "mine")()


def test_a_specimen_apart_is_named(population):
    """The words, from a table in which one specimen lies apart."""
    table = population.specimens.copy()
    of = table["specimen"] == "a"
    table.loc[of, "specimen_predictive_p"] = 0.01
    table.loc[of & (table["quantity"] == "k1"), "predictive_p"] = 0.002
    notes = contradictions(table)
    assert len(notes) == 1 and "a contradicts its group healthy" in notes[0] and "k1" in notes[0]


def test_a_specimen_of_which_one_quantity_is_pooled_may_lie_apart():
    row = {"specimen": "a", "group": "healthy", "quantity": "k1", "predictive_p": 0.002}
    (note,) = contradictions(pd.DataFrame([row | {"specimen_predictive_p": 0.01}]))
    assert note.startswith("a contradicts its group healthy") and "by k1, p 0.002" in note


def test_cards_of_new_specimens_and_of_the_mean_curve(population, tmp_path):
    made = biaxbayes.export(
        population.folder, "abaqus", population="healthy", draws=3, out=tmp_path / "cards"
    )
    assert len(made) == 3
    mean = pd.read_csv(tmp_path / "cards" / "mean-curve" / "manifest.csv")
    assert len(mean) == 1 and mean["kappa"].iloc[0] == 0.1
    with pytest.raises(InputError, match="groups are healthy, aneurysm"):
        biaxbayes.export(population.folder, "abaqus", population="skin", out=tmp_path / "none")


# --- studies that are hard to pool, through the command line -------------------------------------

DIFFICULT = {
    **{f"m{k}": GOH(13.0 + 0.4 * k, 60.0 - 2.0 * k, 8.0, 38.0 + k, 0.1) for k in range(5)},
    "odd": GOH(45.0, 240.0, 9.0, 14.0, 0.1),
}
DIFFICULT_STUDY = """
ess = 60
max_steps = 800
options = { noise = "independent", mounting = "exact" }
priors = { kappa = 0.1 }
"""
DRAW_FIGURES = job.draw_figures
LONGER = QUICK | {"max_steps": 600}
SHARP = "C1 = 0.1\nk1 = 0.1\nk2 = 0.1\nalpha = 3\n"
PRIORS = f"[sd_donors]\n{SHARP}[sd_specimens]\n{SHARP}"


def difficult_study(folder):
    specimens = []
    for k, (name, material) in enumerate(DIFFICULT.items()):
        data = quick_posteriors.specimen(
            material,
            total_stretch=1.1 if name == "m4" else 1.2,
            ratios=((1.0, 1.0), (1.0, 0.5)) if name == "m3" else quick_posteriors.THREE_RATIOS,
            increments=8,
            seed=k,
            noise_N=0.001,
        )
        entries = {"donor": f"D{k}", "layer": "media"}
        specimens.append((replace(data, name=name, layer="media"), entries))
    sample_study(folder, DIFFICULT_STUDY, specimens)


@pytest.fixture(scope="module")
def whole(session_folder):
    return shared.made_once("difficult-study", difficult_study) / "study"


@pytest.fixture
def longer(monkeypatch):
    monkeypatch.setattr(job, "PopulationPlan", lambda **k: PopulationPlan(**(k | LONGER)))
    # the figures, which other tests look at, would cost most of the time
    monkeypatch.setattr(job, "draw_figures", lambda *arguments: None)


@pytest.fixture
def pool(whole, longer, tmp_path, capsys):
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


def tables(folder) -> tuple[pd.DataFrame, pd.DataFrame]:
    return pd.read_csv(folder / "population.csv"), pd.read_csv(folder / "specimens.csv")


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
def test_unlike_specimens_are_pooled_with_a_note_and_those_that_failed_left_out(pool):
    states = {"m1": "unusable", "m2": "failed"}
    reasons = {"m1": "R-hat of k1 is 1.31", "m2": "m2.csv: is no table"}
    code, out, err, folder = pool(["m0", "m1", "m2", "m3", "m4"], state=states, reason=reasons)
    assert code == 0
    assert "left out: m1" in err and "left out: m2" in err
    assert list(json.loads((folder / POPULATION).read_text())["left_out"]) == ["m1", "m2"]
    assert set(tables(folder)[1]["specimen"]) == {"m0", "m3", "m4"}
    assert "left out: m1" in (folder / "population.html").read_text(encoding="utf-8")
    assert "specimens were tested with 2 to 3 protocols (2: m3)" in out
    [output] = [line for line in out.splitlines() if "specimens were stretched to" in line]
    assert "least: m4" in output
    low = float(output.split("stretched to ")[1].split()[0])
    assert low == pytest.approx(1.1, abs=0.01)
    groups, _ = tables(folder)
    at = groups["quantity"].str.extract(r"cauchy_x at (.*)")[0].dropna().astype(float)
    assert at.max() == pytest.approx(low, abs=1e-3)  # nobody is extrapolated


@pytest.mark.long
def test_one_specimen_that_can_be_used_is_no_population(pool):
    code, _, err, folder = pool(["m0", "m1"], state={"m1": "unusable"}, reason={"m1": "short"})
    assert code == 2 and not folder.exists()
    assert err.count("\n") == 1 and "1 of 2 specimens can be pooled" in err and "m1" in err


@pytest.mark.long
def test_a_specimen_that_contradicts_its_group_is_named(pool, tmp_path):
    priors = tmp_path / "priors.toml"
    priors.write_text(PRIORS)
    _, out, _, folder = pool([*DIFFICULT], "--priors", str(priors))
    output = [line for line in out.splitlines() if "contradicts its group" in line]
    [line] = output
    assert line.startswith("note: odd contradicts its group media (posterior predictive p 0.0")
    _, specimens = tables(folder)
    p = specimens.groupby("specimen")["specimen_predictive_p"].first()
    assert p.idxmin() == "odd" and (p.drop("odd") > 0.05).all()
    assert "odd contradicts" in (folder / "population.html").read_text(encoding="utf-8")


@pytest.mark.long
def test_not_converged_gives_exit_three_and_no_verdict(pool, monkeypatch):
    short = LONGER | {"first_block": 20, "max_steps": 20, "ess": 1e5}
    monkeypatch.setattr(job, "PopulationPlan", lambda **k: PopulationPlan(**(k | short)))
    code, out, _, folder = pool(["m0", "m1"])
    assert code == 3
    assert "TENTATIVE" in out or "UNUSABLE" in out
    groups, specimens = tables(folder)
    assert set(groups["verdict"]) == {NO_VERDICT}
    assert set(specimens["pooled_verdict"]) <= {NO_VERDICT, "fixed"}
    assert set(specimens["single_verdict"]) - {NO_VERDICT, "fixed"}


@pytest.mark.long
def test_runs_of_other_laws_or_fixed_parameters_are_refused(whole):
    first, second = (
        Source.from_run(n, biaxbayes.open_run(whole / "runs" / n)) for n in ("m0", "m1")
    )
    fixed = second.posterior.replaced(priors={**second.posterior.priors, "k2": 8.0})
    with pytest.raises(InputError, match="k2 was sampled in m0 and fixed or tied in m1"):
        pooled_names([first, replace(second, posterior=fixed)])


@pytest.mark.long
def test_pooled_mounting_stretches_are_judged_and_drawn(pool, monkeypatch):
    monkeypatch.setattr(job, "draw_figures", DRAW_FIGURES)
    code, _, _, folder = pool(["m0", "m1"], "--pool-mounting", "--spread", "by-group")
    assert code in (0, 3)
    groups, specimens = tables(folder)
    for table, column in ((groups, "verdict"), (specimens, "pooled_verdict")):
        of = table[table["quantity"].str.startswith("mounting_stretch")]
        assert len(of) and set(of[column]) <= set(VERDICTS)
    assert (folder / "population-pairs.png").is_file()


def test_terminal_and_page_print_the_same_digits(population):
    terminal = closing_message(population).splitlines()
    page = (population.folder / "population.html").read_text()
    heads = [k for k, line in enumerate(terminal) if line.startswith("Quantity ")]
    assert len(heads) == 3  # two groups, and what differs between them
    assert terminal[heads[2] - 1] == "aneurysm compared with healthy"
    plain = page.replace("\N{MINUS SIGN}", "-")
    groups = population.groups.groupby("group", sort=False)
    tables = [group_table(str(group), part).without("new_donor") for group, part in groups]
    tables += [table for _, table in group_differences(population.contrasts, population.groups)]
    for table in tables:
        for row in table.cells():
            cells = [as_text(c[0] if isinstance(c, tuple) else c) for c in row[2:]]
            assert any(all(c in line for c in cells) for line in terminal), row
            assert all(f">{c}<" in plain for c in cells), row
    new = [as_text(row[-1]) for row in tables[0].cells()]
    assert all(re.fullmatch(r"\S+ to \S+ \(median \S+\)", text) for text in new), new
