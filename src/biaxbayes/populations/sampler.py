"""Draws of a population and their convergence.

Warm-up in rounds, each fitting archives, mixtures and principal components to the one before; then
blocks of kept sweeps until R-hat and the effective sample size of all that is reported are good. As
in :mod:`biaxbayes.sampling` every decision depends on the draws alone, so that a seed determines
every byte, whatever the number of threads and however often it was interrupted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from biaxbayes.populations.ensemble import FRESH_VISITS, JOINT, Design, Ensemble, Spreading, Tuning
from biaxbayes.sampling.convergence import (
    MIN_STEPS_PER_TAU,
    RHAT_LIMIT,
    STATES,
    Convergence,
    assess,
)
from biaxbayes.sampling.proposal import TransportedMixture, fit_transported_mixture
from biaxbayes.sampling.sampler import Progress
from biaxbayes.tasks import one_blas_thread

LENGTH_ROUNDS = 2
ARCHIVE, COMPONENTS, DIRECTIONS = 1500, 6, 6
GROWTH, LEAST_GROWTH, MOST_GROWTH = 1.5, 1.1, 2.0
"""Growth of the number of sweeps between assessments; the first while R-hat is too large."""
AHEAD = 1.15
"""Sweeps until the next assessment, relative to those that seem to be needed."""
SPECIMENS_OWN = ("theta", "u", "effect")
EVERY, MOST_BYTES = 2, 2**27
"""The specimens' values are kept every second sweep, half as often when they take more memory."""
TOGETHER = 0.3
"""Acceptance that the joint moves are tuned to."""
FRESH_AT_ONCE = 32
"""Sweeps whose mixture draws are made together."""


@dataclass(frozen=True)
class Plan:
    """Goal and budget of a run."""

    ess: float = 1000.0  # of the worst quantity
    max_steps: int = 6000  # kept sweeps of each ensemble
    seed: int = 1
    workers: int = 1  # threads; the draws do not depend on it
    ensembles: int = 4
    chains: int = 16  # of each ensemble; a chain of 25 autocorrelation times has 25 draws
    rounds: int = 4  # of the warm-up
    round_sweeps: int = 24
    first_block: int = 80  # kept sweeps before the first assessment


@dataclass(frozen=True)
class History:
    """Kept draws; first axes (ensembles, kept, chains)."""

    mu: np.ndarray  # (..., groups, p), centred
    sd_donors: np.ndarray  # (..., p)
    sd: np.ndarray  # (..., sets, p)
    # (..., 2, pairs): partial correlations of donors and specimens, by block
    partial: tuple[np.ndarray, ...]
    theta: np.ndarray  # (..., n, p), centred; as the next two of every `every`-th sweep
    u: np.ndarray  # (..., n, dmax)
    effect: np.ndarray  # (..., donors, p)
    every: int

    def arrays(self) -> dict[str, np.ndarray]:
        """The arrays by name, for a checkpoint."""
        plain = {k: getattr(self, k) for k in ("mu", "sd_donors", "sd", "theta", "u", "effect")}
        return plain | {f"partial{k}": v for k, v in enumerate(self.partial)}

    @classmethod
    def from_arrays(cls, arrays: dict[str, np.ndarray], every: int) -> History:
        """Inverse of :meth:`arrays`."""
        own = dict(arrays)
        partial = [own.pop(k) for k in sorted(own) if k.startswith("partial")]
        return cls(**own, partial=tuple(partial), every=every)

    def followed_by(self, other: History) -> History:
        """Both, one after the other."""
        mine, theirs = self.arrays(), other.arrays()
        joined = {k: np.concatenate([mine[k], theirs[k]], axis=1) for k in mine}
        whole = History.from_arrays(joined, self.every)
        while sum(joined[k].nbytes for k in SPECIMENS_OWN) > MOST_BYTES:
            whole = whole.thinned()
            joined = whole.arrays()
        return whole

    def thinned(self) -> History:
        """The history without the specimens' values of every other sweep that has them."""
        halved = {name: getattr(self, name)[:, ::2].copy() for name in SPECIMENS_OWN}
        return replace(self, **halved, every=2 * self.every)


@dataclass
class State:
    """A population between two blocks; what a checkpoint holds."""

    tuning: Tuning
    members: list[dict[str, Any]]
    history: History | None
    sweeps: int
    block: int
    finished: bool = False


@dataclass(frozen=True)
class Sampled:
    """Draws of a population with their convergence."""

    history: History
    convergence: Convergence
    # by kind of move, for each specimen or direction
    acceptance: dict[str, np.ndarray] = field(repr=False)
    interrupted: bool = False


Quantities = Callable[[History], list[dict[str, np.ndarray]]]


def draw(
    design: Design,
    plan: Plan,
    quantities: Quantities,
    *,
    state: State | None = None,
    on_block: Callable[[State], None] = lambda s: None,
    progress: Callable[[Progress], None] = lambda p: None,
    stop: Callable[[], object] = lambda: False,
) -> Sampled:
    """Draw from a population until the draws have converged, or the plan ends.

    ``quantities`` of a history are assessed: dicts of arrays (ensembles, kept, chains) by name,
    each with its own sweeps. ``on_block`` is given the state after the warm-up and every block.
    """
    seeds = np.random.SeedSequence(plan.seed).spawn(plan.ensembles + 1)
    ensembles = [Ensemble(design, k, plan.chains, seeds[k]) for k in range(plan.ensembles)]
    with one_blas_thread(), ThreadPoolExecutor(plan.workers) as pool:
        if state is None:
            rng = np.random.default_rng(seeds[-1])
            tuning = _warm_up(design, plan, ensembles, pool, rng, progress)
            state = State(tuning, [_snapshot(e) for e in ensembles], None, 0, plan.first_block)
            on_block(state)
        else:
            for ensemble, member in zip(ensembles, state.members, strict=True):
                _restore(ensemble, member)
        history, convergence = state.history, None
        while not state.finished and not stop():
            _report_progress(progress, state, convergence, plan)
            sweeps = min(state.block, plan.max_steps - state.sweeps)
            new = _run_block(ensembles, pool, state, sweeps)
            history = new if history is None else history.followed_by(new)
            done = state.sweeps + sweeps
            assessments = [assess(q, target_ess=plan.ess) for q in quantities(history)]
            convergence = _worst(assessments)
            finished = convergence.state == "converged" or done >= plan.max_steps
            members = [_snapshot(e) for e in ensembles]
            block = _next_block(assessments, done, plan.ess)
            state = State(state.tuning, members, history, done, block, finished)
            on_block(state)
        if history is None:
            history = _run_block(ensembles, pool, state, EVERY)
        if convergence is None:
            convergence = _worst([assess(q, target_ess=plan.ess) for q in quantities(history)])
    return Sampled(history, convergence, _acceptance(ensembles, state.sweeps), not state.finished)


def _worst(assessments: list[Convergence]) -> Convergence:
    """All parts together; the state is the worst of theirs."""
    worst = max(assessments, key=lambda c: STATES.index(c.state))
    whole = {
        what: np.concatenate([getattr(c, what) for c in assessments])
        for what in ("ess_bulk", "ess_tail", "rhat", "tau")
    }
    names = tuple(name for c in assessments for name in c.names)
    state, reason = worst.state, worst.reason
    return Convergence(names, **whole, steps=assessments[0].steps, state=state, reason=reason)


def _next_block(assessments: list[Convergence], done: int, ess: float) -> int:
    """Sweeps until the next assessment, from the diagnostics so far."""
    growth = GROWTH
    assessed = [c for c in assessments if c.names]
    if assessed and max(c.worst_rhat for c in assessed) < RHAT_LIMIT:
        few = max(ess / max(c.worst_ess, 1.0) for c in assessed)
        short = max(MIN_STEPS_PER_TAU * c.tau.max() / c.steps for c in assessed)
        growth = min(max(AHEAD * max(few, short), LEAST_GROWTH), MOST_GROWTH)
    return math.ceil((growth - 1.0) * done)


def _report_progress(
    progress: Callable[[Progress], None], state: State, convergence: Convergence | None, plan: Plan
) -> None:
    if convergence is None:
        progress(Progress("sampling the population", 0.0))
        return
    share = min(convergence.worst_ess / plan.ess, 0.99)
    text = (
        f"sampling: R-hat {convergence.worst_rhat:.3f}, {convergence.worst_ess:.0f} effective draws"
    )
    progress(Progress(text, share))


def _run_block(
    ensembles: list[Ensemble], pool: ThreadPoolExecutor, state: State, sweeps: int
) -> History:
    """Further sweeps of all ensembles."""
    every = EVERY if state.history is None else state.history.every
    run = partial(_run, tuning=state.tuning, done=state.sweeps, sweeps=sweeps, every=every)
    parts = [part.arrays() for part in pool.map(run, ensembles)]
    whole = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return History.from_arrays(whole, every)


def _run(ensemble: Ensemble, tuning: Tuning, done: int, sweeps: int, every: int) -> History:
    """Kept sweeps of one ensemble, with a first axis of one."""
    common: dict[str, list[np.ndarray]] = {k: [] for k in ("mu", "sd_donors", "sd")}
    parts: list[list[np.ndarray]] = [[] for _ in ensemble.partial]
    of_specimens: dict[str, list[np.ndarray]] = {k: [] for k in SPECIMENS_OWN}
    for number in _sweeps(ensemble, tuning, sweeps):
        for name, values in common.items():
            values.append(getattr(ensemble, name).copy())
        for of, own in zip(parts, ensemble.partial, strict=True):
            of.append(own.transpose(1, 0, 2).copy())
        if (done + number) % every == 0:
            for name, values in of_specimens.items():
                values.append(getattr(ensemble, name).copy())
    arrays = {k: np.array(v)[None] for k, v in (common | of_specimens).items()}
    return History(**arrays, partial=tuple(np.array(v)[None] for v in parts), every=every)


def _sweeps(ensemble: Ensemble, tuning: Tuning, sweeps: int) -> Iterator[int]:
    """Do sweeps, yielding after each its number."""
    C = len(ensemble.u)
    for first in range(0, sweeps, FRESH_AT_ONCE):
        several = min(FRESH_AT_ONCE, sweeps - first)
        fresh = ensemble.fresh_pool(tuning, several * C * FRESH_VISITS)
        for k in range(several):
            ensemble.sweep(tuning, fresh, k * C * FRESH_VISITS)
            yield first + k


# --- warm-up -------------------------------------------------------------------------------------


def _warm_up(
    design: Design,
    plan: Plan,
    ensembles: list[Ensemble],
    pool: ThreadPoolExecutor,
    rng: np.random.Generator,
    progress: Callable[[Progress], None],
) -> Tuning:
    members = design.individuals
    archives = tuple(_few(m.pool.reshape(-1, m.dimension), rng) for m in members)
    size = max(m.dimension for m in members)
    tuning = Tuning(archives, (), np.zeros((0, len(members), size)), np.zeros(0))
    for number in range(plan.rounds):
        progress(Progress("warming up", number / plan.rounds))
        for ensemble in ensembles:
            ensemble.accepted.clear()
        rounds = list(pool.map(partial(_round, tuning=tuning, sweeps=plan.round_sweeps), ensembles))
        history = np.concatenate(rounds, axis=1)  # sweeps, chains of all ensembles
        last = history[len(history) // 2 :]
        points = last.reshape(-1, *last.shape[2:])
        own = tuple(_few(points[:, i, : m.dimension], rng) for i, m in enumerate(members))
        seeds = [int(s) for s in rng.integers(2**63, size=len(members))]
        proposals = tuple(pool.map(lambda m, a, s: _fitted(m.bounds, a, s), members, own, seeds))
        directions = _directions(points, rng)
        tuning = replace(tuning, archives=own, proposals=proposals, directions=directions)
        tuning = _with_steps(tuning, ensembles, points)
    # lengths of the joint moves alone, for the last components
    for _ in range(LENGTH_ROUNDS):
        for ensemble in ensembles:
            ensemble.accepted.clear()
        list(pool.map(partial(_round, tuning=tuning, sweeps=plan.round_sweeps // 2), ensembles))
        tuning = _with_steps(tuning, ensembles, points)
    for ensemble in ensembles:
        ensemble.accepted.clear()
    return tuning


def _round(ensemble: Ensemble, tuning: Tuning, sweeps: int) -> np.ndarray:
    return np.array([ensemble.u.copy() for _ in _sweeps(ensemble, tuning, sweeps)])


def _few(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    chosen = rng.choice(len(points), min(ARCHIVE, len(points)), replace=False)
    return np.ascontiguousarray(points[np.sort(chosen)])


def _fitted(bounds: np.ndarray, points: np.ndarray, seed: int) -> TransportedMixture:
    rng = np.random.default_rng(seed)
    return fit_transported_mixture(points, rng, bounds=bounds, components=COMPONENTS)


def _directions(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Leading principal components of the stacked coordinates, shape (L, n, dmax)."""
    few = _few(points.reshape(len(points), -1), rng)
    centred = few - few.mean(axis=0)
    sd = centred.std(axis=0)
    scale = np.where(sd > 0.0, sd, 1.0)
    _, singular, rows = np.linalg.svd(centred / scale, full_matrices=False)
    most = min(DIRECTIONS, len(rows))
    lengths = singular[:most] / math.sqrt(len(few))
    leading: np.ndarray = (lengths[:, None] * rows[:most] * scale).reshape(most, *points.shape[1:])
    return leading


def _with_steps(tuning: Tuning, ensembles: list[Ensemble], points: np.ndarray) -> Tuning:
    """Lengths of the joint moves from the acceptance of the last round."""
    count, kinds = len(tuning.directions), len(ensembles[0].memberships)
    apart = np.empty((kinds, 0)) if tuning.spreading is None else tuning.spreading.steps
    both = zip([tuning.steps, *apart], JOINT, strict=False)
    steps = np.array([_steps(current, ensembles, name, count) for current, name in both])
    spreading = Spreading(points.mean(axis=0), points.std(axis=0), steps[1:]) if kinds else None
    return replace(tuning, steps=steps[0], spreading=spreading)


def _steps(steps: np.ndarray, ensembles: list[Ensemble], name: str, count: int) -> np.ndarray:
    hits, tried = (
        np.sum([e.accepted.get(k, np.zeros(count)) for e in ensembles], axis=0)
        for k in (name, f"{name} tried")
    )
    if len(steps) != count:
        return np.full(count, 0.5)
    share = hits / np.maximum(tried, 1.0)
    change = np.where(tried > 0.0, np.clip((share + 0.02) / (TOGETHER + 0.02), 0.25, 2.0), 1.0)
    return np.clip(steps * change, 1e-3, 3.0)


# --- state ---------------------------------------------------------------------------------------


CARRIED = ("u", "theta", "log", "mu", "effect", "sd_donors", "sd")


def _snapshot(ensemble: Ensemble) -> dict[str, Any]:
    out: dict[str, Any] = {name: getattr(ensemble, name).copy() for name in CARRIED}
    for k, own in enumerate(ensemble.partial):
        out[f"partial{k}"], out[f"factor{k}"] = own.copy(), ensemble.factor[k].copy()
    out["rng"] = ensemble.rng.bit_generator.state
    out["accepted"] = {k: np.array(v) for k, v in ensemble.accepted.items()}
    return out


def _restore(ensemble: Ensemble, member: dict[str, Any]) -> None:
    for name in CARRIED:
        setattr(ensemble, name, member[name].copy())
    for k in range(len(ensemble.partial)):
        ensemble.partial[k], ensemble.factor[k] = member[f"partial{k}"], member[f"factor{k}"]
    ensemble.rng.bit_generator.state = member["rng"]
    ensemble.accepted = {k: np.array(v) for k, v in member["accepted"].items()}


def _acceptance(ensembles: list[Ensemble], sweeps: int) -> dict[str, np.ndarray]:
    """Accepted shares of the kept sweeps: by specimen, and of the joint moves by direction."""
    names = sorted({k for e in ensembles for k in e.accepted})
    total = {
        k: np.sum([e.accepted[k] for e in ensembles if k in e.accepted], axis=0) for k in names
    }
    out = {}
    for k, v in total.items():
        if k in JOINT:
            out[k] = v / np.maximum(total[f"{k} tried"], 1.0)
        elif not k.endswith(" tried"):
            out[k] = v / max(len(ensembles) * sweeps, 1)
    return out
