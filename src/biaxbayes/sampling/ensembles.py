"""Independent ensembles of walkers on one density, and how they are warmed up.

Each ensemble has its own random numbers, so that the draws do not depend on how many threads
advance the ensembles. Compiled densities let go of the interpreter while they are evaluated.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from typing import Any

import emcee
import numpy as np

from biaxbayes.parallel import one_blas_thread
from biaxbayes.sampling.independence_move import AdaptedIndependenceMove
from biaxbayes.sampling.proposal import Proposal
from biaxbayes.sampling.target import LogDensity

__all__ = ["Ensemble", "Ensembles"]

SWEEPS = 2
"""Proposals tried in one step. At an acceptance of a half, draws two proposals apart are nearly
independent; more in a step would be thrown away."""


class _Sampler(emcee.EnsembleSampler):
    """Without what emcee does at every step and nobody asks for.

    A look at every value for blobs takes a quarter of the density's time; the random state, which
    :meth:`Ensemble.snapshot` keeps at the end, is not copied.
    """

    @property
    def random_state(self) -> None:
        """Not copied."""

    @random_state.setter
    def random_state(self, state: object) -> None:
        del state

    def compute_log_prob(self, coords: np.ndarray) -> tuple[np.ndarray, None]:
        log_prob = self.log_prob_fn(coords)
        if np.isnan(log_prob).any():
            raise ValueError("the log density is not a number")
        return log_prob, None


class Ensemble:
    """One emcee ensemble with differential-evolution and adapted independence moves.

    Parameters
    ----------
    log_density : callable
        Vectorised: (n, d) coordinates to (n,) values.
    start : ndarray, shape (walkers, d)
    seed : numpy.random.SeedSequence
    bounds : ndarray, shape (d, 2), optional
        Bounds of the coordinates, for the independence move.
    """

    def __init__(
        self,
        log_density: LogDensity,
        start: np.ndarray,
        seed: np.random.SeedSequence,
        bounds: np.ndarray | None = None,
    ) -> None:
        walker_seed, proposal_seed = seed.spawn(2)
        self.log_density = log_density
        self.random = np.random.RandomState(np.random.MT19937(walker_seed))
        self.independence = AdaptedIndependenceMove(
            np.random.default_rng(proposal_seed), sweeps=SWEEPS, bounds=bounds
        )
        self.state = emcee.State(start, log_prob=log_density(start))
        self.evaluations = len(start)
        self.independence_share = 0.0
        # In the neck of a funnel only steps much shorter than the usual ones are accepted.
        self._de = [
            (emcee.moves.DEMove(), 0.4),
            (emcee.moves.DEMove(gamma0=0.2), 0.3),
            (emcee.moves.DEMove(gamma0=0.06), 0.15),
            (emcee.moves.DESnookerMove(), 0.1),
            (emcee.moves.DEMove(gamma0=1.0), 0.05),
        ]

    def _counted(self, x: np.ndarray) -> np.ndarray:
        self.evaluations += len(x)
        return self.log_density(x)

    def run(
        self, steps: int, stopped: threading.Event | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Advance; coordinates (steps, walkers, d) and log densities (steps, walkers).

        Fewer steps where ``stopped`` is set by another thread.
        """
        walkers, d = self.state.coords.shape
        share = self.independence_share if self.independence.proposal is not None else 0.0
        moves: list[tuple[Any, float]] = [(m, w * (1.0 - share)) for m, w in self._de]
        if share > 0.0:
            moves.append((self.independence, share))
        sampler = _Sampler(
            walkers, d, self._counted, moves=[m for m in moves if m[1] > 0.0], vectorize=True
        )
        sampler.log_prob_fn = self._counted  # emcee's own copy prints what stops it
        sampler._random = self.random  # one stream for the whole run, across blocks
        start = emcee.State(self.state.coords, log_prob=self.state.log_prob, copy=True)
        state = start
        for state in sampler.sample(start, iterations=steps, skip_initial_state_check=True):  # noqa: B007
            if stopped is not None and stopped.is_set():
                break
        self.state = emcee.State(state.coords, log_prob=state.log_prob, copy=True)
        return sampler.get_chain(), sampler.get_log_prob()

    def snapshot(self) -> dict[str, Any]:
        """Everything needed to continue: walkers, random states, shares and counts."""
        return {
            "coordinates": self.state.coords.copy(),
            "log_prob": self.state.log_prob.copy(),
            "walker_random": self.random.get_state(legacy=False),
            "proposal_random": self.independence.rng.bit_generator.state,
            "independence_share": self.independence_share,
            "evaluations": self.evaluations,
            "tried": self.independence.tried,
            "accepted": self.independence.accepted,
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Continue from a snapshot."""
        self.state = emcee.State(snapshot["coordinates"], log_prob=snapshot["log_prob"], copy=True)
        self.random.set_state(snapshot["walker_random"])
        self.independence.rng.bit_generator.state = snapshot["proposal_random"]
        self.independence_share = float(snapshot["independence_share"])
        self.evaluations = int(snapshot["evaluations"])
        self.independence.tried = int(snapshot["tried"])
        self.independence.accepted = int(snapshot["accepted"])


class Ensembles:
    """Several independent ensembles that share one proposal.

    Parameters
    ----------
    log_density : callable
    starts : sequence of ndarray, shape (walkers, d)
        One dispersed start an ensemble.
    seed : numpy.random.SeedSequence
    bounds : ndarray, shape (d, 2), optional
        Bounds of the coordinates, for the independence move.
    workers : int
        Threads that advance ensembles at the same time.
    """

    def __init__(
        self,
        log_density: LogDensity,
        starts: Sequence[np.ndarray],
        seed: np.random.SeedSequence,
        *,
        bounds: np.ndarray | None = None,
        workers: int = 1,
    ) -> None:
        seeds = seed.spawn(len(starts) + 1)
        self.rng = np.random.default_rng(seeds[-1])
        self.members = [
            Ensemble(log_density, start, s, bounds) for start, s in zip(starts, seeds, strict=False)
        ]
        self.workers = min(workers, len(self.members))

    def run(self, steps: int) -> tuple[np.ndarray, np.ndarray]:
        """Advance every ensemble; (ensembles, steps, walkers, d), (ensembles, steps, walkers)."""
        with one_blas_thread():
            if self.workers == 1:
                out = [member.run(steps) for member in self.members]
            else:
                out = self._run_in_threads(steps)
        return np.stack([c for c, _ in out]), np.stack([p for _, p in out])

    def _run_in_threads(self, steps: int) -> list[tuple[np.ndarray, np.ndarray]]:
        stopped = threading.Event()
        with ThreadPoolExecutor(self.workers) as pool:
            runs = [pool.submit(member.run, steps, stopped) for member in self.members]
            try:
                wait(runs, return_when=FIRST_EXCEPTION)
            finally:
                stopped.set()
            return [run.result() for run in runs]

    @property
    def evaluations(self) -> int:
        """Density evaluations so far."""
        return sum(m.evaluations for m in self.members)

    @property
    def acceptance(self) -> float:
        """Acceptance of the independence move since the counts were reset."""
        tried = sum(m.independence.tried for m in self.members)
        return sum(m.independence.accepted for m in self.members) / tried if tried else 0.0

    @property
    def proposal(self) -> Proposal | None:
        """The proposal shared by all ensembles."""
        return self.members[0].independence.proposal

    @proposal.setter
    def proposal(self, proposal: Proposal) -> None:
        for member in self.members:
            member.independence.proposal = proposal

    def set_share(self, share: float) -> None:
        """Probability of an independence step."""
        for member in self.members:
            member.independence_share = share

    def freeze(self) -> None:
        """Freeze the proposal and start counting its acceptance."""
        for member in self.members:
            member.independence.freeze()
            member.independence.reset_counts()

    def adapt(
        self,
        history: np.ndarray,
        *,
        components: int | None = None,
        parts: int = 1,
        label: np.ndarray | None = None,
        screen: bool = True,
    ) -> None:
        """Fit the shared proposal to the pooled history of all ensembles, shape (n, d)."""
        lead = self.members[0].independence
        with one_blas_thread():
            lead.adapt(
                history,
                components=components,
                parts=parts,
                label=label,
                screen=screen,
            )
        assert lead.proposal is not None
        self.proposal = lead.proposal

    def reset_counts(self) -> None:
        """Start counting acceptance afresh."""
        for member in self.members:
            member.independence.reset_counts()
