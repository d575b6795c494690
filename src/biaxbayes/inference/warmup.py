"""Warm-up: from a deterministic fit to ensembles with a frozen, well-fitting proposal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from biaxbayes.errors import NotConverged
from biaxbayes.inference.coordinates import ANGULAR, SHEAR, softening_of
from biaxbayes.inference.covering import cover
from biaxbayes.inference.ensembles import DE_SHARE, POOR_ACCEPTANCE, Ensembles
from biaxbayes.inference.mode import local_mode
from biaxbayes.inference.posterior import Posterior
from biaxbayes.inference.priors import Prior
from biaxbayes.inference.proposal import Proposal, edge_array, first_proposal, fit_proposal

__all__ = ["WarmUp", "dispersed_starts", "search", "tempered_points", "warm_up"]

ROUND_STEPS = 16
FINAL_COMPONENTS = 12
SEARCH_COMPONENTS = 6
COVERING_ROUNDS = 2
STICKY = 3.0  # log weight above the median at which differential evolution gets half the steps
MAX_ROUNDS = 8
ENOUGH = 0.65  # acceptance at which more adaptation buys little
RISE = 0.02  # smallest rise of acceptance that is worth another round

POPULATION = 4096
MAX_GENERATIONS = 24
TARGET_SHARE = 0.4  # effective share of a generation at which the proposal fits well enough
TEMPERED_SHARE = 0.15  # effective share that each tempered generation keeps


@dataclass(frozen=True)
class WarmUp:
    """What the warm-up found.

    Attributes
    ----------
    rounds : int
        Adaptation rounds.
    acceptance : float
        Acceptance of the independence move in the last round.
    message : str
        Empty, or what the user should know.
    """

    rounds: int
    acceptance: float
    message: str


def search(
    posterior: Posterior, rng: np.random.Generator, population: int = POPULATION
) -> tuple[Proposal, np.ndarray, np.ndarray]:
    """Find the posterior by population Monte Carlo (Cappe et al., J. Comput. Graph. Stat. 2004).

    A population is drawn from a proposal, weighted by density over proposal, and the next
    proposal is fitted to it. The first one is much wider than the posterior, so the weights
    are tempered: raised to the largest power that keeps a share of the population effective.
    Thousands of points at once cost the compiled density a few milliseconds; walkers would need
    hundreds of steps to come as far.

    Returns
    -------
    proposal : Proposal
    population : ndarray, shape (n, d)
    log_weight : ndarray, shape (n,)
        Of the last generation.
    """
    edges = edge_array(posterior.edges, posterior.dimension)
    proposal = _first_proposal(posterior, edges)
    best_share, stalled = 0.0, 0
    for _ in range(MAX_GENERATIONS):
        u = proposal.sample(rng, population)
        log_prob = posterior.log_prob(u)
        inside = np.isfinite(log_prob)
        log_weight = np.full(len(u), -np.inf)
        log_weight[inside] = log_prob[inside] - proposal.log_density(u[inside])
        if not np.isfinite(log_weight).any():
            raise NotConverged("no region of positive density around the deterministic fit")
        power = _tempering(log_weight)
        share = effective_share(log_weight)
        if power == 1.0:
            stalled = 0 if share > best_share + 0.02 else stalled + 1
            best_share = max(share, best_share)
            if share > TARGET_SHARE or stalled >= 2:
                break
        chosen = _resample(power * log_weight, population // 2, rng)
        with threadpool_limits(1, user_api="blas"):
            proposal = fit_proposal(u[chosen], rng, edges=edges, components=SEARCH_COMPONENTS)
    return _recharted(posterior, u, log_weight, rng) or (proposal, u, log_weight)


def _recharted(
    posterior: Posterior, u: np.ndarray, log_weight: np.ndarray, rng: np.random.Generator
) -> tuple[Proposal, np.ndarray, np.ndarray] | None:
    """Move to a chart softened for the posterior, where the fit's own does not suit it."""
    if posterior.chart != SHEAR:
        return None
    half = len(u) // 2
    chosen = _resample(log_weight, half, rng)
    natural = posterior.natural(u[np.isfinite(log_weight)])
    typical = posterior.natural(u[chosen])
    softening = softening_of(np.deg2rad(typical["alpha"]), typical["kappa"])
    if 0.5 < softening / posterior.softening < 2.0:
        return None
    # Weights are ratios of densities in the same coordinates: they carry over.
    weights = log_weight[np.isfinite(log_weight)]
    posterior.use_softening(softening)
    u = posterior.coordinates(natural)
    edges = edge_array(posterior.edges, posterior.dimension)
    picked = u[_resample(weights, half, rng)]
    with threadpool_limits(1, user_api="blas"):
        return fit_proposal(picked, rng, edges=edges, components=SEARCH_COMPONENTS), u, weights


def effective_share(log_weight: np.ndarray) -> float:
    """Effective share (sum w)^2 / (n sum w^2) of an importance sample."""
    w = np.exp(log_weight - log_weight.max())
    return float(w.sum() ** 2 / (w.size * (w * w).sum()))


def _tempering(log_weight: np.ndarray) -> float:
    """Largest power of the weights, at most one, that keeps a share of them effective."""
    if effective_share(log_weight) >= TEMPERED_SHARE:
        return 1.0
    low, high = 0.0, 1.0
    finite = log_weight[np.isfinite(log_weight)]
    needed = min(TEMPERED_SHARE, 0.5 * finite.size / log_weight.size)
    for _ in range(40):
        power = 0.5 * (low + high)
        share = effective_share(power * finite) * finite.size / log_weight.size
        low, high = (power, high) if share >= needed else (low, power)
    return low


def _resample(log_weight: np.ndarray, size: int, rng: np.random.Generator) -> np.ndarray:
    """Indices drawn in proportion to the weights (systematic resampling)."""
    w = np.exp(log_weight - log_weight.max())
    edges = np.cumsum(w) / w.sum()
    return np.minimum(np.searchsorted(edges, (np.arange(size) + rng.random()) / size), w.size - 1)


def _first_proposal(posterior: Posterior, edges: np.ndarray) -> Proposal:
    """Student t distributions around the deterministic fit and the local mode above it.

    Two have the local curvature, three are nested and wide, in case the mode is not all.
    """
    centre = posterior.coordinates(start_parameters(posterior))[0]
    scale = _spread(posterior)
    mode, factor = local_mode(posterior.log_prob, centre, scale, edges)
    # The mounting force is pinned by its reading, however wide the rest.
    pinned = np.array([n.startswith("mounting_force") for n in posterior.free])
    wide = [np.diag(scale * np.where(pinned, 1.0, width)) for width in (0.3, 1.0, 3.0)]
    return first_proposal(
        np.array([mode, mode, mode, centre, centre]),
        [factor, 2.0 * factor, *wide],
        np.array([0.4, 0.3, 0.1, 0.1, 0.1]),
        edges,
    )


def tempered_points(
    population: np.ndarray, log_weight: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Points of a population drawn by the square root of their weights, shape (n, d)."""
    return population[_resample(0.5 * log_weight, len(population) // 2, rng)]


def dispersed_starts(
    population: np.ndarray,
    log_weight: np.ndarray,
    rng: np.random.Generator,
    *,
    ensembles: int,
    walkers: int,
) -> list[np.ndarray]:
    """Starts of independent ensembles, spread wider than the posterior.

    Drawn from a population by the square root of its weights: about twice the posterior's
    variance.

    Returns
    -------
    list of ndarray, shape (walkers, d)
    """
    starts = []
    for _ in range(ensembles):
        # Without replacement (Gumbel keys), so that the walkers are distinct.
        keys = 0.5 * log_weight + rng.gumbel(size=log_weight.size)
        keys[~np.isfinite(log_weight)] = -np.inf
        starts.append(population[np.argsort(keys)[::-1][:walkers]])
    return starts


def start_parameters(posterior: Posterior) -> dict[str, float]:
    """Natural parameters of the deterministic fit, moved off the edges of their ranges."""
    fit = posterior.start
    specimen = posterior.specimen
    rms = float(np.sqrt(np.mean(np.concatenate(fit.residuals) ** 2)))
    out: dict[str, float] = {
        "C1": max(fit.material.C1_kPa, 1e-3),
        "k1": max(fit.material.k1_kPa, 1e-3),
        "k2": max(fit.material.k2, 1e-2),
        "alpha": float(np.clip(fit.material.alpha_deg, 3.0, 87.0)),
        "kappa": float(np.clip(fit.material.kappa, 0.01, 0.32)),
        "noise_sd": max(rms, 1e-6 * specimen.peak_load),
        "noise_growth": 0.03,
    }
    for name in posterior.free:
        if name.startswith("mounting_"):
            label = name[name.index("[") + 1 : -1] if "[" in name else ""
            m = posterior.mounts.index(label)
            values = fit.mounting_stretch if "stretch" in name else fit.mounting_load
            out[name] = float(values[m][0 if "_x" in name[:20] else 1])
        elif name not in out:
            out[name] = 0.0 if name.startswith("load_offset") else 1.0
    for name, prior in posterior.priors.items():
        if name in out and isinstance(prior, Prior):
            low, high = prior.low, prior.high
            if not low < out[name] < high:
                span = (high - low) if np.isfinite(high - low) else max(abs(low), 1.0)
                out[name] = float(np.clip(out[name], low + 0.01 * span, high - 0.01 * span))
    return out


def _spread(posterior: Posterior) -> np.ndarray:
    """Width of the dispersed starts in each sampling coordinate."""
    _, sd = posterior.specimen.mounting_readings(
        shared=posterior.settings.mounting_stretch == "shared"
    )
    widths = {"C1": 0.4, "k1": 0.4, "k2": 0.5, "alpha": 0.3, "kappa": 0.3, "noise_sd": 0.3}
    if posterior.chart == ANGULAR:
        widths |= {"alpha": 0.3, "kappa": 0.06}
    out = []
    for name in posterior.free:
        if name.startswith("mounting_force"):
            k = 0 if "_x" in name else 1
            out.append(float(np.mean(sd[:, k])))
        elif name.startswith("mounting_stretch"):
            out.append(0.005)
        elif name in widths:
            out.append(widths[name])
        else:
            prior = posterior.priors[name]
            assert isinstance(prior, Prior)
            out.append(0.5 * prior.scale)
    return np.array(out)


def warm_up(
    ensembles: Ensembles,
    proposal: Proposal,
    spread: np.ndarray,
    *,
    progress: Callable[[str], None] = lambda text: None,
) -> WarmUp:
    """Let the ensembles forget their starts, adapt the proposal to their history and freeze it.

    Rounds of steps alternate with fits of the proposal to the newest pooled history, until the
    acceptance stops rising. Differential evolution stays in the mix throughout.

    Parameters
    ----------
    ensembles : Ensembles
    proposal : Proposal
        A first proposal.
    spread : ndarray, shape (n, d)
        Points spread wider than the posterior (:func:`tempered_points`). They make up a fifth
        of what the final proposal is fitted to, so that it reaches into tails where walkers
        were not yet: a proposal too narrow there would hold a walker for long.
    progress : callable
        Called with a short text at each round.
    """
    ensembles.proposal = proposal
    ensembles.set_share(0.7)
    best, stalled, rounds = -1.0, 0, 0
    recent: list[np.ndarray] = []
    recent_log_prob: list[np.ndarray] = []
    for rounds in range(1, MAX_ROUNDS + 1):
        ensembles.reset_counts()
        chain, log_prob = ensembles.run(ROUND_STEPS)
        acceptance = ensembles.acceptance
        progress(f"adapting, acceptance {acceptance:.2f}")
        history = chain[:, ROUND_STEPS // 4 :].reshape(-1, chain.shape[-1])
        recent = [*recent[-2:], history]
        recent_log_prob = [*recent_log_prob[-2:], log_prob[:, ROUND_STEPS // 4 :].ravel()]
        stalled = 0 if acceptance > best + RISE else stalled + 1
        best = max(best, acceptance)
        if rounds > 1 and (acceptance > ENOUGH or stalled >= 2):
            break
        ensembles.adapt(history)
    # The proposal that is kept: more components, from the last rounds together.
    points, log_prob = np.concatenate(recent), np.concatenate(recent_log_prob)
    count = min(len(spread), len(points) // 4)
    chosen = ensembles.rng.choice(len(spread), count, replace=False)
    ensembles.adapt(np.concatenate([points, spread[chosen]]), components=FINAL_COMPONENTS)
    assert ensembles.proposal is not None
    ensembles.proposal = _covered(ensembles, ensembles.proposal, points, log_prob, 2 * len(spread))
    ensembles.reset_counts()
    chain, log_prob = ensembles.run(ROUND_STEPS)
    best = ensembles.acceptance
    share, message = _final_share(ensembles, chain, log_prob, best)
    ensembles.set_share(share)
    ensembles.freeze()
    return WarmUp(rounds, best, message)


def _final_share(
    ensembles: Ensembles, chain: np.ndarray, log_prob: np.ndarray, acceptance: float
) -> tuple[float, str]:
    """Share of independence steps that suits the proposal, and what to tell the user."""
    if acceptance < POOR_ACCEPTANCE:
        return 0.1, (
            f"the adapted proposal fits poorly (acceptance {acceptance:.3f}); "
            "sampling falls back on differential evolution, which takes longer"
        )
    assert ensembles.proposal is not None
    points = chain.reshape(-1, chain.shape[-1])
    log_weight = log_prob.ravel() - ensembles.proposal.log_density(points)
    # Walkers that the proposal could hold for long need another way to move.
    stuck = np.quantile(log_weight, 0.998) - np.median(log_weight)
    return (1.0 - DE_SHARE if stuck < STICKY else 0.5), ""


def _covered(
    ensembles: Ensembles,
    proposal: Proposal,
    points: np.ndarray,
    log_prob: np.ndarray,
    size: int,
) -> Proposal:
    """The proposal with components added where walkers or its own draws find it short."""
    log_density = ensembles.members[0].log_density
    for _ in range(COVERING_ROUNDS):
        fresh = proposal.sample(ensembles.rng, size)
        fresh_log_prob = log_density(fresh)
        inside = np.isfinite(fresh_log_prob)
        fresh, fresh_log_prob = fresh[inside], fresh_log_prob[inside]
        log_weight = fresh_log_prob - proposal.log_density(fresh)
        top = log_weight.max()
        log_mean = top + np.log(np.exp(log_weight - top).sum() / size)
        points, first = np.unique(np.concatenate([points, fresh]), axis=0, return_index=True)
        log_prob = np.concatenate([log_prob, fresh_log_prob])[first]
        before = proposal
        proposal = cover(proposal, points, log_prob, float(log_mean))
        if proposal is before:
            break
    return proposal
