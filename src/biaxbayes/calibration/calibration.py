"""Simulation-based calibration on the protocols and load noise of a specimen.

The rank of a true value, drawn from the prior, among the draws of the posterior of its simulated
readings is uniform if and only if density and sampler are right (Talts et al., arXiv:1804.06788).
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from biaxbayes.calibration.simulated_specimen import (
    draw_truth,
    local_prior,
    protocol_prior,
    simulate_specimen,
)
from biaxbayes.errors import InputError, NotConverged, RunError
from biaxbayes.fitting.fit_result import FitResult
from biaxbayes.laws.law import Law
from biaxbayes.model.draw import draw_posterior
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import prepare
from biaxbayes.model.priors import Prior, Tie, default_priors
from biaxbayes.options import CalibrationPlan, ModelOptions, Settings
from biaxbayes.sampling.sampler import Plan
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.tasks import Executor, Stop

RANKED_DRAWS = 127
"""Number of draws among which a true value is ranked; 128 possible ranks."""

MANY_PARAMETERS = 8
"""Number of parameters of a law from which replications use the ensembles of ``sample``. With the
smaller ones, 88 of 200 replications of ``four-fibre`` did not converge, and the ranks of its fibres
were not uniform."""
REPLICATION = Plan(max_steps=2_000, ensembles=2, walkers=32, population=2048, first_block=64)
"""Sampling of a replication; each is one of many."""


@dataclass(frozen=True)
class Calibration:
    """A calibration; with an index, it determines a replication."""

    specimen: Specimen  # protocols, dimensions, load noise, and the loads a misfit is relative to
    options: Mapping[str, Any]  # of the posterior, without priors
    priors: Mapping[str, Prior | float | Tie]  # of every parameter, drawn from and sampled with
    plan: Plan  # its seed is that of the calibration

    @property
    def law(self) -> Law:
        """The law that is calibrated."""
        return Settings(**self.options).material_law

    def simulated(
        self, model: Posterior, truth: Mapping[str, float], rng: np.random.Generator
    ) -> Specimen:
        """A specimen with these true values."""
        return simulate_specimen(model, truth, rng)

    def posterior(self, specimen: Specimen, seed: int = 0) -> Posterior:
        """The posterior of a simulated specimen."""
        given = {**self.options, "priors": self.priors, "misfit_fit": self.misfit_fit}
        return prepare(specimen, **given, seed=seed)

    @cached_property
    def misfit_fit(self) -> FitResult | None:
        """The fit whose loads the misfit is relative to, in simulation and inference."""
        posterior = Posterior(self.specimen, **self.options, priors=self.priors)
        return posterior.fit if posterior.settings.has_misfit else None

    def model(self) -> Posterior:
        """The statistical model that true values and readings are simulated from."""
        given = {**self.options, "priors": self.priors, "misfit_fit": self.misfit_fit}
        return Posterior(self.specimen, **given)


def planned_calibration(
    specimen: Specimen, options: Mapping[str, Any], plan: CalibrationPlan
) -> Calibration:
    """A calibration with priors for the protocols, or around the posterior of the specimen."""
    model = {name: value for name, value in options.items() if name != "priors"}
    given = dict(options["priors"])
    settings = ModelOptions.from_values(model)
    if plan.source == "posterior":
        posterior = prepare(specimen, **model, priors=given, seed=plan.seed)
        drawn = draw_posterior(posterior, Plan(seed=plan.seed))
        if drawn.convergence.state == "unusable":
            raise NotConverged(
                "the posterior of the specimen cannot be used as prior of the calibration: "
                f"{drawn.convergence.reason}"
            )
        wide = {**default_priors(specimen, posterior.settings), **given}
        priors = local_prior(drawn.quantities, wide, posterior.quantities)
    else:
        priors = {**protocol_prior(specimen, settings), **given}
    many = len(settings.material_law.parameters) >= MANY_PARAMETERS
    sampling = Plan(max_steps=4_000) if many else REPLICATION
    return Calibration(specimen, model, priors, replace(sampling, seed=plan.seed, ess=plan.ess))


def replicate(calibration: Calibration, index: int) -> list[dict[str, Any]]:
    """Draw true values, simulate, sample and rank: a row of ``ranks.csv`` for each quantity.

    Calibration and index determine all but the seconds. Where nothing could be sampled the rows
    have true values alone.
    """
    clock = time.perf_counter()
    model = calibration.model()
    rng = np.random.default_rng([calibration.plan.seed, index])
    truth, rejected = draw_truth(model, rng)
    simulated = calibration.simulated(model, truth, rng)
    seed = int(rng.integers(2**62))
    common: dict[str, Any] = {"replication": index, "rejected_draws": rejected}
    try:
        posterior = calibration.posterior(simulated, seed)
        draws = draw_posterior(posterior, replace(calibration.plan, seed=seed))
    except (NotConverged, InputError, np.linalg.LinAlgError) as error:
        common |= {"state": "failed", "reason": str(error)}
        ranked: list[dict[str, Any]] = [{"parameter": k, "truth": v} for k, v in truth.items()]
    else:
        convergence = draws.convergence
        common |= {"state": convergence.state, "reason": convergence.reason}
        common |= {"worst_ess": convergence.worst_ess, "worst_rhat": convergence.worst_rhat}
        at_truth = posterior.natural(posterior.coordinates(truth))
        truth["log_likelihood"] = float(at_truth["log_likelihood"][0])
        ranked = _ranked(draws.quantities, truth, rng)
    common["seconds"] = round(time.perf_counter() - clock, 3)
    for row in ranked:
        known = model.quantities.get(row["parameter"])
        row["unit"] = "-" if known is None else known.unit.replace("1", "-")
    return [common | row for row in ranked]


def _ranked(
    quantities: Mapping[str, np.ndarray], truth: Mapping[str, float], rng: np.random.Generator
) -> list[dict[str, Any]]:
    """The rank of each true value among some draws, and the share of all draws below it."""
    total = next(iter(quantities.values())).size
    chosen = rng.choice(total, size=min(RANKED_DRAWS, total), replace=False)
    rows = []
    for name, values in quantities.items():
        flat = values.ravel()
        if name == "lp" or not np.ptp(flat) > 1e-12 * max(abs(float(flat[0])), 1e-300):
            continue  # constants have no rank; lp differs from the likelihood by the prior only
        rows.append(
            {
                "parameter": name,
                "truth": truth[name],
                "rank": int(np.count_nonzero(flat[chosen] < truth[name])),
                "below": float(np.mean(flat < truth[name])),
                "median": float(np.median(flat)),
                "sd": float(flat.std()),
            }
        )
    return rows


def run_replications(
    calibration: Calibration, indices: Sequence[int], executor: Executor, *, stop: Stop
) -> Iterator[tuple[int, list[dict[str, Any]]]]:
    """Yield index and rows of replications as they finish; RunError if workers keep dying."""
    left, work = list(indices), partial(replicate, calibration)
    if type(executor) is not Executor and left:
        # The first runs here and fills the cache of compiled code for the workers.
        for outcome in Executor().run(work, left[:1], stop=stop):
            yield left[0], outcome.value
            left = left[1:]
    for outcome in executor.run(work, left, stop=stop):
        if outcome.failure:
            raise RunError(
                f"replication {left[outcome.index]}: {outcome.failure}; `resume=True` continues, "
                "with fewer `workers`"
            )
        yield left[outcome.index], outcome.value
