"""Checkpoints: the state of a run between two blocks, written so that no crash can lose it.

A new one replaces the previous, which stays under a second name; a checksum shows damage.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from biaxbayes.errors import CannotResume, InputError, RunError
from biaxbayes.sampling.adaptation import WarmUp
from biaxbayes.sampling.proposal import MixtureProposal
from biaxbayes.sampling.sampler import Checkpoint
from biaxbayes.stored_data import DamagedArchive, pack_record, read_record
from biaxbayes.text_files import atomic_write_bytes, sync_folder

FORMAT = 9
NAME = "checkpoint.npz"
PREVIOUS = "checkpoint-previous.npz"
NAMES = (NAME, PREVIOUS)


# --- the state of a run as nested dicts and lists of arrays and plain values, and back ------------


def run_record(state: Checkpoint) -> dict[str, Any]:
    """Arrays and plain values of a run."""
    plain = {**vars(state), "constants": dict(state.constants), "warmup": vars(state.warmup)}
    return plain | {"proposal": state.proposal.arrays()}


def run_state(record: Mapping[str, Any]) -> Checkpoint:
    """Inverse of :func:`run_record`; ValueError if its parts do not fit together."""
    state = Checkpoint(
        constants={
            "isotropy_scale": float(record["constants"]["isotropy_scale"]),
            "terms": [indices.astype(np.int64) for indices in record["constants"]["terms"]],
        },
        proposal=MixtureProposal.from_arrays(record["proposal"]),
        members=[m | {"walker_random": tuple(m["walker_random"])} for m in record["members"]],
        chain=record["chain"],
        log_prob=record["log_prob"],
        steps=int(record["steps"]),
        thin=int(record["thin"]),
        warmup=WarmUp(**record["warmup"]),
        counts=record["counts"],
    )
    ensembles, stored, walkers, d = state.chain.shape
    fits = [
        np.isfinite(state.chain).all(),
        state.log_prob.shape == (ensembles, stored, walkers) and np.isfinite(state.log_prob).all(),
        len(state.members) == ensembles >= 1,
        state.steps >= 0 and state.thin >= 1 and -(-state.steps // state.thin) == stored,
        all(part.bounds.shape == (d, 2) for part in state.proposal.parts),
        all(m["coordinates"].shape == (walkers, d) for m in state.members),
        all(np.isfinite(m["coordinates"]).all() for m in state.members),
    ]
    if not all(fits):
        raise ValueError("the parts do not fit together")
    return state


# --- files ---------------------------------------------------------------------------------------


def save(
    folder: Path,
    state: Any,
    identity: dict[str, Any],
    record: Callable[[Any], dict[str, Any]] = run_record,
) -> None:
    """Write a checkpoint with the identity of its run (hashes and settings as JSON values)."""
    path, following = folder / NAME, folder / ".checkpoint-following.npz"
    data = pack_record({"format": FORMAT, "identity": identity, "state": record(state)})
    try:
        atomic_write_bytes(following, data)
        # At every moment one of the names holds the newest whole checkpoint.
        if path.exists():
            path.replace(folder / PREVIOUS)
        following.replace(path)
    except (InputError, OSError) as error:
        raise RunError(
            f"the checkpoint could not be saved: {error}; the one before it remains, "
            "and the same command with `resume=True` continues from there"
        ) from None
    sync_folder(folder)


def load(
    folder: Path, identity: dict[str, Any], from_record: Callable[[dict[str, Any]], Any] = run_state
) -> tuple[Any | None, str]:
    """The newest intact checkpoint of this run, or None; a note if a damaged one was skipped."""
    damaged = []
    now = json.loads(json.dumps(identity))
    for name in NAMES:
        path = folder / name
        if not path.exists() and not path.is_symlink():
            continue
        try:
            stored = read_record(path)
            before, found = dict(stored["identity"]), stored["format"]
            state = from_record(stored["state"]) if found == FORMAT else None
        except DamagedArchive as error:
            damaged.append(f"{name} {error}")
            continue
        except Exception as error:  # whatever foreign values make of it
            damaged.append(f"{name} is damaged ({type(error).__name__})")
            continue
        if found != FORMAT:
            problem = f"has checkpoint format {_short(found)}, this version reads {FORMAT}"
            remedy = "finish the run with the version that started it"
            raise CannotResume(f"{path}: {problem}; {remedy}")
        if differing := _differences(before, now):
            raise CannotResume(
                f"{path}: belongs to another run, which differs in {', '.join(differing)}; use "
                "the same file and options, or another `out`, or start again without `resume`"
            )
        return state, f"{damaged[0]}; continuing from {name}" if damaged else ""
    if damaged:
        raise CannotResume(f"{folder}: {' and '.join(damaged)}; start again without `resume`")
    return None, ""


def _differences(before: dict[str, Any], now: dict[str, Any], of: str = "") -> list[str]:
    """Settings that differ, with both values where they are short enough to help."""
    differing = []
    for key in {**now, **before}:
        a, b = before.get(key), now.get(key)
        if isinstance(a, dict) and isinstance(b, dict) and a != b:
            # a key that is None in one and missing in the other is not named
            differing += _differences(a, b, f"{of}{key}: ") or [""]
        elif a != b:
            differing.append(f"{of}{key} ({_short(a)} there, {_short(b)} now)")
    return differing


def _short(value: object) -> str:
    if value is None:
        return "default"
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= 60 else text[:12] + "..."
