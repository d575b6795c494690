"""From a posterior to judged draws, and from a file to a run folder."""

import json
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import biaxbayes
from biaxbayes.model.draw import draw_posterior
from biaxbayes.model.posterior import Posterior
from biaxbayes.runs.run import SUMMARY_COLUMNS
from biaxbayes.sampling.convergence import effective_sample_size
from biaxbayes.sampling.ensembles import Ensembles
from biaxbayes.sampling.sampler import Plan
from biaxbayes.specimens.specimen_file import read_specimen, write_specimen
from commands import exit_code
from quick_posteriors import runs_without_figures, without_figures

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import arviz as az

DATA = Path(__file__).parents[1] / "data"
THETA = ("C1", "k1", "k2", "alpha", "kappa", "mounting_stretch_x", "mounting_stretch_y")


def specimen(name="donor2-media"):
    return read_specimen(DATA / f"{name}.csv")


# --- ways to the same posterior ----------------------------------------------------------------


@pytest.mark.long
def test_draws_with_a_misfit_are_those_of_the_density_on_a_grid():
    """Two parameters are free; quantiles by quadrature of the density."""
    fixed = {"k1": 12.0, "k2": 2.0, "kappa": 0.05}
    posterior = Posterior(specimen(), mounting="exact", priors=fixed)
    plan = Plan(ess=3000, seed=5, workers=2, walkers=32, population=2048)
    result = draw_posterior(posterior, plan)
    assert result.convergence.state == "converged"
    grids = {}
    for name in posterior.free:
        x = result.quantities[name]
        spread = 8.0 * x.std()
        grids[name] = np.linspace(max(x.mean() - spread, 1e-3), x.mean() + spread, 161)
    C1, alpha = np.meshgrid(grids["C1"], grids["alpha"], indexing="ij")
    logs = posterior.log_density({"C1": C1, "alpha": alpha})
    # a density in ln C1
    mass = np.exp(logs - logs.max()) / C1
    assert max(mass[[0, -1]].max(), mass[:, [0, -1]].max()) < 1e-4 * mass.max()
    for name, along in (("C1", mass.sum(axis=1)), ("alpha", mass.sum(axis=0))):
        x = result.quantities[name]
        cumulative = np.cumsum(along) - 0.5 * along
        for level in (0.05, 0.5, 0.95):
            value = np.interp(level, cumulative / along.sum(), grids[name])
            below = (x < value).astype(float)
            error = np.sqrt(level * (1 - level) / effective_sample_size(below))
            # and what the grid resolves
            assert abs(below.mean() - level) < 4.0 * error + 0.002


# --- seeds, workers, interruption -------------------------------------------------------------


def advanced(workers):
    """Ensembles on half a normal density, and the blocks that they made."""

    def log_density(x):
        return np.where(x[:, 0] >= 0.0, -0.5 * (x**2).sum(axis=1), -np.inf)

    rng = np.random.default_rng(3)
    starts = [np.abs(rng.standard_normal((16, 2))) for _ in range(4)]
    ensembles = Ensembles(log_density, starts, np.random.SeedSequence(1), workers=workers)
    made = [ensembles.run(5)]
    history = made[0][0].reshape(-1, 2)
    ensembles.adapt(history, label=np.arange(len(history)) % 2, components=4)
    ensembles.set_share(0.7)
    return [*made, ensembles.run(3)], ensembles


@pytest.mark.parametrize("workers", [2, 3])
def test_ensembles_do_not_depend_on_the_number_of_threads(workers):
    alone, expected = advanced(1)
    made, result = advanced(workers)
    assert len(result.proposal.parts) == 2
    for block, same in zip(made, alone, strict=True):
        np.testing.assert_array_equal(block[0], same[0])
        np.testing.assert_array_equal(block[1], same[1])
    assert result.acceptance == expected.acceptance > 0.0
    np.testing.assert_array_equal(result.run(4)[0], expected.run(4)[0])


def test_an_error_in_one_thread_ends_the_block():
    calls, seen = [], []

    def log_density(x):
        seen.append(len(x))
        if x[0, 0] > 5.0:
            calls.append(len(x))
            if len(calls) > 3:
                raise RuntimeError("the density failed")
        return np.zeros(len(x)) - 1e3 * ((x - np.round(x[0, 0], -1)) ** 2).sum(axis=1)

    starts = [10.0 * k + np.random.default_rng(k).uniform(-0.1, 0.1, (8, 2)) for k in (0, 1)]
    ensembles = Ensembles(log_density, starts, np.random.SeedSequence(1), workers=2)
    with pytest.raises(RuntimeError, match="the density failed"):
        ensembles.run(100_000)  # minutes, if the other ensemble went on
    assert sum(seen) < 100_000


@pytest.mark.long
def test_thinning_keeps_every_so_many_steps_whatever_the_blocks(monkeypatch):
    """And a posterior that was drawn from before gives the same draws again."""
    from biaxbayes.sampling import sampler

    posterior = Posterior(specimen("donor2-adventitia"), noise="independent")
    plan = Plan(ess=1e9, max_steps=300, seed=3, first_block=64, population=2048, walkers=32)
    whole = draw_posterior(posterior, plan)
    monkeypatch.setattr(sampler, "MAX_STORED_STEPS", 70)
    thinned = draw_posterior(posterior, plan)
    assert thinned.thin == 8
    np.testing.assert_array_equal(thinned.chain, whole.chain[:, ::8])


# --- the run folder ---------------------------------------------------------------------------

FILES = {"posterior.nc", "summary.csv", "fit.json", "provenance.json"}
FILES |= {f"{figure}.{kind}" for figure in ("corner", "stress-bands") for kind in ("pdf", "png")}
GROUPS = {"posterior", "sample_stats", "posterior_predictive", "observed_data", "constant_data"}
ROWS = (*THETA, "mounting_force_x", "mounting_force_y")


@pytest.fixture(scope="module")
def run(media_run):
    return media_run


def test_run_folder_holds_every_file_and_reopens(run):
    assert {p.name for p in run.path.iterdir()} >= FILES
    assert run.state == "converged"
    again = biaxbayes.open_run(run.path)
    assert again.specimen == read_specimen(DATA / "donor2-media.csv")
    k2 = again.chains["k2"].transpose(0, 2, 1).ravel()
    np.testing.assert_array_equal(k2, again.draws["k2"].to_numpy())
    posterior = again.posterior()
    assert posterior.settings == run.settings and posterior.settings.has_misfit
    few = again.draws[:50]
    np.testing.assert_allclose(
        posterior.log_density(few[list(posterior.free)]), few["lp"], rtol=1e-9
    )
    (record,) = again.fit
    assert record["method"] == "constrained"
    for name in ("corner", "stress-bands"):
        assert (run.path / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert (run.path / f"{name}.pdf").read_bytes().startswith(b"%PDF")


def test_summary_is_that_of_the_draws(run):
    table = pd.read_csv(run.path / "summary.csv")
    assert tuple(table.columns) == SUMMARY_COLUMNS
    assert tuple(table["parameter"]) == ROWS
    units = dict(zip(table["parameter"], table["unit"], strict=True))
    assert (units["C1"], units["alpha"], units["mounting_force_x"]) == ("kPa", "deg", "N")
    for row in table.itertuples():
        values = run.draws[row.parameter]
        assert row.mean == pytest.approx(values.mean(), rel=1e-6)
        assert row.q05 == pytest.approx(np.quantile(values, 0.05), rel=1e-6)
        assert row.q95 == pytest.approx(np.quantile(values, 0.95), rel=1e-6)
    assert (table["rhat"] < 1.01).all() and (table["ess_bulk"] >= 500).all()


def test_archive_opens_with_arviz_and_has_its_groups_and_dimensions(run):
    opened = az.from_netcdf(run.path / "posterior.nc")
    names = opened.groups() if callable(opened.groups) else opened.groups
    assert {str(n).strip("/") for n in names} >= GROUPS
    posterior = opened["posterior"]
    assert set(posterior["C1"].dims) == {"chain", "draw"}
    assert posterior.sizes["chain"] == 4
    assert posterior["C1"].attrs["units"] == "kPa"
    assert posterior.attrs["biaxbayes_version"] == biaxbayes.__version__
    np.testing.assert_array_equal(posterior["k1"].to_numpy().ravel(), run.draws["k1"])
    rows = specimen().protocols[0].rows - specimen().protocols[0].rest_rows
    for name in ("load", "model_load"):
        sizes = opened["posterior_predictive"][name].sizes
        assert (sizes["chain"], sizes["row"], sizes["direction"]) == (4, rows, 2)


OPENED = {
    "file": lambda run: az.from_netcdf(run.path / "posterior.nc"),
    "run": lambda run: run.arviz,
}


@pytest.mark.parametrize("opened", OPENED.values(), ids=list(OPENED))
def test_arviz_summarises_a_run(run, opened):
    summary = az.summary(opened(run), var_names=["C1", "alpha"])
    assert float(summary.loc["C1", "mean"]) == pytest.approx(run.draws["C1"].mean(), rel=0.05)
    rhat = az.rhat(opened(run), var_names=["C1"])
    assert float(np.asarray(rhat["C1"])) < 1.05


def test_stored_likelihood_is_that_of_all_readings(run):
    """The readings depend on each other, so there is none of single ones."""
    names = [str(n).strip("/") for n in run.tree.groups]
    assert not any(n.startswith("log_likelihood") for n in names)
    few = run.draws.iloc[::500]
    residual = run.posterior().residuals(few)
    expected = run.posterior().misfit.log_likelihood(residual)
    np.testing.assert_allclose(few["log_likelihood"], expected, rtol=1e-6, atol=1e-5)


def test_stored_predictions_are_new_readings_of_the_tissue(run):
    """They scatter about the readings as those do; the law alone misses them."""
    stored, measured = (
        run.tree["posterior_predictive"],
        run.tree["observed_data"]["load"].to_numpy(),
    )
    new = stored["load"].to_numpy().reshape(-1, *measured.shape)
    low, high = np.quantile(new, [0.05, 0.95], axis=0)
    inside = (measured >= low) & (measured <= high)
    assert 0.85 < inside.mean() < 0.99
    law = np.median(stored["model_load"].to_numpy().reshape(-1, *measured.shape), axis=0)
    missed, missed_by_law = (
        np.sqrt(np.mean((measured - m) ** 2)) for m in (np.median(new, axis=0), law)
    )
    assert missed < 2.0 * run.provenance["noise"]["load_noise"] < missed_by_law


def test_provenance_says_what_was_run_and_how_long_each_part_took(run):
    record = run.provenance
    assert (record["biaxbayes"], record["seed"]) == (biaxbayes.__version__, 11)
    assert record["settings"]["mounting"] == "noisy"
    noise, parts = record["noise"], record["seconds"]
    assert 0 < noise["readings_compared"] < noise["readings"] == 200
    assert noise["load_noise"] > 0.0
    assert parts["total"] >= parts["warm-up"] + parts["sampling"] + parts["fit"]


def test_the_terms_that_are_summed_make_up_the_likelihood(run):
    """A tenth of them or so; what is left out is counted on the draws."""
    misfit, record = run.posterior().misfit, run.provenance["misfit"]
    assert 0.002 < record["amplitude"] < 0.12 and 0.02 < record["toe"] < 0.4
    (summed,), (count,) = record["terms"], record["of"]
    assert len(summed) == len(misfit.terms.toe) < 0.3 * count
    few = run.draws.iloc[::37]
    every = replace(misfit, chosen=None).log_likelihood(run.posterior().residuals(few))
    left_out = -np.expm1(few["log_likelihood"] - every)
    assert 0.0 <= left_out.quantile(0.99) < 0.003 and record["left_out"] < 0.05


@pytest.mark.long
def test_same_seed_same_bytes_whatever_the_workers(run, tmp_path):
    with without_figures():
        again = biaxbayes.sample(
            DATA / "donor2-media.csv", out=tmp_path / "again", seed=11, ess=500, workers=2
        )
    for name in ("summary.csv", "fit.json"):
        assert (again.path / name).read_bytes() == (run.path / name).read_bytes()
    np.testing.assert_array_equal(again.draws.to_numpy(), run.draws.to_numpy())


# --- the command ------------------------------------------------------------------------------


@pytest.mark.long
def test_a_converged_run_ends_with_0_and_one_screen(tmp_path, capsys):
    out = tmp_path / "run"
    code = exit_code(
        "sample", DATA / "donor2-media.csv", "--out", out, "--ess", 300, "--workers", 2,
        "--noise", "independent",
    )  # fmt: skip
    text = capsys.readouterr().out
    assert code == 0
    assert {p.name for p in out.iterdir()} >= FILES
    assert len(text.splitlines()) <= 40
    for word in ("C1", "kappa", "mounting_stretch_x", "converged", "R-hat", str(out)):
        assert word in text


@pytest.mark.long
@pytest.mark.parametrize("apart", [False, True])
def test_a_run_that_does_not_converge_ends_with_3_and_shows_nothing_to_trust(
    tmp_path, capsys, monkeypatch, apart
):
    """Too short, or its ensembles disagree, as here by a limit that none keeps."""
    out = tmp_path / "short"
    for limit in ("RHAT_LIMIT", "TENTATIVE_RHAT") if apart else ():
        monkeypatch.setattr(f"biaxbayes.sampling.convergence.{limit}", 0.9)
    words = ("--max-steps", 128, "--ess", 1e7, *(["--quiet"] if apart else []))
    with runs_without_figures():
        code = exit_code("sample", DATA / "donor2-media.csv", "--out", out, *words)
    text, err = capsys.readouterr()
    assert code == 3
    assert "not converged" in text or apart
    convergence = json.loads((out / "provenance.json").read_text())["convergence"]
    assert convergence["state"] != "converged"
    assert convergence["reason"]
    table = pd.read_csv(out / "summary.csv")
    assert table["ess_bulk"].isna().all() and table["ess_tail"].isna().all()
    if apart:
        assert convergence["state"] == "unusable"
        assert convergence["reason"].startswith("R-hat of ") and convergence["reason"] in err
        assert table[["mean", "sd", "q05", "q50", "q95"]].isna().all(axis=None)
        assert table["rhat"].notna().any()
    assert (out / "posterior.nc").is_file()  # the draws are kept


def test_a_tared_file_ends_with_2_and_names_the_ways_on(tmp_path, capsys):
    path = tmp_path / "tared.csv"
    write_specimen(specimen().zeroed(), path)
    code = exit_code("sample", path, "--out", tmp_path / "run")
    text = capsys.readouterr().err
    assert code == 2
    assert len(text.strip().splitlines()) == 1
    for words in (f"{path}: ", "tared", "--mounting-force X Y", "--mounting zeroed"):
        assert words in text
    assert not (tmp_path / "run" / "provenance.json").exists()


def test_a_foreign_folder_is_not_written_into(tmp_path, capsys):
    (tmp_path / "thesis.docx").write_text("years of work")
    code = exit_code("sample", DATA / "donor2-media.csv", "--out", tmp_path)
    assert code == 2
    assert "choose another --out" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir() if not p.name.startswith(".")] == ["thesis.docx"]
