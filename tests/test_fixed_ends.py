"""An end of a parameter's range as a hypothesis: the others with the parameter held there."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import biaxbayes
from biaxbayes.identifiability import fixed_ends as module
from biaxbayes.identifiability.fixed_ends import fixed_end, fixed_end_table
from biaxbayes.identifiability.marginals import Edge
from biaxbayes.identifiability.reported import interval_text
from biaxbayes.laws.goh import GOH
from biaxbayes.model.preparation import prepare
from biaxbayes.model.search import draw_posterior
from biaxbayes.reports.closing_message import closing_message
from biaxbayes.sampling.sampler import Plan
from biaxbayes.specimens.virtual_specimen import Machine, virtual_specimen

ALIGNED = GOH(8.0, 15.0, 4.0, 40.0, 0.0)


def edge(side: int, value: float) -> Edge:
    return Edge(side, value, "physical", 0.02, 0.5, 0.1, 1.0)


@pytest.fixture(scope="module")
def aligned():
    """The posterior of a specimen whose fibres are aligned."""
    specimen, _ = virtual_specimen(
        ALIGNED,
        name="aligned",
        mounting_stretch=(1.01, 1.02),
        total_stretch=1.2,
        ratios=((1.0, 1.0), (1.0, 0.5), (0.5, 1.0)),
        increments=20,
        machine=Machine(noise_N=0.002),
        seed=3,
    )
    return prepare(specimen, noise="independent")


@pytest.fixture(scope="module")
def held(aligned):
    return fixed_end(aligned, "kappa", edge(0, 0.0))


def test_importance_sampling_finds_what_the_sampler_finds(aligned, held, monkeypatch):
    assert held.draws > module.LEAST_ESS and "kappa" not in held.intervals
    assert set(aligned.law.names) - {"kappa"} <= set(held.intervals)
    # no importance weight is even enough: the sampler draws
    monkeypatch.setattr(module, "LARGEST_SHARE", 0.0)
    sampled = fixed_end(aligned, "kappa", edge(0, 0.0))
    assert sampled.draws != held.draws
    other = draw_posterior(
        prepare(aligned.specimen, noise="independent", priors={"kappa": 0.0}), Plan(seed=9)
    )
    for name, (low, median, high) in held.intervals.items():
        draws = other.quantities[name].ravel()
        sd = draws.std()
        for found, level in ((low, 0.05), (median, 0.5), (high, 0.95)):
            # the error of a quantile of 1,000 normal draws is at most 0.067 sd, of both 0.09
            assert abs(found - np.quantile(draws, level)) < 0.25 * sd, (name, level)
        assert abs(sampled.intervals[name][1] - median) < 0.25 * sd


def test_the_truth_lies_in_the_intervals_with_the_edge_held(held):
    truth = dict(zip(("C1", "k1", "k2", "alpha"), ALIGNED.values, strict=False))
    inside = [held.intervals[n][0] <= v <= held.intervals[n][2] for n, v in truth.items()]
    assert sum(inside) >= 3, held.intervals


def test_what_means_nothing_at_the_edge_has_no_interval(aligned):
    """Isotropic fibres have no angle; so soft a fit is refused or says nothing of it."""
    isotropic = fixed_end(aligned, "kappa", edge(1, 1.0 / 3.0))
    assert isotropic is None or "alpha" not in isotropic.intervals


def test_no_edge_is_held_where_there_is_no_such_material(aligned):
    assert fixed_end(aligned, "alpha", edge(1, 91.0)) is None


def test_the_table_has_a_row_per_quantity(held):
    table = fixed_end_table((held,)).set_index("parameter")
    assert list(table.index) == list(held.intervals)
    low, median, high = held.intervals["k1"]
    assert tuple(table.loc["k1", ["low_90", "median", "high_90"]]) == (low, median, high)


def test_the_report_shows_fixed_ends_other_laws_and_the_cure(media_run):
    page = (media_run.path / "report.html").read_text()
    table = pd.read_csv(media_run.path / "evidence" / "edges.csv").set_index("parameter")
    k1 = media_run.quantities["k1"].parameter
    interval = interval_text(table.low_90["k1"], table.high_90["k1"], k1)
    assert "With a parameter fixed at an end of its range" in page and f">{interval}<" in page
    assert "kappa = 0 (aligned fibres)" in page and "the ones to report" not in page
    laws = pd.read_csv(media_run.path / "evidence" / "law-fits.csv")
    assert "<h3>Other laws</h3>" in page
    assert all(f'class="name">{law}<' in page for law in laws.law)
    assert "if kappa" not in closing_message(media_run)


def test_a_run_without_results_is_analysed_anew(media_run, copied):
    run = copied(media_run.path)
    (run / "results.json").unlink()
    again = biaxbayes.open_run(run).result
    pd.testing.assert_frame_equal(again.to_frame(), media_run.result.to_frame())
    pd.testing.assert_frame_equal(again.fixed_ends, media_run.result.fixed_ends)
    assert again.fit == media_run.result.fit
