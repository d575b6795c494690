"""Ranking of further measurements by how much they would narrow the posterior."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.errors import InputError, RunError, listed
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import with_sampling_constants
from biaxbayes.optimal_design.candidates import Candidate, FurtherProtocol, standard_candidates
from biaxbayes.optimal_design.information_gain import OUTCOMES, Expected, design_quantities, expect
from biaxbayes.parallel import InThisProcess
from biaxbayes.parameters import Quantities
from biaxbayes.prediction.percentiles import evenly_chosen
from biaxbayes.sampling.sampler import Progress
from biaxbayes.tasks import Executor

BEYOND_TESTED = 1.2
"""Ratio of a planned load to the largest tested one above which a caution is given."""
WORTH_NAMING = 0.1
"""Expected reduction of an sd from which the conclusion names it."""
PEAK_DRAWS = 4000
"""Number of draws for the largest load."""


@dataclass(frozen=True)
class PeakLoad:
    """Largest load of a planned protocol, and the largest tested one.

    Attributes
    ----------
    low, high : float
        5 and 95 % quantile over the draws.
    tested : float
        Largest load of the record.
    unit : str
        N or kPa.
    """

    low: float
    high: float
    tested: float
    unit: str

    @property
    def caution(self) -> str:
        """Text if the load is beyond the tested ones; otherwise empty."""
        if not self.high > BEYOND_TESTED * self.tested:
            return ""
        return (
            f"needs up to {self.high:.3g} {self.unit} where {self.tested:.3g} {self.unit} were "
            "tested: the tissue may be damaged or rupture before"
        )


@dataclass(frozen=True)
class Design:
    """Candidates in the order of their rank.

    Attributes
    ----------
    skipped : tuple of str
        Candidates whose loads overflow for some draws.
    candidates : tuple
        In the order of ``expected``.
    known : Quantities
        Symbol, unit and range of the parameters.
    peaks : tuple of (PeakLoad or None)
        Of the candidates that load the specimen, in the order of ``expected``.
    """

    quantities: tuple[str, ...]
    expected: tuple[Expected, ...]
    skipped: tuple[str, ...]
    candidates: tuple[Any, ...]
    known: Quantities
    peaks: tuple[PeakLoad | None, ...]

    def cautions(self) -> dict[str, str]:
        """Cautions by the name of candidates that load the specimen beyond the tested range."""
        pairs = zip(self.expected, self.peaks, strict=True)
        return {e.name: p.caution for e, p in pairs if p is not None and p.caution}

    @property
    def conclusion(self) -> str:
        """Sentence on what to measure next."""
        trusted = [e for e in self.expected if e.trusted]
        if not trusted:
            return "no candidate can be recommended: too few draws are left for their outcomes"
        best, material = trusted[0], {p.name for p in self.known.material}
        reductions = [
            (float(share), name)
            for share, name in zip(best.reduction, self.quantities, strict=True)
            if name in material and share >= WORTH_NAMING
        ]
        if not reductions:
            return (
                f"no candidate narrows a material parameter by {100 * WORTH_NAMING:.0f} % or more; "
                f"the best is {best.name}"
            )
        named = listed([f"{n} by {100 * s:.0f} %" for s, n in sorted(reductions)[::-1]])
        caution = self.cautions().get(best.name)
        more = f", but it {caution}" if caution else ""
        return f"measure next: {best.name}. Expected reduction of the sd: {named}{more}"

    def to_frame(self) -> pd.DataFrame:
        """One row per candidate and quantity."""
        rows = []
        for rank, (e, p) in enumerate(zip(self.expected, self.peaks, strict=True), start=1):
            head = {
                "rank": rank,
                "candidate": e.name,
                "information_gain_nats": e.gain,
                "information_gain_error": e.gain_error,
                "effective_draws": e.effective,
                "share_of_outcomes_below_20_draws": e.untrusted,
                "trusted": e.trusted,
            }
            for i, name in enumerate(self.quantities):
                rows.append(
                    head
                    | {
                        "quantity": name,
                        "expected_reduction_of_sd": e.reduction[i],
                        "error": e.error[i],
                        "at_least": e.at_least[i],
                        "peak_load_q05": np.nan if p is None else p.low,
                        "peak_load_q95": np.nan if p is None else p.high,
                        "largest_tested_load": np.nan if p is None else p.tested,
                        "load_unit": "" if p is None else p.unit,
                        "caution": "" if p is None else p.caution,
                    }
                )
        return pd.DataFrame(rows)

    def __repr__(self) -> str:
        best = f"; best {self.expected[0].name!r}" if self.expected else ""
        return f"Design({len(self.expected)} candidates ranked{best})"

    def _repr_html_(self) -> str:
        """Expected reduction of each standard deviation, for notebooks."""
        wide = pd.DataFrame(
            [dict(zip(self.quantities, e.reduction, strict=True)) for e in self.expected],
            index=[e.name + ("" if e.trusted else " *") for e in self.expected],
        )
        wide.insert(0, "information (nats)", [e.gain for e in self.expected])
        return wide.to_html(float_format=lambda v: f"{v:.2f}")


def design(
    posterior: Posterior,
    draws: pd.DataFrame,
    candidates: Sequence[Candidate] | None = None,
    *,
    rank_by: str = "parameters",
    seed: int = 1,
    outcomes: int = OUTCOMES,
    executor: Executor | None = None,
    progress: Callable[[Progress], None] = lambda p: None,
) -> Design:
    """Rank candidate measurements by their expected benefit.

    Parameters
    ----------
    draws : DataFrame
        Draws of the posterior, as in ``run.draws``.
    candidates : sequence of Candidate, optional
        Default :func:`~biaxbayes.optimal_design.candidates.standard_candidates`.
    rank_by : str
        ``parameters`` (mean reduction over the free material parameters), ``information``, or
        the name of the quantity whose sd is to be reduced most.
    outcomes : int
        Simulated outcomes of each candidate.
    executor : Executor, optional
        Default this process. The result does not depend on it.
    progress : callable
        Called with the fraction of finished candidates.

    Raises
    ------
    InputError
        If ``rank_by`` is not a quantity.
    """
    chosen = list(standard_candidates(posterior, draws) if candidates is None else candidates)
    quantities = {
        name: v for name, v in design_quantities(posterior, draws).items() if np.ptp(v) > 0.0
    }
    if rank_by not in ("parameters", "information", *quantities):
        raise InputError(
            f"`rank_by` {rank_by[:60]!r} is not a quantity of this run",
            remedy=f"one of parameters, information, {', '.join(quantities)}",
        )
    work = partial(
        _expect_one,
        draws=draws,
        quantities=quantities,
        outcomes=outcomes,
        posterior=with_sampling_constants(posterior),
    )
    tasks = [(candidate, [seed, number]) for number, candidate in enumerate(chosen)]
    expected: list[Expected | None] = [None] * len(tasks)
    progress(Progress("simulating outcomes"))
    for done, outcome in enumerate((executor or InThisProcess()).run(work, tasks), start=1):
        if outcome.failure:
            raise RunError(f"candidate {chosen[outcome.index].name}: {outcome.failure}")
        expected[outcome.index] = outcome.value
        progress(Progress("simulating outcomes", done / len(tasks)))

    names = tuple(quantities)
    wanted = [n in posterior.law.names if rank_by == "parameters" else n == rank_by for n in names]

    def rank(pair: tuple[Expected, Any]) -> float:
        expected = pair[0]
        # with all material parameters fixed, rank by information
        return -float(expected.reduction[wanted].mean() if any(wanted) else expected.gain)

    pairs = list(zip(expected, chosen, strict=True))
    ranked = sorted([(e, c) for e, c in pairs if e is not None], key=rank)
    thinned = draws.iloc[evenly_chosen(len(draws), PEAK_DRAWS)]
    specimen = posterior.specimen
    peaks = [
        PeakLoad(*c.peak_load(thinned), specimen.peak_load, specimen.unit)
        if isinstance(c, FurtherProtocol) and c.loads_as_tested
        else None
        for _, c in ranked
    ]
    return Design(
        names,
        tuple(e for e, _ in ranked),
        tuple(c.name for e, c in pairs if e is None),
        tuple(c for _, c in ranked),
        posterior.quantities,
        tuple(peaks),
    )


def _expect_one(
    task: tuple[Candidate, list[int]],
    *,
    draws: pd.DataFrame,
    quantities: dict[str, np.ndarray],
    outcomes: int,
    posterior: Posterior,
) -> Expected | None:
    candidate, seed = task
    rng = np.random.default_rng(seed)
    return expect(candidate, draws, quantities, rng, outcomes=outcomes, posterior=posterior)
