"""What one density evaluation costs, and how it grows."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

import numpy as np
from numba import njit

from biaxbayes.laws import LAWS
from biaxbayes.laws.goh import GOH
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import prepare
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.virtual_specimen import Machine, virtual_specimen

__all__ = ["cost_of_laws", "density_cost", "growth_with_points", "growth_with_walkers"]

POINTS = (50, 200, 1000, 5000)
WALKERS = (16, 64, 256, 1024, 4096)
REPEATS = 7


@njit
def _exponentials(x, out):
    for i in range(x.size):
        out[i] = np.exp(x[i])


def _best(code: Callable[[], object], count: int) -> float:
    """Seconds of one of ``count`` pieces of work, the least of several repeats."""
    code()
    least = np.inf
    for _ in range(REPEATS):
        clock = time.perf_counter()
        code()
        least = min(least, time.perf_counter() - clock)
    return least / count


def _walkers(posterior: Posterior, count: int) -> np.ndarray:
    """Points around the fit with a positive density, (count, d)."""
    from biaxbayes.model.preparation import start_parameters

    centre = posterior.coordinates(start_parameters(posterior))[0]
    rng = np.random.default_rng(1)
    points = centre + 1e-3 * rng.standard_normal((count, centre.size)) * np.abs(centre)
    points[~np.isfinite(posterior.log_prob(points))] = centre
    return points


def density_cost(specimen: Specimen) -> tuple[float, float, int]:
    """(seconds of a density evaluation, of as many bare exponentials as rows, rows)."""
    posterior = prepare(specimen, noise="independent")
    points = _walkers(posterior, 2000)
    rows = sum(p.rows for p in specimen.protocols)
    x, out = np.random.default_rng(0).uniform(0.0, 3.0, rows), np.empty(rows)

    def exponentials() -> None:
        for _ in range(2000):
            _exponentials(x, out)

    evaluation = _best(lambda: posterior.log_prob(points), 2000)
    return evaluation, _best(exponentials, 2000), rows


def growth_with_points() -> dict[int, float]:
    """Seconds of a density evaluation by the number of readings' rows."""
    found = {}
    for count in POINTS:
        specimen, _ = virtual_specimen(
            GOH(10, 40, 5, 40, 0.15),
            name=f"{count} rows",
            mounting_stretch=(1.01, 1.02),
            total_stretch=1.2,
            ratios=((1.0, 1.0),),
            increments=count - 1,
            machine=Machine(noise_N=0.002),
            seed=1,
        )
        posterior = prepare(specimen, noise="independent")
        points = _walkers(posterior, 1000)
        found[count] = _best(partial(posterior.log_prob, points), 1000)
    return found


def growth_with_walkers(specimen: Specimen) -> dict[int, float]:
    """Seconds a walker of one call, by the number of walkers."""
    posterior = prepare(specimen, noise="independent")
    found = {}
    for count in WALKERS:
        points = _walkers(posterior, count)
        found[count] = _best(partial(posterior.log_prob, points), count)
    return found


def cost_of_laws(specimen: Specimen) -> dict[str, float]:
    """Seconds of a density evaluation by law; laws take turns, so that ratios are of one time."""
    posteriors = {law: prepare(specimen, law=law, noise="independent") for law in LAWS}
    points = {law: _walkers(posterior, 1000) for law, posterior in posteriors.items()}
    least = dict.fromkeys(LAWS, np.inf)
    for _ in range(REPEATS):
        for law, posterior in posteriors.items():
            clock = time.perf_counter()
            posterior.log_prob(points[law])
            least[law] = min(least[law], (time.perf_counter() - clock) / len(points[law]))
    return least
