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
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from biaxbayes.errors import CannotResume, InputError, RunError
from biaxbayes.sampling.adaptation import WarmUp
from biaxbayes.sampling.proposal import MixtureProposal, TransportedMixture
from biaxbayes.sampling.sampler import State
from biaxbayes.text_files import atomic_write_bytes, read_bytes, sync_folder

FORMAT = 5
NAME = "checkpoint.npz"
PREVIOUS = "checkpoint-previous.npz"
NAMES = (NAME, PREVIOUS)
FOLLOWING = ".checkpoint-following.npz"
MAX_BYTES = 1_000_000_000


class DamagedCheckpoint(Exception):
    """The bytes are not what was written."""


def save(
    folder: Path,
    state: Any,
    identity: dict[str, Any],
    pack: Callable[[Any, dict[str, Any]], bytes] | None = None,
) -> None:
    """Write a checkpoint with the identity of its run (hashes and settings as JSON values)."""
    path, following = folder / NAME, folder / FOLLOWING
    try:
        atomic_write_bytes(following, (pack or _pack)(state, identity))
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
    reader: Callable[[bytes], tuple[Any, dict[str, Any]]] | None = None,
) -> tuple[Any | None, str]:
    """Read the newest intact checkpoint, or None, and a note if a damaged one was skipped.

    Raises RunError for a checkpoint of another run, or if none is readable.
    """
    damaged = []
    for name in NAMES:
        path = folder / name
        if not path.exists() and not path.is_symlink():
            continue
        try:
            state, stored = (reader or unpack)(read_bytes(path, limit=MAX_BYTES))
        except (InputError, DamagedCheckpoint) as error:
            problem = error.problem if isinstance(error, InputError) else str(error)
            damaged.append(f"{name} {problem}")
            continue
        except RunError as error:
            raise CannotResume(f"{path}: {error}") from None
        now = json.loads(json.dumps(identity))
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


def _pack(state: State, identity: dict[str, Any]) -> bytes:
    arrays: dict[str, np.ndarray] = {"chain": state.chain, "rejected": state.rejected}
    members = []
    for i, member in enumerate(state.members):
        plain = dict(member)
        arrays[f"coordinates_{i}"] = plain.pop("coordinates")
        arrays[f"log_prob_{i}"] = plain.pop("log_prob")
        name, arrays[f"walker_key_{i}"], *rest = plain.pop("walker_random")
        plain["walker_random"] = [name, *rest]
        members.append(plain)
    arrays |= {f"proposal_{k}": v for k, v in state.proposal.arrays().items()}
    text = json.dumps(
        {
            "format": FORMAT,
            "identity": identity,
            "members": members,
            "frame": dict(state.frame),
            "steps": state.steps,
            "thin": state.thin,
            "evaluations": state.evaluations,
            "finished": state.finished,
            "warmup": vars(state.warmup),
        },
        default=int,
    )
    return sealed(arrays, text)


def sealed(arrays: dict[str, np.ndarray], text: str) -> bytes:
    """Arrays and a JSON text as one archive, behind its checksum."""
    buffer = io.BytesIO()
    whole = arrays | {"text": np.frombuffer(text.encode(), dtype=np.uint8)}
    np.savez(buffer, **whole)  # type: ignore[arg-type]
    data = buffer.getvalue()
    return hashlib.sha256(data).digest() + data


def opened(data: bytes) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Arrays and text of :func:`sealed` bytes; DamagedCheckpoint if the bytes have changed."""
    digest, body = data[:32], data[32:]
    if hashlib.sha256(body).digest() != digest:
        raise DamagedCheckpoint("is damaged (its checksum is wrong)")
    try:
        arrays = _arrays(body)
        return arrays, json.loads(arrays["text"].tobytes().decode())
    except Exception as error:  # three parsers of foreign bytes may raise whatever they like
        raise DamagedCheckpoint(f"is damaged ({type(error).__name__})") from None


def unpack(data: bytes) -> tuple[State, dict[str, Any]]:
    """State and identity of a checkpoint; RunError if another version wrote it."""
    arrays, stored = opened(data)
    try:
        if stored["format"] != FORMAT:
            raise RunError(
                f"has checkpoint format {_short(stored['format'])}, this version reads {FORMAT}; "
                "finish the run with the version that started it"
            )
        state = _state(stored, arrays)
        _check(state)
        return state, dict(stored["identity"])
    except RunError:
        raise
    except Exception as error:  # three parsers of foreign bytes may raise whatever they like
        raise DamagedCheckpoint(f"is damaged ({type(error).__name__})") from None


def _arrays(body: bytes) -> dict[str, np.ndarray]:
    """Arrays of the archive, none of them larger than the archive itself."""
    with zipfile.ZipFile(io.BytesIO(body)) as entries:
        if any(e.compress_type != zipfile.ZIP_STORED for e in entries.infolist()):
            raise ValueError("compressed")
    with np.load(io.BytesIO(body), allow_pickle=False) as archive:
        arrays = {key: archive[key] for key in archive.files}
    if not all(isinstance(a, np.ndarray) and a.nbytes <= len(body) for a in arrays.values()):
        raise ValueError("not arrays")
    return arrays


def _state(stored: dict[str, Any], arrays: dict[str, np.ndarray]) -> State:
    members = []
    for i, plain in enumerate(stored["members"]):
        name, *rest = plain["walker_random"]
        members.append(
            plain
            | {
                "coordinates": arrays[f"coordinates_{i}"],
                "log_prob": arrays[f"log_prob_{i}"],
                "walker_random": (name, arrays[f"walker_key_{i}"], *rest),
            }
        )
    prefix = "proposal_"
    proposal = MixtureProposal.from_arrays(
        {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}
    )
    return State(
        frame={"softening": float(stored["frame"]["softening"])},
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


def _check(state: State) -> None:
    """Refuse a state whose parts do not fit together: whoever made it, it was not this program."""
    ensembles, _, walkers, d = state.chain.shape
    shares = state.proposal.weights
    fits = [
        state.chain.dtype == shares.dtype == np.float64,
        shares.shape == (len(state.proposal.parts),) and len(shares) >= 1,
        *(_fits(part, d) for part in state.proposal.parts),
        len(state.members) == ensembles >= 1,
        state.steps >= 0 and state.thin >= 1 and np.isfinite(state.frame["softening"]),
        -(-state.steps // state.thin) == state.chain.shape[1],
        np.isfinite(state.chain).all(),
        state.rejected.shape == (4,) and state.rejected.dtype.kind == "i",
    ]
    for member in state.members:
        fits += [
            member["coordinates"].shape == (walkers, d),
            member["log_prob"].shape == (walkers,),
            bool(
                np.isfinite(member["coordinates"]).all() and np.isfinite(member["log_prob"]).all()
            ),
        ]
        np.random.RandomState().set_state(member["walker_random"])
        np.random.PCG64().state = member["proposal_random"]
        float(member["independence_share"]), int(member["tried"]), int(member["accepted"])
        int(member["evaluations"])
    if not all(fits):
        raise ValueError("the parts do not fit together")


def _fits(part: TransportedMixture, d: int) -> bool:
    """True if the arrays of a proposal in d dimensions fit together."""
    mixture, transport = part.mixture, part.transport
    k = mixture.weights.size
    floats = [mixture.weights, mixture.means, mixture.factors, part.bounds]
    floats += [transport.centre, transport.scale, transport.coefficients, transport.widths]
    return (
        all(a.dtype == np.float64 for a in floats)
        and mixture.means.shape == (k, d)
        and mixture.factors.shape == (k, d, d)
        and part.bounds.shape == (d, 2)
        and transport.centre.shape == transport.scale.shape == (d,)
        and transport.coefficients.ndim == transport.widths.ndim == 2
        and len(transport.coefficients) == len(transport.widths) == d
        and sorted(transport.order.tolist()) == list(range(d))
    )
