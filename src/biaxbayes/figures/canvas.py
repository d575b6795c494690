"""What figures are drawn on and written with: in a batch the same symbols and letters come again.

Matplotlib sets each symbol anew for every size and file, and its pictures, filtered row by row in
five ways, take longer than the drawing itself.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from biaxbayes.figures.letters import letters_alone

if TYPE_CHECKING:
    from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg

__all__ = ["canvas"]


@cache
def canvas() -> type[FigureCanvasAgg]:
    """The class of canvas that figures are drawn on; matplotlib is not imported before."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    symbols = _symbols()

    class Canvas(FigureCanvasAgg):
        def get_renderer(self) -> RendererAgg:
            renderer = super().get_renderer()
            renderer.mathtext_parser = symbols
            return renderer

        def print_png(self, filename_or_obj: Any, **_: Any) -> None:
            FigureCanvasAgg.draw(self)
            for part in png(np.asarray(self.buffer_rgba()), self.figure.dpi):
                filename_or_obj.write(part)

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


# --- pictures ------------------------------------------------------------------------------------


PNG_LEVEL = 3
"""Of zlib: a file of a corner plot a quarter larger than at its default 6, in half the time."""
ROWS = 64
"""Of a picture that are compressed at once."""


def png(pixels: np.ndarray, dpi: float) -> Iterator[bytes]:
    """The parts of a PNG file (ISO/IEC 15948), rows without a filter: most of a figure is blank.

    Parameters
    ----------
    pixels : ndarray of uint8, shape (height, width, 4)
        Red, green, blue and opacity, which the file holds where it is not full everywhere.
    dpi : float
    """
    height, width, _ = pixels.shape
    channels = 3 if pixels[..., 3].min() == 255 else 4
    kind = {3: 2, 4: 6}[channels]
    per_metre = round(dpi / 0.0254)
    yield b"\x89PNG\r\n\x1a\n"
    yield _chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, kind, 0, 0, 0))
    yield _chunk(b"pHYs", struct.pack(">IIB", per_metre, per_metre, 1))
    compressor = zlib.compressobj(PNG_LEVEL)
    for first in range(0, height, ROWS):
        part = pixels[first : first + ROWS]
        rows = np.zeros((len(part), 1 + channels * width), np.uint8)
        for k in range(channels):  # in one step it takes five times as long
            rows[:, 1 + k :: channels] = part[..., k]
        if data := compressor.compress(rows.tobytes()):
            yield _chunk(b"IDAT", data)
    yield _chunk(b"IDAT", compressor.flush())
    yield _chunk(b"IEND", b"")


def _chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
