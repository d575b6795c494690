"""Priors that a calibration study draws its true values from, and samples with.

The default priors of a posterior are wide on purpose: most of their draws are no tissue (10 MPa,
or pushed together at mounting) on the protocol at hand. A study needs true values that could be
a specimen on this machine, and it must sample with the prior that it draws from.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from biaxbayes.inference.priors import DEFAULT_BOUNDS, Prior, Tie, default_priors
from biaxbayes.specimens.specimen import Specimen

__all__ = ["local_prior", "prior_value", "priors_toml", "protocol_prior"]

MATRIX_SHARE = 0.3
"""Share of the peak stress that the matrix carries at the median of the prior."""
WIDENED = 2.0
"""A local prior is this much wider than the posterior it is taken from."""


def protocol_prior(specimen: Specimen) -> dict[str, Prior | float | Tie]:
    """Prior of tissue that reaches stresses like this specimen's on its protocols.

    The largest measured stretch and the peak stress set the scales: at the medians, the
    fibres' exponent k2 E^2 is one there and matrix and fibres carry 30 and 70 % of the stress.
    The noise sd is around 0.5 % of the peak load of *this* specimen, whatever a simulated
    one's peak is.

    Parameters
    ----------
    specimen : Specimen

    Returns
    -------
    dict
        Natural units, as in a priors file.
    """
    stretch = 1.02 * max(
        float(max(p.stretch_x.max(), p.stretch_y.max())) for p in specimen.protocols
    )
    peak = max(float(np.abs(specimen.load(p) / specimen.area).max()) for p in specimen.protocols)
    strain = stretch**2 - 1.0  # fibre strain of an equibiaxial stretch without dispersion
    # P = 2 C1 (l - l^-5) and 4 k1 E exp(k2 E^2) Hx l with Hx = 1/2 and k2 E^2 = 1
    matrix = 2.0 * (stretch - stretch**-5)
    fibres = 2.0 * strain * np.e * stretch
    stated = default_priors(specimen)
    prior: dict[str, Prior | float | Tie] = {
        "C1": Prior("lognormal", _rounded(MATRIX_SHARE * peak / matrix), 0.8),
        "k1": Prior("lognormal", _rounded((1.0 - MATRIX_SHARE) * peak / fibres), 0.8),
        "k2": Prior("lognormal", _rounded(strain**-2), 0.8),
        "alpha": Prior("uniform", low=0.0, high=90.0),
        "kappa": Prior("uniform", low=0.0, high=1.0 / 3.0),
        "noise_sd": Prior("lognormal", _rounded(0.005 * specimen.peak_load), 0.7),
        "noise_growth": Prior("lognormal", 0.03, 0.5),
    }
    for axis in "xy":
        name = f"mounting_stretch_{axis}"
        measured = name in specimen.metadata
        prior[name] = stated[name] if measured else Prior("normal", 1.02, 0.01, low=0.5)
    return prior


def local_prior(
    draws: Mapping[str, np.ndarray], wide: Mapping[str, Prior | float | Tie]
) -> dict[str, Prior | float | Tie]:
    """Prior around a posterior: its marginals, each twice as wide, independent of one another.

    Parameters
    ----------
    draws : mapping of str to ndarray
        Draws of the specimen's own posterior. Those of several mounted states are pooled.
    wide : mapping
        The priors it was sampled with; never exceeded in width, and kept where not a
        distribution.

    Returns
    -------
    dict
    """
    out: dict[str, Prior | float | Tie] = {}
    for name, prior in wide.items():
        found = [v.ravel() for k, v in draws.items() if k == name or k.startswith(f"{name}[")]
        if not isinstance(prior, Prior) or not found:
            out[name] = prior
            continue
        values = np.concatenate(found)
        logs = name in ("C1", "k1", "k2", "noise_sd", "noise_growth")
        x = np.log(values) if logs else values
        low, middle, high = np.quantile(x, [0.1587, 0.5, 0.8413])
        scale = WIDENED * 0.5 * float(high - low)
        if prior.family == ("lognormal" if logs else "normal"):
            scale = min(scale, prior.scale)
        centre = float(np.exp(middle) if logs else middle)
        family = "lognormal" if logs else "normal"
        bounds = DEFAULT_BOUNDS.get(name, (prior.low, prior.high))
        out[name] = Prior(family, float(f"{centre:.6g}"), _rounded(scale)).within(*bounds)
    return out


def prior_value(prior: Prior | float | Tie) -> Any:
    """A prior as a priors file holds it: a table, text of a tie, or a number."""
    if isinstance(prior, Prior):
        return prior.as_table()
    return f"{prior.factor!r} * {prior.other}" if isinstance(prior, Tie) else float(prior)


def priors_toml(priors: Mapping[str, Prior | float | Tie], unit: str) -> str:
    """A priors file that reads back to these priors."""
    lines = [f"# kPa for C1 and k1, degrees for alpha, {unit} for noise_sd"]
    for name, prior in priors.items():
        value = prior_value(prior)
        if isinstance(value, dict):
            items = ", ".join(f"{key} = {_toml(item)}" for key, item in value.items())
            lines.append(f"{name} = {{ {items} }}")
        else:
            lines.append(f"{name} = {_toml(value)}")
    return "\n".join(lines) + "\n"


def _toml(value: object) -> str:
    return f'"{value}"' if isinstance(value, str) else repr(value)


def _rounded(value: float) -> float:
    """Three significant digits: a stated prior should be possible to state."""
    return float(f"{value:.3g}")
