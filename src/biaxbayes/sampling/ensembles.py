"""Independent ensembles of walkers on one density, each with random numbers of its own.

So the draws do not depend on how many threads advance the ensembles.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from concurrent.futures import FIRST_EXCEPTION, CancelledError, ThreadPoolExecutor, wait
from typing import Any

import emcee
import numpy as np

from biaxbayes.sampling.independence_move import AdaptedIndependenceMove
from biaxbayes.sampling.proposal import MixtureProposal
from biaxbayes.sampling.target import LogDensity
from biaxbayes.tasks import one_blas_thread

SWEEPS = 4
"""Proposals tried in one step. They are evaluated together, which costs little more than one; at an
acceptance of a half, draws four proposals apart are nearly independent."""


class Ensemble:
    """One emcee ensemble with differential-evolution and adapted independence moves."""

    def __init__(
        self,
        log_density: LogDensity,
        start: np.ndarray,
        seed: np.random.SeedSequence,
        bounds: np.ndarray | None = None,
    ) -> None:
        walker_seed, proposal_seed = seed.spawn(2)
        self.log_density = log_density
        self.independence = AdaptedIndependenceMove(
            np.random.default_rng(proposal_seed), sweeps=SWEEPS, bounds=bounds
        )
        random = np.random.RandomState(np.random.MT19937(walker_seed))
        self.state = emcee.State(
            start, log_prob=log_density(start), random_state=random.get_state()
        )
        self.independence_share = 0.0
        self.stop = threading.Event()
        # In the neck of a funnel (Neal, Ann. Stat. 31 (2003) 705) only steps much shorter than the
        # usual ones are accepted.
        self._de = [
            (emcee.moves.DEMove(), 0.4),
            (emcee.moves.DEMove(gamma0=0.2), 0.3),
            (emcee.moves.DEMove(gamma0=0.06), 0.15),
            (emcee.moves.DESnookerMove(), 0.1),
            (emcee.moves.DEMove(gamma0=1.0), 0.05),
        ]

    def _stoppable(self, x: np.ndarray) -> np.ndarray:
        if self.stop.is_set():
            raise CancelledError
        return self.log_density(x)

    def run(self, steps: int) -> tuple[np.ndarray, np.ndarray]:
        """Advance; coordinates (steps, walkers, d) and log densities (steps, walkers)."""
        walkers, d = self.state.coords.shape
        share = self.independence_share if self.independence.proposal is not None else 0.0
        moves: list[tuple[Any, float]] = [(m, w * (1.0 - share)) for m, w in self._de]
        moves.append((self.independence, share))
        sampler = emcee.EnsembleSampler(walkers, d, self._stoppable, moves=moves, vectorize=True)
        sampler.log_prob_fn = self._stoppable  # emcee's wrapper prints a traceback
        self.state = sampler.run_mcmc(self.state, steps, skip_initial_state_check=True)
        return sampler.get_chain(), sampler.get_log_prob()

    def snapshot(self) -> dict[str, Any]:
        """Everything needed to continue: walkers, random states, shares and counts."""
        return {
            "coordinates": self.state.coords.copy(),
            "log_prob": self.state.log_prob.copy(),
            "walker_random": self.state.random_state,
            "proposal_random": self.independence.rng.bit_generator.state,
            "independence_share": self.independence_share,
            "tried": self.independence.tried,
            "accepted": self.independence.accepted,
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Continue from a snapshot."""
        self.state = emcee.State(
            snapshot["coordinates"],
            log_prob=snapshot["log_prob"],
            random_state=snapshot["walker_random"],
            copy=True,
        )
        self.independence.rng.bit_generator.state = snapshot["proposal_random"]
        self.independence_share = float(snapshot["independence_share"])
        self.independence.tried = int(snapshot["tried"])
        self.independence.accepted = int(snapshot["accepted"])


class Ensembles:
    """Independent ensembles, one per dispersed start (walkers, d), that share one proposal."""

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
        for member in self.members:
            member.stop.clear()
        with one_blas_thread(), ThreadPoolExecutor(self.workers) as pool:
            futures = [pool.submit(member.run, steps) for member in self.members]
            try:
                for future in wait(futures, return_when=FIRST_EXCEPTION).done:
                    future.result()
                runs = [future.result() for future in futures]
            except BaseException:  # an error of one, or a signal: the others end at their next step
                for member in self.members:
                    member.stop.set()
                raise
        return np.stack([c for c, _ in runs]), np.stack([p for _, p in runs])

    @property
    def acceptance(self) -> float:
        """Acceptance of the independence move since the counts were reset."""
        tried = sum(m.independence.tried for m in self.members)
        return sum(m.independence.accepted for m in self.members) / tried if tried else 0.0

    @property
    def proposal(self) -> MixtureProposal:
        """The proposal shared by all ensembles, once there is one."""
        proposal = self.members[0].independence.proposal
        assert proposal is not None
        return proposal

    @proposal.setter
    def proposal(self, proposal: MixtureProposal) -> None:
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
        self.reset_counts()

    def adapt(self, history: np.ndarray, **options: Any) -> None:
        """Fit the shared proposal to the pooled history of all ensembles, shape (n, d)."""
        lead = self.members[0].independence
        with one_blas_thread():
            lead.adapt(history, **options)
        assert lead.proposal is not None
        self.proposal = lead.proposal

    def reset_counts(self) -> None:
        """Start counting acceptance afresh."""
        for member in self.members:
            member.independence.reset_counts()
