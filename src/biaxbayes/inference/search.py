"""Finding the posterior: from deterministic fits to a population spread over it."""

from __future__ import annotations

import numpy as np
from threadpoolctl import threadpool_limits

from biaxbayes.inference.basins import Basin, find_basins
from biaxbayes.inference.coordinates import ANGULAR, SHEAR, softening_of
from biaxbayes.inference.fixed_parameters import held_and_free
from biaxbayes.inference.population import POPULATION, SEARCH_COMPONENTS, explore, resample
from biaxbayes.inference.posterior import Posterior
from biaxbayes.inference.priors import Prior
from biaxbayes.inference.proposal import Proposal, edge_array, first_proposal, fit_proposal
from biaxbayes.inference.readings import readings
from biaxbayes.inference.starting_points import screened_points

__all__ = ["search", "start_parameters"]

SCOUTS = 16
"""Materials, far from one another, from which other basins of the posterior are looked for."""
SCOUT_NOISE = 10.0
"""A scout fits worse than the fit: the noise it starts with, over that of the fit."""


def search(
    posterior: Posterior, rng: np.random.Generator, population: int = POPULATION
) -> tuple[Proposal, np.ndarray, np.ndarray]:
    """Find the posterior, all of its basins that carry mass.

    Returns
    -------
    proposal : Proposal
    population : ndarray, shape (n, d)
    log_weight : ndarray, shape (n,)
        As :func:`.population.explore`.

    Raises
    ------
    NotConverged
        If no region of positive density is found.
    """
    edges = edge_array(posterior.edges, posterior.dimension)
    first = _first_proposal(posterior, edges, rng)
    proposal, u, log_weight = explore(posterior.log_prob, first, edges, rng, population)
    return _recharted(posterior, u, log_weight, rng) or (proposal, u, log_weight)


def _recharted(
    posterior: Posterior, u: np.ndarray, log_weight: np.ndarray, rng: np.random.Generator
) -> tuple[Proposal, np.ndarray, np.ndarray] | None:
    """Move to a chart softened for the posterior, where the fit's own does not suit it."""
    if posterior.chart != SHEAR:
        return None
    half = len(u) // 2
    chosen = resample(log_weight, half, rng)
    natural = posterior.natural(u[np.isfinite(log_weight)])
    typical = posterior.natural(u[chosen])
    softening = softening_of(np.deg2rad(typical["alpha"]), typical["kappa"])
    if 0.5 < softening / posterior.softening < 2.0:
        return None
    # Weights are ratios of densities in the same coordinates: they carry over.
    weights = log_weight[np.isfinite(log_weight)]
    posterior.use_chart(softening)
    with np.errstate(divide="ignore"):
        u = posterior.coordinates(natural)
    regular = np.isfinite(u).all(axis=1)  # aligned fibres, to the last digit, lie at infinity
    u, weights = u[regular], weights[regular]
    edges = edge_array(posterior.edges, posterior.dimension)
    picked = u[resample(weights, half, rng)]
    with threadpool_limits(1, user_api="blas"):
        return fit_proposal(picked, rng, edges=edges, components=SEARCH_COMPONENTS), u, weights


def _first_proposal(posterior: Posterior, edges: np.ndarray, rng: np.random.Generator) -> Proposal:
    """Student t distributions around every basin, and wide ones around the deterministic fit.

    Each basin has one of the local curvature and one of twice its width; three nested and wide
    ones are there in case the basins are not all.
    """
    base = start_parameters(posterior)
    centre = posterior.coordinates(base)[0]
    scale = _spread(posterior)
    starts = np.vstack([centre, _scouts(posterior, base, rng)])
    found = find_basins(posterior.log_prob, starts, scale, edges) or [
        Basin(centre, np.diag(scale), 0.0)
    ]
    # The mounting force is pinned by its reading, however wide the rest.
    pinned = np.array([n.startswith("mounting_force") for n in posterior.free])
    wide = [np.diag(scale * np.where(pinned, 1.0, width)) for width in (0.3, 1.0, 3.0)]
    means = [b.mode for b in found for _ in range(2)] + [found[0].mode, centre, centre]
    factors = [width * b.factor for b in found for width in (1.0, 2.0)] + wide
    shares = [share / len(found) for _ in found for share in (0.4, 0.3)] + [0.1] * 3
    return first_proposal(np.array(means), factors, np.array(shares), edges)


def _scouts(posterior: Posterior, base: dict[str, float], rng: np.random.Generator) -> np.ndarray:
    """Sampling coordinates of materials that fit in other ways than the best fit, (n, d)."""
    settings = posterior.settings
    held = {k: v for k, v in settings.fixed.items() if k in ("C1", "k1", "k2", "alpha", "kappa")}
    point, free = held_and_free(held)
    if not free.size:
        return np.empty((0, posterior.dimension))
    data = readings(
        posterior.specimen,
        shared=settings.mounting_stretch == "shared",
        zeroed=settings.mounting == "zeroed",
    )
    materials, stretches = screened_points(
        data, SCOUTS, rng, point=point, free=free, with_mounting=settings.infers_mounting
    )
    scouts = []
    for (C1, k1, k2, t, kappa), lm in zip(materials, stretches, strict=True):
        alpha = np.rad2deg(np.arccos(np.sqrt(t)))
        scout = base | _off_the_edges(C1, k1, k2, float(alpha), kappa)
        scout["noise_sd"] = SCOUT_NOISE * base["noise_sd"]
        for name in posterior.free:
            if name.startswith("mounting_stretch"):
                scout[name] = float(lm[0 if name.startswith("mounting_stretch_x") else 1])
        scouts.append(posterior.coordinates(_inside_priors(posterior, scout))[0])
    return np.array(scouts)


def start_parameters(posterior: Posterior) -> dict[str, float]:
    """Natural parameters of the deterministic fit, moved off the edges of their ranges."""
    fit = posterior.start
    specimen = posterior.specimen
    rms = float(np.sqrt(np.mean(np.concatenate(fit.residuals) ** 2)))
    out: dict[str, float] = {
        **_off_the_edges(
            fit.material.C1_kPa,
            fit.material.k1_kPa,
            fit.material.k2,
            fit.material.alpha_deg,
            fit.material.kappa,
        ),
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
    return _inside_priors(posterior, out)


def _off_the_edges(C1: float, k1: float, k2: float, alpha: float, kappa: float) -> dict[str, float]:
    """A material moved to where the sampling coordinates are regular."""
    return {
        "C1": max(C1, 1e-3),
        "k1": max(k1, 1e-3),
        "k2": max(k2, 1e-2),
        "alpha": float(np.clip(alpha, 3.0, 87.0)),
        "kappa": float(np.clip(kappa, 0.01, 0.32)),
    }


def _inside_priors(posterior: Posterior, parameters: dict[str, float]) -> dict[str, float]:
    """Parameters moved into the ranges of their priors."""
    out = dict(parameters)
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
