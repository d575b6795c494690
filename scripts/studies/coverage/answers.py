"""What one version of the package reports of specimen files; run as a process of its own.

Reads one line of JSON for each specimen, and answers it by another: ``file``, ``options`` of the
posterior and a ``path`` to predict. It runs under any version that has
``prepare``, ``draw_posterior`` and ``identify_draws``, whichever the Python path leads to.
"""

from __future__ import annotations

import inspect
import json
import sys
import time
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes import prepare, read_specimen
from biaxbayes.errors import BiaxbayesError
from biaxbayes.identifiability.identify import identify_draws
from biaxbayes.model.draw import draw_posterior
from biaxbayes.model.posterior import Posterior
from biaxbayes.prediction.stress import predict_stress
from biaxbayes.runs.archive import draw_table
from biaxbayes.sampling.sampler import Plan

ESS = 600
MAX_STEPS = 8000
BOUNDED = "bounded"


def answer(request: dict[str, Any]) -> dict[str, Any]:
    """Quantiles, ends that hold and verdicts of every parameter, and bands along a path."""
    clock, processor = time.perf_counter(), time.process_time()
    specimen = read_specimen(request["file"])
    posterior = prepare(specimen, **request["options"])
    drawn = draw_posterior(posterior, Plan(ess=ESS, max_steps=MAX_STEPS))
    seconds = {name: round(value, 2) for name, value in drawn.seconds.items()}
    seconds["processor, sampled"] = time.process_time() - processor
    state, draws = drawn.convergence.state, draw_table(drawn.quantities)
    found = identify_draws(posterior, draws, state)
    rows = []
    for row in found.reported:
        q05, q50, q95 = (float(v) for v in np.quantile(draws[row.name], [0.05, 0.5, 0.95]))
        # a version that reports other intervals than quantiles has them here; else the quantiles
        low, high = (float(v) for v in (row.low, row.high))
        bound = getattr(row, "bound", "")
        if not bound and row.verdict == BOUNDED:
            bound = "high" if np.isnan(low) else "low"
        rows.append(
            {
                "parameter": row.name,
                "q05": q05,
                "q50": q50,
                "q95": q95,
                "low": low,
                "high": high,
                "verdict": row.verdict,
                "bound": bound,
                "reason": row.reason,
            }
        )
    out = {
        "state": state,
        "seconds": seconds,
        "evaluations": drawn.evaluations["evaluated"],
        "rows": rows,
    }
    if request["path"] is not None:
        out["bands"] = bands(posterior, draws, np.array(request["path"]))
    seconds["processor"] = time.process_time() - processor
    seconds["wall"] = time.perf_counter() - clock
    return out


def bands(posterior: Posterior, draws: pd.DataFrame, path: np.ndarray) -> dict[str, list[float]]:
    """Ends of both bands of the nominal stress along measured stretches, by column."""
    predict: Any = predict_stress
    names = inspect.signature(predict).parameters
    known = {
        "posterior": posterior,
        "draws": draws,
        "specimen": posterior.specimen,
        "settings": posterior.settings,
    }
    given = {name: value for name, value in known.items() if name in names}
    table = predict(path=path, relative_to="mounted", stress="piola", **given)
    kept = [name for name in table if name.startswith("piola")]
    return {name: table[name].round(6).tolist() for name in kept}


def main() -> None:
    """Answer every line of the standard input."""
    for line in sys.stdin:
        try:
            found = answer(json.loads(line))
        except (BiaxbayesError, ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
            found = {"state": f"{type(error).__name__}: {error}", "seconds": {}, "rows": []}
        print(json.dumps(found), flush=True)


if __name__ == "__main__":
    main()
