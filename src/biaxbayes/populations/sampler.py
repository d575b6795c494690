"""Draws of a population and their convergence.

Every decision depends on the draws alone, so that a seed determines every byte, whatever the number
of threads and however often it was interrupted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from biaxbayes.populations.hierarchy import Layout
from biaxbayes.populations.reweighting import MAX_K, Chains, RunDraws
from biaxbayes.progress_bar import Progress
from biaxbayes.sampling.convergence import MIN_STEPS_PER_TAU, RHAT_LIMIT, Convergence, assess
from biaxbayes.tasks import one_blas_thread
from biaxbayes.text_files import first_few

K_LEVEL = 0.75
"""Tuned on virtual specimens with long ridges: at the median, more sweeps were needed."""
BLOCK_GROWTH, MIN_GROWTH, MAX_GROWTH = 1.5, 1.1, 2.0
"""Growth of the number of sweeps between assessments; the first while R-hat is too large."""
BLOCK_MARGIN = 1.15
"""Sweeps until the next assessment, relative to those that seem to be needed."""


@dataclass(frozen=True)
class PopulationPlan:
    """Goal and budget of sampling a population."""

    ess: float = 1000.0  # of the worst quantity
    max_steps: int = 6000  # stored sweeps of each ensemble
    seed: int = 1
    workers: int = 1  # threads; the draws do not depend on it
    ensembles: int = 4
    chains: int = 8  # of each ensemble; a chain of 25 autocorrelation times has 25 draws
    warm_up: int = 100  # sweeps
    rounds: int = 3  # in which runs are sampled again
    first_block: int = 200  # stored sweeps before the first assessment
    run_ess: float = 2000.0  # of a run that is sampled again


@dataclass(frozen=True)
class History:
    """Stored draws; first axes (ensembles, sweeps, chains)."""

    mu: np.ndarray  # (..., groups, p), centred
    effect: np.ndarray  # (..., donors, p)
    sd: np.ndarray  # (..., 1 + sets, p): of donors, then of specimens
    partial: np.ndarray  # (..., 2, pairs): partial correlations of donors and specimens, or none
    index: np.ndarray  # (..., n): which draw of its run each specimen is

    @classmethod
    def concatenate(cls, parts: list[History], axis: int) -> History:
        """Histories of several ensembles (axis 0), or one after the other (axis 1)."""
        names = [f.name for f in fields(cls)]
        return cls(*(np.concatenate([getattr(h, n) for h in parts], axis) for n in names))

    def values_of(self, specimens: list[RunDraws]) -> np.ndarray:
        """Values of the specimens, centred, (ensembles, sweeps, chains, n, p)."""
        every = range(len(self.index))
        values = [
            np.stack([s.theta[e][self.index[e, ..., i]] for e in every])
            for i, s in enumerate(specimens)
        ]
        return np.stack(values, axis=-2)


@dataclass
class PopulationCheckpoint:
    """Sampler of a population between two steps."""

    again: dict[int, RunDraws] = field(default_factory=dict)  # runs that were sampled again
    rounds: int = 0  # begun
    # those of this round that still have to be: index, mean and sd (p,) of the normal prior
    left: list[tuple[int, np.ndarray, np.ndarray]] = field(default_factory=list)
    chains: list[dict[str, Any]] = field(default_factory=list)  # once the warm-up is over
    history: History | None = None
    block: int = 0  # sweeps until the next assessment

    def record(self) -> dict[str, Any]:
        """Plain values and arrays for a checkpoint."""
        parts = [f.name for f in fields(RunDraws)]
        again = {str(i): {p: getattr(d, p) for p in parts} for i, d in self.again.items()}
        return {**vars(self), "again": again, "history": self.history and vars(self.history)}

    @classmethod
    def from_record(cls, record: dict[str, Any]) -> PopulationCheckpoint:
        """Inverse of :meth:`record`."""
        again = {int(i): RunDraws(**parts) for i, parts in record["again"].items()}
        left = [(i, mean, sd) for i, mean, sd in record["left"]]
        history = record["history"] and History(**record["history"])
        return cls(**record | {"again": again, "left": left, "history": history})


@dataclass(frozen=True)
class PopulationDraws:
    """Draws of a population with their convergence."""

    history: History
    specimens: list[RunDraws]  # that the indices of the history are of
    convergence: Convergence
    pareto_k: np.ndarray  # (n,), of each specimen's weights, as of the last sweep
    sampled_again: list[int]  # specimens

    @property
    def theta(self) -> np.ndarray:
        """Values of the specimens, centred, (ensembles, sweeps, chains, n, p)."""
        return self.history.values_of(self.specimens)


def draw_population(
    layout: Layout,
    specimens: list[RunDraws],
    plan: PopulationPlan,
    quantities: Callable[[History, np.ndarray], dict[str, np.ndarray]],
    sample_again: Callable[[int, np.ndarray, np.ndarray, int], RunDraws | None],
    *,
    labels: Sequence[str],
    cut_short: list[int] | None = None,
    state: PopulationCheckpoint | None = None,
    on_step: Callable[[PopulationCheckpoint], None] = lambda s: None,
    progress: Callable[[Progress], None] = lambda p: None,
    stop: Callable[[], object] = lambda: False,
) -> PopulationDraws | None:
    """Draw from a population until the draws have converged, or the plan ends; None if stopped.

    Runs that the warm-up shows to have too few draws where the population puts their specimen are
    sampled again, until none is left or the rounds are spent. Then blocks of sweeps are stored.

    ``quantities`` of a history and the specimens' values are assessed: arrays (ensembles, sweeps,
    chains) by name. ``sample_again`` of a specimen's index, mean and sd (p,) of a normal prior and
    a seed gives its draws under that prior, or None if it was stopped; progress names it by its
    label. The runs that are ``cut_short`` have no draws in a part of the range and are sampled
    again in any case.
    ``on_step`` is given the state after every run and every block.
    """
    state = state or PopulationCheckpoint()
    seeds = np.random.SeedSequence(plan.seed).spawn(plan.ensembles)
    with one_blas_thread(), ThreadPoolExecutor(plan.workers) as pool:

        def start() -> list[Chains]:
            known = [state.again.get(i, draws) for i, draws in enumerate(specimens)]
            return [Chains(layout, known, e, plan.chains, seed) for e, seed in enumerate(seeds)]

        def advance(ensembles: list[Chains], sweeps: int) -> History:
            parts = pool.map(lambda chains: _stored_sweeps(chains, sweeps), ensembles)
            return History.concatenate(list(parts), 0)

        while not state.chains:
            if not state.left:
                progress(Progress("warming up"))
                ensembles = start()
                warm = advance(ensembles, plan.warm_up)
                poor = {i for i, k in enumerate(_upper_k(ensembles)) if k > MAX_K}
                poor |= {*(cut_short or [])} - {*state.again}
                if not poor or state.rounds == plan.rounds:
                    state.chains = [chains.snapshot() for chains in ensembles]
                    state.block = plan.first_block
                    break
                state.rounds += 1
                state.left = [(i, *_prior_of_specimen(layout, warm, i)) for i in sorted(poor)]
                named = first_few([labels[i] for i in sorted(poor)], 4)
                note = (
                    f"sampling {named} of {len(labels)} specimens again, which takes about as long "
                    "as each run did: too few of the draws lie where the other specimens put them "
                    f"(Pareto k above {MAX_K:g}); round {state.rounds} of at most {plan.rounds}"
                )
                progress(Progress("warming up", note=note))
            for k, (i, mean, sd) in enumerate(again := list(state.left)):
                text = f"sampling {labels[i]} again, round {state.rounds}"
                progress(Progress(text, k / len(again)))
                seed = np.random.SeedSequence([plan.seed, state.rounds, i]).generate_state(1)
                draws = None if stop() else sample_again(i, mean, sd, int(seed[0]))
                if draws is None:
                    return None
                state.again[i] = draws
                del state.left[0]
                on_step(state)
        ensembles = start()
        for chains, snapshot in zip(ensembles, state.chains, strict=True):
            chains.restore(snapshot)
        known, history = ensembles[0].specimens, state.history

        def assessed(history: History) -> Convergence:
            values = quantities(history, history.values_of(known))
            return assess(values, target_ess=plan.ess)

        convergence, done = None, 0
        if history is not None:
            convergence, done = assessed(history), history.mu.shape[1]
        while convergence is None or (convergence.state != "converged" and done < plan.max_steps):
            if stop():
                return None
            text, share = "sampling the population", 0.0
            if convergence is not None:
                rhat, worst = convergence.worst_rhat, convergence.worst_ess
                text = f"sampling: R-hat {rhat:.3f}, {worst:.0f} effective draws"
                share = min(worst / plan.ess, 0.99)
            progress(Progress(text, share))
            new = advance(ensembles, min(state.block, plan.max_steps - done))
            history = new if history is None else History.concatenate([history, new], 1)
            convergence, done = assessed(history), history.mu.shape[1]
            state.block = _next_block(convergence, done, plan.ess)
            state.history, state.chains = history, [chains.snapshot() for chains in ensembles]
            on_step(state)
        assert history is not None
    return PopulationDraws(history, known, convergence, _upper_k(ensembles), sorted(state.again))


def _stored_sweeps(chains: Chains, sweeps: int) -> History:
    """The values of each of some sweeps, as an ensemble of its own."""
    stored = []
    for _ in range(sweeps):
        chains.sweep()
        stored.append(chains.snapshot())
    names = [f.name for f in fields(History)]
    return History(*(np.array([values[name] for values in stored])[None] for name in names))


def _upper_k(ensembles: list[Chains]) -> np.ndarray:
    """Pareto k of each specimen (n,) that a quarter of the chains exceeds.

    In some chains an sd is close to zero, where k is large for any number of draws. Whether these
    matter is seen where ensembles, each with draws of its own, disagree.
    """
    k = np.concatenate([chains.pareto_k() for chains in ensembles])
    return np.asarray(np.quantile(k, K_LEVEL, axis=0))


def _prior_of_specimen(layout: Layout, history: History, i: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean and sd (p,) of a specimen of this group and donor, from the later half of the sweeps."""
    half = history.mu.shape[1] // 2
    m = history.mu[:, half:, :, layout.group[i]] + history.effect[:, half:, :, layout.donor[i]]
    sd = history.sd[:, half:, :, 1 + layout.set_of[i]]
    # var theta = var m + E sd^2
    variance = m.var(axis=(0, 1, 2)) + (sd**2).mean(axis=(0, 1, 2))
    return m.mean(axis=(0, 1, 2)), np.sqrt(variance)


def _next_block(convergence: Convergence, done: int, ess: float) -> int:
    """Sweeps until the next assessment, from the diagnostics so far."""
    growth = BLOCK_GROWTH
    if convergence.names and convergence.worst_rhat < RHAT_LIMIT:
        shortfall = ess / max(convergence.worst_ess, 1.0)
        short = MIN_STEPS_PER_TAU * convergence.tau.max() / convergence.steps
        growth = min(max(BLOCK_MARGIN * max(shortfall, short), MIN_GROWTH), MAX_GROWTH)
    return math.ceil((growth - 1.0) * done)
