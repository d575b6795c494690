"""Whether a figure can be read in print."""

import warnings

import numpy as np
import pytest
from matplotlib.text import Text


def in_view(figure) -> list[tuple[str, object]]:
    """What can be read and its box in pixels."""
    return [(text.get_text(), box) for text, box in _texts(figure)]


def _texts(figure) -> list[tuple[Text, object]]:
    """Texts without tick labels that matplotlib keeps in store but does not draw."""
    spare = set()
    for ax in figure.axes:
        for axis, (low, high) in ((ax.xaxis, ax.get_xlim()), (ax.yaxis, ax.get_ylim())):
            low, high = sorted((low, high))
            for tick in axis.get_major_ticks() + axis.get_minor_ticks():
                margin = 1e-6 * (high - low)
                outside = not low - margin <= tick.get_loc() <= high + margin
                drawn = ax.axison and axis.get_visible() and tick in axis._update_ticks()
                for label in (tick.label1, tick.label2):
                    if outside or not drawn or not label.get_visible():
                        spare.add(id(label))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        figure.draw_without_rendering()
        return [
            (t, t.get_window_extent())
            for t in figure.findobj(Text)
            if id(t) not in spare and t.get_visible() and t.get_text().strip()
        ]


def assert_readable(figure, width_mm) -> None:
    """Right size, nothing cut off, no two texts over each other, 7 to 9 points."""
    assert figure.get_size_inches()[0] * 25.4 == pytest.approx(width_mm)
    assert figure.get_size_inches()[1] * 25.4 < 250.0  # a page
    texts = _texts(figure)
    result = [(text.get_text(), box) for text, box in texts]
    assert result
    frame = figure.bbox
    for text, box in result:
        assert box.x0 > frame.x0 - 0.5 and box.x1 < frame.x1 + 0.5, text
        assert box.y0 > frame.y0 - 0.5 and box.y1 < frame.y1 + 0.5, text
    ends = np.array([box.extents for _, box in result])
    over = np.minimum(ends[:, None, 2:], ends[None, :, 2:]) - np.maximum(
        ends[:, None, :2], ends[None, :, :2]
    )
    # Boxes count the line's full height; letters may come this close across their line.
    turned = np.array([text.get_rotation() == 90.0 for text, _ in texts])
    close = np.where((turned[:, None] & turned)[..., None], [2.5, 0.5], [0.5, 2.5])
    meet = np.triu((over > close).all(axis=-1), 1)
    assert not meet.any(), [(result[i][0], result[j][0]) for i, j in np.argwhere(meet)]
    for artist in figure.findobj(Text):
        if artist.get_text().strip():
            assert 7.0 <= artist.get_fontsize() <= 9.0
