r"""Error models: what separates a reading from the model's load, and what the readings are worth.

A reading f of a load q has a normal error of standard deviation sd(q); the log likelihood of a
curve is multiplied by its weight n_eff / n, the independent readings that its rows are worth over
their number. An error model thus says four things, each once:

    sd          of a reading at a load
    weight      from the residuals of a fit
    likelihood  of readings, here for draws and, compiled, for the density
    simulation  of readings

The mounting force stands outside of this: it is one reading with the load cell's own sd.

To add one: a ``NamedTuple`` with its compiled functions where its sd is new, and a line in
:data:`WEIGHTS` or :data:`SPREADS`.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from biaxbayes.compilation import inlined, picked
from biaxbayes.model.effective_readings import (
    EffectiveReadings,
    effective_readings,
    systematic_readings,
)
from biaxbayes.options import Settings
from biaxbayes.parameters import NOISE_GROWTH, NOISE_SD, Parameter

__all__ = [
    "SPREADS",
    "WEIGHTS",
    "ErrorModel",
    "curve_log_likelihood",
    "error_model",
    "errors_of",
    "errors_of_draws",
    "misfit",
    "variance",
]

HALF_LOG_2PI = 0.9189385332046727


# --- how wide errors are: compiled, picked by type -----------------------------------------------


class ConstantSd(NamedTuple):
    """The same sd w for all readings."""

    growth: float = 0.0


class GrowingSd(NamedTuple):
    """An sd that grows with the load: sd^2 = w^2 + (b f)^2."""

    growth: float = 1.0


_STATED: dict[tuple[str, type], Callable[..., Any]] = {}


def variance(spread, w, b, load):
    """Variance of one reading at a model load; ``w`` and ``b`` are the spread's parameters."""
    return _STATED["variance", type(spread)](spread, w, b, load)


def misfit(spread, w, b, load, square):
    """What one reading adds to the sum of its curve, from its squared residual."""
    return _STATED["misfit", type(spread)](spread, w, b, load, square)


def curve_log_likelihood(spread, w, total, n):
    """Log likelihood of a curve of n readings from the sum of their misfits."""
    return _STATED["curve_log_likelihood", type(spread)](spread, w, total, n)


def _constant_variance(spread, w, b, load):
    return w * w


def _constant_misfit(spread, w, b, load, square):
    return square


def _constant_curve(spread, w, total, n):
    # sum ln N = -(1/2) sum r^2 / w^2 - n (ln w + ln sqrt(2 pi))
    return -0.5 * total / (w * w) - n * (0.5 * np.log(w * w) + HALF_LOG_2PI)


def _growing_variance(spread, w, b, load):
    # sd^2 = w^2 + (b f)^2
    return w * w + b * b * load * load


def _growing_misfit(spread, w, b, load, square):
    v = _growing_variance(spread, w, b, load)
    return square / v + np.log(v)


def _growing_curve(spread, w, total, n):
    # sum ln N = -(1/2) sum (r^2 / sd^2 + ln sd^2) - n ln sqrt(2 pi)
    return -0.5 * total - n * HALF_LOG_2PI


def register(spread: type, **functions: Callable[..., Any]) -> None:
    """Say what the functions above are for a type of spread."""
    for name, function in functions.items():
        _STATED[name, spread] = inlined(function)


_growing_variance = inlined(_growing_variance)
register(
    ConstantSd,
    variance=_constant_variance,
    misfit=_constant_misfit,
    curve_log_likelihood=_constant_curve,
)
register(
    GrowingSd,
    variance=_growing_variance,
    misfit=_growing_misfit,
    curve_log_likelihood=_growing_curve,
)


def _of(name: str, spread: Any) -> Callable[..., Any] | None:
    return _STATED.get((name, getattr(spread, "instance_class", type(None))))


picked(variance)(lambda spread, w, b, load: _of("variance", spread))
picked(misfit)(lambda spread, w, b, load, square: _of("misfit", spread))
picked(curve_log_likelihood)(lambda spread, w, total, n: _of("curve_log_likelihood", spread))


# --- error models ------------------------------------------------------------------------------


Weigh = Callable[[Sequence[np.ndarray], Sequence[np.ndarray] | None], EffectiveReadings]

WEIGHTS: dict[str, tuple[Weigh | None, str]] = {
    "effective": (effective_readings, "weighted by the independent readings they are worth"),
    "systematic": (systematic_readings, "the same, a smooth misfit one error a curve"),
    "independent": (None, "independent"),
}
"""What the rows of a curve are worth, by the names of ``--noise``, and words for it."""
SPREADS: dict[bool, tuple[Any, tuple[Parameter, ...]]] = {
    False: (ConstantSd(), (NOISE_SD,)),
    True: (GrowingSd(), (NOISE_SD, NOISE_GROWTH)),
}
"""How wide errors are, by whether the sd grows with the load, and the parameters of it."""


@dataclass(frozen=True)
class ErrorModel:
    """Normal errors with a weight.

    Attributes
    ----------
    name : str
        As ``--noise`` has it.
    words : str
        What its weight is, in words.
    weigh : callable or None
        From residuals, one array (n_p, 2) a protocol, and their sd where it is not constant, to
        what they are worth; None where every reading counts.
    spread : NamedTuple
        How wide errors are, for the compiled density.
    parameters : tuple of Parameter
        Of the spread.
    """

    name: str
    words: str
    weigh: Weigh | None
    spread: Any
    parameters: tuple[Parameter, ...]

    @property
    def grows(self) -> bool:
        """Whether the sd depends on the load."""
        return len(self.parameters) > 1

    def readings(
        self, residuals: Sequence[np.ndarray], sd: Sequence[np.ndarray] | None = None
    ) -> EffectiveReadings | None:
        """What the rows are worth; None where every reading counts."""
        return None if self.weigh is None else self.weigh(residuals, sd)

    def weight(
        self, residuals: Sequence[np.ndarray], sd: Sequence[np.ndarray] | None = None
    ) -> float:
        """The weight n_eff / n of the log likelihood."""
        found = self.readings(residuals, sd)
        return 1.0 if found is None else found.beta

    def sd(self, values: Mapping[str, Any], load: Any) -> Any:
        """Standard deviation of a reading at a model load.

        Parameters
        ----------
        values : mapping
            Parameters of the spread by name, each broadcastable with the load.
        load : array_like
            Model load, in the unit of the specimen.
        """
        b = values[NOISE_GROWTH.name] if self.grows else 0.0
        return np.sqrt(variance(self.spread, values[NOISE_SD.name], b, load))

    def log_likelihood(
        self, values: Mapping[str, Any], load: Any, measured: Any, scatter: Any = 0.0
    ) -> Any:
        """Unweighted log likelihood of each reading, broadcast.

        Parameters
        ----------
        values, load
            As in :meth:`sd`.
        measured : array_like
        scatter : array_like
            Mean square scatter of the readings that a measured load is the mean of.
        """
        sd = self.sd(values, load)
        square = (measured - load) ** 2 + scatter
        return -0.5 * square / sd**2 - np.log(sd) - HALF_LOG_2PI

    def simulate(self, values: Mapping[str, Any], load: Any, rng: np.random.Generator) -> Any:
        """New readings around the model, of the load's shape."""
        return load + self.sd(values, load) * rng.standard_normal(np.shape(load))


def error_model(noise: str, *, growth: bool = False) -> ErrorModel:
    """The error model of the options ``--noise`` and ``--noise-growth``."""
    weigh, words = WEIGHTS[noise]
    spread, parameters = SPREADS[growth]
    return ErrorModel(noise, words, weigh, spread, parameters)


def errors_of_draws(columns: Container[object]) -> ErrorModel:
    """The spread of the errors that draws have parameters of; every reading counts."""
    return error_model("independent", growth=NOISE_GROWTH.name in columns)


def errors_of(settings: Settings) -> ErrorModel:
    """The error model of a run's options."""
    return error_model(settings.noise, growth=settings.noise_growth)
