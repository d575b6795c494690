"""An independence move for emcee, whose proposal is fitted to the walkers' own history.

It does not depend on the walker's position, so that a good fit gives nearly independent draws. The
acceptance ratio is the exact Metropolis-Hastings one,

    min(1, pi(y) q(x) / (pi(x) q(y))),

so the mixture decides how fast the chain mixes, never where it goes. Adapting the proposal to
the chain's own past breaks detailed balance: draws may be used only after :meth:`freeze`.
"""

from __future__ import annotations

from typing import Any

import emcee
import numpy as np

from biaxbayes.sampling.proposal import MixtureProposal, fit_mixture_proposal


class AdaptedIndependenceMove(emcee.moves.Move):
    """Metropolis-Hastings with a proposal fitted to the history of the ensemble.

    ``sweeps`` proposals are tried for each walker in one step: evaluated together, accepted or
    rejected in turn. Proposals are folded at ``bounds`` (d, 2); the move is exact without them.
    """

    def __init__(
        self, rng: np.random.Generator, *, sweeps: int = 4, bounds: np.ndarray | None = None
    ) -> None:
        super().__init__()
        self.rng, self.sweeps, self.bounds = rng, sweeps, bounds
        self.proposal: MixtureProposal | None = None
        self.frozen = False
        self.reset_counts()

    def reset_counts(self) -> None:
        """Start counting acceptance afresh."""
        self.tried = self.accepted = 0

    def adapt(
        self, history: np.ndarray, *, components: int = 8, label: np.ndarray | None = None
    ) -> None:
        """Fit the proposal to a history (n, d) of walkers; RuntimeError after :meth:`freeze`."""
        if self.frozen:
            raise RuntimeError("the proposal is frozen: its draws are already in use")
        self.proposal = fit_mixture_proposal(
            history, self.rng, bounds=self.bounds, components=components, label=label
        )

    def freeze(self) -> None:
        """Refuse further adaptation; every draw from here on may be used."""
        self.frozen = True

    def propose(self, model: Any, state: emcee.State) -> tuple[emcee.State, np.ndarray]:
        """One step of every walker; called by emcee."""
        if self.proposal is None:
            raise RuntimeError("the independence move has no proposal yet: call adapt first")
        walkers = len(state.coords)
        proposals = self.proposal.sample(self.rng, self.sweeps * walkers)
        log_prob, blobs = model.compute_log_prob_fn(proposals)
        log_q = self.proposal.log_density(np.concatenate([state.coords, proposals]))
        # ln pi - ln q, the importance weight of the point that a walker is at, and of proposals; a
        # point that the proposal cannot return from is refused
        weight = state.log_prob - log_q[:walkers]
        weights = np.full(self.sweeps * walkers, -np.inf)
        np.subtract(log_prob, log_q[walkers:], out=weights, where=log_q[walkers:] > -np.inf)
        log_u = np.log(self.rng.random((self.sweeps, walkers)))
        chosen = np.full(walkers, -1)  # the last accepted sweep
        for s, candidate in enumerate(weights.reshape(self.sweeps, walkers)):
            yes = log_u[s] < candidate - weight
            weight[yes], chosen[yes] = candidate[yes], s
            self.accepted += int(yes.sum())
        moved = chosen >= 0
        index = chosen[moved] * walkers + np.flatnonzero(moved)
        state.coords[moved] = proposals[index]
        state.log_prob[moved] = np.asarray(log_prob)[index]
        if blobs is not None and state.blobs is not None:
            state.blobs[moved] = blobs[index]
        self.tried += self.sweeps * walkers
        return state, moved
