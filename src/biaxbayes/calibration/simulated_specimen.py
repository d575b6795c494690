"""Specimens drawn from the statistical model, and the priors of their true values.

    f0 = p0 + o + mean over the protocols (delta) + c s0 eps          reading of a mounted state
    f  = load of the law + o + delta + c s eps                        every other reading

with the offset o of the load cell, its noise s and the factor c of it, eps ~ N(0, 1), and the
misfit delta of each piece (with its toe, see :mod:`biaxbayes.model.misfit`) drawn from its prior,
relative to the loads of a fit that the inference uses as well. With independent errors there is no
misfit.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from biaxbayes.laws.law import Law
from biaxbayes.mechanics.mounting import BRACKET, balance, mounting_stretches
from biaxbayes.model.assembly import peak_stress
from biaxbayes.model.misfit import CurvePoints
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.priors import Prior, Tie, default_priors, prior_value
from biaxbayes.model.readings import LEAST_NOISE, SHARED_NOISE
from biaxbayes.options import Settings
from biaxbayes.parameters import NOISE_SD, Quantities, mounting_names, name_of
from biaxbayes.specimens.specimen import Specimen

ROOT_TOLERANCE = 1e-6
"""Largest relative difference of mounting stretches of the same root."""


@dataclass(frozen=True)
class SimulatedSpecimen(Specimen):
    """A specimen whose readings have the sd that they were simulated with."""

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
    """Draw from the prior truncated to the support of the posterior; also the number of rejections.

    ``priors`` replace those of the model. The posterior is zero where the law has no such material,
    where no stable mounted state exists in the bracket, and, if the mounting force is sampled,
    where Newton's method, started from the unloaded state, converges to another one.
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
                truth[name] = prior.factor * truth[name_of(prior.other, quantities[name].state)]
        if model.law.is_admissible(truth) and _add_mounting_forces(model, truth):
            return truth, rejected
    raise ValueError("the prior has hardly any mass where a material has a stable mounted state")


def simulate_specimen(
    model: Posterior, truth: Mapping[str, float], rng: np.random.Generator
) -> SimulatedSpecimen:
    """Simulate readings of a material, from :func:`draw_truth`, on the protocols of a specimen."""
    pieces = [_simulated_piece(model, i, truth, rng) for i in range(len(model.pieces))]
    return replace(pieces[0], further=tuple(pieces[1:]))


def _simulated_piece(
    model: Posterior, index: int, truth: Mapping[str, float], rng: np.random.Generator
) -> SimulatedSpecimen:
    """Readings of one piece, with a misfit of its own."""
    piece, settings = model.pieces[index], model.settings
    specimen, forward, label = piece.specimen, piece.forward, piece.labels.label
    read = np.isin([0, 1], specimen.experiment.axes)
    least = LEAST_NOISE * specimen.peak_loads * settings.has_misfit
    noise = np.maximum(specimen.noise_sds, least)
    if not settings.has_misfit:
        noise = truth[name_of(NOISE_SD.name, label)] * specimen.load_scale
    (misfit, scatter), offset = _misfits(model, index, rng), forward.offset(truth)[0, 0]
    # across a strip there is no load
    forces = [mounting_names("force", state) for state in piece.labels.states]
    reading = np.array([[truth.get(name, 0.0) for name in pair] for pair in forces])
    floor = np.maximum(SHARED_NOISE * noise * settings.has_misfit, least)
    sd = read * np.maximum(specimen.mounting_readings(shared=settings.shared)[1], floor)
    if settings.mounting != "exact":
        starts = np.array([curve[0] for curve in misfit])
        of_states = starts.mean(axis=0, keepdims=True) if settings.shared else starts
        reading = reading + offset + of_states + scatter * sd * rng.standard_normal(sd.shape)
        reading *= read
    protocols = []
    for i, p in enumerate(specimen.protocols):
        errors = noise * rng.standard_normal((p.rows, 2))
        if settings.has_misfit:
            loaded = p.rows - p.rest_rows
            errors[p.rest_rows :] += noise * _shared(piece.readings_of(i), loaded, rng)
        errors *= scatter
        errors[p.rest_rows :] += misfit[i][1:]
        load = read * (forward.load(truth, p.stretch, p.name)[0] + offset + errors)
        load[: p.rest_rows] = reading[0 if settings.shared else i]
        load = load * specimen.per_nominal(p.known_stretch)
        protocols.append(replace(p, load_x=load[:, 0], load_y=load[:, 1]))
    fields = {k: getattr(specimen, k) for k in Specimen.__dataclass_fields__}
    if settings.has_misfit:
        fields["load_noise"] = float(noise[0])
        if (key := specimen.kind_of_loads.noise_key_y) and noise[1] > 0.0:  # it was read
            fields["metadata"] = {**specimen.metadata, key: float(noise[1])}
    return SimulatedSpecimen(
        **fields | {"protocols": tuple(protocols)},
        reading=tuple((float(x), float(y)) for x, y in reading),
        reading_sd=tuple((float(x), float(y)) for x, y in sd),
    )


def _shared(readings: int, rows: int, rng: np.random.Generator) -> np.ndarray:
    """What the rows of a reading share of their noise, over its sd, (rows, 2)."""
    of_row = np.arange(rows) * readings // max(rows, 1)
    size = np.bincount(of_row, minlength=readings)
    # sd^2 of the mean: SHARED_NOISE^2 where 1 / size is less
    missing = np.maximum(SHARED_NOISE**2 - 1.0 / np.maximum(size, 1), 0.0)
    return (np.sqrt(missing)[:, None] * rng.standard_normal((readings, 2)))[of_row]


def _misfits(
    model: Posterior, index: int, rng: np.random.Generator
) -> tuple[list[np.ndarray], float]:
    """A misfit (1 + rows, 2) of each protocol, mounted state first; a factor of the noise."""
    protocols = model.pieces[index].specimen.protocols
    loaded = [p.stretch[p.rest_rows :] for p in protocols]
    if not model.settings.has_misfit:
        return [np.zeros((1 + len(stretch), 2)) for stretch in loaded], 1.0
    points, paths = [], model.paths_of_pieces[index]
    for i, stretch in enumerate(loaded):
        points += [paths.start(i), paths.tested(i, stretch)]
    drawn, friction, factor = model.misfits[index].draw(CurvePoints.joined(points), rng)
    ends = np.cumsum([1 + len(stretch) for stretch in loaded])
    return np.split((drawn + friction).reshape(-1, 2), ends[:-1]), factor


def _add_mounting_forces(model: Posterior, truth: dict[str, float]) -> bool:
    """Add the mounting forces, and stretches across strips; False if no such state exists."""
    law = model.law
    material = law.material_at(tuple(truth[name] for name in law.names))
    for piece in model.pieces:
        forward, axes = piece.forward, piece.labels.axes
        section = forward.section(truth)[0, 0]
        if not (np.all(section > 0.0) and np.all(np.isfinite(list(truth.values())))):
            return False
        for state in piece.labels.states if piece.specimen.experiment.is_mounted else ():
            lm = forward.mounting_stretch(truth, state)[0, 0]
            if not np.all((lm > BRACKET[0]) & (lm < BRACKET[1])):
                return False
            force = forward.mounting_load(truth, state)[0]
            if model.settings.mounting == "free":
                # stable: the derivative of the balance is positive definite
                at, logs = force / section, np.log(lm)
                mounted = forward.mounted_dimensions
                _, _, jxx, jxy, jyy = balance(material.constants, *at, mounted, *logs)
                good = bool(jxx > 0.0 and jxx * jyy - jxy * jxy > 0.0)
            else:
                geometry = piece.specimen.geometry
                found = mounting_stretches(material, *(force / section), geometry=geometry)
                good = np.allclose(found, lm, rtol=ROOT_TOLERANCE, atol=0.0)
            if not good:
                return False
            stretches, forces = (mounting_names(what, state) for what in ("stretch", "force"))
            for k in range(2):
                truth[stretches[k]] = float(lm[k])
                if k in axes:
                    truth[forces[k]] = float(force[k])
    return True


LOCAL_PRIOR_WIDTH = 2.0
"""Width of a local prior relative to the posterior it is taken from."""


def protocol_prior(specimen: Specimen, settings: Settings) -> dict[str, Prior | float | Tie]:
    """Prior of tissue that reaches these stresses; independent errors around 0.5 % of the peak.

    Most draws of the default priors are not like tissue on these protocols.
    """
    tested = [p for piece in specimen.pieces for p in piece.protocols]
    stretch = 1.02 * max(float(p.known_stretch.max()) for p in tested)  # mounted at 1.02
    prior = default_priors(specimen, settings)
    scaled = settings.material_law.scaled_prior(stretch, peak_stress(specimen))
    for name, (family, first, second) in scaled.items():
        rounded = first if family == "uniform" else _rounded(first)
        prior[name] = Prior.from_numbers(family, rounded, second)
    if not settings.has_misfit:
        prior[NOISE_SD.name] = Prior("lognormal", _rounded(0.005 * specimen.peak_load), 0.7)
    for name in mounting_names("stretch"):
        if name not in specimen.metadata:
            prior[name] = Prior("normal", 1.02, 0.01, low=0.5)
    return prior


def local_prior(
    draws: Mapping[str, np.ndarray], wide: Mapping[str, Prior | float | Tie], known: Quantities
) -> dict[str, Prior | float | Tie]:
    """Independent priors twice as wide as the marginals of `draws`, at most those in `wide`."""
    out: dict[str, Prior | float | Tie] = {}
    for name, prior in wide.items():
        quantities = [q for q in known.values() if q.parameter.name == name and q.name in draws]
        values_of_states = [draws[q.name].ravel() for q in quantities]
        if not isinstance(prior, Prior) or not values_of_states:
            out[name] = prior
            continue
        values, parameter = np.concatenate(values_of_states), quantities[0].parameter
        logs = parameter.logarithmic
        family = "lognormal" if logs else "normal"
        low, middle, high = np.quantile(np.log(values) if logs else values, [0.1587, 0.5, 0.8413])
        scale = LOCAL_PRIOR_WIDTH * 0.5 * float(high - low)
        if prior.family == family:
            scale = min(scale, prior.scale)
        centre = float(np.exp(middle) if logs else middle)
        bounds = parameter.range if parameter.bounded else (prior.low, prior.high)
        out[name] = Prior(family, float(f"{centre:.6g}"), _rounded(scale)).within(*bounds)
    return out


def priors_toml(priors: Mapping[str, Prior | float | Tie], unit: str, law: Law) -> str:
    """A priors file that reads back to these priors."""
    by_unit: dict[str, list[str]] = {}
    for p in law.parameters:
        if p.unit_words():
            by_unit.setdefault(p.unit_words().strip(), []).append(p.name)
    units = [f"{words} for {' and '.join(names)}" for words, names in by_unit.items()]
    lines = [f"# {', '.join(units)}, {unit} for noise_sd"]
    for name, prior in priors.items():
        value = prior_value(prior)
        if isinstance(value, dict):
            items = ", ".join(f"{key} = {json.dumps(item)}" for key, item in value.items())
            lines.append(f"{name} = {{ {items} }}")
        else:
            lines.append(f"{name} = {json.dumps(value)}")
    return "\n".join(lines) + "\n"


def _rounded(value: float) -> float:
    """Three significant digits, so that the prior can be reported."""
    return float(f"{value:.3g}")
