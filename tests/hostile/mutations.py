"""Small damage to valid input: bytes, and values deep inside JSON and TOML."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

__all__ = ["TOKENS", "VALUES", "as_toml", "mutated_bytes", "mutated_table", "odd_numbers"]

TOKENS = [
    b"", b",", b"\n", b"\r", b'"', b"'", b"#", b":", b";", b"\t", b" ", b"-", b"0", b"=", b"[",
    b"]", b"{", b"}", b".", b"1e308", b"-1e308", b"1e-320", b"nan", b"inf", b"=A1", b"1_0",
    b"\xff", b"\x00", b"\xef\xbb\xbf", b"\xff\xfe", b"\xe2\x80\xa8", b"\x0b", b"\x1c", b"\x85",
    b"\\u0000", b"\\", "\u0661".encode(), b"null", b"true", b"9" * 400, b"../", b"<b>&amp;",
    b"PK\x03\x04", b"\x89HDF", b"1.0000,", b"1,5",
]  # fmt: skip

VALUES: list[Any] = [
    None, True, False, 0, -1, 1, 2, 10**400, -(2**63), 0.5, -0.0, 1e308, -1e308, 5e-324,
    float("nan"), float("inf"), "", "nan", "x", "x" * 5000, "../../etc/passwd", "/dev/zero",
    "<script>alert(1)</script>", "\x1b[31m", "a\nb", "\x00", "C1", "2 * C1", "\udc80", [], {},
    [[]], [1, 2], [1.0, float("nan")], {"x": 1}, {"distribution": "normal", "mean": 0, "sd": 1},
]  # fmt: skip


def mutated_bytes(
    rng: np.random.Generator, data: bytes, tokens: Sequence[bytes] = TOKENS, most: int = 4
) -> bytes:
    """A few edits: bytes flipped, tokens put in, parts cut or repeated, numbers exchanged."""
    out = bytearray(data)
    longest = int(rng.choice([1, 8, 400]))  # small damage may leave a file valid
    for _ in range(rng.integers(1, most + 1)):
        at = int(rng.integers(max(len(out), 1)))
        kind = rng.choice(["flip", "token", "token", "cut", "repeat", "number"])
        if kind == "flip" and out:
            out[at] = int(rng.integers(256)) if longest > 1 else ord(str(rng.integers(10)))
        elif kind == "token":
            out[at : at + int(rng.integers(min(longest, 8) + 1))] = tokens[
                int(rng.integers(len(tokens)))
            ]
        elif kind == "cut":
            del out[at : at + int(rng.integers(longest + 1))]
        elif kind == "repeat":
            out[at:at] = out[at : at + int(rng.integers(longest + 1))]
        else:
            number = f"{rng.standard_normal():.3g}e{rng.integers(-330, 311)}"
            out[at : at + 4] = number.encode()
    return bytes(out)


def mutated_table(rng: np.random.Generator, table: Any, most: int = 3) -> Any:
    """A copy of nested dicts and lists, a few of whose values, keys or parts are others."""
    table = json.loads(json.dumps(table))
    for _ in range(rng.integers(1, most + 1)):
        place, key = _somewhere(rng, table)
        if place is None:
            return copy.deepcopy(VALUES[rng.integers(len(VALUES))])
        kind = rng.choice(["value", "value", "value", "drop", "rename"])
        if kind == "value":
            place[key] = copy.deepcopy(VALUES[rng.integers(len(VALUES))])
        elif kind == "drop":
            del place[key]
        elif isinstance(place, dict):
            place[f"{key}{rng.integers(3)}"] = place.pop(key)
    return table


def _somewhere(rng: np.random.Generator, table: Any) -> tuple[Any, Any]:
    """A random container in nested ones, and a key of it."""
    place, key = None, None
    while isinstance(table, dict | list) and len(table):
        place = table
        key = (
            list(table)[rng.integers(len(table))]
            if isinstance(table, dict)
            else (int(rng.integers(len(table))))
        )
        table = place[key]
        if rng.random() < 0.3:
            break
    return place, key


def as_toml(table: dict[str, Any]) -> str:
    """A TOML text of a table; what TOML cannot say stands there all the same."""
    return "".join(f"{_key(k)} = {_inline(v)}\n" for k, v in table.items())


def _key(key: str) -> str:
    return json.dumps(key)


def _inline(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_key(k)} = {_inline(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(_inline, value)) + "]"
    if isinstance(value, float):
        return {"nan": "nan", "inf": "inf", "-inf": "-inf"}.get(repr(value), repr(value))
    return json.dumps(value)


FACTORS = (1.0, 1.0, -1.0, 0.0, 0.5, 3.0, 1e3, 1e-3, 1e300)
ADDED = (0.0, 0.0, 0.0, 0.01, -0.01, 1.0, 1e-9)


def odd_numbers(rng: np.random.Generator, text: str) -> str:
    """The same table with a few cells or header values turned into other numbers."""
    lines = text.rstrip("\n").split("\n")
    for _ in range(rng.integers(4)):
        at = int(rng.integers(len(lines)))
        cells = re.split(r"(,|: )", lines[at])
        numeric = [i for i, cell in enumerate(cells) if re.fullmatch(r"[-+\d.e]*\d[-+\d.e]*", cell)]
        if numeric:
            i = int(rng.choice(numeric))
            with np.errstate(all="ignore"):
                cells[i] = repr(
                    float(np.float64(cells[i]) * rng.choice(FACTORS) + rng.choice(ADDED))
                )
            lines[at] = "".join(cells)
    return "\n".join(lines) + "\n"
