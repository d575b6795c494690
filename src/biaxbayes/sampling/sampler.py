"""Warm-up, then blocks of steps until the draws have converged.

Every decision depends on the draws alone, never on the clock, so that a seed determines every
byte, however often the run is interrupted.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from biaxbayes.progress_bar import Progress
from biaxbayes.sampling.adaptation import WarmUp, warm_up
from biaxbayes.sampling.convergence import MAX_STUCK, Convergence, assess, longest_stuck, unassessed
from biaxbayes.sampling.ensembles import Ensembles
from biaxbayes.sampling.population_monte_carlo import (
    POPULATION,
    Start,
    dispersed_starts,
    draw_cluster_points,
    draw_tempered_points,
)
from biaxbayes.sampling.proposal import MixtureProposal
from biaxbayes.sampling.target import Target

FIRST_BLOCK = 64
LONGEST_BLOCK = 8 * FIRST_BLOCK
"""Number of steps between checkpoints; a run can be stopped there."""
ASSESSMENT_GROWTH = 1.5
"""Ratio of the numbers of steps at which the draws are assessed: as they grow by a factor, all
assessments together take time in proportion to the length of the chain."""
MAX_STORED_STEPS = 1024
"""Beyond this every other stored step is dropped and the thinning doubled."""


@dataclass(frozen=True)
class Plan:
    """Goal and budget of a run.

    Attributes
    ----------
    ess : float
        Effective sample size of the worst quantity.
    max_steps : int
        Maximum number of steps of each ensemble after the warm-up.
    ensembles : int
        Independent ensembles, which the convergence diagnostics compare.
    walkers : int
        Minimum number per ensemble; at least four per coordinate are used.
    seed : int
        Determines the draws.
    workers : int
        Threads that advance ensembles; the draws do not depend on it.
    population : int
        Points per generation of the search.
    first_block : int
        Steps of each ensemble before the first assessment.
    """

    ess: float = 2000.0
    max_steps: int = 20_000
    ensembles: int = 4
    walkers: int = 64
    seed: int = 1
    workers: int = 1
    population: int = POPULATION
    first_block: int = FIRST_BLOCK

    def search_rng(self) -> np.random.Generator:
        """Random numbers of the search, continued by the warm-up."""
        return np.random.default_rng(np.random.SeedSequence(self.seed).spawn(2)[0])

    def ensemble_seed(self) -> np.random.SeedSequence:
        """Seed of the ensembles."""
        return np.random.SeedSequence(self.seed).spawn(2)[1]


@dataclass
class Checkpoint:
    """The state of a run between two blocks.

    Attributes
    ----------
    constants : mapping
        Constants of the target.
    proposal : MixtureProposal
        The frozen proposal of the independence move.
    members : list of dict
        Snapshot of each ensemble.
    chain : ndarray, shape (ensembles, stored steps, walkers, d)
    log_prob : ndarray, shape (ensembles, stored steps, walkers)
        Log densities of the chain.
    steps, thin : int
        Steps of each ensemble so far, of which every ``thin``-th is stored.
    counts : int64 ndarray
        The target's counts so far, search and warm-up included.
    """

    constants: Mapping[str, Any]
    proposal: MixtureProposal
    members: list[dict[str, Any]]
    chain: np.ndarray
    log_prob: np.ndarray
    steps: int
    thin: int
    warmup: WarmUp
    counts: np.ndarray


@dataclass(frozen=True)
class Draws:
    """Draws and their convergence.

    Attributes
    ----------
    target : Target
        The density, in the coordinates of ``chain`` and ``proposal``.
    chain : ndarray, shape (ensembles, steps, walkers, d)
    quantities : dict of ndarray, shape (ensembles, steps, walkers)
        The target's quantities.
    evaluations : dict
        Evaluations, and those of zero density by reason, over the whole run; empty where the
        target does not count.
    acceptance : float
        Acceptance rate of the independence move after the warm-up.
    thin : int
        Steps from one stored step to the next.
    seconds : dict
        Wall time of each phase in this process.
    """

    target: Target
    chain: np.ndarray
    quantities: dict[str, np.ndarray]
    convergence: Convergence
    warmup: WarmUp
    proposal: MixtureProposal
    evaluations: dict[str, int]
    acceptance: float
    thin: int
    seconds: dict[str, float] = field(default_factory=dict)
    interrupted: bool = False


def draw(
    target: Target,
    start: Start | Checkpoint,
    plan: Plan,
    *,
    on_block: Callable[[Checkpoint], None] | None = None,
    progress: Callable[[Progress], None] = lambda p: None,
    stop: Callable[[], int] = lambda: False,
) -> Draws:
    """Draw from a density until the draws have converged or the budget is spent.

    Parameters
    ----------
    start : Start or Checkpoint
        The result of a search, or the checkpoint from which a run is continued.
    on_block : callable, optional
        Called after the warm-up and every block with the state to save.
    stop : callable
        Called between blocks; True (or the number of a signal) ends the run early.
    """
    seconds: dict[str, float] = {}
    if isinstance(start, Checkpoint):
        state = start
        ensembles = restore_ensembles(target, plan, state)
    else:
        clock = time.perf_counter()
        ensembles, state = start_ensembles(target, start, plan, progress)
        seconds["warm-up"] = time.perf_counter() - clock
        if on_block:
            on_block(state)
    clock = time.perf_counter()
    next_check = _next_assessment(state.steps, plan)
    convergence = unassessed("stopped")
    quantities: dict[str, np.ndarray] = {}  # those of the chain; empty until it is assessed
    if state.steps == next_check:
        quantities, convergence = _assess(target, state, plan)
    rate = 0.0  # effective sample size per step, as a fraction of the goal
    interrupted = False
    while convergence.state != "converged" and state.steps < plan.max_steps:
        if stop():
            interrupted = True
            break
        if state.steps == next_check:
            next_check = _next_assessment(next_check + 1, plan)
        state = _advance(ensembles, state, min(next_check - state.steps, LONGEST_BLOCK), target)
        quantities = {}
        # The check for stuck walkers is cheap, the other diagnostics take longer.
        unstuck = longest_stuck(state.chain) <= MAX_STUCK * state.chain.shape[1]
        if state.steps == next_check and (unstuck or state.steps == plan.max_steps):
            quantities, convergence = _assess(target, state, plan)
            rate = convergence.worst_ess / plan.ess / state.steps
        progress(Progress("sampling", min(rate * state.steps, 0.99)))
        if on_block:
            on_block(state)
    seconds["sampling"] = time.perf_counter() - clock
    if not quantities and state.steps >= plan.first_block:
        quantities, convergence = _assess(target, state, plan)
    elif not quantities:
        quantities = _quantities(target, state)
    return Draws(
        target=target,
        chain=state.chain,
        quantities=quantities,
        convergence=convergence,
        warmup=state.warmup,
        proposal=state.proposal,
        evaluations=target.evaluations(state.counts),
        acceptance=ensembles.acceptance,
        thin=state.thin,
        seconds=seconds,
        interrupted=interrupted,
    )


def start_ensembles(
    target: Target,
    start: Start,
    plan: Plan,
    progress: Callable[[Progress], None] = lambda p: None,
) -> tuple[Ensembles, Checkpoint]:
    """Ensembles after the warm-up, and the state before the first step."""
    walkers = max(plan.walkers, 4 * target.dimension)
    ensembles = Ensembles(
        target.log_prob,
        dispersed_starts(start, ensembles=plan.ensembles, walkers=walkers),
        plan.ensemble_seed(),
        bounds=target.bounds,
        workers=plan.workers,
    )
    result = warm_up(
        ensembles,
        start.proposal,
        draw_tempered_points(start),
        draw_cluster_points(start),
        progress=lambda text: progress(Progress(f"warming up: {text}")),
    )
    return ensembles, Checkpoint(
        constants=target.constants,
        proposal=ensembles.proposal,
        members=[m.snapshot() for m in ensembles.members],
        chain=np.empty((plan.ensembles, 0, walkers, target.dimension)),
        log_prob=np.empty((plan.ensembles, 0, walkers)),
        steps=0,
        thin=1,
        warmup=result,
        counts=target.counts.copy(),
    )


def restore_ensembles(target: Target, plan: Plan, state: Checkpoint) -> Ensembles:
    """Ensembles that continue from a checkpoint, to whose counts the target's are set."""
    ensembles = Ensembles(
        target.log_prob,
        [m["coordinates"] for m in state.members],
        np.random.SeedSequence(plan.seed),
        bounds=target.bounds,
        workers=plan.workers,
    )
    ensembles.proposal = state.proposal
    ensembles.freeze()
    for member, snapshot in zip(ensembles.members, state.members, strict=True):
        member.restore(snapshot)
    target.counts[:] = state.counts
    return ensembles


def _advance(ensembles: Ensembles, state: Checkpoint, block: int, target: Target) -> Checkpoint:
    """Run a block and store its steps, thinned so that memory stays bounded."""
    before, added = (state.chain, state.log_prob), ensembles.run(block)
    # Stored steps are those whose number is a multiple of the thinning.
    first, thin = -state.steps % state.thin, state.thin
    chain, log_prob = (
        np.concatenate([old, new[:, first::thin]], axis=1)
        for old, new in zip(before, added, strict=True)
    )
    while chain.shape[1] > MAX_STORED_STEPS:
        chain, log_prob, thin = chain[:, ::2], log_prob[:, ::2], 2 * thin
    return replace(
        state,
        members=[m.snapshot() for m in ensembles.members],
        chain=chain,
        log_prob=log_prob,
        steps=state.steps + block,
        thin=thin,
        counts=target.counts.copy(),
    )


def _next_assessment(steps: int, plan: Plan) -> int:
    """Number of steps of the first assessment that is not before ``steps``."""
    due = min(plan.first_block, plan.max_steps)
    while due < min(steps, plan.max_steps):
        # rounded down to a multiple of 32 steps
        growth = int(due * (ASSESSMENT_GROWTH - 1.0)) // 32 * 32
        due = min(due + max(plan.first_block, growth), plan.max_steps)
    return due


def _assess(
    target: Target, state: Checkpoint, plan: Plan
) -> tuple[dict[str, np.ndarray], Convergence]:
    """The target's quantities, and the convergence of those that are assessed."""
    quantities = _quantities(target, state)
    assessed = {name: v for name, v in quantities.items() if name not in target.skip_diagnostics}
    return quantities, assess(assessed, target_ess=plan.ess)


def _quantities(target: Target, state: Checkpoint) -> dict[str, np.ndarray]:
    """The target's quantities, each of shape (ensembles, steps, walkers)."""
    shape, d = state.log_prob.shape, state.chain.shape[-1]
    values = target.quantities(state.chain.reshape(-1, d), state.log_prob.ravel())
    return {name: v.reshape(shape) for name, v in values.items()}
