"""From a search to draws that have been judged.

Warm-up, then blocks of kept steps until the effective sample size of the worst quantity is on
target and the ensembles agree. Every decision depends on the draws alone, never on the clock, so
that a seed determines every byte, however often the run is interrupted.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from biaxbayes.progress_bar import Progress
from biaxbayes.sampling.adaptation import WarmUp, warm_up
from biaxbayes.sampling.convergence import LONGEST_HOLD, Convergence, assess, longest_hold
from biaxbayes.sampling.population_monte_carlo import (
    POPULATION,
    Start,
    dispersed_starts,
    ridge_points,
    tempered_points,
)
from biaxbayes.sampling.proposal import MixtureProposal
from biaxbayes.sampling.target import Target

if TYPE_CHECKING:
    from biaxbayes.sampling.ensembles import Ensembles

__all__ = [
    "Draws",
    "Plan",
    "Progress",
    "State",
    "draw",
    "ensembles_at",
    "first_state",
]

FIRST_BLOCK = 128
LONGEST_BLOCK = 8 * FIRST_BLOCK
"""Steps after which the state is saved and may be stopped at."""
JUDGED_GROWTH = 1.5
"""Steps at which the draws are judged, over those of the judgement before. As they grow by a
factor, all judgements together take time in proportion to what is kept."""
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
        Threads that advance ensembles; the draws do not depend on it.
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

    def search_rng(self) -> np.random.Generator:
        """Random numbers of the search, which the warm-up goes on with."""
        return np.random.default_rng(self._seeds()[0])

    def ensemble_seed(self) -> np.random.SeedSequence:
        """Seed of the ensembles."""
        return self._seeds()[1]

    def _seeds(self) -> list[np.random.SeedSequence]:
        return np.random.SeedSequence(self.seed).spawn(2)


@dataclass
class State:
    """A run between two blocks; what a checkpoint holds.

    Attributes
    ----------
    frame : mapping of str to float
        That of the target.
    proposal : MixtureProposal
    members : list of dict
        Snapshot of each ensemble.
    chain : ndarray, shape (ensembles, kept steps, walkers, d)
    steps : int
        Steps of each ensemble so far, of which every ``thin``-th is kept.
    warmup : WarmUp
    evaluations : int
    rejected : int64 ndarray
        Counts of the target so far.
    finished : bool
        Whether the plan is met.
    """

    frame: Mapping[str, float]
    proposal: MixtureProposal
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
    target : Target
        What was drawn from, in the coordinates of ``chain`` and ``proposal``.
    chain : ndarray, shape (ensembles, steps, walkers, d)
        Coordinates.
    quantities : dict of ndarray, shape (ensembles, steps, walkers)
        The target's quantities.
    convergence : Convergence
    warmup : WarmUp
    proposal : MixtureProposal
    evaluations : int
    rejected : dict
        Evaluations, and those of zero density by reason, over the whole run; empty where the
        target does not count.
    acceptance : float
        Of the independence move, while draws were kept.
    seconds : dict
        Wall time of each phase in this process.
    interrupted : bool
    """

    target: Target
    chain: np.ndarray
    quantities: dict[str, np.ndarray]
    convergence: Convergence
    warmup: WarmUp
    proposal: MixtureProposal
    evaluations: int
    rejected: dict[str, int]
    acceptance: float
    thin: int
    seconds: dict[str, float] = field(default_factory=dict)
    interrupted: bool = False


def draw(
    target: Target,
    start: Start | State,
    plan: Plan,
    *,
    on_block: Callable[[State], None] | None = None,
    progress: Callable[[Progress], None] = lambda p: None,
    stop: Callable[[], int] = lambda: False,
) -> Draws:
    """Draw from a density until the plan is met or its budget spent.

    Parameters
    ----------
    target : Target
    start : Start or State
        What a search found, or the state from which a run is continued.
    plan : Plan
    on_block : callable, optional
        Called after the warm-up and every block with the state to save.
    progress : callable
    stop : callable
        Asked between blocks; True (or the number of a signal) ends the run early.

    Returns
    -------
    Draws
    """
    seconds: dict[str, float] = {}
    if isinstance(start, State):
        state = start
        ensembles = ensembles_at(target, plan, state)
    else:
        clock = time.perf_counter()
        ensembles = _dispersed(target, start, plan)
        state = _warmed_up(ensembles, target, start, progress)
        seconds["warm-up"] = time.perf_counter() - clock
        if on_block:
            on_block(state)
    clock = time.perf_counter()
    due = _judged_at(state.steps, plan)
    convergence, quantities, a_step = None, None, 0.0
    if state.steps >= due:
        convergence, quantities, _ = _judge(target, state, plan)
    interrupted = False
    while convergence is None or (
        convergence.state != "converged" and state.steps < plan.max_steps
    ):
        if stop():
            interrupted = True
            break
        if state.steps == due:
            due = _judged_at(due + 1, plan)
        state = _advance(ensembles, state, min(due - state.steps, LONGEST_BLOCK), target)
        if state.steps == due:
            convergence, quantities, share = _judge(target, state, plan)
            state.finished = convergence is not None and convergence.state == "converged"
            a_step = share / state.steps
        progress(Progress("sampling", min(a_step * state.steps, 0.99)))
        if on_block:
            on_block(state)
    seconds["sampling"] = time.perf_counter() - clock
    if convergence is None and state.steps >= plan.first_block:
        convergence = assess(
            _judged_ones(target, _quantities(target, state.chain)), target_ess=plan.ess
        )
    if convergence is None:
        none = np.empty(0)
        convergence = Convergence((), none, none, none, none, 0, "unusable", "stopped")
    if quantities is None or interrupted:
        quantities = _quantities(target, state.chain)
    return Draws(
        target=target,
        chain=state.chain,
        quantities=quantities,
        convergence=convergence,
        warmup=state.warmup,
        proposal=state.proposal,
        evaluations=state.evaluations,
        rejected=target.rejections(state.rejected),
        acceptance=ensembles.acceptance,
        thin=state.thin,
        seconds=seconds,
        interrupted=interrupted,
    )


def first_state(
    target: Target,
    start: Start,
    plan: Plan,
    progress: Callable[[Progress], None] = lambda p: None,
) -> State:
    """Warm ensembles up from what a search found; the state before the first kept step."""
    return _warmed_up(_dispersed(target, start, plan), target, start, progress)


def _dispersed(target: Target, start: Start, plan: Plan) -> Ensembles:
    """Ensembles spread wider than the density, from what a search found."""
    from biaxbayes.sampling.ensembles import Ensembles

    walkers = max(plan.walkers, 4 * target.dimension)
    starts = dispersed_starts(start, ensembles=plan.ensembles, walkers=walkers)
    return Ensembles(
        target.log_prob,
        starts,
        plan.ensemble_seed(),
        bounds=target.bounds,
        workers=plan.workers,
    )


def _warmed_up(
    ensembles: Ensembles, target: Target, start: Start, progress: Callable[[Progress], None]
) -> State:
    """The state of ensembles that have forgotten where they began."""
    warmed = warm_up(
        ensembles,
        start.proposal,
        tempered_points(start),
        ridge_points(start),
        progress=lambda text: progress(Progress(f"warming up: {text}")),
    )
    assert isinstance(ensembles.proposal, MixtureProposal)
    return State(
        frame=target.frame,
        proposal=ensembles.proposal,
        members=[m.snapshot() for m in ensembles.members],
        chain=np.empty((len(ensembles.members), 0, *ensembles.members[0].state.coords.shape)),
        steps=0,
        thin=1,
        warmup=warmed,
        evaluations=ensembles.evaluations,
        rejected=target.counts.copy(),
    )


def ensembles_at(target: Target, plan: Plan, state: State) -> Ensembles:
    """Ensembles that continue from a state; the target's counts are set to those of the state."""
    from biaxbayes.sampling.ensembles import Ensembles  # emcee

    ensembles = Ensembles(
        target.log_prob,
        [m["coordinates"] for m in state.members],
        np.random.SeedSequence(plan.seed),
        bounds=target.bounds,
        workers=plan.workers,
    )
    for member, snapshot in zip(ensembles.members, state.members, strict=True):
        member.restore(snapshot)
    ensembles.proposal = state.proposal
    for member in ensembles.members:
        member.independence.freeze()
    target.counts[:] = state.rejected
    return ensembles


def _advance(ensembles: Ensembles, state: State, block: int, target: Target) -> State:
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
        rejected=target.counts.copy(),
    )


def _quantities(target: Target, chain: np.ndarray) -> dict[str, np.ndarray]:
    shape = chain.shape[:3]
    found = target.quantities(chain.reshape(-1, chain.shape[-1]))
    return {name: values.reshape(shape) for name, values in found.items()}


def _judged_at(steps: int, plan: Plan) -> int:
    """The first of the numbers of steps at which draws are judged that is not below ``steps``."""
    due = min(plan.first_block, plan.max_steps)
    while due < min(steps, plan.max_steps):
        grown = int(due * (JUDGED_GROWTH - 1.0)) // 32 * 32
        due = min(due + max(plan.first_block, grown), plan.max_steps)
    return due


def _judge(
    target: Target, state: State, plan: Plan
) -> tuple[Convergence | None, dict[str, np.ndarray], float]:
    """What is to be said of the draws, their quantities, and the share of the target reached.

    Nothing, yet, where a walker has stood still for so long that the run must go on whatever else
    is said: that is seen at once, the rest takes a third of a second.
    """
    kept = _quantities(target, state.chain)
    judged = _judged_ones(target, kept)
    steps, held = state.chain.shape[1], longest_hold(judged)
    if held > LONGEST_HOLD * steps and state.steps < plan.max_steps:
        return None, kept, LONGEST_HOLD * steps / held
    convergence = assess(judged, target_ess=plan.ess)
    return convergence, kept, convergence.worst_ess / plan.ess


def _judged_ones(target: Target, kept: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: values for name, values in kept.items() if name not in target.unjudged}
