"""What the terminal tells: progress, ledgers, few replications."""

import io
import time

import numpy as np
import pandas as pd
import pytest

from biaxbayes.figures.quantities import number, range_text
from biaxbayes.figures.run.corner import corner_figure
from biaxbayes.identifiability.identify import MOST_DRAWS
from biaxbayes.parameters import mounting_names
from biaxbayes.progress_bar import Progress, live_bar, minute_lines
from biaxbayes.verbs.calibrate import Outcome, closing_message
from biaxbayes.verbs.ledger import cell


def test_time_spent_is_not_called_time_left():
    from rich.console import Console

    def shown(share: float | None) -> str:
        out = io.StringIO()
        seconds = iter(range(0, 1000, 5))
        bar = live_bar(Console(file=out, width=120))
        bar.get_time = lambda: float(next(seconds))
        task = bar.add_task("sampling", total=None)
        for part in (0.1, 0.3, share) if share is not None else (None,):
            bar.update(task, total=None if part is None else 1.0, completed=part or 0.0)
        Console(file=out, width=120).print(bar.get_renderable())
        return out.getvalue()

    writing = shown(None)
    assert "elapsed" in writing and "%" not in writing and "left" not in writing
    halfway = shown(0.5)
    assert halfway.index("elapsed") < halfway.index("50 %")
    assert "100 %" in shown(1.0) and "left" not in shown(1.0)


def test_a_terminal_without_a_live_line_gets_a_line_each_minute(capsys):
    err = ""
    with minute_lines(every=0.01) as show:
        show(Progress("sampling", 1 / 9, note="sampled again"))
        # nothing is reported any more, and the line is repeated all the same
        deadline = time.monotonic() + 20.0
        while err.count("sampling") < 2 and time.monotonic() < deadline:
            time.sleep(0.01)
            err += capsys.readouterr().err
    lines = [line for line in err.splitlines() if line != "biaxbayes: starting, 0 min"]
    assert lines[0] == "biaxbayes: sampled again"
    assert len(lines) > 2 and set(lines[1:]) == {"biaxbayes: sampling, 11 %, 0 min"}


def test_a_minute_passes_before_the_first_line(capsys):
    with minute_lines() as show:
        show(Progress("sampling"))
    assert capsys.readouterr().err == ""


def test_intervals_of_a_ledger_are_not_rounded_to_nothing():
    row = {"inferred_q05": 1.01951, "inferred_median": 1.02004, "inferred_q95": 1.02047}
    assert cell(row, "inferred") == "1.02004 (1.01951, 1.02047)"
    row = {"inferred_q05": 13.1, "inferred_median": 14.23, "inferred_q95": 15.52}
    assert cell(row, "inferred") == "14.2 (13.1, 15.5)"


@pytest.mark.parametrize(("replications", "p"), [(4, 0.6), (200, 0.6), (200, 1e-6), (4, 1e-6)])
def test_few_replications_conclude_nothing(tmp_path, replications, p):
    row = {"parameter": "C1", "uniformity_p": p, "inside_band": "yes"}
    row |= {f"coverage_{level}": 0.5 for level in (50, 80, 90, 95)}
    outcome = Outcome(pd.DataFrame([row]), {"converged": replications}, p >= 0.05, p)
    assert f"{replications} converged" in repr(outcome) and "\n" not in repr(outcome)
    said = closing_message(tmp_path, outcome, True)
    assert ("nothing follows" in said) == (replications < 50 and p >= 0.05)
    assert ("are uniform" in said) == (replications >= 50 and p >= 0.05)
    assert ("NOT uniform" in said) == (p < 0.05)


def test_a_number_that_stands_in_two_places_is_the_same(media_run):
    summary = media_run.summary.set_index("parameter")
    assert len(media_run.draws) > MOST_DRAWS  # else the evidence would be judged by all draws
    judged = media_run.result.identifiability.set_index("parameter")
    for name, row in judged.iterrows():
        told = summary.loc[name, ["q50", "q05", "q95"]].to_numpy(dtype=float)
        numbers = row[["posterior_median", "posterior_q05", "posterior_q95"]]
        np.testing.assert_allclose(numbers.to_numpy(dtype=float), told, rtol=2e-5)
    # and in the corner of the figure, where an interval that piles up at an edge is another one
    (legend,) = corner_figure(media_run.draws, width_mm=180.0).legends
    written = " ".join(text.get_text() for text in legend.get_texts())
    for name in ("C1", "k2", *mounting_names("stretch")):
        q50, q05, q95 = summary.loc[name, ["q50", "q05", "q95"]].to_numpy(dtype=float)
        said = [
            f" {number(q50, q05, q95, log=log)} ({range_text(q05, q95, (False, False), log=log)})"
            for log in (True, False)
        ]
        assert any(text in written for text in said), name
