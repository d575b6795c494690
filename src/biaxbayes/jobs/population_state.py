"""The state of a population between two blocks, as the bytes of a checkpoint."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from biaxbayes.errors import RunError
from biaxbayes.populations.ensemble import Tuning
from biaxbayes.populations.sampler import History, State
from biaxbayes.populations.spreading import Spreading
from biaxbayes.runs import checkpoint
from biaxbayes.sampling.proposal import TransportedMixture

__all__ = ["pack", "unpack"]


FORMAT = 2


def pack(state: State, identity: dict[str, Any]) -> bytes:
    """State and what it is a state of, as bytes."""
    arrays: dict[str, np.ndarray] = {}
    members = []
    for k, member in enumerate(state.members):
        arrays |= {f"m{k}.{n}": v for n, v in member.items() if isinstance(v, np.ndarray)}
        accepted = {n: v.tolist() for n, v in member["accepted"].items()}
        members.append({"rng": member["rng"], "accepted": accepted})
    tuning = state.tuning
    arrays |= {f"archive{i}": a for i, a in enumerate(tuning.archives)}
    for i, q in enumerate(tuning.proposals):
        arrays |= {f"q{i}.{n}": v for n, v in q.arrays().items()}
    arrays |= {"directions": tuning.directions, "steps": tuning.steps}
    if tuning.spreading is not None:
        arrays |= {f"spreading.{n}": v for n, v in vars(tuning.spreading).items()}
    if state.history is not None:
        arrays |= {f"h.{n}": v for n, v in state.history.arrays().items()}
    text = json.dumps(
        {
            "format": FORMAT,
            "identity": identity,
            "members": members,
            "specimens": len(tuning.archives),
            "sweeps": state.sweeps,
            "block": state.block,
            "every": state.history.every if state.history is not None else 0,
            "finished": state.finished,
        },
        default=int,
    )
    return checkpoint.sealed(arrays, text)


def unpack(data: bytes) -> tuple[State, dict[str, Any]]:
    """Inverse of :func:`pack`.

    Raises
    ------
    DamagedCheckpoint
        If the bytes are not what was written.
    RunError
        If another version wrote them.
    """
    arrays, stored = checkpoint.opened(data)
    try:
        if stored["format"] != FORMAT:
            raise RunError("has the checkpoint of another version; start again without --resume")

        def part(prefix: str) -> dict[str, np.ndarray]:
            return {n.removeprefix(prefix): v for n, v in arrays.items() if n.startswith(prefix)}

        members = []
        for k, plain in enumerate(stored["members"]):
            accepted = {n: np.array(v) for n, v in plain["accepted"].items()}
            members.append({**part(f"m{k}."), "rng": plain["rng"], "accepted": accepted})
        number = int(stored["specimens"])
        tuning = Tuning(
            tuple(arrays[f"archive{i}"] for i in range(number)),
            tuple(TransportedMixture.from_arrays(part(f"q{i}.")) for i in range(number)),
            arrays["directions"],
            arrays["steps"],
            Spreading(**spreading) if (spreading := part("spreading.")) else None,
        )
        own = part("h.")
        history = History.from_arrays(own, int(stored["every"])) if own else None
        state = State(
            tuning,
            members,
            history,
            int(stored["sweeps"]),
            int(stored["block"]),
            bool(stored["finished"]),
        )
        return state, dict(stored["identity"])
    except (KeyError, ValueError, TypeError, AttributeError) as error:
        raise checkpoint.DamagedCheckpoint(f"is damaged ({type(error).__name__})") from None
