"""From a posterior to draws that have been judged.

Search, warm-up, then blocks of kept steps until the effective sample size of the worst quantity
is on target and the ensembles agree. Every decision depends on the draws alone, never on the
clock, so that a seed determines every byte, however often the run is interrupted.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from biaxbayes.inference.convergence import Convergence, assess
from biaxbayes.inference.ensembles import Ensembles
from biaxbayes.inference.patchwork import Patchwork
from biaxbayes.inference.population import POPULATION, dispersed_starts, tempered_points
from biaxbayes.inference.posterior import Posterior
from biaxbayes.inference.search import search
from biaxbayes.inference.warmup import WarmUp, warm_up

__all__ = ["Draws", "Plan", "Progress", "draw", "ensembles_at", "first_state"]

FIRST_BLOCK = 128
BLOCK_GROWTH = 1.5
MAX_KEPT_STEPS = 1024
"""Beyond this every other kept step is dropped and the thinning doubled."""


@dataclass(frozen=True)
class Plan:
    """What the sampler is asked for.

    Attributes
    ----------
    ess : float
        Effective sample size of the worst quantity.
    max_steps : int
        Kept steps of each ensemble at which it gives up.
    ensembles, walkers : int
    seed : int
    workers : int
        Threads; the draws do not depend on it.
    population : int
        Points of a generation of the search before the walkers start.
    first_block : int
        Kept steps of each ensemble before the draws are judged for the first time.
    """

    ess: float = 2000.0
    max_steps: int = 20_000
    ensembles: int = 4
    walkers: int = 64
    seed: int = 1
    workers: int = 1
    population: int = POPULATION
    first_block: int = FIRST_BLOCK


@dataclass(frozen=True)
class Progress:
    """Where a run stands.

    Attributes
    ----------
    phase : str
    share : float or None
        Of the target; None where unknown.
    note : str
        What the user must be told, wherever the progress is shown.
    """

    phase: str
    share: float | None = None
    note: str = ""


@dataclass
class State:
    """A run between two blocks; what a checkpoint holds."""

    softening: float
    proposal: Patchwork
    members: list[dict[str, Any]]
    chain: np.ndarray
    steps: int
    thin: int
    warmup: WarmUp
    evaluations: int
    rejected: np.ndarray
    finished: bool = False


@dataclass(frozen=True)
class Draws:
    """Judged draws.

    Attributes
    ----------
    chain : ndarray, shape (ensembles, steps, walkers, d)
        Sampling coordinates.
    quantities : dict of ndarray, shape (ensembles, steps, walkers)
        Natural quantities by the names of ``summary.csv``, ``log_likelihood`` and ``lp``.
    convergence : Convergence
    warmup : WarmUp
    proposal : Patchwork
    evaluations : int
    rejected : dict
        Evaluations of zero density by reason, over the whole run.
    acceptance : float
        Of the independence move, while draws were kept.
    seconds : dict
        Wall time of each phase in this process.
    interrupted : bool
    """

    chain: np.ndarray
    quantities: dict[str, np.ndarray]
    convergence: Convergence
    warmup: WarmUp
    proposal: Patchwork
    evaluations: int
    rejected: dict[str, int]
    acceptance: float
    thin: int
    seconds: dict[str, float] = field(default_factory=dict)
    interrupted: bool = False


def draw(
    posterior: Posterior,
    plan: Plan,
    *,
    state: State | None = None,
    on_block: Callable[[State], None] | None = None,
    progress: Callable[[Progress], None] = lambda p: None,
    stop: Callable[[], int] = lambda: False,
) -> Draws:
    """Draw from a posterior until the plan is met or its budget spent.

    Parameters
    ----------
    posterior : Posterior
    plan : Plan
    state : State, optional
        Continue from here rather than from the start.
    on_block : callable, optional
        Called after every block with the state to save.
    progress : callable
    stop : callable
        Asked between blocks; True (or the number of a signal) ends the run early.

    Returns
    -------
    Draws

    Raises
    ------
    NotConverged
        If no region of positive density is found.
    """
    seconds: dict[str, float] = {}
    if state is None:
        state, seconds = first_state(posterior, plan, progress)
        if on_block:
            on_block(state)
    ensembles = ensembles_at(posterior, plan, state)
    clock = time.perf_counter()
    convergence = None
    if state.steps:
        convergence = _judge(posterior, state, plan)
    interrupted = False
    while convergence is None or (convergence.state != "reliable" and state.steps < plan.max_steps):
        if stop():
            interrupted = True
            break
        grown = int(state.steps * (BLOCK_GROWTH - 1.0)) // 32 * 32
        block = min(max(plan.first_block, grown), 8 * FIRST_BLOCK, plan.max_steps - state.steps)
        state = _advance(ensembles, state, block, posterior)
        convergence = _judge(posterior, state, plan)
        progress(Progress("sampling", min(convergence.worst_ess / plan.ess, 0.99)))
        state.finished = convergence.state == "reliable"
        if on_block:
            on_block(state)
    seconds["sampling"] = time.perf_counter() - clock
    if convergence is None:
        none = np.empty(0)
        convergence = Convergence((), none, none, none, none, 0, "unusable", "stopped")
    return Draws(
        chain=state.chain,
        quantities=_quantities(posterior, state.chain),
        convergence=convergence,
        warmup=state.warmup,
        proposal=state.proposal,
        evaluations=state.evaluations,
        rejected=_reasons(state.rejected),
        acceptance=ensembles.acceptance,
        thin=state.thin,
        seconds=seconds,
        interrupted=interrupted,
    )


def first_state(
    posterior: Posterior, plan: Plan, progress: Callable[[Progress], None] = lambda p: None
) -> tuple[State, dict[str, float]]:
    """Search and warm up; the state before the first kept step, and the wall times."""
    seconds = {}
    clock = time.perf_counter()
    progress(Progress("fitting"))
    posterior.use_chart()
    seconds["fit"] = time.perf_counter() - clock
    clock = time.perf_counter()
    progress(Progress("compiling (once; cached for later runs)"))
    posterior.log_prob(np.zeros((1, posterior.dimension)))
    seconds["compile"] = time.perf_counter() - clock
    clock = time.perf_counter()
    progress(Progress("searching"))
    posterior.rejected[:] = 0
    search_seed, ensemble_seed = np.random.SeedSequence(plan.seed).spawn(2)
    rng = np.random.default_rng(search_seed)
    proposal, population, log_weight = search(posterior, rng, plan.population)
    walkers = max(plan.walkers, 4 * posterior.dimension)
    ensembles = Ensembles(
        posterior.log_prob,
        dispersed_starts(population, log_weight, rng, ensembles=plan.ensembles, walkers=walkers),
        ensemble_seed,
        edges=posterior.edges,
        workers=plan.workers,
    )
    spread = tempered_points(population, log_weight, rng)
    warmed = warm_up(
        ensembles, proposal, spread, progress=lambda text: progress(Progress(f"warming up: {text}"))
    )
    assert isinstance(ensembles.proposal, Patchwork)
    seconds["warm-up"] = time.perf_counter() - clock
    shape = (plan.ensembles, 0, walkers, posterior.dimension)
    state = State(
        softening=posterior.softening,
        proposal=ensembles.proposal,
        members=[m.snapshot() for m in ensembles.members],
        chain=np.empty(shape),
        steps=0,
        thin=1,
        warmup=warmed,
        evaluations=ensembles.evaluations,
        rejected=posterior.rejected.copy(),
    )
    return state, seconds


def ensembles_at(posterior: Posterior, plan: Plan, state: State) -> Ensembles:
    """Ensembles that continue from a state."""
    posterior.use_chart(state.softening)
    ensembles = Ensembles(
        posterior.log_prob,
        [m["coordinates"] for m in state.members],
        np.random.SeedSequence(plan.seed),
        edges=posterior.edges,
        workers=plan.workers,
    )
    for member, snapshot in zip(ensembles.members, state.members, strict=True):
        member.restore(snapshot)
    ensembles.proposal = state.proposal
    for member in ensembles.members:
        member.independence.freeze()
    posterior.rejected[:] = state.rejected
    return ensembles


def _advance(ensembles: Ensembles, state: State, block: int, posterior: Posterior) -> State:
    """Run a block and keep its steps, thinned so that memory stays bounded."""
    chain, _ = ensembles.run(block)
    # Kept steps are those whose number is a multiple of the thinning.
    first = -state.steps % state.thin
    kept = np.concatenate([state.chain, chain[:, first :: state.thin]], axis=1)
    thin = state.thin
    while kept.shape[1] > MAX_KEPT_STEPS:
        kept, thin = kept[:, ::2], 2 * thin
    return replace(
        state,
        members=[m.snapshot() for m in ensembles.members],
        chain=kept,
        steps=state.steps + block,
        thin=thin,
        evaluations=ensembles.evaluations,
        rejected=posterior.rejected.copy(),
    )


def _quantities(posterior: Posterior, chain: np.ndarray) -> dict[str, np.ndarray]:
    shape = chain.shape[:3]
    natural = posterior.natural(chain.reshape(-1, chain.shape[-1]))
    return {name: values.reshape(shape) for name, values in natural.items()}


def _judge(posterior: Posterior, state: State, plan: Plan) -> Convergence:
    judged = _quantities(posterior, state.chain)
    del judged["log_likelihood"]
    return assess(judged, target_ess=plan.ess)


def _reasons(counts: np.ndarray) -> dict[str, int]:
    names = ("evaluated", "out_of_range", "no_mounting_root", "overflow")
    values = [int(c) for c in counts]
    return dict(zip(names, [sum(values), *values[1:]], strict=True))
