"""A log density with bounds goes in, draws and their convergence come out.

A banana whose first coordinate ends at zero:

    import numpy as np
    from biaxbayes.sampling import Plan, Target, draw, search

    def banana(x):
        log_prob = -0.5 * x[:, 0] ** 2 - 0.5 * (x[:, 1] - x[:, 0] ** 2) ** 2
        return np.where(x[:, 0] >= 0.0, log_prob, -np.inf)

    target = Target(banana, np.array([[0.0, np.inf], [-np.inf, np.inf]]))
    plan = Plan(ess=2000, seed=1)
    start = search(target, np.array([[1.0, 0.0]]), np.ones(2), plan.search_rng())
    draws = draw(target, start, plan)
    print(draws.convergence.state, draws.quantities["x0"].mean())  # converged, near 0.798

``search`` is given points of positive density to start from, and how far around them to look. It
climbs from each to a mode (:mod:`.modes`), puts a Student t with the local curvature there
(Laplace's approximation), and lets population Monte Carlo (:mod:`.population_monte_carlo`) turn
that into a proposal that fits, with a part for each cluster of modes. Independent ensembles of
walkers (:mod:`.ensembles`) then move by differential evolution and by an independence move
(:mod:`.independence_move`) whose proposal (:mod:`.proposal`) is a mixture of Student t
distributions (:mod:`.mixture`), seen through triangular transport maps (:mod:`.transport_map`) and
reflected at bounds. The warm-up (:mod:`.adaptation`) fits it to the walkers' history; then it is
frozen. :mod:`.sampler` runs blocks of steps until :mod:`.convergence` is satisfied, and
:mod:`.bridge` integrates the density from its draws.
"""

from biaxbayes.sampling.bridge import log_integral
from biaxbayes.sampling.population_monte_carlo import Start, search
from biaxbayes.sampling.sampler import Checkpoint, Draws, Plan, Progress, draw
from biaxbayes.sampling.target import Target, bounds_array

__all__ = [
    "Checkpoint",
    "Draws",
    "Plan",
    "Progress",
    "Start",
    "Target",
    "bounds_array",
    "draw",
    "log_integral",
    "search",
]
