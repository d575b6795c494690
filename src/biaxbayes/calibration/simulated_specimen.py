"""Specimens drawn from the statistical model, and the priors of their true values.

The default priors of a posterior are so wide that most of their draws are not like tissue on the
protocols of a study (10 MPa, or compressed at mounting). A study needs realistic true values, and
must sample with the prior that it draws from.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from biaxbayes.error_model import simulate
from biaxbayes.laws.law import Law
from biaxbayes.mechanics.mounting import BRACKET, balance, mounted_state
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.priors import Prior, Tie, default_priors, prior_value
from biaxbayes.options import Settings
from biaxbayes.parameters import NOISE_SD, Quantities, mounting_names
from biaxbayes.specimens.specimen import Specimen

ROOT_TOLERANCE = 1e-6
"""Largest relative difference of mounting stretches of the same root."""


@dataclass(frozen=True)
class SimulatedSpecimen(Specimen):
    """A specimen whose mounting readings have the sd that they were simulated with."""

    reading: tuple[tuple[float, float], ...] = ()
    reading_sd: tuple[tuple[float, float], ...] = ()

    def mounting_readings(self, *, shared: bool) -> tuple[np.ndarray, np.ndarray]:
        """Simulated mounting readings and their sds."""
        del shared
        return np.array(self.reading), np.array(self.reading_sd)


def draw_truth(
    model: Posterior,
    rng: np.random.Generator,
    priors: Mapping[str, Prior | float | Tie] | None = None,
) -> tuple[dict[str, float], int]:
    """Draw from the prior truncated to the support of the posterior; also return the rejections.

    ``priors`` replace those of the model.

    The posterior is zero where the law has no such material, where no stable mounted state exists
    in the bracket, and, if the mounting force is sampled, where Newton's method converges to
    another state from the unloaded one. Rejecting such draws gives the prior of the posterior.
    """
    priors, quantities = model.priors if priors is None else priors, model.quantities
    for rejected in range(1000):
        truth = {
            name: float(prior.sample(rng, 1)[0] if isinstance(prior, Prior) else prior)
            for name, prior in priors.items()
            if not isinstance(prior, Tie)
        }
        for name, prior in priors.items():
            if isinstance(prior, Tie):
                truth[name] = prior.factor * truth[quantities.in_same_state(name, prior.other)]
        if model.law.is_admissible(truth) and _add_mounting_forces(model, truth):
            return truth, rejected
    raise ValueError("the prior has hardly any mass where a stable mounted state exists")


def simulate_specimen(
    model: Posterior,
    truth: Mapping[str, float],
    rng: np.random.Generator,
    *,
    noise_factor: float = 1.0,
) -> SimulatedSpecimen:
    """Simulate readings of `truth` on the specimen's protocols with `noise_factor` times the sd."""
    specimen = model.specimen
    forces = np.array([_pair(truth, "force", m) for m in model.mounts])
    _, sd = specimen.mounting_readings(shared=model.settings.shared)
    reading = forces
    if model.settings.mounting != "exact":
        # f0 = p0 + offset + s0 eps
        reading = forces + model.forward.offset(truth)[0] + sd * rng.standard_normal(sd.shape)
    protocols = []
    for i, p in enumerate(specimen.protocols):
        m = 0 if model.settings.shared else i
        mean, spread = model.forward.predict(truth, p.stretch, p.name)
        load = simulate(mean[0].T, noise_factor * spread[0].T, rng)
        load[:, : p.rest_rows] = reading[m][:, None]
        if specimen.stress_pair == "cauchy":
            load = load * p.stretch.T
        protocols.append(replace(p, load_x=load[0], load_y=load[1]))
    fields = {k: getattr(specimen, k) for k in Specimen.__dataclass_fields__}
    return SimulatedSpecimen(
        **fields | {"protocols": tuple(protocols)},
        reading=tuple((float(x), float(y)) for x, y in reading),
        reading_sd=tuple((float(x), float(y)) for x, y in sd),
    )


def _pair(truth: Mapping[str, float], what: str, label: str) -> np.ndarray:
    return np.array([truth[name] for name in mounting_names(what, label)])


def _add_mounting_forces(model: Posterior, truth: dict[str, float]) -> bool:
    """Add the mounting forces; False if the posterior has no such state."""
    law = model.law
    material = law.material_at(tuple(truth[name] for name in law.names))
    section = model.forward.section(truth)[0, 0]
    if not (np.all(section > 0.0) and np.all(np.isfinite(list(truth.values())))):
        return False
    for label in model.mounts:
        lm = _pair(truth, "stretch", label)
        if not np.all((lm > BRACKET[0]) & (lm < BRACKET[1])):
            return False
        force = model.forward.mounting_load(truth, label)[0]
        if model.settings.mounting == "free":
            # stable: the derivative of the balance is positive definite
            px, py = force / section
            _, _, jxx, jxy, jyy = balance(
                material.constants,
                px,
                py,
                model.forward.mounted_dimensions,
                np.log(lm[0]),
                np.log(lm[1]),
            )
            good = bool(jxx > 0.0 and jxx * jyy - jxy * jxy > 0.0)
        else:
            state = mounted_state(material, *(force / section), geometry=model.specimen.geometry)
            good = state.exists and bool(
                np.allclose(state.stretch, lm, rtol=ROOT_TOLERANCE, atol=0.0)
            )
        if not good:
            return False
        truth.update(zip(mounting_names("force", label), map(float, force), strict=True))
    return True


# --- priors of a calibration study ---------------------------------------------------------------

LOCAL_PRIOR_WIDTH = 2.0
"""Width of a local prior relative to the posterior it is taken from."""


def protocol_prior(specimen: Specimen, settings: Settings) -> dict[str, Prior | float | Tie]:
    """Prior of tissue with similar stresses on these protocols; noise around 0.5 % of the peak."""
    stretch = 1.02 * max(
        float(max(p.stretch_x.max(), p.stretch_y.max())) for p in specimen.protocols
    )
    peak = max(float(np.abs(specimen.load(p) / specimen.area).max()) for p in specimen.protocols)
    prior = default_priors(specimen, settings)
    for name, (family, first, second) in settings.material_law.scaled_prior(stretch, peak).items():
        rounded = first if family == "uniform" else _rounded(first)
        prior[name] = Prior.from_numbers(family, rounded, second)
    prior[NOISE_SD.name] = Prior("lognormal", _rounded(0.005 * specimen.peak_load), 0.7)
    for p in settings.error_model.parameters:
        if p.prior is not None:
            family, median, sd_log = p.prior
            prior[p.name] = Prior.from_numbers(family, median, 0.5 * sd_log)
    for name in mounting_names("stretch"):
        if name not in specimen.metadata:
            prior[name] = Prior("normal", 1.02, 0.01, low=0.5)
    return prior


def local_prior(
    draws: Mapping[str, np.ndarray], wide: Mapping[str, Prior | float | Tie], known: Quantities
) -> dict[str, Prior | float | Tie]:
    """Independent priors twice as wide as the marginals of `draws`, never wider than `wide`."""
    out: dict[str, Prior | float | Tie] = {}
    for name, prior in wide.items():
        quantities = [q for q in known.of_parameter(name) if q.name in draws]
        values_of_states = [draws[q.name].ravel() for q in quantities]
        if not isinstance(prior, Prior) or not values_of_states:
            out[name] = prior
            continue
        values = np.concatenate(values_of_states)
        parameter = quantities[0].parameter
        logs = parameter.logarithmic
        x = np.log(values) if logs else values
        low, middle, high = np.quantile(x, [0.1587, 0.5, 0.8413])
        scale = LOCAL_PRIOR_WIDTH * 0.5 * float(high - low)
        if prior.family == ("lognormal" if logs else "normal"):
            scale = min(scale, prior.scale)
        centre = float(np.exp(middle) if logs else middle)
        family = "lognormal" if logs else "normal"
        bounds = parameter.range if parameter.bounded else (prior.low, prior.high)
        out[name] = Prior(family, float(f"{centre:.6g}"), _rounded(scale)).within(*bounds)
    return out


def priors_toml(priors: Mapping[str, Prior | float | Tie], unit: str, law: Law) -> str:
    """A priors file that reads back to these priors."""

    def toml(value: object) -> str:
        return f'"{value}"' if isinstance(value, str) else repr(value)

    by_unit: dict[str, list[str]] = {}
    for p in law.parameters:
        if p.unit_words():
            by_unit.setdefault(p.unit_words().strip(), []).append(p.name)
    units = [f"{words} for {' and '.join(names)}" for words, names in by_unit.items()]
    lines = [f"# {', '.join(units)}, {unit} for noise_sd"]
    for name, prior in priors.items():
        value = prior_value(prior)
        if isinstance(value, dict):
            items = ", ".join(f"{key} = {toml(item)}" for key, item in value.items())
            lines.append(f"{name} = {{ {items} }}")
        else:
            lines.append(f"{name} = {toml(value)}")
    return "\n".join(lines) + "\n"


def _rounded(value: float) -> float:
    """Three significant digits, so that the prior can be reported."""
    return float(f"{value:.3g}")
