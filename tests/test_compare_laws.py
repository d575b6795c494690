"""Laws weighed by what they predict: stacking against an optimiser, the verb and its files."""

import re

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import minimize
from scipy.stats import norm

import biaxbayes
from biaxbayes.comparison.law_comparison import (
    MAX_LAW_DRAWS,
    MAX_PART_DRAWS,
    WHOLE,
    Task,
    left_out_parts,
    predicted_readings,
    restricted_to,
    sample_part,
    without,
)
from biaxbayes.comparison.law_weights import (
    MIXTURE,
    PRIOR_READINGS,
    stacking_weights,
    weigh_laws,
    weighted_density,
)
from biaxbayes.errors import InputError, Interrupted, NotConverged
from biaxbayes.laws.goh import GOH
from biaxbayes.model.misfit import Structure
from biaxbayes.model.posterior import Posterior
from biaxbayes.parameters import Quantities
from biaxbayes.report_table import interval_texts
from biaxbayes.specimens.specimen_file import write_specimen
from commands import exit_code
from made_up import SD, predicted
from quick_posteriors import small_specimen
from quick_posteriors import specimen as specimen_of

PARAMETERS = Quantities(())


LAWS = "goh,hgo"


def test_stacking_weights_are_those_of_an_optimiser():
    rng = np.random.default_rng(4)
    for models in (2, 3, 5):
        density = rng.normal(0.0, 2.0, (models, 60)) + rng.normal(0.0, 0.5, (models, 1))

        def loss(z, density=density):
            w = np.exp(z - np.logaddexp.reduce(z))
            mixed = np.logaddexp.reduce(density + np.log(w)[:, None], axis=0)
            return -mixed.sum() - PRIOR_READINGS * np.log(w).mean()

        z = minimize(loss, np.zeros(models), method="BFGS", options={"gtol": 1e-9}).x
        expected = np.exp(z - np.logaddexp.reduce(z))
        result = stacking_weights(density)
        np.testing.assert_allclose(result, expected, atol=2e-6)
        assert result.sum() == pytest.approx(1.0)
        # never below what the best single model predicts, less what the prior asks for
        mixed = weighted_density(density, result).sum()
        assert mixed > density.sum(axis=1).max() - models * np.log(1e3)


def test_nothing_to_tell_apart_leaves_equal_weights():
    same = np.tile(np.linspace(-3.0, 0.0, 20), (4, 1))
    np.testing.assert_allclose(stacking_weights(same), 0.25)
    # a reading that no model allows says nothing
    barred = np.hstack([same, np.full((4, 1), -np.inf)])
    np.testing.assert_allclose(stacking_weights(barred), 0.25)


def test_draws_of_a_law_without_a_part_have_the_columns_of_its_run():
    specimen = small_specimen()
    options = {"noise": "independent", "mounting": "exact"}
    three = specimen.protocols
    for part, kept in ((None, MAX_LAW_DRAWS), (left_out_parts(specimen)[0], MAX_PART_DRAWS)):
        task = Task("goh", specimen, part, options, seed=1, ess=20.0, max_steps=64)
        result = sample_part(task)
        assert len(result.draws) == kept
        shown = specimen if part is None else without(specimen, part)
        target = Posterior(shown, **options)
        expected = set(target.target().quantities(np.zeros((1, target.dimension))))
        assert set(result.draws) == expected
        if part is None:
            assert result.readings is None
        else:
            assert len(result.readings.measured) == three[0].rows - three[0].rest_rows


def misses(specimen, k1, kappa):
    """Measured less computed loads of each protocol, (rows, 2), and kPa of Cauchy stress a load."""
    material, out = GOH(14.0, k1, 8.0, 38.0, kappa), []
    for p in specimen.protocols:
        measured = np.column_stack([p.stretch_x, p.stretch_y])[p.rest_rows :]
        total = measured * (1.01, 1.02)
        # f_k = s_k A_k / l_k of the dimensions that were measured
        area = np.array(specimen.area) / (measured if specimen.geometry == "mounted" else total)
        load = np.column_stack(material.cauchy(*total.T)) * area
        out.append((np.column_stack([p.load_x, p.load_y])[p.rest_rows :] - load, area))
    return out


@pytest.mark.parametrize("geometry", ["unloaded", "mounted"])
def test_laws_are_weighed_by_densities_and_misses_that_can_be_computed_by_hand(geometry):
    specimen, result = predicted(geometry)
    judged = weigh_laws(specimen, result, ["goh", "hgo"])
    table, parts = judged.table.set_index("law"), judged.parts
    assert judged.converged and judged.left_out == {}
    assert list(table.index) == ["goh", "hgo", MIXTURE]
    for law, k1, kappa in (("goh", 60.0, 0.1), ("hgo", 63.0, 0.0)):
        own = parts[parts["law"] == law]
        assert own["part"].tolist() == [p.name for p in specimen.protocols]
        square, size = 0.0, 0
        for (miss, area), (_, row) in zip(misses(specimen, k1, kappa), own.iterrows(), strict=True):
            density = norm.logpdf(miss, 0.0, SD).sum()
            assert row["left_out_density_nats"] == pytest.approx(density, rel=1e-9)
            in_kPa = miss / area
            assert row["left_out_rms_kPa"] == pytest.approx(np.sqrt((in_kPa**2).mean()), rel=1e-9)
            assert row["readings"] == miss.size
            square, size = square + (in_kPa**2).sum(), size + miss.size
        assert table["left_out_rms_kPa"][law] == pytest.approx(np.sqrt(square / size), rel=1e-9)
        assert table["left_out_density_nats"][law] == pytest.approx(
            own["left_out_density_nats"].sum()
        )
        for at in ("q05", "q50", "q95"):
            assert table[f"mounting_stretch_y_{at}"][law] == pytest.approx(1.02)
    assert table["weight"]["goh"] > 0.9
    assert table["weight"][["goh", "hgo"]].sum() == pytest.approx(1.0)
    low, high = table["weight_low"]["goh"], table["weight_high"]["goh"]
    assert 0.5 < low <= high < 1.0
    mixture = parts[parts["law"] == MIXTURE]
    assert mixture["weight"].tolist() == [1.0] * 3
    assert table["left_out_density_nats"][MIXTURE] == pytest.approx(
        mixture["left_out_density_nats"].sum()
    )
    sizes = mixture["readings"] / mixture["readings"].sum()
    rms = np.sqrt((sizes * mixture["left_out_rms_kPa"] ** 2).sum())
    assert table["left_out_rms_kPa"][MIXTURE] == pytest.approx(rms, rel=1e-9)


def test_weights_of_the_other_parts_alone_and_of_none():
    specimen, result = predicted()
    judged = weigh_laws(specimen, result, ["goh", "hgo"])
    # of the first part, by the weights that the other two alone give
    others = np.array(
        [
            np.concatenate([norm.logpdf(miss, 0.0, SD).ravel() for miss, _ in missed[1:]])
            for missed in (misses(specimen, 60.0, 0.1), misses(specimen, 63.0, 0.0))
        ]
    )
    expected = stacking_weights(others)
    mixture = judged.parts[judged.parts["law"] == MIXTURE].set_index("part")
    first = np.concatenate([m.ravel() for m, _ in misses(specimen, 60.0, 0.1)[:1]])
    second = np.concatenate([m.ravel() for m, _ in misses(specimen, 63.0, 0.0)[:1]])
    density = np.log(expected @ np.exp(norm.logpdf([first, second], 0.0, SD))).sum()
    name = specimen.protocols[0].name
    assert mixture["left_out_density_nats"][name] == pytest.approx(density, rel=1e-9)


@pytest.mark.parametrize("protocols", [1, pytest.param(3, marks=pytest.mark.long)])
def test_a_left_out_part_is_predicted_with_the_misfit_that_the_rest_shows(protocols):
    """Draw by draw a normal conditional, against that of the joint covariance of all readings."""
    specimen = specimen_of(GOH(14.0, 60.0, 8.0, 38.0, 0.1), increments=40, noise_N=0.0005)
    if protocols == 1:
        specimen = specimen.only(specimen.protocols[0].name)
    part = left_out_parts(specimen)[1]
    posterior = Posterior(without(specimen, part), mounting="exact")
    values = {"C1": 14.0, "k1": 61.0, "k2": 8.0, "alpha": 38.0, "kappa": 0.1}
    table = pd.DataFrame([values | {"mounting_stretch_x": 1.01, "mounting_stretch_y": 1.02}] * 4000)
    found = predicted_readings(posterior, table, specimen, part)
    misfit, residual = posterior.misfit, posterior.residuals(table)[:1]
    left = Posterior(
        restricted_to(specimen, part), mounting="exact", misfit_fit=posterior.misfit_fit
    )
    at = posterior.paths.path(left.rows.stretch, 0 if protocols == 1 else None)
    average = np.zeros((len(left.readings.weight), len(at.path)))
    flat = left.readings.index.ravel()
    average[flat, np.arange(len(flat))] = np.repeat(left.readings.share, 2)
    mean, variance = np.zeros(len(average)), np.zeros(len(average))
    logs = misfit.log_weights(residual)[0]
    shares = np.exp(logs - np.logaddexp.reduce(logs))
    toe_shape = Structure(1.0, plane=True)
    for i in np.flatnonzero(shares > 1e-6):
        h, a, factor, t, u, _ = (values[i] for values in misfit.terms)

        def covariance(p, q, h=h, a=a, t=t):
            toe = t**2 * np.outer(p.toe_scale, q.toe_scale) * toe_shape.matrix(p, q)
            return a**2 * misfit.structures[h].covariance(p, q) + toe

        seen = misfit.reading @ covariance(misfit.points, misfit.points) @ misfit.reading.T
        seen += np.diag((factor * misfit.noise_sd) ** 2)
        friction = u**2 * misfit.points.friction_covariance(misfit.points)
        seen += misfit.reading @ friction @ misfit.reading.T
        cross = misfit.reading @ covariance(misfit.points, at) @ average.T
        gain = np.linalg.solve(seen, cross)
        own = np.diag(average @ covariance(at, at) @ average.T) - (gain * cross).sum(axis=0)
        centre = residual[0] @ gain
        mean += shares[i] * centre
        variance += shares[i] * (own + centre**2)
    variance -= mean**2
    law = left.readings.means(posterior.forward.load(table[:1], left.rows.stretch)[0])
    expected = (law + mean).reshape(-1, 2)
    sd = np.sqrt(variance).reshape(-1, 2)
    result_sd = np.sqrt(found.mean.var(axis=0) + (found.sd**2).mean(axis=0))
    # components are drawn: the mean over 4,000 draws
    assert (np.abs(found.mean.mean(axis=0) - expected) < 0.3 * sd).all()
    np.testing.assert_allclose(result_sd, sd, rtol=0.15)
    np.testing.assert_allclose(found.measured, left.readings.means(left.rows.load).reshape(-1, 2))


def test_laws_that_failed_or_have_not_converged_are_named():
    specimen, result = predicted(hgo="tentative")
    judged = weigh_laws(specimen, result, ["goh", "hgo"])
    assert not judged.converged and judged.left_out == {}
    specimen, result = predicted(hgo="failed")
    judged = weigh_laws(specimen, result, ["goh", "hgo"])
    assert not judged.converged
    assert judged.left_out == {"hgo": f"{WHOLE}: failed for a reason"}
    assert judged.table.set_index("law")["weight"]["goh"] == pytest.approx(1.0)
    assert np.isnan(judged.table.set_index("law")["weight"]["hgo"])
    specimen, result = predicted(hgo="failed", goh="unusable")
    with pytest.raises(NotConverged, match=r"no law could be sampled.*goh.*unusable for a reason"):
        weigh_laws(specimen, result, ["goh", "hgo"])


def test_parts_make_up_the_record_and_are_left_out_of_the_rest():
    three = small_specimen()
    assert [p.name for p in left_out_parts(three)] == [p.name for p in three.protocols]
    one = three.only(three.protocols[0].name)
    rest = one.protocols[0].rest_rows
    seen = []
    for part in left_out_parts(one):
        left, kept = restricted_to(one, part).protocols[0], without(one, part).protocols[0]
        assert left.rows - rest + kept.rows == one.protocols[0].rows
        assert left.stretch_x[0] == kept.stretch_x[0] == one.protocols[0].stretch_x[0]
        assert not set(left.load_x[rest:]) & set(kept.load_x[rest:])
        seen += list(left.stretch_x[rest:])
    np.testing.assert_array_equal(seen, one.protocols[0].stretch_x[rest:])


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    """Two laws on a specimen of three protocols whose truth is dispersed GOH."""
    folder = tmp_path_factory.mktemp("laws")
    write_specimen(small_specimen(), folder / "small.csv")
    return folder, exit_code(*command(folder))


def command(folder):
    options = ("--noise", "independent", "--mounting", "exact", "--ess", "60", "--workers", "1")
    return ("laws", folder / "small.csv", "--laws", LAWS, "--out", folder / "out", *options)


@pytest.mark.long
def test_the_law_of_the_truth_predicts_best(compared):
    folder, _ = compared
    table = pd.read_csv(folder / "out" / "laws.csv").set_index("law")
    assert list(table.index) == ["goh", "hgo", MIXTURE]
    assert table["weight"]["goh"] > 0.9
    assert table["left_out_rms_kPa"]["goh"] < table["left_out_rms_kPa"]["hgo"]
    assert table["left_out_density_nats"][MIXTURE] > table["left_out_density_nats"]["goh"] - 2.0
    assert table["mounting_stretch_x_q05"]["goh"] < table["mounting_stretch_x_q95"]["goh"]
    parts = pd.read_csv(folder / "out" / "left-out.csv")
    # weights that have seen a part predict it better, but for what their prior asks for
    mixture = parts[parts["law"] == MIXTURE]
    assert mixture["density_final_weights"].sum() > mixture["left_out_density_nats"].sum() - 0.5
    alone = parts[parts["law"] == "goh"]
    pd.testing.assert_series_equal(
        alone["density_final_weights"], alone["left_out_density_nats"], check_names=False
    )
    for name in ("law-misfit", "law-mounting"):
        assert (folder / "out" / f"{name}.pdf").stat().st_size > 1000


@pytest.mark.long
def test_a_comparison_is_resumed_and_never_overwritten(compared, capsys):
    folder, code = compared
    common = command(folder)
    before = (folder / "out" / "laws.csv").read_bytes()
    assert exit_code(*common) == 2
    assert "continue it with --resume" in capsys.readouterr().err
    removed = sorted((folder / "out" / "parts").glob("*.npz"))[1]
    removed.unlink()
    assert exit_code(*common, "--resume") == code
    assert (folder / "out" / "laws.csv").read_bytes() == before
    assert exit_code(*common, "--resume", "--seed", "2") == 2
    assert "another comparison" in capsys.readouterr().err
    with pytest.raises(Interrupted, match="0 of 8 posteriors"):
        biaxbayes.compare_laws(small_specimen(), laws=LAWS, workers=1, stop=lambda: 1)


@pytest.mark.long
@pytest.mark.parametrize("workers", [1, 2])
def test_the_progress_of_a_comparison_moves_within_a_posterior(workers):
    seen, options = [], {"max_steps": 3000, "noise": "independent", "mounting": "exact", "ess": 1e5}

    def stop():
        return any(8.0 * p.share % 1.0 for p in seen)

    with pytest.raises(Interrupted, match="of 8 posteriors"):
        biaxbayes.compare_laws(
            small_specimen(), laws=LAWS, workers=workers, progress=seen.append, stop=stop, **options
        )
    within = next(p for p in seen if 8.0 * p.share % 1.0)
    assert re.match("0 of 8 posteriors; goh, (whole record|P1): ", within.phase)


def test_what_cannot_be_compared_is_refused():
    for options, message in (
        ({"mounting_stretch": "per-protocol", "workers": 1}, "its own mounted state"),
        ({"laws": "goh,fong"}, "did you mean fung"),
        ({"laws": " , "}, "`laws` names no law"),
        ({"laws": ()}, "`laws` names no law"),
        ({"laws": "goh"}, "goh alone"),
        ({"law": "goh", "fibre_switch": True}, "cannot be given for several laws"),
    ):
        with pytest.raises(InputError, match=message):
            biaxbayes.compare_laws(small_specimen(), **options)


@pytest.mark.long
def test_mounting_stretches_are_the_same_in_table_page_and_terminal(compared, capsys):
    folder, _ = compared
    laws = pd.read_csv(folder / "out" / "laws.csv").set_index("law")
    page = (folder / "out" / "laws.html").read_text(encoding="utf-8")
    assert exit_code(*command(folder), "--resume") in (0, 3)
    output = capsys.readouterr().out
    assert not (folder / "out" / "report.csv").exists()
    for law in ("goh", "hgo"):
        for name, true in (("mounting_stretch_x", 1.01), ("mounting_stretch_y", 1.02)):
            q05, q50, q95 = laws.loc[law, [f"{name}_q{q}" for q in ("05", "50", "95")]]
            assert q05 < q50 < q95
            median, low, high = interval_texts(q50, q05, q95, PARAMETERS[name].parameter)
            assert f"{median}, {low} to {high}" in page
            assert f"{median}, {low} to {high}" in output
            if law == "goh":
                assert abs(q50 - true) < 0.1 * (true - 1.0)  # an exact force leaves its error out
    rms_kPa = f"{laws['left_out_rms_kPa']['goh']:.3g}"
    assert "not below\nthe mounted state" in output and "mixture" in output
    assert f"goh predicts left-out parts best: its rms error is {rms_kPa} kPa" in page
    assert "src=" in page and "http://" not in page and "<script" not in page
