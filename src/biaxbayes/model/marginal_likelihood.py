"""The marginal likelihood of the data, from the draws of a posterior with independent errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from biaxbayes.model.posterior import Posterior
from biaxbayes.model.priors import Prior, Tie
from biaxbayes.sampling.bridge import log_integral
from biaxbayes.sampling.sampler import Draws


@dataclass(frozen=True)
class MarginalLikelihood:
    """Log marginal likelihood of the data.

    The prior is normalised over the parameters that are a material of the law (for ``fung`` b_x b_y
    > b_xy^2). Materials without a stable mounted state have density zero, and the rest is not
    renormalised.
    """

    log_evidence: float  # natural log, for data in the unit of the file
    error: float  # sd of the estimate
    # log density of the mounting reading where the model is one without prestretch (`ignored`): a
    # force of zero, read with the load cell's noise. To be added before comparing with a model
    # whose data include that reading. None where it is included already, or is unknown
    mounting_reading: float | None = None


def marginal_likelihood(posterior: Posterior, draws: Draws, *, seed: int = 0) -> MarginalLikelihood:
    """Log marginal likelihood; ValueError with a smooth misfit, or if rows are averaged."""
    problem = _reason_without(posterior)
    if problem:
        raise ValueError(problem)
    value, error = log_integral(draws.target.log_prob, draws.chain, draws.proposal, seed=seed)
    of_reading, offset = None, any(name.startswith("load_offset") for name in posterior.free)
    if posterior.settings.mounting == "ignored" and not offset:
        reading, sd = posterior.specimen.mounting_readings(shared=posterior.settings.shared)
        if (sd > 0.0).all():
            # lm = 1 carries no force: ln N(f0 | 0, s0)
            log = -0.5 * (reading / sd) ** 2 - np.log(sd) - 0.5 * np.log(2.0 * np.pi)
            of_reading = float(log.sum())
    return MarginalLikelihood(value - log_prior_mass(posterior), error, of_reading)


def log_prior_mass(posterior: Posterior) -> float:
    """Log prior probability of the law's condition on several parameters, to about 0.003."""
    law, priors = posterior.law, posterior.priors
    joint = {name: priors[name] for name in law.joint_parameters}
    if not any(isinstance(p, Prior) for p in joint.values()):
        return 0.0
    rng, values = np.random.default_rng(0), dict[str, Any](joint)
    for name, prior in joint.items():
        if isinstance(prior, Prior):
            values[name] = prior.ppf(rng.random(2**18))
    for name, tie in joint.items():
        if isinstance(tie, Tie):
            values[name] = tie.factor * values[tie.other]
    return float(np.log(np.mean(law.is_admissible(values))))


def marginal_likelihood_record(posterior: Posterior, draws: Draws, seed: int) -> dict[str, Any]:
    """The marginal likelihood as JSON values, or the reason why there is none."""
    problem = _reason_without(posterior)
    if not problem and draws.convergence.state != "converged":
        problem = "the draws have not converged"
    if problem:
        return {"log_evidence": None, "reason": problem}
    result = marginal_likelihood(posterior, draws, seed=seed)
    return {
        "log_evidence": result.log_evidence,
        "error": result.error,
        "log_density_of_mounting_reading": result.mounting_reading,
    }


def _reason_without(posterior: Posterior) -> str:
    """Why a posterior has no marginal likelihood; empty where it has one."""
    if posterior.settings.has_misfit:
        return "a smooth misfit is relative to the fit of its law, so laws could not be compared"
    if posterior.settings.max_rows:
        return "averaged rows have no marginal likelihood (--max-rows none has one)"
    return ""
