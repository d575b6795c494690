"""Count the words of the documentation, page by page: ``python scripts/docs_words.py``."""

from __future__ import annotations

import sys
from pathlib import Path

DOCS = Path(__file__).resolve().parents[1] / "docs"
MOST = 20_000


def main() -> int:
    words = {page.name: len(page.read_text(encoding="utf-8").split()) for page in DOCS.glob("*.md")}
    for name, count in sorted(words.items(), key=lambda item: -item[1]):
        print(f"{count:6d}  {name}")
    print(f"{sum(words.values()):6d}  of at most {MOST}")
    return int(sum(words.values()) > MOST)


if __name__ == "__main__":
    sys.exit(main())
