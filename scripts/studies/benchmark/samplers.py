"""Samplers on the same posterior, on one core each."""

from __future__ import annotations

import time

import emcee
import numpy as np

from biaxbayes.model.draw import draw_posterior, find_start
from biaxbayes.model.marginal_likelihood import marginal_likelihood
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import with_sampling_constants
from biaxbayes.sampling.sampler import Checkpoint, Plan, restore_ensembles, start_ensembles
from biaxbayes.sampling.target import Target
from studies.benchmark.natural_density import NaturalDensity
from studies.benchmark.outcome import Outcome, judged

WALKERS = 64
ENSEMBLES = 4
CRITERION_ESS, CRITERION_RHAT = 2000.0, 1.01
SEEDS = 5
SHORT = 30.0  # seconds; plain emcee's limit up to which every seed is tried
BLOCK, MOST_BLOCKS = 16, 200  # steps of ours between two looks, and looks
BLOCK_OF_PLAIN, GROWTH = 50, 0.1
"""Steps of plain emcee between two looks: so many at first, then this part of those taken."""
JUDGED_EVERY = 10  # steps of plain emcee, whose autocorrelation times are hundreds


def ours(posterior: Posterior, *, steps: int) -> Outcome:
    """Our sampler, of several seeds the one whose rate is in the middle.

    Each goes to its own criterion, then on for a rate that is not that of a short run.
    """
    times = [_time_to_criterion(posterior, seed) for seed in range(SEEDS)]
    runs = [_beyond_criterion(posterior, seed, steps) for seed in range(SEEDS)]
    runs.sort(key=lambda outcome: outcome.rate)
    outcome = runs[SEEDS // 2]
    outcome.extra |= {
        "lowest_rate": runs[0].rate,
        "highest_rate": runs[-1].rate,
        "to_criterion": float(np.median(times)),
        "fastest": min(times),
        "slowest": max(times),
    }
    return outcome


def _beyond_criterion(posterior: Posterior, seed: int, steps: int) -> Outcome:
    """So many steps after a run that met its own criterion."""
    kept: list[Checkpoint] = []
    plan = Plan(ess=CRITERION_ESS, workers=1, seed=seed)
    first = draw_posterior(posterior, plan, on_block=kept.append)
    warmup = sum(v for k, v in first.seconds.items() if k != "sampling")
    ensembles = restore_ensembles(first.target, plan, kept[-1])
    before = first.target.counts.sum()
    clock = time.perf_counter()
    chain, log_prob = ensembles.run(steps)
    seconds = time.perf_counter() - clock
    draws = _natural(first.target, chain, log_prob)
    ess, rhat = judged(draws)
    told = None
    if posterior.settings.noise == "independent":
        integral = marginal_likelihood(posterior, first)
        told = (integral.log_evidence, integral.error)
    return Outcome(
        ess,
        int(first.target.counts.sum() - before),
        seconds,
        warmup,
        rhat,
        draws,
        "" if first.convergence.state == "converged" else first.convergence.reason,
        told,
        {"acceptance": ensembles.acceptance},
    )


def _time_to_criterion(posterior: Posterior, seed: int) -> float:
    """From the deterministic fit to R-hat and ESS on target, the judging itself left out.

    As for plain emcee below: judged by the same function after every short block.
    """
    posterior = with_sampling_constants(posterior)  # the fit is where both start
    plan = Plan(ess=CRITERION_ESS, workers=1, seed=seed)
    clock = time.perf_counter()
    target, start = find_start(posterior, plan.search_rng(), plan.population)
    ensembles, _ = start_ensembles(target, start, plan)
    spent = time.perf_counter() - clock
    blocks: list[dict[str, np.ndarray]] = []
    while len(blocks) < MOST_BLOCKS:
        clock = time.perf_counter()
        blocks.append(_natural(target, *ensembles.run(BLOCK)))
        spent += time.perf_counter() - clock
        kept = {k: np.concatenate([b[k] for b in blocks], axis=1) for k in blocks[0]}
        ess, rhat = judged(kept)
        if rhat < CRITERION_RHAT and ess >= CRITERION_ESS:
            return spent
    return np.inf


def _natural(target: Target, chain: np.ndarray, log_prob: np.ndarray) -> dict[str, np.ndarray]:
    """Draws by name."""
    natural = target.quantities(chain.reshape(-1, chain.shape[-1]), log_prob.ravel())
    others = ("lp", "log_likelihood")
    return {k: v.reshape(chain.shape[:3]) for k, v in natural.items() if k not in others}


def emcee_reseeded(density: NaturalDensity, *, limit: float) -> Outcome:
    """:func:`emcee_plain` of one seed, its time to the criterion the median over several.

    One seed is enough where it takes long and does not get there.
    """
    outcome = emcee_plain(density, limit=limit)
    times = [outcome.extra["to_criterion"]]
    if limit <= SHORT or np.isfinite(times[0]):
        rest = range(2, SEEDS + 1)
        times += [emcee_plain(density, limit=limit, seed=s).extra["to_criterion"] for s in rest]
    outcome.extra |= {
        "to_criterion": float(np.median(times)),
        "fastest": min(times),
        "slowest": max(times),
        "limit": limit,
    }
    return outcome


def emcee_plain(density: NaturalDensity, *, limit: float, seed: int = 1) -> Outcome:
    """The stretch move in natural parameters, for at most so many seconds, on the same density.

    Four ensembles of 64 walkers, all started around the deterministic fit; the first quarter of
    the steps is left out. ``to_criterion`` is the time at which R-hat and ESS met the criterion
    (infinite where they did not).
    """
    rng = np.random.default_rng(seed)
    samplers = [
        emcee.EnsembleSampler(WALKERS, len(density.names), density, vectorize=True)
        for _ in range(ENSEMBLES)
    ]
    for sampler in samplers:  # else all four would share NumPy's global stream
        sampler._random.seed(rng.integers(2**32))
    states = [density.starts(WALKERS, rng) for _ in samplers]
    spent, met, block, total = 0.0, np.inf, BLOCK_OF_PLAIN, 0
    before = density.evaluations
    while spent < limit:
        clock = time.perf_counter()
        states = [
            s.run_mcmc(x, block, skip_initial_state_check=True)
            for s, x in zip(samplers, states, strict=True)
        ]
        spent += time.perf_counter() - clock
        total += block
        block = max(BLOCK_OF_PLAIN, int(GROWTH * total))
        # The last block must not overrun the limit by much.
        block = max(1, min(block, int((limit - spent) / spent * total) + 1))
        kept = _kept(samplers, total)  # (ensembles, steps, walkers, d)
        ess, rhat = judged(density.summaries(kept))
        if rhat < CRITERION_RHAT and ess >= CRITERION_ESS:
            met = spent
            break
    share = 1.0 - total // 4 / total
    return Outcome(
        ess,
        int((density.evaluations - before) * share),
        spent * share,
        spent * (1.0 - share),
        rhat,
        density.summaries(kept),
        "" if np.isfinite(met) else "not converged",
        extra={"to_criterion": met},
    )


def _kept(samplers: list[emcee.EnsembleSampler], total: int) -> np.ndarray:
    first, every = total // 4, JUDGED_EVERY
    return np.stack([s.get_chain(discard=first, thin=every) for s in samplers])
