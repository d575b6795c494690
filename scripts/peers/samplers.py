"""Samplers on the same posterior, on one core each."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable

import emcee
import numpy as np
from scipy.special import ndtr, ndtri

from biaxbayes.inference.evidence import evidence
from biaxbayes.inference.posterior import Posterior
from biaxbayes.inference.sampler import Plan, State, draw, ensembles_at
from peers.natural_density import NAMES, NaturalDensity, summaries
from peers.outcome import Outcome, judged

__all__ = ["emcee_plain", "nested", "ours"]

WALKERS = 64
ENSEMBLES = 4
CRITERION_ESS, CRITERION_RHAT = 2000.0, 1.01
JUDGED_EVERY = 10  # steps of plain emcee, whose autocorrelation times are hundreds
NESTED_ESS = 10_000


def ours(posterior: Posterior, *, steps: int) -> Outcome:
    """Our sampler: to its own criterion, then on for a rate that is not that of a short run."""
    kept: list[State] = []
    plan = Plan(ess=CRITERION_ESS, workers=1)
    clock = time.perf_counter()
    first = draw(posterior, plan, on_block=kept.append)
    to_criterion = time.perf_counter() - clock
    warmup = sum(v for k, v in first.seconds.items() if k != "sampling")
    ensembles = ensembles_at(posterior, plan, kept[-1])
    before = ensembles.evaluations
    clock = time.perf_counter()
    chain, _ = ensembles.run(steps)
    seconds = time.perf_counter() - clock
    natural = posterior.natural(chain.reshape(-1, chain.shape[-1]))
    draws = {k: v.reshape(chain.shape[:3]) for k, v in natural.items() if k in NAMES}
    draws["alpha"] = np.deg2rad(draws["alpha"])
    ess, rhat = judged(draws)
    told = None
    if posterior.settings.noise == "independent":
        integral = evidence(posterior, first)
        told = (integral.log_evidence, integral.error)
    return Outcome(
        ess,
        ensembles.evaluations - before,
        seconds,
        warmup,
        rhat,
        draws,
        "" if first.convergence.state == "reliable" else first.convergence.reason,
        told,
        {"to_criterion": to_criterion, "acceptance": ensembles.acceptance},
    )


def emcee_plain(density: NaturalDensity, *, limit: float, seed: int = 1) -> Outcome:
    """The stretch move in natural parameters, for at most so many seconds, on the same density.

    Four ensembles of 64 walkers, all started around the deterministic fit; the first quarter of
    the steps is left out. ``to_criterion`` is the time at which R-hat and ESS met the criterion
    (infinite where they did not).
    """
    rng = np.random.default_rng(seed)
    samplers = [
        emcee.EnsembleSampler(WALKERS, len(NAMES), density, vectorize=True)
        for _ in range(ENSEMBLES)
    ]
    states = [density.starts(WALKERS, rng) for _ in samplers]
    spent, met, block, total = 0.0, np.inf, 250, 0
    before = density.evaluations
    while spent < limit:
        clock = time.perf_counter()
        states = [
            s.run_mcmc(x, block, skip_initial_state_check=True)
            for s, x in zip(samplers, states, strict=True)
        ]
        spent += time.perf_counter() - clock
        total += block
        block = int(total * 0.5) + 1
        # The last block must not overrun the limit by much.
        block = max(1, min(block, int((limit - spent) / spent * total) + 1))
        kept = _kept(samplers, total)  # (ensembles, steps, walkers, 8)
        ess, rhat = judged(summaries(kept))
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
        summaries(kept),
        "" if np.isfinite(met) else "not converged",
        extra={"to_criterion": met},
    )


def _kept(samplers: list[emcee.EnsembleSampler], total: int) -> np.ndarray:
    first, every = total // 4, JUDGED_EVERY
    return np.stack([s.get_chain(discard=first, thin=every) for s in samplers])


def nested(density: NaturalDensity, *, live: int, limit: float, seed: int = 1) -> Outcome:
    """Nautilus with the vectorised density, for at most so many seconds; draws are weighted."""
    import nautilus

    transform, log_prior = _prior_cube(density)
    rows: list[np.ndarray] = []

    def log_likelihood(cube: np.ndarray) -> np.ndarray:
        x = transform(np.atleast_2d(cube))
        return np.maximum(density(x) - log_prior(x), -1e300)

    clock = time.perf_counter()
    before = density.evaluations
    sampler = nautilus.Sampler(
        lambda cube: cube,
        log_likelihood,
        n_dim=len(NAMES),
        n_live=live,
        vectorized=True,
        pass_dict=False,
        seed=seed,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        finished = sampler.run(n_eff=NESTED_ESS, timeout=limit, verbose=False)
    seconds = time.perf_counter() - clock
    points, log_weight, _ = sampler.posterior()
    rows.append(transform(points))
    weight = np.exp(log_weight - log_weight.max())
    # Kish's effective sample size, the one that nautilus reports
    ess = float(weight.sum() ** 2 / (weight**2).sum())
    draws = summaries(rows[0]) | {"weight": weight}
    error = 1.0 / np.sqrt(ess)
    return Outcome(
        ess,
        density.evaluations - before,
        seconds,
        0.0,
        float("nan"),
        draws,
        "" if finished else "not finished",
        (float(sampler.log_z), float(error)) if finished else None,
    )


def _prior_cube(density: NaturalDensity) -> tuple[Callable, Callable]:
    """From the unit cube to the prior, and the prior's log density."""
    priors = density.posterior.priors
    logs = [NAMES.index(n) for n in ("C1", "k1", "k2", "noise_sd")]
    centre = np.log([priors[NAMES[i]].location for i in logs])  # type: ignore[union-attr]
    scale = np.array([priors[NAMES[i]].scale for i in logs])  # type: ignore[union-attr]
    stretch = priors["mounting_stretch_x"]
    below = float(ndtr((0.0 - stretch.location) / stretch.scale))  # type: ignore[union-attr]

    def transform(cube: np.ndarray) -> np.ndarray:
        x = np.empty_like(cube)
        x[:, logs] = np.exp(centre + scale * ndtri(cube[:, logs]))
        x[:, 3] = 0.5 * np.pi * cube[:, 3]
        x[:, 4] = cube[:, 4] / 3.0
        for i in (5, 6):
            u = below + (1.0 - below) * cube[:, i]
            x[:, i] = stretch.location + stretch.scale * ndtri(u)  # type: ignore[union-attr]
        return x

    half_log_2pi = 0.5 * np.log(2.0 * np.pi)

    def log_prior(x: np.ndarray) -> np.ndarray:
        z = (np.log(x[:, logs]) - centre) / scale
        out = -(0.5 * z * z + np.log(scale) + half_log_2pi).sum(axis=1)
        out -= np.log(x[:, logs]).sum(axis=1)
        out += np.log(2.0 / np.pi) + np.log(3.0)
        for i in (5, 6):
            z = (x[:, i] - stretch.location) / stretch.scale  # type: ignore[union-attr]
            out -= 0.5 * z * z + np.log(stretch.scale) + half_log_2pi + np.log1p(-below)  # type: ignore[union-attr]
        return out

    return transform, log_prior
