"""Fonts inside a PDF: the outlines of letters, cut out of a font once for all files of a process.

To read a font's names and rules for setting text, and to cut them down to the letters that are
used, takes longer than all else about it. To cut the outlines takes as long as a small figure.
"""

from __future__ import annotations

import io
import string
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache, lru_cache
from typing import Any

__all__ = ["OUTLINES", "letters_alone"]

OUTLINES = {"GlyphOrder", "glyf", "head", "hhea", "hmtx", "loca", "maxp", "cvt ", "fpgm", "prep"}
"""Tables of a TrueType font that a PDF needs (ISO 32000-1, 9.9)."""
ALPHABET = string.ascii_letters + string.digits + " %()+,-./:;<=>[]°±–−"
"""What a font of words holds in each file, used or not, so that files share it."""
WORDS = 16
"""Letters from which on they are words; a figure has fewer symbols, mostly the same ones."""
MOST_CUT = 32
"""Fonts kept, 10 to 30 kB each."""
_cut: dict[Any, tuple[bytes, dict[int, int]]] = {}


@contextmanager
def letters_alone() -> Iterator[None]:
    """Have matplotlib write PDFs with such fonts; it asks fontTools for them by these names."""
    from fontTools import subset

    whole = _whole()
    subset.load_font, subset.Subsetter = _Font, _Letters  # type: ignore[assignment,misc]
    try:
        yield
    finally:
        subset.load_font, subset.Subsetter = whole


@cache
def _whole() -> tuple[Any, Any]:
    """What fontTools opens a font and cuts it down with."""
    from fontTools import subset

    return subset.load_font, subset.Subsetter


class _Font:
    """In place of an open font: what is left of it."""

    def __init__(self, file: Any, options: Any) -> None:
        self.file, self.options = file, options
        self.data = b""

    def save(self, file: Any, **_: Any) -> None:
        file.write(self.data)

    def __enter__(self) -> _Font:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing is open."""


class _Letters:
    """In place of what cuts a font down to glyphs."""

    def __init__(self, options: Any) -> None:
        self.glyphs: frozenset[int] = frozenset()
        self.glyph_index_map: dict[int, int] = {}

    def populate(self, *, gids: Any) -> None:
        self.glyphs = frozenset(gids)

    def subset(self, font: _Font) -> None:
        name = str(font.file), font.options.font_number
        glyphs = self.glyphs | (_alphabet(*name) if len(self.glyphs) >= WORDS else frozenset())
        if (name, glyphs) not in _cut:
            if len(_cut) >= MOST_CUT:
                _cut.clear()
            _cut[name, glyphs] = _cut_out(font, glyphs)
        font.data, self.glyph_index_map = _cut[name, glyphs]


@lru_cache(MOST_CUT)
def _alphabet(file: str, face: int) -> frozenset[int]:
    """Glyphs of the alphabet in a font."""
    from matplotlib.ft2font import FT2Font

    font = FT2Font(file, face_index=max(face, 0))
    return frozenset(font.get_char_index(ord(letter)) for letter in ALPHABET)


def _cut_out(of: _Font, glyphs: frozenset[int]) -> tuple[bytes, dict[int, int]]:
    """A file of some glyphs of a font, and their numbers there by those in the font."""
    load, cutter = _whole()
    of.options.glyph_names = False
    with load(of.file, of.options) as font:
        if "glyf" in font:  # outlines of another kind are left as they are
            for table in set(font.keys()) - OUTLINES:
                del font[table]
            font.setGlyphOrder([f"glyph{i:05d}" for i in range(font["maxp"].numGlyphs)])
        cut, out = cutter(options=of.options), io.BytesIO()
        cut.populate(gids=glyphs)
        cut.subset(font)
        font.save(out, reorderTables=False)
    return out.getvalue(), cut.glyph_index_map
