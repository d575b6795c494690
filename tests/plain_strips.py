"""Strips of a tissue a second time: plain, slow, and from the printed equations alone.

A square is that of :mod:`plain_posterior`, whose complex-step stresses are used here as well. The
stretch across a strip is a root that SciPy brackets, row by row; its mounting force and the change
of variables from it to the mounting stretch are those of the strip alone.
"""

import itertools
import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.optimize import brentq
from scipy.stats import norm

from biaxbayes.specimens.specimen import Protocol, Specimen
from plain_posterior import (
    LEAST_NOISE,
    Places,
    PlainPosterior,
    correlations,
    errors,
    log_prior,
    lognormal,
    mixture,
    normal,
    piola,
    positions,
    readings,
    roots,
    theta_of,
)


def pair(axis, along, across):
    """(x, y) of what is along and across a strip."""
    return (along, across) if axis == 0 else (across, along)


def across_root(theta, axis, along):
    """The stretch across a strip where nothing pulls there."""
    stress = lambda across: piola(theta, *pair(axis, along, across))[1 - axis]  # noqa: E731
    return brentq(stress, 0.55, 1.3, xtol=1e-14, rtol=1e-14)


def strip_force(theta, axis, lm, along, across, section, mounted):
    """Loads (n,) at measured stretches along, and across where the width was measured (or None)."""
    lm_across = 1.0 if lm is None else across_root(theta, axis, lm)
    lm = 1.0 if lm is None else lm
    total = lm * np.asarray(along)
    if across is None:
        other = np.array([across_root(theta, axis, t) for t in total])
    else:
        other = lm_across * np.asarray(across)
    force = section * piola(theta, *pair(axis, total, other))[axis]
    return force * lm if mounted else force


def strip(
    axis, theta, *, lm=1.02, stiffness=1.0, width=False, geometry="unloaded", noise=0.002, rows=12,
    seed=5, **extra,
):  # fmt: skip
    """A strip along an axis, 12 mm x 3 mm x 1.1 mm, made with the second implementation."""
    along = 1.0 + 0.3 * np.linspace(0.0, 1.0, rows)
    start = across_root(theta, axis, lm)
    across = np.array([across_root(theta, axis, lm * a) / start for a in along])
    section = stiffness * 3.0 * 1.1e-3
    force = strip_force(theta, axis, lm, along, None, section, geometry == "mounted")
    force = force + noise * np.random.default_rng(seed).standard_normal(rows)
    stretch = pair(axis, along, across if width else np.full(rows, np.nan))
    protocol = Protocol("1", *stretch, *pair(axis, force, np.zeros(rows)))
    edges = dict(zip(("edge_x_mm", "edge_y_mm"), pair(axis, 12.0, 3.0), strict=True))
    return Specimen(
        f"strip-{'xy'[axis]}", (protocol,), "force", geometry, thickness_mm=1.1,
        load_noise=noise, test=f"strip {'xy'[axis]}", metadata=extra, **edges,
    )  # fmt: skip


@dataclass
class PlainStrip:
    """A strip beside a square: log density of what is its own, given the material."""

    specimen: Specimen
    mounting: str
    noise: str
    toe: float
    smooth: dict = field(default_factory=dict)  # material, mounting_stretch, stiffness
    terms: tuple[int, ...] = ()

    @property
    def axis(self):
        return "xy".index(self.specimen.test[-1])

    @property
    def mounted(self):
        return self.specimen.geometry == "mounted"

    @cached_property
    def protocol(self):
        """Load, stretch along, and stretch across or None, of the rows and of the row at rest."""
        (p,) = self.specimen.protocols
        along, across = pair(self.axis, p.stretch_x, p.stretch_y)
        return readings(self.specimen, p)[self.axis], along, None if np.isnan(across[0]) else across

    @property
    def section(self):
        if self.specimen.loads != "force":
            return 1.0
        width = pair(self.axis, self.specimen.edge_y_mm, self.specimen.edge_x_mm)[0]
        return width * self.specimen.thickness_mm / 1000

    @property
    def stated(self):
        """Priors of the unknowns of the strip, by name without the piece."""
        known, letter = self.specimen.metadata, "xy"[self.axis]
        out = {"stiffness": {"distribution": "logstudent", "median": 1.0, "scale_log": 0.1}}
        if self.noise == "independent":
            out["noise_sd"] = lognormal(0.005 * np.abs(self.protocol[0]).max(), 1.5)
        if "thickness_sd_mm" in known:
            sd = known["thickness_sd_mm"] / self.specimen.thickness_mm
            out["thickness"] = normal(1.0, sd, 0.0)
        if "load_offset_sd_N" in known:
            out[f"load_offset_{letter}"] = normal(0.0, known["load_offset_sd_N"])
        return out

    @property
    def names(self):
        mounted = {"noisy": ["force"], "free": ["stretch"]}.get(self.mounting, [])
        return {*self.stated, *(f"mounting_{what}_{'xy'[self.axis]}" for what in mounted)}

    def log_density(self, theta, values):
        """Priors, mounted state and likelihood of the readings of the strip."""
        total = sum(log_prior(stated, values[n]) for n, stated in self.stated.items())
        total += sum(math.log(values[n]) for n in ("stiffness", "noise_sd") if n in values)
        section = self.section * values["stiffness"] * values.get("thickness", 1.0)
        offset = values.get(f"load_offset_{'xy'[self.axis]}", 0.0)
        load, along, across = self.protocol
        own = lambda lm: self.force_at_mount(theta, lm, section)  # noqa: E731
        lm = None
        if self.mounting == "free":
            lm = values[f"mounting_stretch_{'xy'[self.axis]}"]
            p0 = own(lm)
        elif self.mounting in ("noisy", "exact"):
            p0 = load[0] - offset
            if self.mounting == "noisy":
                p0 = values[f"mounting_force_{'xy'[self.axis]}"]
            lm = brentq(lambda x: own(x) - p0, 0.9, 1.3, xtol=1e-14, rtol=1e-14)
            # p(p0) = p(lm) d lm / d p0
            total -= math.log((own(lm + 1e-5) - own(lm - 1e-5)) / 2e-5)
        if lm is not None:
            total += log_prior(
                {"distribution": "student", "centre": 1.0, "scale": 0.1, "low": 0.0}, lm
            )
        carried = strip_force(
            theta, self.axis, lm, along[1:], None if across is None else across[1:], section,
            self.mounted,
        )  # fmt: skip
        missed = load[1:] - carried - offset
        if self.mounting in ("noisy", "free"):
            missed = np.concatenate([[load[0] - p0 - offset], missed])
        if self.noise == "correlated":
            return total + self.log_misfit(missed)
        if self.mounting in ("noisy", "free"):
            total += norm.logpdf(missed[0], scale=self.specimen.load_noise)
        rows = missed[-(len(load) - 1) :]
        return total + norm.logpdf(rows, scale=values["noise_sd"]).sum()

    def force_at_mount(self, theta, lm, section):
        return strip_force(theta, self.axis, lm, [1.0], None, section, self.mounted)[0]

    def log_misfit(self, missed):
        """Log likelihood of what a law misses: the mean over all covariances."""
        return mixture(*self.normals, missed)

    @cached_property
    def normals(self):
        """Log weight and covariance of all readings of each normal distribution."""
        load, along, across = self.protocol
        first = 0 if self.mounting in ("noisy", "free") else 1
        lm = None if self.mounting == "ignored" else self.smooth["mounting_stretch"]
        section = self.section * self.smooth["stiffness"]
        smooth = strip_force(
            theta_of(self.smooth), self.axis, lm, along, across, section, self.mounted
        )
        other = np.ones_like(along) if across is None else across
        plane = [np.log(v) / max(np.abs(np.log(v)).max(), 1e-6) for v in (along, other)]
        path = np.concatenate([[0.0], positions(np.array([along, other])[:, 1:])])
        place = [(0, self.axis, s, *p) for s, *p in zip(path, *plane, strict=True)][first:]
        at = Places(place, smooth[first:], np.full(len(place), np.abs(smooth).max()))
        sd = max(self.specimen.load_noise, LEAST_NOISE * np.abs(load).max())
        known, toe, friction = correlations(1), at.toe(at), at.friction()
        weights, covariances, number = [], [], itertools.count()
        for correlation in known:
            delta = at.smooth(correlation, at)
            for a, factor, t, u, weight in errors(self.toe):
                if next(number) not in self.terms:
                    continue
                weights.append(weight / len(known))
                covariance = a**2 * delta + t**2 * toe + u**2 * friction
                covariances.append(covariance + (factor * sd) ** 2 * np.eye(len(place)))
        return np.log(weights), roots(np.array(covariances))


@dataclass
class PlainTissue:
    """A square with strips: log density of natural parameters by the names of the product."""

    square: PlainPosterior
    strips: list[PlainStrip]

    @property
    def names(self):
        of_strips = {f"{n}[{s.specimen.name}]" for s in self.strips for n in s.names}
        return self.square.names | of_strips

    def log_density(self, given):
        theta = theta_of(given)
        total = self.square.log_density({n: given[n] for n in self.square.names})
        for s in self.strips:
            own = {n: given[f"{n}[{s.specimen.name}]"] for n in s.names}
            total += s.log_density(theta, own)
        return total
