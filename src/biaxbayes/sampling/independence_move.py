"""An adapted independence move for emcee.

    move = AdaptedIndependenceMove(rng=numpy.random.default_rng(1))
    sampler = emcee.EnsembleSampler(
        walkers, d, log_density, moves=[(move, 0.8), (emcee.moves.DEMove(), 0.2)]
    )
    ... warm up, move.adapt(history), ..., move.freeze(), sample

The proposal is a heavy-tailed mixture behind a transport map, fitted to the walkers' own history.
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
    ``components`` limits the mixture.
    """

    def __init__(
        self,
        rng: np.random.Generator | None = None,
        *,
        sweeps: int = 4,
        components: int = 8,
        bounds: np.ndarray | None = None,
        proposal: MixtureProposal | None = None,
    ) -> None:
        super().__init__()
        if sweeps < 1:
            raise ValueError("a step needs at least one sweep")
        self.rng = np.random.default_rng() if rng is None else rng
        self.sweeps = sweeps
        self.components = components
        self.bounds = bounds
        self.proposal = proposal
        self.frozen = False
        self.reset_counts()

    def reset_counts(self) -> None:
        """Start counting acceptance afresh."""
        self.tried = 0
        self.accepted = 0

    @property
    def acceptance(self) -> float:
        """Fraction of proposals accepted since :meth:`reset_counts`; 0 when none were tried."""
        return self.accepted / self.tried if self.tried else 0.0

    def adapt(
        self,
        history: np.ndarray,
        *,
        components: int | None = None,
        label: np.ndarray | None = None,
    ) -> None:
        """Fit the proposal to a history (n, d) of walkers; RuntimeError after :meth:`freeze`."""
        if self.frozen:
            raise RuntimeError("the proposal is frozen: its draws are already in use")
        self.proposal = fit_mixture_proposal(
            history,
            self.rng,
            bounds=self.bounds,
            components=components or self.components,
            label=label,
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
        chosen, accepted = _accept(
            state.log_prob,
            log_q[:walkers],
            np.asarray(log_prob).reshape(self.sweeps, walkers),
            log_q[walkers:].reshape(self.sweeps, walkers),
            np.log(self.rng.random((self.sweeps, walkers))),
        )
        moved = chosen >= 0
        index = chosen[moved] * walkers + np.flatnonzero(moved)
        state.coords[moved] = proposals[index]
        state.log_prob[moved] = np.asarray(log_prob)[index]
        if blobs is not None and state.blobs is not None:
            state.blobs[moved] = blobs[index]
        self.tried += self.sweeps * walkers
        self.accepted += accepted
        return state, moved


def _accept(
    log_prob: np.ndarray,
    log_q: np.ndarray,
    proposed_prob: np.ndarray,
    proposed_q: np.ndarray,
    log_u: np.ndarray,
) -> tuple[np.ndarray, int]:
    """The last accepted sweep of each walker, -1 if none; and the number accepted."""
    chosen = np.full(log_prob.shape, -1)
    accepted = 0
    # ln pi(x) - ln q(x), the importance weight of the point that a walker is at
    weight = log_prob - log_q
    for s in range(len(proposed_q)):
        # a point that the proposal cannot return from is refused
        candidate = np.full(log_prob.shape, -np.inf)
        np.subtract(proposed_prob[s], proposed_q[s], out=candidate, where=proposed_q[s] > -np.inf)
        yes = log_u[s] < candidate - weight
        weight[yes], chosen[yes] = candidate[yes], s
        accepted += int(yes.sum())
    return chosen, accepted
