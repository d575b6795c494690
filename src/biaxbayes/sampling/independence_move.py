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

from biaxbayes.sampling.proposal import Proposal, fit_mixture_proposal


class AdaptedIndependenceMove(emcee.moves.Move):
    """Metropolis-Hastings with a proposal fitted to the history of the ensemble.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of the proposals.
    sweeps : int
        Proposals tried for each walker in one step. They are drawn and evaluated together, so
        that a vectorised density is called once, and accepted or rejected in turn.
    components : int
        Largest number of mixture components.
    bounds : ndarray, shape (d, 2), optional
        Lower and upper bounds, infinite where there is none; proposals are folded there. The
        move is exact without; with them no proposal is lost beyond a bound.

    Attributes
    ----------
    proposal : MixtureProposal, TransportedMixture or None
        None until :meth:`adapt` or assignment. A step without one is an error.
    tried, accepted : int
        Counts of proposals since :meth:`reset_counts`.
    """

    def __init__(
        self,
        rng: np.random.Generator | None = None,
        *,
        sweeps: int = 4,
        components: int = 8,
        bounds: np.ndarray | None = None,
        proposal: Proposal | None = None,
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
        """Share of proposals accepted since :meth:`reset_counts`; 0 when none were tried."""
        return self.accepted / self.tried if self.tried else 0.0

    def adapt(
        self,
        history: np.ndarray,
        *,
        components: int | None = None,
        label: np.ndarray | None = None,
    ) -> None:
        """Fit the proposal to a history of walkers, shape (n, d).

        Parameters
        ----------
        history : ndarray, shape (n, d)
        components : int, optional
            In place of the limit of the constructor, for this fit.
        label : int64 ndarray, shape (n,), optional
            Groups of points, as in :func:`.proposal.fit_mixture_proposal`.

        Raises
        ------
        RuntimeError
            After :meth:`freeze`: adapting then would bias the draws.
        """
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
    """Sweep that each walker ends on, -1 where it stays; and the number of accepted proposals.

    The walkers' log densities have the shape (walkers,), the proposals' (sweeps, walkers).
    """
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
