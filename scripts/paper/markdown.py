"""Markdown pieces."""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["image", "number", "table"]


def table(header: Sequence[str], rows: Sequence[Sequence[str]], *, left: int = 1) -> str:
    """A pipe table; the first ``left`` columns are text, the others numbers."""
    rule = [":---" if i < left else "---:" for i in range(len(header))]
    lines = [header, rule, *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines) + "\n"


def image(name: str, text: str) -> str:
    """An image of the page's own figures, with its caption."""
    return f"![{text}](figures/{name})\n\n*{text}*\n"


def number(value: float, digits: int = 4) -> str:
    """A number with so many significant digits, never in powers of ten."""
    if value == 0.0:
        return "0"
    text = f"{value:.{digits}g}"
    if "e" in text:
        text = f"{value:.0f}" if abs(value) >= 1 else f"{value:.6f}".rstrip("0")
    return text
