"""A strip pulled along x or y, with free long sides.

q_k = g_k s_k / l_k     along it
0 = s_j                 across it: the stretch there is the root where it was not measured
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from biaxbayes.errors import ReadingError
from biaxbayes.experiments.sheet import Sheet

LEAST_WIDTHS = 4.0
"""Gauge length of a strip over its width below which its clamps hold back more than its ends."""


class Strip(Sheet):
    """A strip pulled along one direction."""

    free_side: int

    def __init__(self, axis: int) -> None:
        self.axis, self.axes, self.free_side = axis, (axis,), 1 - axis
        self.name = f"strip {'xy'[axis]}"
        self.words = f"uniaxial tension of a strip along {'xy'[axis]} with free sides"
        self.meaning = "the same along y"
        if axis == 0:
            self.meaning = (
                "a strip pulled along x, whose file has stretch and load of that direction, and "
                "the other stretch if the width was measured"
            )

    def needed(self, loads: str) -> tuple[str, ...]:
        """No section depends on the length of a strip."""
        return tuple(key for key in super().needed(loads) if key != f"edge_{'xy'[self.axis]}_mm")

    def check(self, header: Mapping[str, Any], protocols: Sequence[Any]) -> None:
        """Refuse a load across the strip, too."""
        super().check(header, protocols)
        side = "xy"[self.free_side]
        for p in protocols:
            if p.recorded_load[:, self.free_side].any():
                raise ReadingError(
                    f"a strip carries no load across it, and load_{side} is not zero",
                    argument=f"load_{side}",
                    protocol=p.name,
                    remedy="leave it out, or state '# test: biaxial'",
                )

    def warnings(self, header: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
        """Clamps hold the width of a strip at its ends; its middle is free only if it is long."""
        edges = (header["edge_x_mm"], header["edge_y_mm"])
        length, width = edges[self.axis], edges[self.free_side]
        if length is not None and width is not None and length < LEAST_WIDTHS * width:
            yield (
                "short-strip",
                f"the strip is {length:g} mm long and {width:g} mm wide: clamped strips shorter "
                f"than {LEAST_WIDTHS:g} widths are not free to contract, and look stiffer",
            )
