"""Virtual specimens of known truth, made without the package that is judged.

Stresses are derivatives of energies by complex step, mounted states and unloaded states of layers
are roots of a Newton iteration of its own, misfits are drawn from Gaussian processes of its own.
A family and a seed determine a specimen.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

ROWS = 100
"""Readings of a protocol, the mounted state among them."""
NOISE = 0.0015
"""Sd of a reading, as a share of the largest load of the specimen."""
MISFIT = 0.02
TOE = 0.06
"""Sd of the relative error of the law at the mounted state, where only the toe is wrong."""
RATIOS = ((1.0, 1.0), (1.0, 0.5), (0.5, 1.0))
LEFT_OUT = (1.0, 0.75)
PEAK_KPA = (50.0, 150.0)
"""Range of the largest Cauchy stress on the way along x = y."""
Energy = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Energy per volume, kPa, of principal stretches (complex)."""

MISFITS = ("misfit-0.1", "misfit-0.25", "misfit-1", "alike", "plane", "toe", "gain")
NOISES = {"noise-0.1": 0.001, "noise-0.5": 0.005, "noise-2": 0.02, "noise-5": 0.05}
TISSUES = ("four-fibre", "fung", "recruited", "layers", "exponent-1.5", "exponent-2.6")
FAR = tuple(f"far-{name}" for name in TISSUES)
MACHINES = ("polynomial", "friction", "viscous", "lag", "slip")
FAMILIES = (*MISFITS, *TISSUES, *NOISES, *FAR, *MACHINES)


class Unsuitable(Exception):
    """A material that cannot be tested as planned; another one is drawn."""


# --- mechanics -----------------------------------------------------------------------------------


def cauchy(energy: Energy, total: np.ndarray) -> np.ndarray:
    """Cauchy stress (n, 2), kPa, in plane stress at total stretches (n, 2)."""
    step = 1e-30
    out = np.empty(total.shape)
    for k in range(2):
        x, y = (total + 1j * step * (np.arange(2) == k)).T
        # s_k = l_k d W(l_x, l_y, 1 / (l_x l_y)) / d l_k
        out[:, k] = total[:, k] * energy(x, y, 1.0 / (x * y)).imag / step
    return out


def piola(energy: Energy, total: np.ndarray) -> np.ndarray:
    """First Piola-Kirchhoff stress (n, 2), kPa: force per unloaded section."""
    return cauchy(energy, total) / total


def stretch_at(stress: Callable[[np.ndarray], np.ndarray], load: np.ndarray) -> np.ndarray:
    """Stretches (2,) at which a nominal stress is a given load, by damped Newton from 1."""
    logs, step = np.zeros(2), 1e-6

    def error(log_stretch: np.ndarray) -> np.ndarray:
        return stress(np.exp(log_stretch)[None])[0] - load

    for _ in range(200):
        now = error(logs)
        slope = np.column_stack([(error(logs + step * e) - now) / step for e in np.eye(2)])
        move = -np.linalg.solve(slope, now)
        if not np.isfinite(move).all():
            break
        logs = logs + move * min(1.0, 0.03 / float(np.abs(move).max() + 1e-300))
        if np.abs(move).max() < 1e-9:
            return np.exp(logs)
    raise Unsuitable("no mounted state")


# --- energies ------------------------------------------------------------------------------------


def structure(alpha: float, kappa: float) -> tuple[float, float, float]:
    """Diagonal of the generalised structure tensor of two families at +-alpha (degrees) from x."""
    c = np.cos(np.deg2rad(alpha)) ** 2
    return kappa + (1.0 - 3.0 * kappa) * c, kappa + (1.0 - 3.0 * kappa) * (1.0 - c), kappa


def goh(
    C1: float, k1: float, k2: float, alpha: float, kappa: float, exponent: float = 2.0
) -> Energy:
    """GOH, or its variant in which the fibre strain has another exponent than 2."""
    H = structure(alpha, kappa)

    def energy(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        # E = H : C - 1
        E = H[0] * x**2 + H[1] * y**2 + H[2] * z**2 - 1.0
        if exponent != 2.0:
            E = np.where(E.real > 0.0, E, 0.0)
        # W = C1 (I1 - 3) + (k1 / k2) (exp(k2 E^p) - 1)
        return C1 * (x**2 + y**2 + z**2 - 3.0) + k1 / k2 * (np.exp(k2 * E**exponent) - 1.0)

    return energy


def fibre_strain(alpha: float, top: np.ndarray) -> float:
    """Squared stretch less one along a direction at alpha degrees from x."""
    c = np.cos(np.deg2rad(alpha)) ** 2
    return max(float(c * top[0] ** 2 + (1.0 - c) * top[1] ** 2 - 1.0), 0.02)


def from_rest(energy: Energy) -> Energy:
    """The same energy of stretches relative to the state without load."""
    at_rest = stretch_at(lambda total: cauchy(energy, total), np.zeros(2))

    def relative(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        a, b = x * at_rest[0], y * at_rest[1]
        return energy(a, b, 1.0 / (a * b))

    return relative


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def goh_for(rng: np.random.Generator, top: np.ndarray, exponent: float = 2.0) -> Energy:
    """GOH whose exponent is that of tissue at the largest total stretches."""
    alpha, kappa = rng.uniform(15.0, 75.0), rng.uniform(0.05, 0.28)
    H = structure(alpha, kappa)
    z = 1.0 / (top[0] * top[1])
    E = max(H[0] * top[0] ** 2 + H[1] * top[1] ** 2 + H[2] * z**2 - 1.0, 0.02)
    q = _log_uniform(rng, 0.3, 3.0)
    fibre = _log_uniform(rng, 1.0, 20.0)
    # the fibres' share 2 p k1 E^(p-1) exp(q) over that of the matrix, 2 C1
    k1 = fibre / (exponent * E ** (exponent - 1.0) * np.exp(q))
    return goh(1.0, k1, q / E**exponent, alpha, kappa, exponent)


def four_fibre_for(rng: np.random.Generator, top: np.ndarray) -> Energy:
    """Fibres along x, along y, and along two diagonals, in a neo-Hookean matrix."""
    angles = np.array([0.0, 90.0, rng.uniform(25.0, 65.0)])
    cos2 = np.cos(np.deg2rad(angles)) ** 2
    strain = np.array([fibre_strain(a, top) for a in angles])
    q = np.array([_log_uniform(rng, 0.3, 3.0) for _ in angles])
    k2 = q / strain**2
    share = np.array([1.0, 1.0, 2.0]) * rng.uniform(0.2, 1.0, 3)
    k1 = _log_uniform(rng, 3.0, 20.0) * share / (strain * np.exp(q))

    def energy(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        out = x**2 + y**2 + z**2 - 3.0
        for c, a, b in zip(cos2, k1, k2, strict=True):
            E = c * x**2 + (1.0 - c) * y**2 - 1.0
            E = np.where(E.real > 0.0, E, 0.0)
            out = out + a / (2.0 * b) * (np.exp(b * E**2) - 1.0)
        return out

    return energy


def fung_for(rng: np.random.Generator, top: np.ndarray) -> Energy:
    """Fung's exponential of Green strains in a little matrix."""
    Ex, Ey = 0.5 * (top**2 - 1.0)
    ratio, rho = np.exp(rng.normal(0.0, 0.5)), rng.uniform(0.1, 0.7)
    q = _log_uniform(rng, 0.8, 4.0)
    # Q = b (r Ex^2 + Ey^2 / r + 2 rho Ex Ey)
    b = q / (ratio * Ex**2 + Ey**2 / ratio + 2.0 * rho * Ex * Ey)
    c = _log_uniform(rng, 5.0, 40.0) * Ex / (q * np.exp(q))

    def energy(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        ex, ey = 0.5 * (x**2 - 1.0), 0.5 * (y**2 - 1.0)
        Q = b * (ratio * ex**2 + ey**2 / ratio + 2.0 * rho * ex * ey)
        return 0.25 * (x**2 + y**2 + z**2 - 3.0) + 0.5 * c * (np.exp(Q) - 1.0)

    return energy


def recruited_for(rng: np.random.Generator, top: np.ndarray) -> Energy:
    """Linear fibres in many directions about +-alpha, which straighten gradually."""
    alpha, spread = rng.uniform(20.0, 70.0), rng.uniform(5.0, 25.0)
    offsets = np.linspace(-2.0, 2.0, 9)
    weight = np.exp(-0.5 * offsets**2)
    weight /= weight.sum()
    cos2 = np.cos(np.deg2rad(alpha + spread * offsets)) ** 2
    last = fibre_strain(alpha, top)
    slack, width = last * rng.uniform(0.2, 0.6), last * rng.uniform(0.06, 0.2)
    stiffness = _log_uniform(rng, 3.0, 20.0) / (last - slack)

    def energy(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        out = 0.5 * (x**2 + y**2 + z**2 - 3.0)
        for c, w in zip(cos2, weight, strict=True):
            u = (c * x**2 + (1.0 - c) * y**2 - 1.0 - slack) / width
            # e = d ln(1 + exp((E - E0) / d)), the mean extension of fibres of all lengths
            part = width * np.logaddexp(0.0, u.real)
            part = part + 1j * width * u.imag / (1.0 + np.exp(-u.real))
            out = out + 0.5 * stiffness * w * part**2
        return out

    return from_rest(energy)


def layers_for(rng: np.random.Generator, top: np.ndarray) -> Energy:
    """Two layers of GOH that are stress-free at different stretches, in parallel."""
    inner, outer = goh_for(rng, top), goh_for(rng, top)
    share, strength = rng.uniform(0.3, 0.7), _log_uniform(rng, 0.3, 3.0)
    slack = 1.0 + rng.uniform(0.0, 0.03, 2)

    def both(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        a, b = x / slack[0], y / slack[1]
        return share * inner(x, y, z) + (1.0 - share) * strength * outer(a, b, 1.0 / (a * b))

    return from_rest(both)


MAKERS: dict[str, Callable[[np.random.Generator, np.ndarray], Energy]] = {
    "four-fibre": four_fibre_for,
    "fung": fung_for,
    "recruited": recruited_for,
    "layers": layers_for,
    "exponent-1.5": lambda rng, top: goh_for(rng, top, 1.5),
    "exponent-2.6": lambda rng, top: goh_for(rng, top, 2.6),
}


# --- a tissue, mounted, and how far it is stretched ----------------------------------------------


@dataclass(frozen=True)
class Tissue:
    """A tissue on the machine."""

    energy: Energy
    mounting: np.ndarray  # (2,)
    strain: float  # largest measured stretch less one
    parameters: dict[str, float] = field(default_factory=dict)  # of GOH, where the tissue is one

    def load(self, measured: np.ndarray) -> np.ndarray:
        """Nominal stress (n, 2), kPa, at measured stretches (n, 2)."""
        return piola(self.energy, measured * self.mounting)


def goh_tissue(rng: np.random.Generator) -> Tissue:
    """GOH with parameters inside their ranges, stretched to a physiological stress."""
    p = {
        "C1": _log_uniform(rng, 2.0, 20.0),
        "k1": _log_uniform(rng, 5.0, 100.0),
        "k2": _log_uniform(rng, 0.5, 20.0),
        "alpha": float(rng.uniform(15.0, 75.0)),
        "kappa": float(rng.uniform(0.05, 0.28)),
    }
    mounting, target = rng.uniform(1.01, 1.08, 2), rng.uniform(*PEAK_KPA)
    energy = goh(**p)
    low, high = 0.03, 0.6

    def peak(strain: float) -> float:
        return float(cauchy(energy, (mounting * (1.0 + strain))[None]).max())

    if not peak(low) < target < peak(high):
        raise Unsuitable("stress out of reach")
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if peak(middle) < target else (low, middle)
    return Tissue(energy, mounting, low, p)


def other_tissue(rng: np.random.Generator, kind: str, *, far: bool) -> Tissue:
    """Tissue of another law, mounted at up to 1.12, or at 1.2 to 1.6."""
    if far:
        mounting = rng.uniform(1.2, 1.6) + rng.uniform(-0.05, 0.05, 2)
    else:
        mounting = rng.uniform(1.01, 1.12, 2)
    strain, target = rng.uniform(0.08, 0.25), rng.uniform(*PEAK_KPA)
    top = mounting * (1.0 + strain)
    unscaled = MAKERS[kind](rng, top)
    scale = target / float(cauchy(unscaled, top[None]).max())
    return Tissue(lambda x, y, z: scale * unscaled(x, y, z), mounting, strain)


def check_tissue(tissue: Tissue) -> None:
    """Refuse what would not be tested so: slack or nearly fully loaded on mounting, or unstable."""
    for ratio in (*RATIOS, LEFT_OUT):
        load = tissue.load(stretches(tissue.strain, ratio))
        if not (np.isfinite(load).all() and (np.diff(load, axis=0) > 0.0).all()):
            raise Unsuitable("loads fall")
    load = tissue.load(stretches(tissue.strain, RATIOS[0]))
    if not ((load[0] > 2e-3 * load.max()).all() and (load[0] < 0.4 * load[-1]).all()):
        raise Unsuitable("mounted too slack or too far")
    found = stretch_at(lambda total: piola(tissue.energy, total), load[0])
    if not np.allclose(found, tissue.mounting, atol=1e-6):
        raise Unsuitable("several mounted states")


def stretches(strain: float, ratio: tuple[float, float], rows: int = ROWS) -> np.ndarray:
    """Measured stretches (rows, 2) of a protocol."""
    return 1.0 + strain * np.linspace(0.0, 1.0, rows)[:, None] * np.array(ratio)


# --- misfits -------------------------------------------------------------------------------------


def gaussian_process(at: np.ndarray, length: float, rng: np.random.Generator) -> np.ndarray:
    """A smooth random function of unit variance at points (n, d)."""
    distance = np.linalg.norm(at[:, None] - at[None], axis=2)
    # K = exp(-d^2 / (2 l^2))
    values, vectors = np.linalg.eigh(np.exp(-0.5 * (distance / length) ** 2))
    return vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.standard_normal(len(at)))


def misfits(
    family: str, tissue: Tissue, paths: list[np.ndarray], rng: np.random.Generator
) -> list[np.ndarray] | None:
    """Relative errors (rows, 2) of the law on each path; None where the family has none."""
    s = np.linspace(0.0, 1.0, ROWS)[:, None]
    if family in MACHINES:
        return machine_errors(family, tissue, paths, rng)
    if family.startswith("misfit-"):
        length = float(family.removeprefix("misfit-"))
        return [
            MISFIT * np.column_stack([gaussian_process(s, length, rng) for _ in "xy"])
            for _ in paths
        ]
    if family == "alike":
        length = _log_uniform(rng, 0.1, 1.0)
        return [MISFIT * np.tile(gaussian_process(s, length, rng)[:, None], 2) for _ in paths]
    if family == "gain":
        return [MISFIT * np.tile(rng.standard_normal(2), (ROWS, 1)) for _ in paths]
    if family == "toe":
        size, length = TOE * rng.standard_normal(2), rng.uniform(0.15, 0.4)
        return [size * np.exp(-s / length) for _ in paths]
    if family == "plane":
        logs = np.log(np.vstack(paths))
        length = _log_uniform(rng, 0.25, 1.0)
        at = logs / logs.max(axis=0)
        error = MISFIT * np.column_stack([gaussian_process(at, length, rng) for _ in "xy"])
        return np.split(error, len(paths))
    return None


def machine_errors(
    family: str, tissue: Tissue, paths: list[np.ndarray], rng: np.random.Generator
) -> list[np.ndarray]:
    """Relative errors (rows, 2) that are no random process of the path."""
    s, ds, out = np.linspace(0.0, 1.0, ROWS), 1.0 / (ROWS - 1), []
    slip, rows_late = MISFIT * np.abs(rng.standard_normal(2)), rng.uniform(0.3, 1.0)
    viscous, time = rng.uniform(0.02, 0.08), rng.uniform(0.1, 0.5)
    for path in paths:
        load = tissue.load(path)
        if family == "polynomial":
            terms = np.vstack([np.zeros(2), rng.standard_normal((3, 2))])
            shape = np.polynomial.legendre.legval(2.0 * s - 1.0, terms).T
            out.append(MISFIT * shape / np.sqrt(np.mean(shape**2, axis=0)))
            continue
        if family == "friction":  # a constant load as soon as the carriage moves
            size = MISFIT * np.abs(rng.standard_normal(2)) * load.max(axis=0)
            read = load + size * (1.0 - np.exp(-s[:, None] / 0.02))
        elif family == "viscous":  # dq = g dF - q ds / time, added
            q = np.zeros_like(load)
            for i in range(1, ROWS):
                q[i] = (q[i - 1] + viscous * (load[i] - load[i - 1])) / (1.0 + ds / time)
            read = load + q
        elif family == "lag":  # loads are read late
            read = np.column_stack([np.interp(s - rows_late * ds, s, f) for f in load.T])
        else:  # slip: the tissue is stretched by less than is read, more so late in the path
            read = tissue.load(1.0 + (path - 1.0) * (1.0 - slip * s[:, None] ** 2))
        out.append(read / load - 1.0)
    return out


# --- the file ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """A specimen file with its truth.

    Attributes
    ----------
    text : str
        The file.
    truth : dict
        Mounting stretches, and the parameters where the tissue is GOH.
    left_out : ndarray, shape (n, 6), or None
        A path that is not in the file: stretches, the tissue's nominal stresses, readings of them,
        kPa, x and y each. None where the misfit is not a function of the stretches.
    mounting_sd : float or None
        Sd of the prior of the mounting stretches, where a user would change it.
    """

    family: str
    text: str
    truth: dict[str, float]
    left_out: np.ndarray | None
    mounting_sd: float | None = None


def make_case(family: str, protocols: int, seed: int) -> Case:
    """The specimen of a family and seed; it has the same tissue with one protocol and three."""
    rng = np.random.default_rng([seed, FAMILIES.index(family), 271828])
    kind = family.removeprefix("far-")
    other = kind in TISSUES
    while True:
        try:
            far = family in FAR
            tissue = other_tissue(rng, kind, far=far) if other else goh_tissue(rng)
            check_tissue(tissue)
            break
        except (Unsuitable, np.linalg.LinAlgError):
            continue
    edge_x, edge_y, thickness = rng.uniform(9.0, 11.0, 2).tolist() + [rng.uniform(0.8, 1.2)]
    section = np.array([edge_y, edge_x]) * thickness * 1e-3  # N / kPa
    ratios = (*RATIOS[:protocols], LEFT_OUT)
    paths = [stretches(tissue.strain, ratio) for ratio in ratios]
    loads = [tissue.load(path) for path in paths]
    error = misfits(family, tissue, paths, rng)
    if error is not None:
        loads = [load * (1.0 + e) for load, e in zip(loads, error, strict=True)]
    forces = [load * section for load in loads]
    sd = NOISES.get(family, NOISE) * max(float(np.abs(f).max()) for f in forces[:protocols])
    readings = [f + sd * rng.standard_normal(f.shape) for f in forces]
    truth = dict(zip(("mounting_stretch_x", "mounting_stretch_y"), tissue.mounting, strict=True))
    known_there = error is None or family in ("plane", "toe")
    left_out = np.hstack([paths[-1], loads[-1], readings[-1] / section])
    return Case(
        family,
        _file(f"{family}-{protocols}-{seed}", paths, readings, (edge_x, edge_y, thickness, sd)),
        tissue.parameters | {name: float(value) for name, value in truth.items()},
        left_out if known_there and protocols > 1 else None,
        0.3 if family in FAR and seed % 2 == 0 else None,
    )


def _file(
    name: str,
    paths: list[np.ndarray],
    readings: list[np.ndarray],
    numbers: tuple[float, float, float, float],
) -> str:
    """A specimen file of all but the last path."""
    edge_x, edge_y, thickness, sd = numbers
    lines = [
        f"# specimen: {name}",
        "# geometry: unloaded",
        f"# edge_x_mm: {edge_x:.6g}",
        f"# edge_y_mm: {edge_y:.6g}",
        f"# thickness_mm: {thickness:.6g}",
        f"# load_noise_N: {sd:.6g}",
        "protocol,stretch_x,stretch_y,force_x_N,force_y_N",
    ]
    for number, (path, force) in enumerate(zip(paths[:-1], readings[:-1], strict=True)):
        label = "{:g}to{:g}".format(*RATIOS[number])
        lines += [
            f"{label},{','.join(f'{v:.8f}' for v in (*x, *f))}"
            for x, f in zip(path, force, strict=True)
        ]
    return "\n".join(lines) + "\n"
