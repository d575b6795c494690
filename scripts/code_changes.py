"""Which top-level definitions of the package compute something else than they did at a commit.

What only moved to another file, and what is words or layout (docstrings, comments, import lines),
is the same. What was removed and not replaced is no difference.
"""

from __future__ import annotations

import ast
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

Tree = dict[str, str]
"""Content ids (git blobs) of the files of a commit by their path."""


@dataclass(frozen=True)
class Definition:
    """A top-level statement of a module, or the whole of a file that is no Python.

    Attributes
    ----------
    name : str
        What the statement binds; its first line where it binds nothing.
    code : str
        What it computes: its syntax tree without docstrings, comments and imports.
    """

    name: str
    code: str


class Change(NamedTuple):
    """A change of some folders of the package that is no difference.

    Attributes
    ----------
    before, after : str
        Commits.
    rooms : tuple of str
        Relative to the root.
    """

    before: str
    after: str
    rooms: tuple[str, ...]


def differing(
    root: Path, commit: str, rooms: list[str], package: str, same: Sequence[Change] = ()
) -> list[str] | None:
    """Definitions in some folders of HEAD that are nowhere in the package at another commit.

    Parameters
    ----------
    root : Path
        The checkout.
    commit : str
        The other commit.
    rooms : list of str
        Folders and files of the package, relative to the root.
    package : str
        Folder of the whole package, relative to the root.
    same : sequence of Change
        The oldest first. Where the package at ``commit`` has what a change replaced, what it put in
        its place counts as known.

    Returns
    -------
    list of str or None
        ``file name`` each, the file relative to the package, in order; None without git or without
        that commit.
    """
    old, new = _tree(root, commit, package), _tree(root, "HEAD", package)
    if old is None or new is None:
        return None
    then = _all_definitions(root, old)
    for change in same:
        trees = [_tree(root, at, package) for at in (change.before, change.after)]
        before, after = (_all_definitions(root, _within(t or {}, change.rooms)) for t in trees)
        if before and before - after <= then:
            then |= after - before
    unchanged = set(old.values())
    return [
        f"{path.removeprefix(f'{package}/')} {definition.name}".strip()
        for path, blob in new.items()
        if blob not in unchanged and _is_within(path, rooms)
        for definition in _definitions(root, blob, path)
        if definition not in then
    ]


# --- what git has ---------------------------------------------------------------------------------


_CONTENTS: dict[tuple[Path, str], bytes] = {}


def _tree(root: Path, commit: str, package: str) -> Tree | None:
    """Files below a folder at a commit, whose contents are then read."""
    listed = _git(root, "ls-tree", "-r", "-z", commit, "--", package)
    if listed is None:
        return None
    pairs = (line.split("\t") for line in listed.decode().split("\0") if line)
    tree = {path: kind.split()[2] for kind, path in pairs}
    missing = sorted({blob for blob in tree.values() if (root, blob) not in _CONTENTS})
    told = _git(root, "cat-file", "--batch", stdin="\n".join(missing)) or b""
    at = 0
    for blob in missing:  # "id kind size", the content, and an empty line's end
        begin = told.index(b"\n", at) + 1
        end = begin + int(told[at:begin].split()[2])
        _CONTENTS[root, blob] = told[begin:end]
        at = end + 1
    return tree


def _git(root: Path, *arguments: str, stdin: str = "") -> bytes | None:
    try:
        done = subprocess.run(
            ["git", *arguments], cwd=root, input=stdin.encode(), capture_output=True
        )
    except OSError:
        return None
    return done.stdout if done.returncode == 0 else None


# --- what a file defines --------------------------------------------------------------------------


def _is_within(path: str, rooms: Sequence[str]) -> bool:
    return any(path == room or path.startswith(f"{room}/") for room in rooms)


def _within(tree: Tree, rooms: Sequence[str]) -> Tree:
    return {path: blob for path, blob in tree.items() if _is_within(path, rooms)}


def _all_definitions(root: Path, tree: Tree) -> set[Definition]:
    """The definitions of every file of a tree."""
    return {known for path, blob in tree.items() for known in _definitions(root, blob, path)}


@cache
def _definitions(root: Path, blob: str, path: str) -> dict[Definition, None]:
    """The definitions of a file, in order."""
    content = _CONTENTS[root, blob]
    if not path.endswith(".py"):
        return {Definition("", blob): None}
    return dict.fromkeys(definitions(content.decode()))


def definitions(text: str) -> list[Definition]:
    """The top-level definitions of a module, in order."""
    module = ast.parse(text)
    _without_words(module)
    found = []
    for node in module.body:
        if isinstance(node, ast.If) and not (node.body or node.orelse):
            continue  # imports for the types alone
        name = _name(node)
        if name != "__all__":
            found.append(Definition(name, ast.dump(node)))
    return found


def _without_words(node: ast.AST) -> None:
    """Take docstrings and imports out of every block below a statement."""
    for part in ("body", "orelse", "finalbody", "handlers", "cases"):
        children = getattr(node, part, None)
        if isinstance(children, list):
            kept = [child for child in children if not _is_words(child)]
            setattr(node, part, kept)
            for child in kept:
                _without_words(child)


def _is_words(node: ast.AST) -> bool:
    """Whether a statement is an import, or a text alone: a docstring of what it stands in."""
    value = node.value if isinstance(node, ast.Expr) else None
    text = isinstance(value, ast.Constant) and isinstance(value.value, str)
    return text or isinstance(node, (ast.Import, ast.ImportFrom))


def _name(node: ast.stmt) -> str:
    """What a statement binds."""
    match node:
        case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.ClassDef():
            return node.name
        case ast.Assign(targets=[target, *_]) | ast.AnnAssign(target=target):
            return ast.unparse(target)
        case _:
            return ast.unparse(node).splitlines()[0]
