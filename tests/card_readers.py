"""What Abaqus and FEBio make of a card, and whether it is the stress of the draw behind the card.

A card is read back from its text, and the program's own strain energy is evaluated in three
dimensions, differentiated by complex steps, with the pressure from plane stress: a route that
shares nothing with :mod:`biaxbayes.laws.goh`. With C, I1, I2, I4, In and E of the isochoric part:

    Holzapfel-Gasser-Ogden    c/2 (I1 - 3) + k1/(2 k2) sum_a (exp(k2 <E_a>^2) - 1)
                              E_a = kappa (I1 - 3) + (1 - 3 kappa) (I4_a - 1)
    Mooney-Rivlin             c1 (I1 - 3) + c2 (I2 - 3)
    fiber-exp-pow-uncoupled   ksi / (alpha beta) (exp(alpha (In - 1)^beta) - 1) where In > 1
    Fung orthotropic          c/2 (exp(Q) - 1)
                              Q = (1/c) sum_a [2 mu_a M_a:E^2 + sum_b lambda_ab (M_a:E) (M_b:E)]

with mu and lambda from Young's moduli, shear moduli and Poisson's ratios.
"""

import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from biaxbayes.cards.febio import FIBRE, FUNG, HGO, MATRIX, MIXTURE

STEP = 1e-30


@dataclass(frozen=True)
class Solid:
    """One elastic material: the whole card, or a part of a mixture."""

    type: str  # FEBio's name
    values: Mapping[str, float]  # in the units of the card
    axes: np.ndarray  # unit vectors as rows: directions of the fibres, or the material axes

    def energy(self, C: np.ndarray) -> np.ndarray:
        """Isochoric strain energy at isochoric right Cauchy-Green tensors (..., 3, 3)."""
        p = self.values
        I1 = np.trace(C, axis1=-2, axis2=-1)
        I4 = np.einsum("ai,...ij,aj->a...", self.axes, C, self.axes)
        if self.type == HGO:
            E = p["kappa"] * (I1 - 3.0) + (1.0 - 3.0 * p["kappa"]) * (I4 - 1.0)
            E = np.where(E.real > 0.0, E, 0.0)
            fibres = (np.exp(p["k2"] * E**2) - 1.0).sum(axis=0)
            return p["c"] / 2.0 * (I1 - 3.0) + p["k1"] / (2.0 * p["k2"]) * fibres
        if self.type == MATRIX:
            I2 = 0.5 * (I1**2 - np.trace(C @ C, axis1=-2, axis2=-1))
            return p["c1"] * (I1 - 3.0) + p["c2"] * (I2 - 3.0)
        if self.type == FIBRE:
            E = np.where(I4[0].real > 1.0, I4[0] - 1.0, 0.0)
            return p["ksi"] / (p["alpha"] * p["beta"]) * (np.exp(p["alpha"] * E ** p["beta"]) - 1.0)
        G12, G23, G31 = p["G12"], p["G23"], p["G31"]
        mu = np.array([G12 + G31 - G23, G12 - G31 + G23, -G12 + G31 + G23])
        compliance = np.diag([1.0 / p["E1"], 1.0 / p["E2"], 1.0 / p["E3"]])
        for i, j, ratio in ((0, 1, "v12"), (1, 2, "v23"), (2, 0, "v31")):
            compliance[i, j] = compliance[j, i] = -p[ratio] / p[f"E{i + 1}"]
        lam = np.linalg.inv(compliance) - 2.0 * np.diag(mu)
        strain = 0.5 * (C - np.eye(3))
        first = np.einsum("ai,...ij,aj->...a", self.axes, strain, self.axes)
        second = np.einsum("ai,...ij,aj->...a", self.axes, strain @ strain, self.axes)
        # Q = (1/c) sum_a [2 mu_a M_a:E^2 + sum_b lambda_ab (M_a:E) (M_b:E)]
        Q = 2.0 * second @ mu + np.einsum("...a,ab,...b->...", first, lam, first)
        return 0.5 * p["c"] * (np.exp(Q / p["c"]) - 1.0)


@dataclass(frozen=True)
class WrittenCard:
    """A card read back, in its own units."""

    label: str
    solids: tuple[Solid, ...]  # their isochoric energies add up; axes in the global system
    bulk: float  # bulk modulus; 0 without a volumetric term

    def energy(self, F: np.ndarray) -> np.ndarray:
        """Strain energy of deformation gradients of shape (..., 3, 3), real or complex."""
        J = np.linalg.det(F)
        hgo = any(solid.type == HGO for solid in self.solids)
        U = (J**2 - 1.0) / 2.0 - np.log(J) if hgo else np.log(J) ** 2
        return self.isochoric_energy(F) + self.bulk / 2.0 * U

    def isochoric_energy(self, F: np.ndarray) -> np.ndarray:
        """The energy without its volumetric term, which does no work while J = 1."""
        C = np.swapaxes(F, -1, -2) @ F * np.linalg.det(F)[..., None, None] ** (-2.0 / 3.0)
        return sum((solid.energy(C) for solid in self.solids), np.zeros(F.shape[:-2]))


def biaxial_stress(
    energy: Callable[[np.ndarray], np.ndarray], stretch_x, stretch_y
) -> tuple[np.ndarray, np.ndarray]:
    """Cauchy stresses (n,) of an incompressible planar biaxial state of an energy of F (n, 3, 3).

    ArithmeticError if the state needs a shear stress: the card is not symmetric about the axes.
    """
    x, y = np.atleast_1d(stretch_x).astype(float), np.atleast_1d(stretch_y).astype(float)
    F = np.zeros((x.size, 3, 3))
    F[:, 0, 0], F[:, 1, 1], F[:, 2, 2] = x, y, 1.0 / (x * y)
    P = np.empty_like(F)
    for i in range(3):
        for j in range(3):
            perturbed = F.astype(complex)
            perturbed[:, i, j] += 1j * STEP
            # P_ij = dU/dF_ij
            P[:, i, j] = energy(perturbed).imag / STEP
    # s = P F^T / J, less the pressure that frees the faces: s_zz = 0
    s = P @ np.swapaxes(F, -1, -2)
    s = s - s[:, 2, 2, None, None] * np.eye(3)
    shear = np.abs(s - s * np.eye(3)).max(initial=0.0)
    if shear > 1e-9 * np.abs(s).max(initial=1e-300):
        raise ArithmeticError("the card needs a shear stress in a state without shear")
    return s[:, 0, 0], s[:, 1, 1]


# --- the text of a card ---


def read_abaqus(text: str) -> WrittenCard:
    """Read a card as Abaqus would, without comments; ValueError if it is not of this kind."""
    blocks: dict[str, tuple[dict[str, str], list[list[str]]]] = {}
    rows: list[list[str]] = []
    for line in text.splitlines():
        if line.startswith("**") or not line.strip():
            continue
        cells = [cell.strip() for cell in line.split(",")]
        if line.startswith("*"):
            options = dict((cell.upper() + "=").split("=")[:2] for cell in cells[1:])
            rows = []
            blocks[cells[0].upper()] = (options, rows)
        else:
            rows.append(cells)
    try:
        orientation, axes = blocks["*ORIENTATION"]
        law, constants = blocks["*ANISOTROPIC HYPERELASTIC"]
        if "HOLZAPFEL" not in law or orientation["LOCAL DIRECTIONS"] != law["LOCAL DIRECTIONS"]:
            raise ValueError("another law, or other directions")
        first, second = np.array(axes[0], dtype=float).reshape(2, 3)
        about, angle = int(axes[1][0]), float(axes[1][1])
        if about != 3 or angle != 0.0:
            raise ValueError("an additional rotation")
        # Local axes: 1 along a, 3 normal to a and b, 2 completing them.
        normal = np.cross(first, second)
        base = np.array([first, np.cross(normal, first), normal])
        base /= np.linalg.norm(base, axis=1, keepdims=True)
        local = np.array(axes[2 : 2 + int(law["LOCAL DIRECTIONS"])], dtype=float)
        C10, D, k1, k2, kappa = (float(cell) for cell in constants[0])
        label = blocks["*MATERIAL"][0]["NAME"]
    except (KeyError, ValueError, IndexError) as error:
        raise ValueError(f"not a material card of this kind ({error})") from None
    families = local @ base
    families /= np.linalg.norm(families, axis=1, keepdims=True)
    # c = 2 C10 and K = 2 / D in FEBio's terms
    values = {"c": 2.0 * C10, "k1": k1, "k2": k2, "kappa": kappa}
    return WrittenCard(label, (Solid(HGO, values, families),), 2.0 / D if D else 0.0)


def read_febio(text: str) -> WrittenCard:
    """Read a card back; ValueError if the text is not a card of this kind."""
    try:
        node = ElementTree.fromstring(text.encode()).find("Material/material")
        if node is None or node.get("type") not in (HGO, MIXTURE):
            raise ValueError("another material")
        if node.get("type") == HGO:
            solids = [_solid(node, np.eye(3))]
        else:
            solids = [_solid(part, _axes(node)) for part in node.findall("solid")]
        bulk = float(node.findtext("k", ""))
    except (ElementTree.ParseError, KeyError, ValueError) as error:
        raise ValueError(f"not a material card of this kind ({error})") from None
    return WrittenCard(node.get("name", ""), tuple(solids), bulk)


def _solid(node: ElementTree.Element, outer: np.ndarray) -> Solid:
    """One material; its own axes are given in those of the mixture around it."""
    kind = node.get("type", "")
    if kind not in (HGO, MATRIX, FIBRE, FUNG):
        raise ValueError(f"a part {kind[:40]!r}")
    values = {c.tag: float(c.text or "") for c in node if c.tag not in ("mat_axis", "fiber")}
    axes = _axes(node) @ outer
    if kind == HGO:
        gamma = np.radians(values["gamma"])
        families = [np.cos(gamma), np.sin(gamma)] * np.array([[1.0, 1.0], [1.0, -1.0]])
        axes = families @ axes[:2]
    return Solid(kind, values, axes)


def _axes(node: ElementTree.Element) -> np.ndarray:
    """Material axes as rows: e1 along a, e3 along a x d, e2 = e3 x e1; for a fibre its vector."""

    def vector(path: str) -> np.ndarray:
        return np.array(node.findtext(path, "").split(","), dtype=float).reshape(3)

    if node.find("fiber") is not None:
        axes = vector("fiber")[None]
    elif node.find("mat_axis") is not None:
        a, d = vector("mat_axis/a"), vector("mat_axis/d")
        e3 = np.cross(a, d)
        axes = np.array([a, np.cross(e3, a), e3])
    else:
        return np.eye(3)
    return axes / np.linalg.norm(axes, axis=1, keepdims=True)


READ = {"abaqus": read_abaqus, "febio": read_febio}
