"""Draws of a population and their convergence.

Warm-up in rounds, each fitting archives, mixtures and principal components to the one before; then
blocks of stored sweeps until R-hat and effective sample size of all reported quantities suffice.
As in :mod:`biaxbayes.sampling` every decision depends on the draws alone, so that a seed determines
every byte, whatever the number of threads and however often it was interrupted.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from biaxbayes.populations.ensemble import JOINT_MOVE_NAMES, Design, Ensemble, Tuning
from biaxbayes.progress_bar import Progress
from biaxbayes.sampling.convergence import (
    MIN_STEPS_PER_TAU,
    RHAT_LIMIT,
    STATES,
    Convergence,
    assess,
)
from biaxbayes.sampling.proposal import TransportedMixture, fit_transported_mixture
from biaxbayes.tasks import one_blas_thread

STEP_TUNING_ROUNDS = 2
ARCHIVE_POINTS, MIXTURE_COMPONENTS, PRINCIPAL_COMPONENTS = 1500, 6, 6
BLOCK_GROWTH, MIN_GROWTH, MAX_GROWTH = 1.5, 1.1, 2.0
"""Growth of the number of sweeps between assessments; the first while R-hat is too large."""
BLOCK_MARGIN = 1.15
"""Sweeps until the next assessment, relative to those that seem to be needed."""
SPECIMEN_ARRAYS = ("theta", "u", "effect")
SPECIMEN_STRIDE, MAX_HISTORY_BYTES = 2, 2**27
"""The specimens' values are stored every second sweep, half as often when they take more memory."""
JOINT_ACCEPTANCE = 0.3
"""Acceptance that the joint moves are tuned to."""


@dataclass(frozen=True)
class PopulationPlan:
    """Goal and budget of sampling a population."""

    ess: float = 1000.0  # of the worst quantity
    max_steps: int = 6000  # stored sweeps of each ensemble
    seed: int = 1
    workers: int = 1  # threads; the draws do not depend on it
    ensembles: int = 4
    chains: int = 16  # of each ensemble; a chain of 25 autocorrelation times has 25 draws
    rounds: int = 4  # of the warm-up
    round_sweeps: int = 24
    first_block: int = 80  # stored sweeps before the first assessment


@dataclass(frozen=True)
class History:
    """Stored draws; first axes (ensembles, sweeps, chains)."""

    mu: np.ndarray  # (..., groups, p), centred
    sd_donors: np.ndarray  # (..., p)
    sd: np.ndarray  # (..., sets, p)
    partial: np.ndarray  # (..., 2, pairs): partial correlations of donors and specimens, or none
    theta: np.ndarray  # (..., n, p), centred; as the next two of every `every`-th sweep
    u: np.ndarray  # (..., n, dmax)
    effect: np.ndarray  # (..., donors, p)
    every: int

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """The arrays by name."""
        return {f.name: getattr(self, f.name) for f in fields(self) if f.name != "every"}

    @classmethod
    def concatenate(cls, parts: list[History], axis: int) -> History:
        """Histories of several ensembles (axis 0), or one after the other (axis 1)."""
        names = parts[0].arrays
        arrays = {k: np.concatenate([part.arrays[k] for part in parts], axis) for k in names}
        return cls(**arrays, every=parts[0].every)

    def within_memory(self) -> History:
        """The history with values of the specimens seldom enough for the memory."""
        stored = self
        while sum(stored.arrays[k].nbytes for k in SPECIMEN_ARRAYS) > MAX_HISTORY_BYTES:
            halved = {name: stored.arrays[name][:, ::2].copy() for name in SPECIMEN_ARRAYS}
            stored = replace(stored, **halved, every=2 * stored.every)
        return stored


@dataclass
class PopulationCheckpoint:
    """Sampler of a population between two blocks."""

    tuning: Tuning
    ensembles: list[dict[str, Any]]
    history: History | None
    sweeps: int
    block: int  # sweeps until the next assessment
    finished: bool = False

    def record(self) -> dict[str, Any]:
        """Plain values and arrays for a checkpoint."""
        tuning = {**vars(self.tuning), "proposals": [q.arrays() for q in self.tuning.proposals]}
        return {
            **vars(self),
            "tuning": tuning,
            "history": None if self.history is None else vars(self.history),
        }

    @classmethod
    def from_record(cls, record: dict[str, Any]) -> PopulationCheckpoint:
        """Inverse of :meth:`record`."""
        own, history = record["tuning"], record["history"]
        proposals = tuple(TransportedMixture.from_arrays(a) for a in own["proposals"])
        return cls(
            Tuning(**{**own, "archives": tuple(own["archives"]), "proposals": proposals}),
            record["ensembles"],
            None if history is None else History(**history),
            int(record["sweeps"]),
            int(record["block"]),
            bool(record["finished"]),
        )


@dataclass(frozen=True)
class PopulationDraws:
    """Draws of a population with their convergence."""

    history: History
    convergence: Convergence
    # accepted shares by kind of move, for each specimen or direction
    acceptance: dict[str, np.ndarray] = field(repr=False)
    interrupted: bool = False


def draw_population(
    design: Design,
    plan: PopulationPlan,
    quantities: Callable[[History], list[dict[str, np.ndarray]]],
    *,
    state: PopulationCheckpoint | None = None,
    on_block: Callable[[PopulationCheckpoint], None] = lambda s: None,
    progress: Callable[[Progress], None] = lambda p: None,
    stop: Callable[[], object] = lambda: False,
) -> PopulationDraws:
    """Draw from a population until the draws have converged, or the plan ends.

    ``quantities`` of a history are assessed: dicts of arrays (ensembles, sweeps, chains) by name,
    each with its own sweeps. ``on_block`` is given the state after the warm-up and every block.
    """
    seeds = np.random.SeedSequence(plan.seed).spawn(plan.ensembles + 1)
    ensembles = [Ensemble(design, k, plan.chains, seeds[k]) for k in range(plan.ensembles)]
    convergence = None
    with one_blas_thread(), ThreadPoolExecutor(plan.workers) as pool:
        if state is None:
            tuning = _warm_up(ensembles, plan, pool, np.random.default_rng(seeds[-1]), progress)
            state = PopulationCheckpoint(
                tuning, [e.snapshot() for e in ensembles], None, 0, plan.first_block
            )
            on_block(state)
        else:
            for ensemble, snapshot in zip(ensembles, state.ensembles, strict=True):
                ensemble.restore(snapshot)
        while not state.finished and not stop():
            _report_progress(progress, convergence, plan.ess)
            sweeps = min(state.block, plan.max_steps - state.sweeps)
            history = _stored_sweeps(ensembles, pool, state, sweeps)
            done = state.sweeps + sweeps
            assessments = [assess(q, target_ess=plan.ess) for q in quantities(history)]
            convergence = _worst(assessments)
            finished = convergence.state == "converged" or done >= plan.max_steps
            block = _next_block(assessments, done, plan.ess)
            state = PopulationCheckpoint(
                state.tuning, [e.snapshot() for e in ensembles], history, done, block, finished
            )
            on_block(state)
        history = state.history or _stored_sweeps(ensembles, pool, state, SPECIMEN_STRIDE)
    if convergence is None:
        convergence = _worst([assess(q, target_ess=plan.ess) for q in quantities(history)])
    acceptance = {}
    for name in sorted({name for e in ensembles for name in e.moves}):
        hits, tried = np.sum([e.moves[name] for e in ensembles if name in e.moves], axis=0)
        acceptance[name] = hits / np.maximum(tried, 1.0)
    return PopulationDraws(history, convergence, acceptance, not state.finished)


def _worst(assessments: list[Convergence]) -> Convergence:
    """All parts together; the state is the worst of theirs."""
    worst = max(assessments, key=lambda c: STATES.index(c.state))
    whole: dict[str, Any] = {
        what: np.concatenate([getattr(c, what) for c in assessments])
        for what in ("ess_bulk", "ess_tail", "rhat", "tau")
    }
    names = tuple(name for c in assessments for name in c.names)
    return replace(worst, names=names, **whole, steps=assessments[0].steps)


def _next_block(assessments: list[Convergence], done: int, ess: float) -> int:
    """Sweeps until the next assessment, from the diagnostics so far."""
    growth = BLOCK_GROWTH
    assessed = [c for c in assessments if c.names]
    if assessed and max(c.worst_rhat for c in assessed) < RHAT_LIMIT:
        shortfall = max(ess / max(c.worst_ess, 1.0) for c in assessed)
        short = max(MIN_STEPS_PER_TAU * c.tau.max() / c.steps for c in assessed)
        growth = min(max(BLOCK_MARGIN * max(shortfall, short), MIN_GROWTH), MAX_GROWTH)
    return math.ceil((growth - 1.0) * done)


def _report_progress(
    progress: Callable[[Progress], None], convergence: Convergence | None, ess: float
) -> None:
    if convergence is None:
        progress(Progress("sampling the population", 0.0))
        return
    rhat, worst = convergence.worst_rhat, convergence.worst_ess
    text = f"sampling: R-hat {rhat:.3f}, {worst:.0f} effective draws"
    progress(Progress(text, min(worst / ess, 0.99)))


def _stored_sweeps(
    ensembles: list[Ensemble], pool: ThreadPoolExecutor, state: PopulationCheckpoint, sweeps: int
) -> History:
    """The history with further sweeps of all ensembles."""
    every = SPECIMEN_STRIDE if state.history is None else state.history.every

    def run(ensemble: Ensemble) -> History:
        stored: dict[str, list[np.ndarray]] = {f.name: [] for f in fields(History)}
        del stored["every"]
        for number in range(state.sweeps, state.sweeps + sweeps):
            ensemble.sweep(state.tuning)
            sd = ensemble.sd
            stored["mu"].append(ensemble.mu)
            stored["sd_donors"].append(sd[:, 0])
            stored["sd"].append(sd[:, 1:])
            stored["partial"].append(ensemble.blocks[0].partial.copy())
            if number % every == 0:
                stored["theta"].append(ensemble.theta.copy())
                stored["u"].append(ensemble.u.copy())
                stored["effect"].append(ensemble.effect)
        return History(**{k: np.array(v)[None] for k, v in stored.items()}, every=every)

    new = History.concatenate(list(pool.map(run, ensembles)), 0)
    if state.history is not None:
        new = History.concatenate([state.history, new], 1)
    return new.within_memory()


# --- warm-up -------------------------------------------------------------------------------------


def _warm_up(
    ensembles: list[Ensemble],
    plan: PopulationPlan,
    pool: ThreadPoolExecutor,
    rng: np.random.Generator,
    progress: Callable[[Progress], None],
) -> Tuning:
    members = ensembles[0].design.individuals
    archives = tuple(_subsample(m.pool.reshape(-1, m.dimension), rng) for m in members)
    size, kinds = max(ensembles[0].sizes), 1 + len(ensembles[0].labels)
    nothing = np.zeros((len(members), size))
    tuning = Tuning(archives, (), nothing[None][:0], np.zeros((kinds, 0)), nothing, nothing)

    def run(sweeps: int) -> np.ndarray:
        """Coordinates of the later half of some sweeps, (draws, n, dmax); counts begin anew."""

        def sweep_ensemble(ensemble: Ensemble) -> np.ndarray:
            ensemble.moves.clear()
            out = []
            for _ in range(sweeps):
                ensemble.sweep(tuning)
                out.append(ensemble.u.copy())
            return np.array(out[sweeps // 2 :])

        return np.concatenate(list(pool.map(sweep_ensemble, ensembles)), axis=1).reshape(
            -1, *nothing.shape
        )

    def fit_mixture(member: Any, points: np.ndarray, seed: int) -> TransportedMixture:
        own = np.random.default_rng(seed)
        return fit_transported_mixture(
            points, own, bounds=member.bounds, components=MIXTURE_COMPONENTS
        )

    for number in range(plan.rounds):
        progress(Progress("warming up", number / plan.rounds))
        points = run(plan.round_sweeps)
        own = tuple(_subsample(points[:, i, : m.dimension], rng) for i, m in enumerate(members))
        seeds = rng.integers(2**63, size=len(members))
        tuning = Tuning(
            own,
            tuple(pool.map(fit_mixture, members, own, seeds)),
            _principal_components(points, rng),
            tuning.steps,
            points.mean(axis=0),
            points.std(axis=0),
        )
        tuning = replace(tuning, steps=_tune_steps(tuning, ensembles))
    for _ in range(STEP_TUNING_ROUNDS):  # lengths of the joint moves alone, for the last components
        run(plan.round_sweeps // 2)
        tuning = replace(tuning, steps=_tune_steps(tuning, ensembles))
    for ensemble in ensembles:
        ensemble.moves.clear()
    return tuning


def _subsample(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    chosen = rng.choice(len(points), min(ARCHIVE_POINTS, len(points)), replace=False)
    return np.ascontiguousarray(points[np.sort(chosen)])


def _principal_components(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Leading principal components of the stacked coordinates, times their sd, (L, n, dmax)."""
    subsample = _subsample(points.reshape(len(points), -1), rng)
    centred = subsample - subsample.mean(axis=0)
    sd = centred.std(axis=0)
    scale = np.where(sd > 0.0, sd, 1.0)
    _, singular, rows = np.linalg.svd(centred / scale, full_matrices=False)
    most = min(PRINCIPAL_COMPONENTS, len(rows))
    lengths = singular[:most] / math.sqrt(len(subsample))
    leading: np.ndarray = (lengths[:, None] * rows[:most] * scale).reshape(most, *points.shape[1:])
    return leading


def _tune_steps(tuning: Tuning, ensembles: list[Ensemble]) -> np.ndarray:
    """Lengths (kinds, L) of the joint moves from the acceptance of the last round."""
    kinds, count = len(tuning.steps), len(tuning.directions)
    if tuning.steps.shape[1] != count:
        return np.full((kinds, count), 0.5)
    moves = [
        [e.moves.get(name, np.zeros((2, count))) for e in ensembles]
        for name in JOINT_MOVE_NAMES[:kinds]
    ]
    hits, tried = np.sum(moves, axis=1).swapaxes(0, 1)
    share = hits / np.maximum(tried, 1.0)
    change = np.where(
        tried > 0.0, np.clip((share + 0.02) / (JOINT_ACCEPTANCE + 0.02), 0.25, 2.0), 1.0
    )
    return np.clip(tuning.steps * change, 1e-3, 3.0)
