"""Checkpoints: the state of a run between two blocks, written so that no crash can lose it.

One NumPy archive holds arrays and a JSON text; nothing in it is ever executed or unpickled.
Writing goes to a temporary name, is synced, and replaces the previous checkpoint, which is kept
under a second name until the next one.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from biaxbayes.errors import InputError, RunError
from biaxbayes.inference.proposal import Proposal
from biaxbayes.inference.sampler import State
from biaxbayes.inference.warmup import WarmUp
from biaxbayes.specimens.text_file import atomic_write_bytes

__all__ = ["FORMAT", "NAME", "PREVIOUS", "load", "save"]

FORMAT = 1
NAME = "checkpoint.npz"
PREVIOUS = "checkpoint-previous.npz"


def save(folder: Path, state: State, identity: dict[str, Any]) -> None:
    """Write a checkpoint into a folder.

    Parameters
    ----------
    folder : Path
    state : State
    identity : dict
        What the run is a run of (hashes and settings, JSON values); a checkpoint of anything
        else will be refused.
    """
    path = folder / NAME
    data = _pack(state, identity)
    if path.exists():
        # Both names hold a whole checkpoint at every moment.
        previous = folder / PREVIOUS
        previous_temporary = folder / f".{PREVIOUS}.tmp"
        previous_temporary.unlink(missing_ok=True)
        try:
            os.link(path, previous_temporary)
            previous_temporary.replace(previous)
        except OSError:
            pass  # file systems without hard links keep one checkpoint
    try:
        atomic_write_bytes(path, data)
    except InputError as error:
        raise RunError(f"the checkpoint could not be saved: {error}") from None


def load(folder: Path, identity: dict[str, Any]) -> tuple[State | None, str]:
    """Read the newest readable checkpoint of a folder.

    Returns
    -------
    state : State or None
        None where there is no checkpoint.
    note : str
        Empty, or that a damaged checkpoint was passed over.

    Raises
    ------
    RunError
        If the checkpoint belongs to another problem, naming what differs, or if none is
        readable.
    """
    note = ""
    found = False
    for name in (NAME, PREVIOUS):
        path = folder / name
        if not path.exists():
            continue
        found = True
        try:
            state, stored = _unpack(path.read_bytes())
        except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile, EOFError) as error:
            note = f"{name} is damaged ({type(error).__name__}); going back to the one before it"
            continue
        differing = [
            f"{key} ({_short(stored.get(key))} there, {_short(value)} now)"
            for key, value in identity.items()
            if stored.get(key) != value
        ]
        if differing:
            raise RunError(
                f"{path}: is a checkpoint of another run, it differs in {', '.join(differing)}; "
                "use the same file and options, or another --out"
            )
        return state, note
    if found:
        raise RunError(f"{folder}: no checkpoint there is readable; start again without --resume")
    return None, note


def _short(value: object) -> str:
    text = json.dumps(value) if not isinstance(value, str) else value
    return text if len(text) <= 24 else text[:21] + "..."


def _pack(state: State, identity: dict[str, Any]) -> bytes:
    arrays: dict[str, np.ndarray] = {"chain": state.chain, "rejected": state.rejected}
    members = []
    for i, member in enumerate(state.members):
        plain = dict(member)
        arrays[f"coordinates_{i}"] = plain.pop("coordinates")
        arrays[f"log_prob_{i}"] = plain.pop("log_prob")
        walker = dict(plain.pop("walker_random"))
        inner = dict(walker["state"])
        arrays[f"walker_key_{i}"] = inner.pop("key")
        plain["walker_random"] = walker | {"state": inner}
        members.append(plain)
    arrays |= {f"proposal_{k}": v for k, v in state.proposal.arrays().items()}
    text = json.dumps(
        {
            "format": FORMAT,
            "identity": identity,
            "members": members,
            "chart": state.chart,
            "steps": state.steps,
            "thin": state.thin,
            "evaluations": state.evaluations,
            "finished": state.finished,
            "warmup": vars(state.warmup),
        },
        default=int,
    )
    arrays["text"] = np.frombuffer(text.encode(), dtype=np.uint8)
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    data = buffer.getvalue()
    return hashlib.sha256(data).digest() + data


def _unpack(data: bytes) -> tuple[State, dict[str, Any]]:
    digest, body = data[:32], data[32:]
    if hashlib.sha256(body).digest() != digest:
        raise ValueError("checksum")
    with np.load(io.BytesIO(body), allow_pickle=False) as archive:
        arrays = {key: archive[key] for key in archive.files}
    stored = json.loads(arrays["text"].tobytes().decode())
    if stored["format"] != FORMAT:
        raise RunError(
            f"the checkpoint has format {stored['format']}, this version reads {FORMAT}; "
            "finish the run with the version that started it"
        )
    members = []
    for i, plain in enumerate(stored["members"]):
        walker = plain["walker_random"]
        inner = walker["state"] | {"key": arrays[f"walker_key_{i}"]}
        members.append(
            plain
            | {
                "coordinates": arrays[f"coordinates_{i}"],
                "log_prob": arrays[f"log_prob_{i}"],
                "walker_random": walker | {"state": inner},
            }
        )
    prefix = "proposal_"
    proposal = Proposal.from_arrays(
        {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}
    )
    state = State(
        chart=int(stored["chart"]),
        proposal=proposal,
        members=members,
        chain=arrays["chain"],
        steps=int(stored["steps"]),
        thin=int(stored["thin"]),
        warmup=WarmUp(**stored["warmup"]),
        evaluations=int(stored["evaluations"]),
        rejected=arrays["rejected"],
        finished=bool(stored["finished"]),
    )
    return state, stored["identity"]
