"""An end of a parameter's range as a hypothesis: the others with the parameter held there."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import biaxbayes
from biaxbayes.identifiability import held_edges as module
from biaxbayes.identifiability.held_edges import HeldEdge, held_edge, held_from, held_table
from biaxbayes.identifiability.marginals import Edge
from biaxbayes.laws.goh import GOH
from biaxbayes.model.preparation import prepare
from biaxbayes.model.search import draw_posterior
from biaxbayes.reports.facts import closing_message
from biaxbayes.reports.page import report_page
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
    return held_edge(aligned, "kappa", edge(0, 0.0))


def test_importance_sampling_finds_what_the_sampler_finds(aligned, held, monkeypatch):
    assert held.draws > module.LEAST_ESS and "kappa" not in held.intervals
    assert set(aligned.law.names) - {"kappa"} <= set(held.intervals)
    # no importance weight is even enough: the sampler draws
    monkeypatch.setattr(module, "LARGEST_SHARE", 0.0)
    sampled = held_edge(aligned, "kappa", edge(0, 0.0))
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
    isotropic = held_edge(aligned, "kappa", edge(1, 1.0 / 3.0))
    assert isotropic is None or "alpha" not in isotropic.intervals


def test_no_edge_is_held_where_there_is_no_such_material(aligned):
    assert held_edge(aligned, "alpha", edge(1, 91.0)) is None


def test_the_table_keeps_all(aligned, held):
    back = held_from(held_table((held,)), aligned.quantities)
    assert back == (held,)
    k1 = aligned.quantities["k1"].parameter
    assert held.condition == "if kappa is 0 (aligned fibres)"
    assert held.in_words("k1", k1).startswith(f"that is with kappa free; {held.condition}, ")
    assert held.in_words("kappa", k1) == ""
    third = HeldEdge(held.parameter, 1.0 / 3.0, "isotropic fibres", {}, 1.0)
    assert third.condition == "if kappa is 1/3 (isotropic fibres)"


def test_a_run_says_both_readings_and_keeps_them(media_run, copied):
    run = copied(media_run.path)
    words = pd.read_csv(run / "identifiability.csv").set_index("parameter")["in_words"]
    assert "if kappa is 0 (aligned fibres)" in words["k1"]
    kept = (run / "edges.csv").read_bytes()
    verdicts = (run / "identifiability.csv").read_bytes()
    biaxbayes.identify(run, out=run, figure=False)
    assert (run / "edges.csv").read_bytes() == kept
    (run / "edges.csv").unlink()  # as in a run of an earlier version
    biaxbayes.identify(run, out=run, figure=False)
    assert (run / "identifiability.csv").read_bytes() == verdicts
    assert (run / "edges.csv").read_bytes() == kept


def test_report_and_closing_message_say_both_readings_and_other_laws(media_run):
    page = (media_run.path / "report.html").read_text()
    table = pd.read_csv(media_run.path / "edges.csv").set_index("parameter")
    k1 = media_run.quantities["k1"].parameter
    interval = f"{k1.number(table.low_90['k1'])} to {k1.number(table.high_90['k1'])}"
    assert "With a parameter at an edge of its range" in page and f">{interval}<" in page
    laws = pd.read_csv(media_run.path / "law-fits.csv")
    assert "<h3>Other laws</h3>" in page
    assert all(f'class="name">{law}<' in page for law in laws.law)
    told = closing_message(media_run)
    assert "if kappa is 0 (aligned fibres): C1 " in told and f"k1 {interval} kPa" in told
    # both mounting stretches are values, so that nobody is asked to measure them
    assert told.count("the laws that fit best agree") == 2 and "VALUE +- SD" not in told


def test_a_run_of_an_earlier_version_has_no_such_sections(media_run, copied):
    run = copied(media_run.path)
    for name in ("edges.csv", "law-fits.csv"):
        (run / name).unlink()
    page = report_page(biaxbayes.open_run(run))
    assert "Other laws" not in page and "at an edge of its range" not in page
    assert "if kappa is 0" not in closing_message(biaxbayes.open_run(run))
