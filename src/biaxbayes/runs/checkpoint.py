"""Checkpoints: the state of a run between two blocks, written so that no crash can lose it.

One NumPy archive holds arrays and a JSON text; nothing in it is ever executed or unpickled.
Writing goes to a temporary name, is synced, and replaces the previous checkpoint, which stays under
a second name until the next one. A checksum shows whether one is damaged.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from biaxbayes.errors import CannotResume, InputError, RunError
from biaxbayes.sampling.adaptation import WarmUp
from biaxbayes.sampling.proposal import MixtureProposal
from biaxbayes.sampling.sampler import Checkpoint
from biaxbayes.text_files import atomic_write_bytes, read_bytes, sync_folder

FORMAT = 7
NAME = "checkpoint.npz"
PREVIOUS = "checkpoint-previous.npz"
NAMES = (NAME, PREVIOUS)
TEMPORARY_NAME = ".checkpoint-following.npz"
MAX_CHECKPOINT_BYTES = 1_000_000_000


class DamagedCheckpoint(Exception):
    """The bytes of a checkpoint are damaged."""


# --- the state of a run as nested dicts and lists of arrays and plain values, and back ------------


def run_record(state: Checkpoint) -> dict[str, Any]:
    """Arrays and plain values of a run."""
    plain = {**vars(state), "constants": dict(state.constants), "warmup": vars(state.warmup)}
    return plain | {"proposal": state.proposal.arrays()}


def run_state(record: Mapping[str, Any]) -> Checkpoint:
    """Inverse of :func:`run_record`; ValueError if its parts do not fit together."""
    state = Checkpoint(
        constants={"isotropy_scale": float(record["constants"]["isotropy_scale"])},
        proposal=MixtureProposal.from_arrays(record["proposal"]),
        members=[m | {"walker_random": tuple(m["walker_random"])} for m in record["members"]],
        chain=record["chain"],
        steps=int(record["steps"]),
        thin=int(record["thin"]),
        warmup=WarmUp(**record["warmup"]),
        counts=record["counts"],
    )
    ensembles, stored, walkers, d = state.chain.shape
    fits = [
        np.isfinite(state.chain).all(),
        len(state.members) == ensembles >= 1,
        state.steps >= 0 and state.thin >= 1 and -(-state.steps // state.thin) == stored,
        all(part.bounds.shape == (d, 2) for part in state.proposal.parts),
        all(m["coordinates"].shape == (walkers, d) for m in state.members),
        all(np.isfinite(m["coordinates"]).all() for m in state.members),
    ]
    if not all(fits):
        raise ValueError("the parts do not fit together")
    return state


# --- bytes ---------------------------------------------------------------------------------------


def pack_record(record: Any) -> bytes:
    """Nested dicts and lists of arrays and plain values as one archive, behind its checksum."""
    arrays: dict[str, np.ndarray] = {}

    def plain(value: Any, path: str) -> Any:
        if isinstance(value, np.ndarray):
            arrays[path] = value
            return {"array": path}
        if isinstance(value, Mapping):
            return {name: plain(v, f"{path}.{name}") for name, v in value.items()}
        if isinstance(value, list | tuple):
            return [plain(v, f"{path}.{k}") for k, v in enumerate(value)]
        return value

    text = json.dumps({name: plain(v, name) for name, v in record.items()}, default=int)
    buffer = io.BytesIO()
    np.savez(buffer, **arrays, text=np.frombuffer(text.encode(), dtype=np.uint8))  # type: ignore
    data = buffer.getvalue()
    return hashlib.sha256(data).digest() + data


def unpack_record(data: bytes) -> dict[str, Any]:
    """Inverse of :func:`pack_record`; no array is larger than the archive itself."""
    digest, body = data[:32], data[32:]
    if hashlib.sha256(body).digest() != digest:
        raise DamagedCheckpoint("is damaged (its checksum is wrong)")
    with zipfile.ZipFile(io.BytesIO(body)) as entries:
        if any(e.compress_type != zipfile.ZIP_STORED for e in entries.infolist()):
            raise ValueError("compressed")
    with np.load(io.BytesIO(body), allow_pickle=False) as archive:
        arrays = {key: archive[key] for key in archive.files}
    if not all(isinstance(a, np.ndarray) and a.nbytes <= len(body) for a in arrays.values()):
        raise ValueError("not arrays")

    def array_or_dict(value: dict[str, Any]) -> Any:
        return arrays[value["array"]] if value.keys() == {"array"} else value

    text = arrays["text"].tobytes().decode()
    return json.loads(text, object_hook=array_or_dict)


def unpack(
    data: bytes, from_record: Callable[[dict[str, Any]], Any] = run_state
) -> tuple[Any, dict[str, Any]]:
    """State and identity of a checkpoint; RunError if another version wrote it."""
    try:
        stored = unpack_record(data)
        if stored["format"] == FORMAT:
            return from_record(stored["state"]), dict(stored["identity"])
    except DamagedCheckpoint:
        raise
    except Exception as error:  # three parsers of foreign bytes may raise whatever they like
        raise DamagedCheckpoint(f"is damaged ({type(error).__name__})") from None
    raise RunError(
        f"has checkpoint format {_short(stored['format'])}, this version reads {FORMAT}; "
        "finish the run with the version that started it"
    )


# --- files ---------------------------------------------------------------------------------------


def save(
    folder: Path,
    state: Any,
    identity: dict[str, Any],
    record: Callable[[Any], dict[str, Any]] = run_record,
) -> None:
    """Write a checkpoint with the identity of its run (hashes and settings as JSON values)."""
    path, following = folder / NAME, folder / TEMPORARY_NAME
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
    folder: Path,
    identity: dict[str, Any],
    from_record: Callable[[dict[str, Any]], Any] = run_state,
) -> tuple[Any | None, str]:
    """Read the newest intact checkpoint, or None, and a note if a damaged one was skipped.

    Raises RunError for a checkpoint of another run, or if none is readable.
    """
    damaged = []
    now = json.loads(json.dumps(identity))
    for name in NAMES:
        path = folder / name
        if not path.exists() and not path.is_symlink():
            continue
        try:
            state, stored = unpack(read_bytes(path, limit=MAX_CHECKPOINT_BYTES), from_record)
        except (InputError, DamagedCheckpoint) as error:
            problem = error.problem if isinstance(error, InputError) else str(error)
            damaged.append(f"{name} {problem}")
            continue
        except RunError as error:
            raise CannotResume(f"{path}: {error}") from None
        differing = [
            _difference(key, stored.get(key), now.get(key))
            for key in {**now, **stored}
            if stored.get(key) != now.get(key)
        ]
        if differing:
            raise CannotResume(
                f"{path}: belongs to another run, which differs in {', '.join(differing)}; use "
                "the same file and options, or another `out`, or start again without `resume`"
            )
        return state, f"{damaged[0]}; continuing from {name}" if damaged else ""
    if damaged:
        raise CannotResume(f"{folder}: {' and '.join(damaged)}; start again without `resume`")
    return None, ""


def _difference(key: str, there: Any, now: Any) -> str:
    """One setting that differs, with both values where they are short enough to help."""
    if isinstance(there, dict) and isinstance(now, dict):
        inner = [k for k in {**now, **there} if there.get(k) != now.get(k)]
        return ", ".join(_difference(f"{key}: {k}", there.get(k), now.get(k)) for k in inner)
    return f"{key} ({_short(there)} there, {_short(now)} now)"


def _short(value: object) -> str:
    if value is None:
        return "default"
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= 60 else text[:12] + "..."
