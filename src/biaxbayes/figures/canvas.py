"""What figures are drawn on and written with.

Matplotlib sets each symbol anew for every size and file, and reads a font's rules for setting text
to put its letters into a page: here symbols are kept, and fonts are outlines alone.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg

__all__ = ["OUTLINES", "canvas", "letters_alone"]


PNG_LEVEL = 3
"""Of zlib: a file of a corner plot a fifth larger than at its default 6, in half the time."""


@cache
def canvas() -> type[FigureCanvasAgg]:
    """The class of canvas that figures are drawn on; matplotlib is not imported before."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    symbols = _symbols()

    class Canvas(FigureCanvasAgg):
        def get_renderer(self) -> RendererAgg:
            renderer = super().get_renderer()
            renderer.mathtext_parser = symbols
            return renderer

        def print_png(self, filename_or_obj: Any, **_: Any) -> None:
            """As matplotlib's own, without the opacity of a picture that is opaque everywhere."""
            FigureCanvasAgg.draw(self)
            pixels, dpi = self.buffer_rgba(), self.figure.dpi
            opaque = np.asarray(pixels)[..., 3].min() == 255
            drawn = "RGBX" if opaque else "RGBA"
            size = self.get_width_height(physical=True)
            picture = Image.frombuffer(drawn, size, pixels, "raw", drawn, 0, 1)
            if opaque:  # the same memory: a copy of a corner plot takes 18 MB
                picture = Image.fromarrow(picture, "RGB", size)
            picture.save(filename_or_obj, "PNG", dpi=(dpi, dpi), compress_level=PNG_LEVEL)

        def print_pdf(self, filename_or_obj: Any, *, metadata: Any = None, **_: Any) -> None:
            """As matplotlib's own, whose renderer cannot be told of the symbols."""
            from matplotlib.backends.backend_mixed import MixedModeRenderer
            from matplotlib.backends.backend_pdf import PdfFile, RendererPdf

            dpi, self.figure.dpi = self.figure.dpi, 72.0
            width, height = self.figure.get_size_inches()
            file = PdfFile(filename_or_obj, metadata=metadata)
            try:
                file.newPage(width, height)
                page: Any = RendererPdf(file, dpi, height, width)
                getattr(page, "_text2path", page).mathtext_parser = symbols  # no public name
                renderer: Any = MixedModeRenderer(self.figure, width, height, dpi, page)
                self.figure.draw(renderer)
                renderer.finalize()
                with letters_alone():
                    file.finalize()
            finally:
                file.close()

    return Canvas


# --- symbols -------------------------------------------------------------------------------------


MOST_SYMBOLS = 1000
"""Kept typeset."""
_typeset: dict[Any, Any] = {}


def _symbols() -> Any:
    """A parser that sets each symbol once a process, which matplotlib's forget with the figure."""
    import matplotlib as mpl
    from matplotlib.mathtext import MathTextParser

    settings = [k for k in mpl.rcParams if k.startswith("mathtext.") or k == "text.hinting"]
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=_forget_symbols)

    class Symbols(MathTextParser):
        def parse(
            self, s: str, dpi: float = 72, prop: Any = None, *, antialiased: bool | None = None
        ) -> Any:
            style = tuple(str(mpl.rcParams[k]) for k in settings)
            key = (s, dpi, prop and prop.copy(), antialiased, style)
            if key not in _typeset:
                if len(_typeset) >= MOST_SYMBOLS:
                    _typeset.clear()
                _typeset[key] = super().parse(s, dpi, prop, antialiased=antialiased)
            return _typeset[key]

    return Symbols("path")


def _forget_symbols() -> None:
    """Let go of typeset symbols, whose fonts are files that the process that forked reads, too.

    Both would move the place at which the other one reads: letters out of place, or none. Of
    matplotlib's two caches that hold fonts one is emptied at a fork by itself.
    """
    from matplotlib.mathtext import MathTextParser

    _typeset.clear()
    MathTextParser._parse_cached.cache_clear()  # type: ignore[attr-defined]


# --- letters -------------------------------------------------------------------------------------


OUTLINES = {"GlyphOrder", "glyf", "head", "hhea", "hmtx", "loca", "maxp", "cvt ", "fpgm", "prep"}
"""Tables of a TrueType font that a PDF needs (ISO 32000-1, 9.9)."""


@contextmanager
def letters_alone() -> Iterator[None]:
    """Fonts go into a PDF as outlines alone, which it places one by one.

    To read a font's names and rules for setting text, and to cut them down to the letters that are
    used, takes longer than all else about it.
    """
    from fontTools import subset

    whole = subset.load_font

    def letters(file: Any, options: Any, *rest: Any, **how: Any) -> Any:
        options.glyph_names = False
        font = whole(file, options, *rest, **how)
        if "glyf" not in font:  # outlines of another kind: left as they are
            return font
        for table in set(font.keys()) - OUTLINES:
            del font[table]
        font.setGlyphOrder([f"glyph{i:05d}" for i in range(font["maxp"].numGlyphs)])
        return font

    subset.load_font = letters
    try:
        yield
    finally:
        subset.load_font = whole
