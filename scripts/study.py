"""Run one of the studies behind the pages of ``docs/``.

    python scripts/study.py                 lists them
    python scripts/study.py laws --help

A study is a file of ``scripts/studies/``, or a folder with a ``study.py``, that has a ``main()``.
"""

from __future__ import annotations

import ast
import sys
from importlib import import_module
from pathlib import Path

FOLDER = Path(__file__).resolve().parent / "studies"


def studies() -> dict[str, Path]:
    """The file of every study, by name."""
    files = {path.stem: path for path in FOLDER.glob("*.py")}
    files |= {path.parent.name: path for path in FOLDER.glob("*/study.py")}
    return {n: p for n, p in sorted(files.items()) if "\ndef main() -> " in p.read_text("utf-8")}


def main() -> int:
    """Run the study that is named first; without a name, list them."""
    found = studies()
    name = sys.argv[1] if len(sys.argv) > 1 else ""
    if name not in found:
        for known, path in found.items():
            said = ast.get_docstring(ast.parse(path.read_text("utf-8"))) or ""
            print(f"{known:24}{said.splitlines()[0]}")
        return 2 if name else 0
    del sys.argv[0]  # what is left looks to the study like its own command line
    within = ".".join(found[name].relative_to(FOLDER).with_suffix("").parts)
    return import_module(f"studies.{within}").main() or 0


if __name__ == "__main__":
    sys.exit(main())
