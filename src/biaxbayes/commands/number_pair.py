"""Two numbers in one option: ``20x15`` or ``1:0.5``."""

from __future__ import annotations

import math
from typing import Any

import click

__all__ = ["Pair"]


class Pair(click.ParamType):
    """Two positive numbers with a separator, or one number for both: ``20`` or ``20x15``."""

    def __init__(self, name: str, separator: str, *, single: bool, zero: bool = False) -> None:
        self.name, self.separator, self.single, self.zero = name, separator, single, zero

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, float]:
        """Numbers from the text of the option."""
        if isinstance(value, tuple):
            return value
        parts = str(value).split(self.separator)
        if len(parts) == 1 and self.single:
            parts *= 2
        try:
            x, y = (float(part) for part in parts)
        except ValueError:
            x = y = math.nan
        lowest = min(x, y)
        if not (math.isfinite(x + y) and (lowest > 0.0 or (self.zero and lowest == 0.0))):
            example = "20 or 20x15" if self.single else "1:0.5"
            self.fail(f"{value!r} does not read like {example}", param, ctx)
        return x, y
