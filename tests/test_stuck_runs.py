"""Runs whose walkers cannot reach all of the posterior: what is written, and the exit code."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from biaxbayes.model.posterior import Posterior
from biaxbayes.sampling import sampler
from biaxbayes.sampling.ensembles import Ensembles
from biaxbayes.sampling.sampler import Plan
from biaxbayes.verbs import sample as sampling
from commands import run
from quick_posteriors import without_figures

SPECIMEN = Path(__file__).parents[1] / "data" / "donor2-adventitia.csv"
CELLS = ["mean", "sd", "q05", "q50", "q95", "ess_bulk", "ess_tail"]


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """No figures, few walkers."""
    monkeypatch.setattr(sampling, "Plan", partial(Plan, walkers=32, population=2048))
    with without_figures():
        yield


def sample(out, capsys, most=256) -> tuple[int, dict, pd.DataFrame]:
    """Exit code, provenance and summary of a run; its draws are there whatever came of it."""
    words = ("--quiet", "--workers", 1, "--ess", 400, "--max-steps", most)
    code, _, err = run(capsys, "sample", SPECIMEN, "--out", out, *words)
    assert (out / "posterior.nc").is_file()
    record = json.loads((out / "provenance.json").read_text())
    assert record["convergence"]["reason"] in err
    return code, record["convergence"], pd.read_csv(out / "summary.csv")


def with_a_wall(monkeypatch):
    """No density where the third coordinate is within most of an sd of its median.

    Two modes, both with mass; every second ensemble starts in the other one.
    """
    real, starts = Posterior.target, sampler.dispersed_starts
    place: dict[str, float] = {}

    def target(self, counts=None):
        free = real(self, counts)

        def log_prob(coordinates):
            out = free.log_prob(coordinates)
            if place:
                inside = np.abs(np.atleast_2d(coordinates)[:, 2] - place["at"]) < place["width"]
                out[inside] = -np.inf
            return out

        return replace(free, log_prob=log_prob)

    def on_two_sides(start, *, ensembles, walkers):
        population, log_weight = start.points, start.log_weight
        weight = np.exp(log_weight - log_weight.max())
        order = np.argsort(population[:, 2])
        share = np.cumsum(weight[order]) / weight.sum()
        low, at, high = population[order, 2][np.searchsorted(share, [0.16, 0.5, 0.84])]
        place.update(at=at, width=0.4 * (high - low))
        out = []
        for i in range(ensembles):
            side = (-1) ** i * (population[:, 2] - at) > place["width"]
            there = np.where(side, log_weight, -np.inf)
            out += starts(replace(start, log_weight=there), ensembles=1, walkers=walkers)
        return out

    monkeypatch.setattr(Posterior, "target", target)
    monkeypatch.setattr(sampler, "dispersed_starts", on_two_sides)


@pytest.mark.long
def test_two_modes_are_sampled_where_a_move_crosses(tmp_path, capsys, monkeypatch):
    with_a_wall(monkeypatch)
    code, convergence, _ = sample(tmp_path / "run", capsys, most=2048)
    assert code == 0 and convergence["state"] == "converged", convergence


@pytest.mark.long
def test_ensembles_that_stay_at_their_modes_make_a_run_unusable(tmp_path, capsys, monkeypatch):
    """Without the move that crosses: each ensemble alone looks converged."""
    with_a_wall(monkeypatch)
    monkeypatch.setattr(Ensembles, "set_share", lambda self, share: None)
    code, convergence, table = sample(tmp_path / "run", capsys)
    assert (code, convergence["state"]) == (3, "unusable")
    assert convergence["reason"].startswith("R-hat of ")
    assert convergence["worst_rhat"] > 1.1
    assert table[CELLS].isna().all(axis=None)
    assert (table["rhat"] > 1.1).any()
