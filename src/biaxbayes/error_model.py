r"""Errors of load readings: variance, likelihood and simulation, defined in one place.

A reading f of a model load q has an independent normal error about it,

    f ~ N(q, v(q)),    v = w^2    or, growing with the load,    v = w^2 + (b q)^2.

The mounting force is not among these readings: it is one reading with the load cell's own sd.

An error model is a ``NamedTuple`` whose type selects the implementation of the generic functions
:func:`variance`, :func:`misfit` and :func:`curve_log_likelihood`: in Python by
``functools.singledispatch``, in the compiled density by ``numba.extending.overload``. The shape of
the errors, normal here, is also that of :func:`standard_cdf` and :func:`standard_quantile`, which
predictive bands and checks are made of.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from functools import singledispatch
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload

from biaxbayes.compilation import WITHIN, implementation
from biaxbayes.parameters import NOISE_GROWTH, NOISE_SD, Parameter

HALF_LOG_2PI = 0.9189385332046727


class ConstantSd(NamedTuple):
    """The same sd for all readings: v = w^2.

    ``growth`` is not read: numba needs a field to tell the types of the two models apart.
    """

    growth: float = 0.0

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its parameters."""
        return (NOISE_SD,)


class GrowingSd(NamedTuple):
    """An sd that grows with the load: v = w^2 + (b q)^2."""

    growth: float = 1.0

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its parameters."""
        return (NOISE_SD, NOISE_GROWTH)


ErrorModel = ConstantSd | GrowingSd


def error_model(names: Container[object]) -> ErrorModel:
    """The error model whose parameters are among the names of draws or of priors."""
    return GrowingSd() if NOISE_GROWTH.name in names else ConstantSd()


# --- what an error model implements; plain arithmetic, compiled into the density -----------------


@singledispatch
def variance(errors, w, b, load):
    """Variance of one reading at a model load."""
    raise NotImplementedError(f"no error model is called {type(errors).__name__}")


@singledispatch
def misfit(errors, w, b, load, square):
    """What one reading adds to the sum of its curve, from its squared residual."""
    raise NotImplementedError(f"no error model is called {type(errors).__name__}")


@singledispatch
def curve_log_likelihood(errors, w, total, n):
    """Log likelihood of a curve of n readings from the sum of their misfits."""
    raise NotImplementedError(f"no error model is called {type(errors).__name__}")


@variance.register(ConstantSd)
def _constant_variance(errors, w, b, load):
    return w * w


@misfit.register(ConstantSd)
def _constant_misfit(errors, w, b, load, square):
    return square


@curve_log_likelihood.register(ConstantSd)
def _constant_curve(errors, w, total, n):
    # sum ln N = -(1/2) sum r^2 / w^2 - n (ln w + ln sqrt(2 pi))
    return -0.5 * total / (w * w) - n * (0.5 * np.log(w * w) + HALF_LOG_2PI)


@variance.register(GrowingSd)
def _growing_variance(errors, w, b, load):
    # v = w^2 + (b q)^2
    return w * w + b * b * load * load


@misfit.register(GrowingSd)
def _growing_misfit(errors, w, b, load, square):
    v = w * w + b * b * load * load
    return square / v + np.log(v)


@curve_log_likelihood.register(GrowingSd)
def _growing_curve(errors, w, total, n):
    # sum ln N = -(1/2) sum (r^2 / v + ln v) - n ln sqrt(2 pi)
    return -0.5 * total - n * HALF_LOG_2PI


@overload(misfit, jit_options=WITHIN)
def _compiled_misfit(errors, w, b, load, square):
    return implementation(misfit, errors)


@overload(curve_log_likelihood, jit_options=WITHIN)
def _compiled_curve_log_likelihood(errors, w, total, n):
    return implementation(curve_log_likelihood, errors)


# --- readings of draws, in NumPy -----------------------------------------------------------------


def error_sd(errors: ErrorModel, values: Mapping[str, Any], load: Any) -> Any:
    """Standard deviation of a reading at a model load.

    ``values`` holds the parameters of the errors by name, each broadcastable with the load.
    """
    w, b = (values[p.name] if p in errors.parameters else 0.0 for p in (NOISE_SD, NOISE_GROWTH))
    return np.sqrt(variance(errors, w, b, load))


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
