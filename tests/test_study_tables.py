"""Short tables of the pages and the CSV files beside them, from records made for the purpose."""

from __future__ import annotations

import json
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from studies import design, edges, intervals, verdicts
from studies.benchmark import study as run
from studies.benchmark import tables as benchmark
from studies.model_error import study as model_error
from studies.model_error import tables as coverage
from studies.page import write_table


@pytest.fixture
def docs(tmp_path):
    for folder in ("docs/figures", "docs/tables", "data"):
        (tmp_path / folder).mkdir(parents=True)
    return tmp_path / "docs"


def page_with(path, *places):
    path.write_text("".join(f"<!-- {place} -->\n<!-- /{place} -->\n" for place in places))
    return path


def test_a_long_table_has_its_link_and_keeps_printed_digits(docs):
    link = write_table(docs, "all", ["name", "printed", "value"], [["a", "1.50", 0.123456]])
    assert (docs / link).read_text() == "name,printed,value\na,1.50,0.1235\n"


def test_coverage_counts_what_intervals_hold(docs):
    groups = [*coverage.GROUPS.values(), *(group for _, group in coverage.VERDICTS)]
    data = pd.DataFrame(
        {
            "seed": seed,
            "candidate": "effective",
            "group": group,
            "inside": seed != 0,
            "width": 0.01 * (1 + seed),
            "far": seed == 3,
            "truth": "two layers" if seed < 2 else "stiff start",
            "state": "tentative" if seed == 1 else "converged",
            "cpu_s": float(seed),
        }
        for seed in range(4)
        for group in groups
    )
    found = coverage.coverage(data)
    told = found.set_index(["quantity", "part"])
    stress = "stress of the tissue at measured stretches"
    assert told.loc[(stress, ""), "share_held"] == 0.75
    assert told.loc[(stress, "two layers"), "share_held"] == 0.5
    assert told.loc[(stress, coverage.FAR_PART), "of"] == 1
    assert told.loc[(stress, ""), "median_width_percent"] == pytest.approx(2.5)
    assert told.loc[(coverage.RUNS_SHORT, ""), "count"] == 1
    page = page_with(docs / "page.md", "result", "model-error")
    model_error.write_place(page, "model-error", found, 4, 1)
    text = page.read_text()
    assert f"| {stress} | 0.75 (2.5 %) |" in text and "4 specimens, 1 of them" in text
    assert "in 75 % at measured stretches (50 to 100 % by kind of tissue)" in text
    assert "4 as a low end (75 % hold)" in text
    assert "| median processor time | 1.5 s |" in text and "- two layers" not in text
    assert len(pd.read_csv(docs / "tables" / "model-error.csv")) == len(found)
    assert (docs / "figures" / "model-error.png").exists()


def test_held_edges_by_parameter(docs):
    rows = [
        {"kappa": kappa, "seed": seed, "parameter": name, "told": kappa == 0.0, "free": seed > 0}
        | ({"held": 1.0} if kappa == 0.0 and name == "k1" else {})
        for kappa in edges.KAPPAS
        for seed in range(4)
        for name in ("k1", "kappa")
    ]
    page = page_with(docs / "page.md", "result edges", "edges")
    edges.write_place(page, edges.summary(pd.DataFrame(rows)))
    text = page.read_text()
    assert "| k1 | 0.75 | 1.00 | 0.75 |" in text and "| kappa | 0.75 | – | 0.75 |" in text
    assert "possible for 4 of kappa 0 and 0 of kappa 0.1" in text
    assert "in 75 to 75 % of specimens with kappa free, and in 100 to 100 %" in text


def test_predicted_and_sampled_reductions(docs):
    names = (*design.SHOWN, "C1")
    values = np.linspace(0.2, 0.6, len(names))
    again = design.Resampled(names, values, 0.03 + 0 * values, 7)
    expected = [
        SimpleNamespace(
            name=name, trusted=trusted, reduction=values + 0.1, error=0.04 + 0 * values,
            at_least=values - 0.1,
        )
        for name, trusted in (("1:0", True), ("0:1", False))
    ]  # fmt: skip
    beside = pd.concat([design.compared(e, names, again) for e in expected], ignore_index=True)
    page = page_with(docs / "page.md", "result design", "design media")
    design.write_place(page, "media", beside)
    text = page.read_text()
    assert "| 1:0 | 7 | 30.0, 20.0 |" in text and "| 2.0, 2.0 |" in text
    assert "of 5 spreads" in text and "within 2.0 standard errors" in text
    assert "| 0:1 | 7 | 10.0, 20.0 |" in text and "| not trusted: at least |" in text
    kept = pd.read_csv(docs / "tables" / "design-media.csv")
    assert len(kept) == 2 * len(names) and kept["predicted_at_least_percent"].notna().sum() == 5


def test_verdicts_on_specimens_of_known_answer(docs):
    def seeds(kind, name):
        richest = kind == next(iter(verdicts.KINDS))
        return Counter({"identified": 3} if richest else {"one-sided (0)": 2, "prior-dominated": 1})

    counts = {
        kind: {name: seeds(kind, name) for name in verdicts.PARAMETERS} for kind in verdicts.KINDS
    }
    counts["equibiaxial to 1.2"]["C1"] = Counter({"prior-dominated": 1, "identified": 2})
    page = page_with(docs / "page.md", "result verdicts", "verdicts")
    verdicts.write_place(page, counts)
    text = page.read_text()
    assert "C1, k1, k2, alpha, kappa are identified on all of 3 seeds" in text
    assert "equibiaxial to 1.2, k1, k2, alpha, kappa on none." in text
    assert "| equibiaxial to 1.2 | identified 2, prior-dominated 1 | one-sided (0) 2, " in text


def test_intervals_beside_the_truth(docs):
    shipped = pd.DataFrame(
        {
            "specimen": "donor1", "noise": noise, "parameter": name, "truth": 1.0, "low": 0.9,
            "high": 1.1, "held": "no" if name == "k1" else "yes", "state": "converged",
            "rhat": 1.00041, "ess": 20703,
        }
        for noise in intervals.NOISES
        for name in intervals.PARAMETERS
    )  # fmt: skip
    found = {
        (intervals.PRINTED, name, noise, seed): {p: float(seed == 0) for p in intervals.PARAMETERS}
        for name in intervals.SPECIMENS
        for noise in intervals.NOISES
        for seed in range(4)
    }
    found[intervals.PRINTED, "donor1", "effective", 3] = None
    shares = intervals.printed_shares(found)
    page = page_with(docs.parent / "data" / "README.md", "result", "intervals")
    shipped.loc[shipped["parameter"] == "kappa", "truth"] = 0.0
    intervals.write_place(page, shipped, shares, "Drawn ones.")
    text = page.read_text()
    assert "| donor1 | 6 of 7 | k1 | 6 of 7 | k1 |" in text
    assert "of 6 true values 90 % intervals hold 5 with `--noise effective` and 5 with" in text
    assert "where 5 would be" in text and "(1 more are ends of their ranges" in text
    row = next(line for line in text.splitlines() if line.startswith("| effective | 0.26 |"))
    assert row.split(" | ")[5] == "0.25"  # donor1, one seed short, has a kappa of 0
    assert "| independent | 0.25 |" in text
    assert "../docs/tables/shipped-intervals.csv" in text and "Drawn ones." in text
    assert "1.0004,20703" in (docs / "tables" / "shipped-intervals.csv").read_text()


def outcome(**more):
    told = {"ess": 4000.0, "evaluations": 20_000, "rate": 4000.0, "rate_with_warmup": 2000.0}
    times = {"to_criterion": 1.0, "fastest": 0.5, "slowest": 2.0, "limit": 20.0}
    times |= {"lowest_rate": 3000.0, "highest_rate": 5000.0}
    return told | times | {"rhat": 1.002, "note": "3 divergences", "log_evidence": None} | more


def test_the_benchmark_says_what_was_not_reached(docs):
    never = dict.fromkeys(("to_criterion", "fastest", "slowest"), np.inf)
    compared = {"count": 24, "rms": 1.0, "largest": -2.0, "where": "k1 5 %"}
    case = {
        "specimen": "donor1",
        "noise": "independent",
        "ours": outcome(log_evidence=(698.975, 0.003)),
        "emcee": outcome(rate=10.0, rhat=1.02, **never),
        "NUTS": outcome(),
        "dynesty": outcome(rate_with_warmup=20.0, log_evidence=(688.801, 0.395)),
        "straightened": outcome(),
        "nautilus": outcome(note="", log_evidence=(698.974, 0.004)),
        "agreement": dict.fromkeys(("NUTS", "straightened", "nautilus"), compared),
        "lab_script_seconds": 1e-4,
        "pymecht_seconds": 6e-3,
    }
    benchmark.write_page({"cases": [case]}, docs / "benchmark.md")
    text = (docs / "benchmark.md").read_text()
    assert "| 4,000 (3,000 to 5,000) | 10.0 | 400 | 1.00 (0.50 to 2.00) | not in 20 |" in text
    assert "400 times (independent noise)" in text and "density | 100 | 100 |" in text
    assert "| 698.975 ± 0.003 | -0.001 ± 0.005 | -10.174 ± 0.395 |" in text
    assert "NUTS has not converged on 0 of 1" in text and "errors on 1 of 1" in text
    kept = pd.read_csv(docs / "tables" / "benchmark-samplers.csv").iloc[0]
    assert np.isnan(kept["emcee_converged_s"]) and kept["ours_over_emcee"] == 400.0
    plain = {key: case[key] for key in ("specimen", "noise", "ours", "emcee")}
    benchmark.write_page({"cases": [plain]}, docs / "benchmark.md")
    assert "## Agreement" not in (docs / "benchmark.md").read_text()


def test_the_benchmark_goes_on_with_the_posteriors_it_has(tmp_path):
    path, asked = tmp_path / "plain.json", {"quick": False, "which": "plain"}
    assert run.cases_of(path, asked) == []
    cases = [{"specimen": "donor1", "noise": "effective"}]
    path.write_text(json.dumps({**asked, "cases": cases}))
    assert run.cases_of(path, asked) == cases
    assert run.cases_of(path, asked | {"which": "others"}) == []
    assert run.cases_of(path, asked | {"quick": True}) == []


def test_what_an_evaluation_and_whole_commands_cost(docs):
    found = {
        "cases": [],
        "density": {"rows": 101, "evaluation": 2e-6, "exponentials": 1e-6},
        "by_points": {"50": 1.5e-6, "1000": 4e-6},
        "by_walkers": {"16": 2.25e-6},
        "by_law": {"goh": 2e-6, "fung": 1.6e-6, "four-fibre": 3e-6},
        "commands": [
            {"text": "sample", "seconds": 9.4, "parts": {"warm-up": 2.8}, "peak_MB": 483},
            {"text": "report", "seconds": 1.9, "parts": {}, "peak_MB": 283},
        ],
    }
    text = benchmark.page(found)
    assert "1.50 us with 50, 4.00 us with 1,000." in text and "2.25 us with 16." in text
    assert "Laws, times `goh`: `fung` 0.80, `four-fibre` 1.50." in text
    assert "| total, s | 9.4 | 1.9 |" in text and "| warm-up, s | 2.8 |  |" in text
    assert "| peak memory, MB | 483 | 283 |" in text
