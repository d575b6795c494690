"""The posterior a second time: plain, slow, and from the printed equations alone.

Nothing of the product is used but the fields of a specimen. Stresses are complex-step derivatives
of Eq. 5 of the paper, the mounted state is found by SciPy's solver, changes of variables are
finite differences, and priors are those of ``scipy.stats``. What has no density here is decided
here as well: the product is never asked.

The errors of the readings are independent, or the noise of the load cell with a smooth misfit of
the law. For the latter the covariance of all readings is written out for every structure,
amplitude, noise and toe, and the likelihood is the mean of as many multivariate normal densities.
"""

import hashlib
import itertools
import json
import math
import os
import pickle
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.optimize import root
from scipy.special import logsumexp
from scipy.stats import lognorm, norm, truncnorm, uniform
from scipy.stats import t as student

from biaxbayes.specimens.specimen import Protocol, Specimen

STEP = 1e-30  # of a complex-step derivative
LOWEST, HIGHEST = 0.3, 4.0  # mounting stretches lie between
EDGE = 0.1  # in log stretch, of either end
IN_LOGS = ("C1", "k1", "k2", "noise_sd")
MATERIAL = ("C1", "k1", "k2", "alpha", "kappa")
RANGES = {"alpha": (0.0, 90.0), "kappa": (0.0, 1 / 3)}
"""Physical ranges that no prior widens."""


# --- the material ----------------------------------------------------------------------------


def energy(theta, lx, ly, lz, switch=False):
    """Eq. 5: invariants of C = F^T F and of two mean fibre directions; k2 = 0 is its limit."""
    C1, k1, k2, alpha, kappa = theta
    I1 = lx * lx + ly * ly + lz * lz
    W = C1 * (I1 - 3)
    for angle in (alpha, -alpha):
        # M C M for C = diag(lx^2, ly^2, lz^2) and M = (cos, sin, 0)
        I4 = (lx * np.cos(angle)) ** 2 + (ly * np.sin(angle)) ** 2
        E = kappa * I1 + (1 - 3 * kappa) * I4 - 1
        fibre = np.expm1(k2 * E * E) / k2 if k2 > 0 else E * E
        if switch:
            fibre = fibre * (np.real(E) >= 0)
        W = W + 0.5 * k1 * fibre
    return W


def piola(theta, lx, ly, switch=False):
    """P_k = dW/dl_k with lz = 1/(lx ly), shape (2, ...), by complex step."""
    step = (1j * STEP * np.array([1, 0])).reshape(2, *(1,) * np.ndim(lx))
    zx, zy = lx + step, ly + step[::-1]
    return np.imag(energy(theta, zx, zy, 1 / (zx * zy), switch)) / STEP


def carried(theta, lm, measured, section, mounted, switch=False):
    """Load at measured stretches, shape (2, n).

    Force over the unloaded section is P; a section that was measured mounted has shrunk by lm.
    """
    total = [lm[k] * np.asarray(measured[k]) for k in (0, 1)]
    force = np.asarray(section)[:, None] * piola(theta, *total, switch).reshape(2, -1)
    return force * np.asarray(lm)[:, None] if mounted else force


def mounting_load(theta, lm, section, mounted, switch=False):
    """What the specimen carries as mounted, shape (2,)."""
    return carried(theta, lm, ([1.0], [1.0]), section, mounted, switch)[:, 0]


def load_slope(theta, lm, section, mounted, switch=False):
    """d p0 / d lm, shape (2, 2), by central differences."""
    h = 1e-5
    columns = []
    for e in np.eye(2):
        ends = [mounting_load(theta, lm + s * h * e, section, mounted, switch) for s in (1, -1)]
        columns.append((ends[0] - ends[1]) / (2 * h))
    return np.array(columns).T


# --- the mounted state -----------------------------------------------------------------------


def is_stable(theta, lm, section, mounted, switch=False):
    """Whether the energy less the work of the held load has a minimum at lm.

    The load does work on the stretch where it is a dead load per unloaded section, and on the
    log of the stretch where it is one per mounted section. At a balance the slope of that
    energy by lm is the load's deficit, so its curvature is the slope of the load itself.
    """
    slope = load_slope(theta, lm, section, mounted, switch) / np.asarray(section)[:, None]
    if mounted:  # the energy's gradient is (s - p0) / lm, so its curvature (ds/dlm) / lm
        slope = slope / np.asarray(lm)[:, None]
    curvature = 0.5 * (slope + slope.T)
    return bool(np.all(np.isfinite(curvature)) and np.linalg.eigvalsh(curvature).min() > 0)


def inside_bracket(lm):
    return bool(np.all((np.asarray(lm) > LOWEST) & (np.asarray(lm) < HIGHEST)))


def near_the_edge(lm):
    return bool(
        np.min(np.log(lm)) < math.log(LOWEST) + EDGE or np.max(lm) > HIGHEST - EDGE * HIGHEST
    )


def mounting_root(theta, p0, section, mounted, switch=False):
    """(mounted state that balances p0 or None, whether a slowly growing load leads to it).

    A load that grows from nothing leads from the unloaded state through stable states. Where it
    comes to the end of them, another stable state may lie elsewhere: it is looked for from many
    starting points.
    """
    scale = max(np.abs(p0).max(), 1e-3 * theta[0] * max(section))

    def lack(logs, share):
        load = mounting_load(theta, np.exp(logs), section, mounted, switch)
        return (load - share * p0) / scale

    def stable_root(start, share):
        found = root(lack, start, (share,), tol=1e-13, options={"maxfev": 80})
        lm = np.exp(found.x)
        if not (np.all(np.isfinite(lm)) and np.abs(found.fun).max() < 1e-9 and inside_bracket(lm)):
            return None
        return lm if is_stable(theta, lm, section, mounted, switch) else None

    with np.errstate(all="ignore"):
        lm = np.ones(2)
        for share in (0.25, 0.5, 0.75, 1.0):
            lm = stable_root(np.log(lm), share)
            if lm is None:
                break
        else:
            return lm, True
        for start in STARTS:
            lm = stable_root(start, 1.0)
            if lm is not None:
                return lm, False
    return None, False


STARTS = [
    np.log([x, y])
    for x in (1.0, 1.05, 1.2, 1.7, 0.85, 0.7, 0.45, 2.6, 0.35, 3.3)
    for y in (1.0, 1.2, 1.7, 0.8, 0.45, 2.6, 0.35, 3.3)
]


# --- priors ----------------------------------------------------------------------------------


def log_prior(stated, x, *, positive=False):
    """Log density at x of a prior as a priors file states it; ``positive`` cuts it at zero."""
    family = stated["distribution"]
    low, high = stated.get("low", -math.inf), stated.get("high", math.inf)
    if positive:
        low = max(low, 0.0)
    if not low <= x <= high:
        return -math.inf
    if family == "normal":
        mean, sd = stated["mean"], stated["sd"]
        return float(truncnorm.logpdf(x, (low - mean) / sd, (high - mean) / sd, mean, sd))
    if family == "lognormal":
        law = lognorm(stated["sd_log"], scale=stated["median"])
        return float(law.logpdf(x) - math.log(law.cdf(high) - law.cdf(max(low, 0.0))))
    if family in ("student", "logstudent"):
        logs = family == "logstudent"
        centre, scale = (
            stated["median" if logs else "centre"],
            stated["scale_log" if logs else "scale"],
        )
        z, a, b = (
            ((math.log(v) if v > 0 else -math.inf) - math.log(centre) if logs else v - centre)
            / scale
            for v in (x, max(low, 0.0) if logs else low, high)
        )
        inside = student(3).cdf(b) - student(3).cdf(a)
        return float(student(3).logpdf(z) - math.log(scale * inside) - (math.log(x) if logs else 0))
    if family == "uniform":
        return float(uniform.logpdf(x, low, high - low))
    return -math.log(x * math.log(high / low))


def within(stated, low, high):
    """A stated prior cut to a range."""
    out = dict(stated)
    out["low"] = max(stated.get("low", -math.inf), low)
    out["high"] = min(stated.get("high", math.inf), high)
    return out


def lognormal(median, sd_log):
    return {"distribution": "lognormal", "median": median, "sd_log": sd_log}


def normal(mean, sd, low=-math.inf):
    return {"distribution": "normal", "mean": mean, "sd": sd, "low": low}


def default_priors(specimen):
    """The documented defaults and what the header of the file states."""
    peak = max(np.abs(readings(specimen, p)).max() for p in specimen.protocols)
    priors = {
        "C1": lognormal(10.0, 2.0),
        "k1": lognormal(30.0, 2.5),
        "k2": lognormal(10.0, 2.0),
        "alpha": {"distribution": "uniform", "low": 0.0, "high": 90.0},
        "kappa": {"distribution": "uniform", "low": 0.0, "high": 1 / 3},
        "noise_sd": lognormal(0.005 * peak, 1.5),
    }
    known = specimen.metadata
    for axis in "xy":
        text = known.get(f"mounting_stretch_{axis}")
        stretch = {"distribution": "student", "centre": 1.0, "scale": 0.1, "low": 0.0}
        if text is not None:
            stretch = normal(*map(float, str(text).split("+-")), 0.0)
        priors[f"mounting_stretch_{axis}"] = stretch
        if "edge_sd_mm" in known:
            edge = specimen.edge_x_mm if axis == "x" else specimen.edge_y_mm
            priors[f"edge_{axis}"] = normal(1.0, known["edge_sd_mm"] / edge, 0.0)
        offset = known.get("load_offset_sd_N", known.get("load_offset_sd_kPa"))
        if offset is not None:
            priors[f"load_offset_{axis}"] = normal(0.0, offset)
    if "thickness_sd_mm" in known:
        priors["thickness"] = normal(1.0, known["thickness_sd_mm"] / specimen.thickness_mm, 0.0)
    return priors


# --- the data --------------------------------------------------------------------------------


def readings(specimen: Specimen, p: Protocol):
    """Force, or first Piola-Kirchhoff stress of the file's own reference, shape (2, n)."""
    pair = np.array([p.load_x, p.load_y])
    return pair / [p.stretch_x, p.stretch_y] if specimen.loads == "cauchy" else pair


def mounting_reading(specimen: Specimen, p: Protocol):
    """Mean of the rows at rest and the sd of that mean, each shape (2,)."""
    rest = readings(specimen, p)[:, : p.rest_rows]
    sd = np.full(2, specimen.load_noise)
    if p.rest_rows >= 5:  # so many show their own scatter
        sd = np.maximum(sd, rest.std(axis=1, ddof=1))
    return rest.mean(axis=1), sd / math.sqrt(p.rest_rows)


def rows_of(load, stretch, rows):
    """(load, stretch, scatter, weight) of the rows that enter the likelihood.

    Of more than ``rows`` rows (0 for all) neighbours are averaged, k at a time; each average
    counts as the readings it stands for, with their mean square about a straight line.
    """
    n = load.shape[1]
    k = math.ceil(n / rows) if rows else 1
    if k == 1:
        return load, stretch, np.zeros_like(load), 1.0
    groups = math.ceil(n / k)
    edges = [i * n // groups for i in range(groups + 1)]
    means, places, scatters = [], [], []
    for first, last in itertools.pairwise(edges):
        size = last - first
        part = load[:, first:last]
        means.append(part.mean(axis=1))
        places.append(stretch[:, first:last].mean(axis=1))
        if size > 2:
            # a line takes two of the k - 1 degrees of freedom that the mean leaves but one of
            t = np.arange(size)
            rss = [np.sum((y - np.polyval(np.polyfit(t, y, 1), t)) ** 2) for y in part]
            scatters.append(np.array(rss) * (size - 1) / (size - 2) / size)
        elif size == 2:  # var(f0 - 2 f1 + f2) = 6 sd^2; two about their mean have sd^2 / 2
            second = load[:, :-2] - 2 * load[:, 1:-1] + load[:, 2:]
            scatters.append(np.mean(second**2, axis=1) / 12)
        else:
            scatters.append(np.zeros(2))
    return np.array(means).T, np.array(places).T, np.array(scatters).T, n / groups


# --- the smooth misfit of the law ------------------------------------------------------------

AMPLITUDES = [0.002 * 200 ** (i / 9) for i in range(10)]  # 0.002 to 0.4, evenly in logs
TOES = [0.1 * 20 ** (i / 4) for i in range(5)]  # 0.1 to 2 times the sd of the prior
TOE_LENGTH = 0.4
NOISE = [(1.0, 0.85), (2.0, 0.1), (4.0, 0.04), (8.0, 0.01)]
"""Factors of the load cell's noise, and their weights."""
FRICTIONS = [(0.0, 0.98), (0.03, 0.02)]
"""Friction of a curve over its peak, and their weights."""
LEAST_NOISE = 1e-4  # of a reading, of the largest load
SHARED = 0.5  # of the noise of a row, that a mean of rows has at least


def in_groups(values, most):
    """Means along the last axis of at most so many groups of neighbours, and their sizes."""
    n = values.shape[-1]
    count = min(n, most)
    member = [[j for j in range(n) if j * count // n == i] for i in range(count)]
    return np.stack([values[..., m].mean(axis=-1) for m in member], axis=-1), [*map(len, member)]


def half_normal(steps, sd):
    """A half-normal density over even steps of the log, made to sum to one."""
    weight = np.array([a * math.exp(-0.5 * (a / sd) ** 2) for a in steps])
    return weight / weight.sum()


def amplitude_weights():
    """Of the amplitudes of the smooth misfit."""
    return half_normal(AMPLITUDES, 0.05)


def toes(sd):
    """(amplitude, weight) of the toe, whose prior has this sd."""
    if not sd:
        return [(0.0, 1.0)]
    steps = [sd * step for step in TOES]
    return list(zip(steps, half_normal(steps, sd), strict=True))


def errors(toe):
    """(amplitude, factor of the noise, toe, friction, weight) of every normal of a structure."""
    return [
        (a, factor, t, u, of_a * of_factor * of_t * of_u)
        for a, of_a in zip(AMPLITUDES, amplitude_weights(), strict=True)
        for factor, of_factor in NOISE
        for t, of_t in toes(toe)
        for u, of_u in FRICTIONS
    ]


def correlations(protocols):
    """Correlation of the misfit at two places, for each structure.

    A place is (protocol, axis, position on the path, its two coordinates in the plane).
    """

    def bell(d):
        return math.exp(-d * d / 2)

    def cusp(d):
        return (1 + math.sqrt(3) * d) * math.exp(-math.sqrt(3) * d)

    def along(shape, length, related):
        def correlation(a, b):
            if a[0] != b[0]:
                return 0.0
            return (1.0 if a[1] == b[1] else related) * shape(abs(a[2] - b[2]) / length)

        return correlation

    def over_plane(length):
        def correlation(a, b):
            return bell(math.dist(a[3:], b[3:]) / length) if a[1] == b[1] else 0.0

        return correlation

    lengths = (0.15, 0.3, 0.6, 1.0, 1.5)
    out = []
    for related in (0.0, 0.9):
        out += [along(bell, length, related) for length in lengths]
        out += [along(cusp, length, related) for length in (0.3, 0.8)]
    if protocols > 1:
        out += [over_plane(length) for length in lengths]
    return out


@dataclass
class Places:
    """Places of n readings on the curves: where they are and what a misfit is relative to there."""

    place: list  # of (protocol, axis, path, plane x, plane y)
    load: np.ndarray
    peak: np.ndarray

    def __add__(self, other):
        return Places(
            self.place + other.place,
            np.concatenate([self.load, other.load]),
            np.concatenate([self.peak, other.peak]),
        )

    def smooth(self, correlation, other):
        """D K D between these places and others, of a misfit of amplitude one."""

        def scale(of):
            return np.sqrt(of.load**2 + (0.05 * of.peak) ** 2)

        K = np.array([[correlation(a, b) for b in other.place] for a in self.place])
        return scale(self)[:, None] * K * scale(other)

    def friction(self):
        """Between these places: one error of a curve at rest, and another as soon as it moves."""

        def product(i, j):
            (p, q), (a, b) = self.peak[[i, j]], (math.exp(-self.place[k][2] / 0.05) for k in (i, j))
            return p * q * (a * b + (1 - a) * (1 - b)) * (self.place[i][:2] == self.place[j][:2])

        return np.array(
            [[product(i, j) for j in range(len(self.place))] for i in range(len(self.place))]
        )

    def toe(self, other):
        """V G V between these places and others: a bell of length 1 over the plane of each axis."""

        def shape(of):
            return of.load * np.exp(-np.array([p[2] for p in of.place]) / TOE_LENGTH)

        G = [
            [(a[1] == b[1]) * math.exp(-(math.dist(a[3:], b[3:]) ** 2) / 2) for b in other.place]
            for a in self.place
        ]
        return np.array(G) * np.outer(shape(self), shape(other))


def some_terms(protocols, toe):
    """Some of the normal distributions, every one of which a density may be asked for."""
    count = len(correlations(protocols)) * len(errors(toe))
    return tuple(sorted(np.random.default_rng(count).choice(count, 300, replace=False).tolist()))


def roots(covariances):
    """Inverses of the Cholesky factors, and log determinants, of covariances (m, n, n)."""
    lower = np.linalg.cholesky(covariances)
    log_det = 2 * np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(axis=1)
    return np.linalg.inv(lower), log_det


def mixture(log_weight, inverse, r):
    """Log density of r under normal distributions with these weights."""
    lower, log_det = inverse
    square = ((lower @ r) ** 2).sum(axis=1)
    logs = log_weight - 0.5 * (square + log_det + len(r) * math.log(2 * math.pi))
    return float(logsumexp(logs))


# --- the posterior ---------------------------------------------------------------------------


@dataclass
class PlainPosterior:
    """Log density of natural parameters, in ln of the positive ones and alpha in radians.

    ``priors`` are those of a priors file: a number is fixed, text is a tie, a table is a
    distribution. ``smooth`` is what the smooth loads are those of, that a misfit is relative to: a
    material, and mounting stretches where they are unknowns. Of the normal distributions of a
    misfit those in ``terms`` are summed.
    """

    specimen: Specimen
    mounting: str = "noisy"
    per_protocol: bool = False
    noise: str = "independent"
    toe: float = 0.2
    smooth: dict | None = None
    terms: tuple[int, ...] = ()  # the normal distributions that are summed, in their order
    switch: bool = False
    max_rows: int = 0
    priors: dict = field(default_factory=dict)

    def __post_init__(self):
        stated = default_priors(self.specimen)
        for name, value in self.priors.items():
            if name == "mounting_stretch":
                stated["mounting_stretch_x"] = stated["mounting_stretch_y"] = value
            elif isinstance(value, dict):
                stated[name] = within(value, *RANGES.get(name, (-math.inf, math.inf)))
            else:
                stated[name] = value
        if self.noise == "correlated":
            del stated["noise_sd"]
        self.stated = stated
        self.remote = ""

    @property
    def labels(self):
        """Tail of the names of each mounted state."""
        return [f"[{p.name}]" if self.per_protocol else "" for p in self.states]

    @property
    def states(self):
        return self.specimen.protocols if self.per_protocol else self.specimen.protocols[:1]

    @property
    def names(self):
        """Names of the unknowns."""
        out = {
            n
            for n, v in self.stated.items()
            if isinstance(v, dict) and not n.startswith("mounting")
        }
        if self.mounting in ("noisy", "free"):
            what = "force" if self.mounting == "noisy" else "stretch"
            for axis in "xy":
                if isinstance(self.stated[f"mounting_stretch_{axis}"], dict):
                    out |= {f"mounting_{what}_{axis}{tail}" for tail in self.labels}
        return out

    def log_density(self, given):
        """Log density, -inf where there is none.

        ``remote`` then names why a search from the unloaded state may miss a mounted state:
        ``no load path`` (no growing load leads to it) or ``near the edge`` (within 10 % of the
        bracket's), and is empty where it must be met.
        """
        self.remote = ""
        values = {n: float(given[n]) for n in self.names}
        if not all(math.isfinite(v) for v in values.values()):
            return -math.inf
        with np.errstate(all="ignore"):
            total = self.log_prior(values)
            if math.isfinite(total):
                total += self.log_likelihood(values)
        return float(total) if math.isfinite(total) else -math.inf

    def complete(self, values):
        """The unknowns with all that is fixed, tied or left at its nominal value."""
        v = {"edge_x": 1.0, "edge_y": 1.0, "thickness": 1.0}
        v |= {"load_offset_x": 0.0, "load_offset_y": 0.0} | values
        for name, stated in self.stated.items():
            if not isinstance(stated, dict | str):
                v[name] = stated
        for name in ("k1", "C1"):
            if isinstance(self.stated[name], str):
                factor, other = self.stated[name].split("*")
                v[name] = float(factor) * v[other.strip()]
        if self.stated["mounting_stretch_y"] == "mounting_stretch_x":
            for tail in self.labels:
                v[f"mounting_stretch_y{tail}"] = v[f"mounting_stretch_x{tail}"]
        return v

    def log_prior(self, values):
        """Of all unknowns but those of the mounted state."""
        total = 0.0
        for name, x in values.items():
            if name.startswith("mounting"):
                continue
            if name in IN_LOGS and x <= 0:
                return -math.inf
            total += log_prior(self.stated[name], x, positive=name in IN_LOGS)
            if name in IN_LOGS:
                total += math.log(x)  # dx = x d ln x
            if name == "alpha":
                total += math.log(180 / math.pi)  # stated per degree
        return total

    def log_likelihood(self, values):
        """Of the mounting readings, with the priors of the mounted state, and of the curves."""
        v = self.complete(values)
        section = self.section * [v["edge_y"] * v["thickness"], v["edge_x"] * v["thickness"]]
        if not np.all(section > 0):
            return -math.inf
        theta, offset = theta_of(v), np.array([v["load_offset_x"], v["load_offset_y"]])
        mounted = self.specimen.geometry == "mounted"
        total, stretches, missed = 0.0, [], []
        for m, tail in enumerate(self.labels):
            log, lm, p0 = self.mounted_state(m, tail, v, theta, section, mounted, offset)
            if lm is None or not math.isfinite(log):
                return -math.inf
            total += log
            stretches.append(lm)
            if self.reads_force:
                missed.append(self.reading(m)[0] - p0 - offset)
        curves = []
        for i, (load, stretch, _, _) in enumerate(self.curves):
            lm = stretches[i if self.per_protocol else 0]
            model = carried(theta, lm, stretch, section, mounted, self.switch)
            curves.append(load - model - offset[:, None])
        if self.noise == "correlated":
            return total + self.log_misfit(missed, curves)
        for m, miss in enumerate(missed):
            total += norm.logpdf(miss, scale=self.reading(m)[1]).sum()
        for miss, (_, _, scatter, weight) in zip(curves, self.curves, strict=True):
            sd = v["noise_sd"]
            total += weight * (norm.logpdf(miss, scale=sd) - 0.5 * scatter / sd**2).sum()
        return total

    @property
    def section(self):
        """Load per kPa by the dimensions of the file, shape (2,)."""
        if self.specimen.loads != "force":  # kPa mm^2 = 1e-3 N
            return np.ones(2)
        edges = np.array([self.specimen.edge_y_mm, self.specimen.edge_x_mm])
        return edges * self.specimen.thickness_mm / 1000

    @property
    def reads_force(self):
        """Whether the mounting forces are readings with an error."""
        return self.mounting in ("noisy", "free")

    @property
    def curves(self):
        """(load, stretch, scatter, weight) of each protocol after its rows at rest."""
        out = []
        for p in self.specimen.protocols:
            load = readings(self.specimen, p)
            if self.mounting == "zeroed":
                load = load - load[:, : p.rest_rows].mean(axis=1)[:, None]
            stretch = np.array([p.stretch_x, p.stretch_y])[:, p.rest_rows :]
            out.append(rows_of(load[:, p.rest_rows :], stretch, self.max_rows))
        return out

    # --- the smooth misfit ---

    @property
    def most(self):
        """Readings of a curve at most, 64 in all in one direction but from 20 to 32."""
        return min(max(64 // len(self.specimen.protocols), 20), 32)

    def log_misfit(self, missed, curves):
        """Log likelihood of what a law misses: of mounting readings, and of rows (2, n)."""
        means = [in_groups(miss, self.most)[0].ravel() for miss in curves]
        r = np.concatenate([*missed, *means])
        if not np.all(np.isfinite(r)):
            return -math.inf
        return mixture(*self.normals, r)

    @cached_property
    def normals(self):
        """Log weight and covariance of all readings of each normal distribution."""
        weights, covariances = zip(*self.hypotheses(), strict=True)
        return np.log(weights), roots(np.array(covariances))

    def hypotheses(self):
        """(weight, covariance of all readings) of each term."""
        at, reading, sd = self.observed
        number = itertools.count()
        known = correlations(len(self.specimen.protocols))
        toe, friction = (reading @ shape @ reading.T for shape in (at.toe(at), at.friction()))
        for correlation in known:
            smooth = reading @ at.smooth(correlation, at) @ reading.T
            for a, factor, t, u, weight in errors(self.toe):
                if next(number) in self.terms:
                    covariance = a**2 * smooth + t**2 * toe + u**2 * friction
                    yield weight / len(known), covariance + np.diag((factor * sd) ** 2)

    @cached_property
    def observed(self):
        """Places; what readings are as means over them; their sd by the load cell's noise."""
        starts = self.states if self.reads_force else []
        protocols = self.specimen.protocols
        least = LEAST_NOISE * max(np.abs(readings(self.specimen, p)).max() for p in protocols)
        shared = max(SHARED * max(self.specimen.load_noise, least), least)
        sd = [np.maximum(self.reading(m)[1], shared) for m in range(len(starts))]
        noise, n = max(self.specimen.load_noise, least), 2 * len(starts)
        rows, at = [], Places([], np.zeros(0), np.zeros(0))
        for i, (_, stretch, _, weight) in enumerate(self.curves):
            # the mounted state, in x and y
            first = len(at.place)
            at = at + self.places(i, np.ones((2, 1)), np.zeros(1))
            for k in range(2 if starts else 0):
                state = i if self.per_protocol else 0
                shared_by = 1 if self.per_protocol else len(self.specimen.protocols)
                rows.append((2 * state + k, first + k, 1 / shared_by))
            # the readings
            means = self.places(i, stretch, positions(stretch))
            _, size = in_groups(stretch, self.most)
            sd.append(noise * np.maximum(SHARED, 1 / np.sqrt(weight * np.array([*size, *size]))))
            for k in range(2 * len(size)):
                rows.append((n + k, len(at.place) + k, 1.0))
            n += 2 * len(size)
            at = at + means
        reading = np.zeros((n, len(at.place)))
        for row, column, share in rows:
            reading[row, column] = share
        return at, reading, np.concatenate(sd)

    def places(self, i, stretch, path):
        """Places of protocol i at measured stretches (2, n), rows in groups; x, then y."""
        theta, mounted = theta_of(self.smooth), self.specimen.geometry == "mounted"
        lm = np.ones(2)
        if self.mounting in ("noisy", "exact", "free"):
            tail = self.labels[i if self.per_protocol else 0]
            lm = np.array([self.smooth[f"mounting_stretch_{axis}{tail}"] for axis in "xy"])

        def smooth_load(at):
            return carried(theta, lm, at, self.section, mounted, self.switch)

        rows = [np.array([p.stretch_x, p.stretch_y]) for p in self.specimen.protocols]
        span = np.max([np.abs(np.log(x)).max(axis=1) for x in rows], axis=0)
        peak = np.abs(smooth_load(rows[i])).max(axis=1)
        q, _ = in_groups(smooth_load(stretch), self.most)
        where, _ = in_groups(np.vstack([path, np.log(stretch) / span[:, None]]), self.most)
        place = [(i, k, *where[:, j]) for k in (0, 1) for j in range(q.shape[1])]
        return Places(place, q.ravel(), np.repeat(peak, q.shape[1]))

    def mounted_state(self, m, tail, v, theta, section, mounted, offset):
        """(log density, lm, p0) of one mounted state, without the likelihood of its readings."""
        if self.mounting in ("ignored", "zeroed"):
            return 0.0, np.ones(2), np.zeros(2)
        total = 0.0
        if self.mounting == "free":
            lm = np.array([v[f"mounting_stretch_{axis}{tail}"] for axis in "xy"])
            if not (inside_bracket(lm) and is_stable(theta, lm, section, mounted, self.switch)):
                return -math.inf, None, None
            p0 = mounting_load(theta, lm, section, mounted, self.switch)
        else:
            p0 = self.reading(m)[0] - offset
            if self.mounting == "noisy":
                p0 = np.array([v[f"mounting_force_{axis}{tail}"] for axis in "xy"])
            lm, led = mounting_root(theta, p0, section, mounted, self.switch)
            if lm is None:
                return -math.inf, None, None
            if not led:
                self.remote = "no load path"
            elif near_the_edge(lm):
                self.remote = self.remote or "near the edge"
            slope = load_slope(theta, lm, section, mounted, self.switch)
            total -= math.log(np.linalg.det(slope))
        for k, axis in enumerate("xy"):
            stated = self.stated[f"mounting_stretch_{axis}"]
            if isinstance(stated, dict):
                total += log_prior(stated, lm[k])
        return total, lm, p0

    def reading(self, m):
        """Mounting load of state m and its sd: one protocol's, or the mean of all."""
        each = [mounting_reading(self.specimen, p) for p in self.specimen.protocols]
        if self.per_protocol or len(each) == 1:
            return each[m]
        loads, sds = (np.array(column) for column in zip(*each, strict=True))
        sd = np.sqrt(np.sum(sds**2, axis=0)) / len(each)
        # the scatter of the protocols' readings counts where it is larger
        scatter = np.std(loads, axis=0, ddof=1) / math.sqrt(len(each))
        return loads.mean(axis=0), np.maximum(sd, scatter)


def theta_of(values):
    """C1, k1, k2, alpha in radians and kappa."""
    return (
        *(values[n] for n in ("C1", "k1", "k2")),
        math.radians(values["alpha"]),
        values["kappa"],
    )


def positions(stretch):
    """Length of the path of measured stretches (2, n) up to each, from 0 as mounted to 1."""
    steps = np.diff(np.hstack([np.ones((2, 1)), stretch]), axis=1)
    path = np.cumsum(np.hypot(*steps))
    return path / path[-1]


def densities(plain: PlainPosterior, points) -> list[tuple[float, str]]:
    """Log density at each point and why its mounted state is ``remote``.

    They do not depend on the product. Where it is changed a thousand times, as by the mutation
    study, the environment's BIAXBAYES_PLAIN_DENSITIES names a folder to keep them in.
    """
    folder = os.environ.get("BIAXBAYES_PLAIN_DENSITIES")
    stated = {f.name: getattr(plain, f.name) for f in fields(plain)}
    key = hashlib.sha256(pickle.dumps((stated, points))).hexdigest()
    kept = Path(folder or ".") / f"{key}.json"
    if folder and kept.exists():
        return json.loads(kept.read_text())
    found = [(plain.log_density(values), plain.remote) for values in points]
    if folder:
        kept.write_text(json.dumps(found))
    return found


# --- a specimen of which all is known ---

EDGES = {"edge_x_mm": 20.0, "edge_y_mm": 17.0, "thickness_mm": 1.1}
SMOOTH = {"C1": 7.0, "k1": 23.0, "k2": 2.8, "alpha": 42.0, "kappa": 0.1}
"""What a misfit is relative to: near the truth, but not it."""
TRUTH = {"C1": 8.0, "k1": 20.0, "k2": 3.0, "alpha": 40.0, "kappa": 0.12}


def specimen_of(
    pair="force", geometry="unloaded", *, protocols=1, rest=1, rows=14, noise=0.01, seed=3, **extra
):
    """A specimen made with the second implementation."""
    rng = np.random.default_rng(seed)
    theta = (TRUTH["C1"], TRUTH["k1"], TRUTH["k2"], np.deg2rad(TRUTH["alpha"]), TRUTH["kappa"])
    lm = np.array([1.03, 1.05])
    area = np.array([EDGES["edge_y_mm"], EDGES["edge_x_mm"]]) * EDGES["thickness_mm"] / 1000
    section = area if pair == "force" else np.ones(2)
    made = []
    for i in range(protocols):
        path = np.concatenate([np.zeros(rest), np.linspace(0.02, 1, rows - rest)])
        x, y = 1 + 0.25 * path, 1 + 0.2 * path / (i + 1)
        load = carried(theta, lm, (x, y), section, geometry == "mounted", False)
        if pair == "cauchy":
            load = load * [x, y]
        load = load + noise * rng.standard_normal(load.shape)
        made.append(Protocol(f"p{i}", x, y, *load, rest_rows=rest))
    return Specimen("test", tuple(made), pair, geometry, load_noise=noise, metadata=extra, **EDGES)
