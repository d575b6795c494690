r"""Errors of load readings: every error model, its likelihood and simulation.

A reading f of a model load q has an independent normal error about it,

    f ~ N(q, v(q)),    v = w^2    or, growing with the load,    v = w^2 + (b q)^2.

The mounting force is not among these readings: it is one reading with the load cell's own sd.

:data:`ERROR_MODELS` is the registry. The values of a model's parameters are a ``NamedTuple``, whose
type selects the implementation of the generic functions :func:`variance`, :func:`deviance_term`,
:func:`curve_log_likelihood` and :func:`from_slots`: in Python by ``functools.singledispatch``, in
the compiled density by ``numba.extending.overload``. A model needs its variance and
:func:`from_slots`; the other two follow from the variance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import singledispatch
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload

from biaxbayes.compilation import WITHIN, implementation
from biaxbayes.parameters import NOISE_GROWTH, NOISE_SD, Parameter

HALF_LOG_2PI = 0.5 * math.log(2.0 * math.pi)


# --- what an error model implements; plain arithmetic, compiled into the density -----------------


@singledispatch
def from_slots(errors, value, first):
    """Values of the parameters from the entries of ``value`` that begin at ``first``.

    Only the type of ``errors`` matters.
    """
    raise NotImplementedError(f"no error model has the values {type(errors).__name__}")


@singledispatch
def variance(errors, load):
    """Variance of one reading at a model load."""
    raise NotImplementedError(f"no error model has the values {type(errors).__name__}")


@singledispatch
def deviance_term(errors, load, square):
    """Deviance of one reading less ln 2 pi, from its squared residual: r^2 / v + ln v."""
    v = variance(errors, load)
    return square / v + np.log(v)


@singledispatch
def curve_log_likelihood(errors, total, n):
    """Log likelihood of a curve of n readings from the sum of their deviance terms."""
    # sum ln N = -(1/2) sum (r^2 / v + ln v) - n ln sqrt(2 pi)
    return -0.5 * total - n * HALF_LOG_2PI


@overload(from_slots, jit_options=WITHIN)
def _compiled_from_slots(errors, value, first):
    return implementation(from_slots, errors)


@overload(variance, jit_options=WITHIN)
def _compiled_variance(errors, load):
    return implementation(variance, errors)


# these two have defaults, which ``dispatch`` returns for models that register none


@overload(deviance_term, jit_options=WITHIN)
def _compiled_deviance_term(errors, load, square):
    return deviance_term.dispatch(errors.instance_class)


@overload(curve_log_likelihood, jit_options=WITHIN)
def _compiled_curve_log_likelihood(errors, total, n):
    return curve_log_likelihood.dispatch(errors.instance_class)


# --- the error models ----------------------------------------------------------------------------


class ConstantSd(NamedTuple):
    """The same sd for all readings: v = w^2. Its deviance terms are r^2 alone, to be fast."""

    noise_sd: Any


@from_slots.register(ConstantSd)
def _constant_from_slots(errors, value, first):
    return ConstantSd(value[first])


@variance.register(ConstantSd)
def _constant_variance(errors, load):
    return errors.noise_sd * errors.noise_sd


@deviance_term.register(ConstantSd)
def _constant_deviance_term(errors, load, square):
    return square


@curve_log_likelihood.register(ConstantSd)
def _constant_curve(errors, total, n):
    # sum ln N = -(1/2) sum r^2 / w^2 - n (ln w + ln sqrt(2 pi))
    v = errors.noise_sd * errors.noise_sd
    return -0.5 * total / v - n * (0.5 * np.log(v) + HALF_LOG_2PI)


class GrowingSd(NamedTuple):
    """An sd that grows with the load: v = w^2 + (b q)^2."""

    noise_sd: Any
    noise_growth: Any


@from_slots.register(GrowingSd)
def _growing_from_slots(errors, value, first):
    return GrowingSd(value[first], value[first + 1])


@variance.register(GrowingSd)
def _growing_variance(errors, load):
    # v = w^2 + (b q)^2
    w, b = errors.noise_sd, errors.noise_growth
    return w * w + b * b * load * load


@dataclass(frozen=True)
class ErrorModel:
    """An error model that a run can have.

    Attributes
    ----------
    values : type
        The ``NamedTuple`` of its parameters' values, by their names.
    parameters : tuple of Parameter
        In the order of that tuple. The first is ``noise_sd``, the sd at zero load, in every model.
    description : str
        Its sd in words.
    option : str
        The field of :class:`~biaxbayes.options.Settings` that chooses it; empty for the default.
    """

    values: Any
    parameters: tuple[Parameter, ...]
    description: str
    option: str = ""

    def __str__(self) -> str:
        return self.description

    def at(self, values: Mapping[str, Any]) -> Any:
        """Values of its parameters, from values by name."""
        return self.values(*(values[p.name] for p in self.parameters))

    def sd(self, values: Mapping[str, Any], load: Any) -> Any:
        """Standard deviation of a reading at a model load, which the values broadcast with."""
        return np.sqrt(variance(self.at(values), load))


CONSTANT = ErrorModel(ConstantSd, (NOISE_SD,), "constant")
GROWING = ErrorModel(
    GrowingSd, (NOISE_SD, NOISE_GROWTH), "growing with the load", option="noise_growth"
)
ERROR_MODELS = (CONSTANT, GROWING)


# --- the normal distribution of single readings, in NumPy ----------------------------------------


def log_likelihood(mean: Any, sd: Any, measured: Any, scatter: Any = 0.0) -> Any:
    """Unweighted log likelihood of each reading, broadcast.

    ``scatter`` is the mean square scatter of the readings that a measured load is the mean of.
    """
    square = (measured - mean) ** 2 + scatter
    return -0.5 * square / sd**2 - np.log(sd) - HALF_LOG_2PI


def simulate(mean: Any, sd: Any, rng: np.random.Generator) -> Any:
    """New readings, of the shape of their mean."""
    return mean + sd * rng.standard_normal(np.shape(mean))


def standard_cdf(z: Any) -> Any:
    """Probability that an error is less than z of its standard deviations."""
    from scipy.special import ndtr

    return ndtr(z)


def standard_quantile(probability: Any) -> Any:
    """Standard deviations below which an error lies with a probability."""
    from scipy.special import ndtri

    return ndtri(probability)
