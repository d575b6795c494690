"""How every figure looks in print: widths, fonts and colours, replaceable by a style file."""

from __future__ import annotations

import io
import threading
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias

import matplotlib as mpl
from matplotlib import ticker
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure

from biaxbayes.errors import InputError
from biaxbayes.options import FIGURE_FORMATS
from biaxbayes.text_files import MADE_HERE, atomic_write_bytes

Style: TypeAlias = Mapping[str, Any] | None
"""Settings of matplotlib that override :data:`STYLE`."""

MM = 1.0 / 25.4
"""Inches per millimetre; matplotlib counts in inches."""
COLUMN_MM, PAGE_MM = 85.0, 180.0
"""Widths of one column and of a page."""
SIDE_BY_SIDE_MM = 120.0
"""Width from which panels are side by side."""
BAND_OPACITY = {"predictive": 0.18, "credible": 0.45}
"""Opacity of both bands, the wide one first."""
AXIS_MARKERS = {"x": "o", "y": "s"}
DASHES = (0, (3, 2))
FINER_UNIT = {"N": "mN", "kPa": "Pa"}
REFERENCE: dict[str, Any] = {"color": "0.6", "linewidth": 0.6, "linestyle": ":", "zorder": 0.5}
"""Line of a value to compare with, such as a mounting stretch of one."""

STYLE: Any = mpl.rc_params_from_file(
    Path(__file__).with_name("paper.mplstyle"), use_default_template=False
)
"""Matplotlib settings of every figure; a style file overrides them one by one."""

# Settings that a style file cannot change: the width in millimetres is fixed, so nothing is
# cropped; names in specimen files are not TeX.
_FIXED: dict[str, Any] = {
    "text.parse_math": True,
    "text.usetex": False,
    "savefig.bbox": None,
    "svg.hashsalt": "biaxbayes",
    "axes.formatter.useoffset": False,
}
_IGNORED = ("backend", "backend_fallback", "interactive", "toolbar", "timezone")


def read_style(path: Path | str) -> dict[str, Any]:
    """Read a ``.mplstyle`` file; its first two colours are those of directions x and y."""
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not a text file"
        raise InputError(f"the style cannot be read ({reason})", file=path) from None
    for row, line in enumerate(lines, start=1):
        key, colon, value = (part.strip() for part in line.split("#", 1)[0].partition(":"))
        if key and not (colon and key in mpl.rcParams):
            raise InputError(
                f"{key[:60]!r} is not a setting of matplotlib",
                file=path,
                row=row,
                remedy="a style has lines 'key: value', such as 'font.family: Arial'",
            )
        if key == "text.usetex" and "t" in value.lower():
            raise InputError(
                "text.usetex cannot be used, because names in specimen files are not TeX",
                file=path,
                row=row,
                remedy="set font.family, and mathtext.fontset: cm for the symbols of TeX",
            )
    try:
        settings = mpl.rc_params_from_file(path, fail_on_error=True, use_default_template=False)
    except Exception as error:  # whatever a validator raises
        raise InputError(f"matplotlib does not accept the style: {error}", file=path) from None
    return {key: value for key, value in settings.items() if key not in _IGNORED}


_one_thread_draws = threading.RLock()
"""Settings of matplotlib and filters of warnings belong to the process."""
_styles: list[Style] = []
"""The styles in use, the outer one first."""


@contextmanager
def print_style(style: Style = None) -> Iterator[None]:
    """Draw in the style of a paper, whatever the settings of the session; other threads wait.

    Also a decorator. Within a style that was chosen, that one stays.
    """
    with _one_thread_draws, mpl.rc_context(), warnings.catch_warnings():
        warnings.simplefilter("ignore", mpl.MatplotlibDeprecationWarning)
        _styles.append(style or (_styles[-1] if _styles else None))
        settings: Any = {k: v for k, v in mpl.rcParamsDefault.items() if k not in _IGNORED}
        mpl.rcParams.update(settings | {**STYLE, **(_styles[-1] or {}), **_FIXED})
        try:
            yield
        finally:
            _styles.pop()


def colour(which: str | int) -> str:
    """Colour of direction ``x`` or ``y``, or of the k-th run, group or ensemble, from 0."""
    cycler = mpl.rcParams["axes.prop_cycle"]
    cycle = (cycler if "color" in cycler.keys else STYLE["axes.prop_cycle"]).by_key()["color"]
    k = "xy".index(which) if isinstance(which, str) else which
    return to_hex(cycle[k % len(cycle)])


def text_colour(face: str) -> str:
    """White on a dark ground, black on a light one."""
    red, green, blue = to_rgb(face)
    return "white" if 0.299 * red + 0.587 * green + 0.114 * blue < 0.5 else "black"


def blank_figure(width_mm: float, height_mm: float) -> Figure:
    """An empty figure with constrained layout; an Agg canvas needs no backend and no window."""
    figure = Figure((width_mm * MM, height_mm * MM), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def limit_ticks(axis: Axis, max_ticks: int = 4) -> None:
    """Set at most `max_ticks` intervals between labelled ticks at round values; no minor ticks."""
    if axis.get_scale() == "log":
        low, high = axis.get_view_interval()
        if high > 100.0 * low:
            axis.set_major_locator(ticker.LogLocator(numticks=max_ticks))
            axis.set_major_formatter(ticker.LogFormatterMathtext())
        else:
            subs = (1, 3) if high > 10.0 * low else (1, 2, 5)
            axis.set_major_locator(ticker.LogLocator(subs=subs))
            axis.set_major_formatter(ticker.StrMethodFormatter("{x:g}"))
    else:
        axis.set_major_locator(ticker.MaxNLocator(max_ticks, steps=(1, 2, 5, 10)))
    axis.set_minor_locator(ticker.NullLocator())


def small_text(**more: Any) -> dict[str, Any]:
    """Keywords of a note or an annotation: its size in the active style."""
    return {"fontsize": mpl.rcParams["legend.fontsize"], **more}


def add_note(figure: Figure, text: str) -> None:
    """Add a note in grey at the foot."""
    if text:
        figure.supxlabel(text, x=0.995, ha="right", **small_text(color="0.35"))


def figure_bytes(figure: Figure, suffix: str) -> bytes:
    """Figure as a reproducible pdf, svg or png, in the style in use."""
    out = io.BytesIO()
    about: dict[str, dict[str, Any]] = {
        "pdf": {"Creator": MADE_HERE, "CreationDate": None},
        "svg": {"Creator": MADE_HERE, "Date": None},
        "png": {"Software": MADE_HERE},
    }
    with print_style():
        # Characters that the font lacks are drawn as boxes.
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        if (engine := figure.get_layout_engine()) is not None:
            # Repeating the layout would move panels by fractions of a dot.
            engine.execute(figure)
            figure.set_layout_engine("none")
        figure.savefig(out, format=suffix, metadata=about[suffix])
    return out.getvalue()


def picture_suffix(path: Path) -> str:
    """The format that a file name ends with; refuses one that cannot be drawn."""
    suffix = path.suffix.lower().removeprefix(".")
    if suffix not in FIGURE_FORMATS:
        raise InputError(
            f"cannot draw a figure as {path.suffix or 'a file without suffix'!r}",
            file=path,
            remedy="use the suffix .pdf, .png or .svg",
        )
    return suffix


def save_figure(figure: Figure, path: Path | str) -> None:
    """Write a figure in the format that the file name ends with, whole or not at all."""
    path = Path(path)
    atomic_write_bytes(path, figure_bytes(figure, picture_suffix(path)))


def save_pictures(figure: Figure | None, folder: Path, stem: str) -> None:
    """Write a figure for print and for the screen; None removes existing pictures."""
    for suffix in ("pdf", "png"):
        path = folder / f"{stem}.{suffix}"
        if figure is None:
            path.unlink(missing_ok=True)
        else:
            save_figure(figure, path)
