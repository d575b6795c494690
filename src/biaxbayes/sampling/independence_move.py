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
the chain's own past breaks detailed balance: draws are to be kept only after :meth:`freeze`.
"""

from __future__ import annotations

from typing import Any

import emcee
import numpy as np

from biaxbayes.compilation import compiled
from biaxbayes.sampling.proposal import Proposal, fit_mixture_proposal

__all__ = ["AdaptedIndependenceMove"]


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
        parts: int = 1,
        label: np.ndarray | None = None,
        screen: bool = True,
    ) -> None:
        """Fit the proposal to a history of walkers, shape (n, d).

        ``components`` overrides the limit of the constructor for this fit; ``parts``, ``label``
        and ``screen`` as in :func:`.proposal.fit_mixture_proposal`.

        Raises
        ------
        RuntimeError
            After :meth:`freeze`: adapting then would make the kept draws wrong.
        """
        if self.frozen:
            raise RuntimeError("the proposal is frozen: draws are being kept")
        self.proposal = fit_mixture_proposal(
            history,
            self.rng,
            components=components or self.components,
            bounds=self.bounds,
            parts=parts,
            label=label,
            screen=screen,
        )

    def freeze(self) -> None:
        """Refuse further adaptation; every draw from here on may be kept."""
        self.frozen = True

    def propose(self, model: Any, state: emcee.State) -> tuple[emcee.State, np.ndarray]:
        """One step of every walker; called by emcee."""
        if self.proposal is None:
            raise RuntimeError("the independence move has no proposal yet: call adapt first")
        walkers = len(state.coords)
        proposals = self.proposal.sample(self.rng, self.sweeps * walkers)
        log_prob, blobs = model.compute_log_prob_fn(proposals)
        log_q = self.proposal.log_density(np.concatenate([state.coords, proposals]))
        log_u = np.log(self.rng.random((self.sweeps, walkers)))
        chosen, accepted = _accept(
            state.log_prob,
            log_q[:walkers],
            np.asarray(log_prob).reshape(self.sweeps, walkers),
            log_q[walkers:].reshape(self.sweeps, walkers),
            log_u,
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


@compiled(nogil=True)
def _accept(log_prob, log_q, proposed_prob, proposed_q, log_u):
    """Sweep through the proposals of every walker.

    Returns
    -------
    chosen : int64 ndarray, shape (walkers,)
        The sweep whose proposal each walker ends on, or -1 where it stays.
    accepted : int
        Proposals accepted in all.
    """
    sweeps, walkers = proposed_prob.shape
    chosen = np.full(walkers, -1)
    accepted = 0
    for i in range(walkers):
        # ln pi(x) - ln q(x), the importance weight of where the walker stands
        weight = log_prob[i] - log_q[i]
        for s in range(sweeps):
            candidate = proposed_prob[s, i] - proposed_q[s, i]
            if log_u[s, i] < candidate - weight:
                weight = candidate
                chosen[i] = s
                accepted += 1
    return chosen, accepted
