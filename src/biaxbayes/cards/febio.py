"""FEBio: its Holzapfel-Gasser-Ogden material, and other laws as a mixture of a matrix and more.

FEBio User Manual, uncoupled materials; C, I1, I2, I4, In and E are those of the isochoric part:

    Holzapfel-Gasser-Ogden    c/2 (I1 - 3) + k1/(2 k2) sum_a (exp(k2 <E_a>^2) - 1)
                              E_a = kappa (I1 - 3) + (1 - 3 kappa) (I4_a - 1)
    Mooney-Rivlin             c1 (I1 - 3) + c2 (I2 - 3)
    fiber-exp-pow-uncoupled   ksi / (alpha beta) (exp(alpha (In - 1)^beta) - 1) where In > 1
    Fung orthotropic          c/2 (exp(Q) - 1)
                              Q = (1/c) sum_a [2 mu_a M_a:E^2 + sum_b lambda_ab (M_a:E) (M_b:E)]

with mu and lambda from Young's moduli, shear moduli and Poisson's ratios. The two families of
Holzapfel-Gasser-Ogden lie at +gamma and -gamma (degrees) from the first axis of ``mat_axis``; c is
2 C1 and each family counts once, as in our law. A fibre material has no ``mat_axis`` but a
``fiber`` vector, which FEBio reads in the axes of the mixture. The outermost material has the
bulk modulus k, with

    U(J) = k/2 ((J^2 - 1)/2 - ln J)  for Holzapfel-Gasser-Ogden,  k/2 (ln J)^2  for a mixture
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from biaxbayes.cards.card import K2_FLOOR, Card, header_lines
from biaxbayes.errors import InputError
from biaxbayes.laws.goh import GOH

SUFFIX = ".feb"
HGO, MIXTURE = "Holzapfel-Gasser-Ogden", "uncoupled solid mixture"
MATRIX, FIBRE, FUNG = "Mooney-Rivlin", "fiber-exp-pow-uncoupled", "Fung orthotropic"


@dataclass(frozen=True)
class Solid:
    """One elastic material: the whole card, or a part of a mixture."""

    type: str  # FEBio's name
    values: Mapping[str, float]  # in the units of the card
    axes: np.ndarray  # (3, 3), material axes as rows; the first is the direction of a fibre


# --- how a law is written ------------------------------------------------------------------------


class Mixture(NamedTuple):
    """A law as a mixture."""

    # from parameters by name: type, stresses (kPa), other parameters, angle from x (degrees)
    parts: Callable[[Mapping[str, float]], list[Part]]
    matrix_shear_kPa: Callable[[Mapping[str, float]], float]
    conventions: tuple[str, ...]


Part = tuple[str, dict[str, float], dict[str, float], float]

AXES = (
    "The first material axis (a) is the x axis of the test; d lies in the plane, towards its y "
    "axis. Replace the {} by the axes of your geometry."
)
HGO_CONVENTIONS: tuple[str, ...] = (
    "Strain energy (isochoric invariants I1, I4; Macaulay brackets <>; two fibre families):",
    "  Psi = c/2 (I1 - 3) + k1/(2 k2) sum (exp(k2 <E>^2) - 1) + k/2 ((J^2 - 1)/2 - ln J)",
    "  E = kappa (I1 - 3) + (1 - 3 kappa) (I4 - 1)",
    "c is 2 C1 of the fit: c is the initial shear modulus of the matrix.",
    "Two families lie at +gamma and -gamma degrees from the first material axis (a).",
    AXES.format("mat_axis"),
    "kappa = 0 means aligned fibres, 1/3 an isotropic distribution; as a dispersion out of the "
    "plane (Holzapfel et al. 2015) it is kappa_op = (1 - kappa) / 2.",
)
THICKNESS = 1e-10
"""Young's modulus through the thickness over the smaller one in the plane: FEBio wants it above
zero, and the law has none."""


def _fung_parts(p: Mapping[str, float]) -> list[Part]:
    b = np.array([[p["b_x"], p["b_xy"]], [p["b_xy"], p["b_y"]]])
    # Q = (1/c) E : C : E with the in-plane block of C = c b; E_a and nu_ab from its inverse
    compliance = np.linalg.inv(p["c"] * b)
    young = 1.0 / np.diag(compliance)
    # as if the plane were isotropic on average: b_x - b_xy = 2 mu / c there
    shear = 0.25 * p["c"] * (p["b_x"] + p["b_y"] - 2.0 * p["b_xy"])
    stresses = {"E1": young[0], "E2": young[1], "E3": THICKNESS * young.min(), "c": p["c"]}
    stresses |= dict.fromkeys(("G12", "G23", "G31"), shear)
    poisson = {"v12": -compliance[0, 1] * young[0], "v23": 0.0, "v31": 0.0}
    return [(MATRIX, {"c1": p["c0"], "c2": 0.0}, {}, 0.0), (FUNG, stresses, poisson, 0.0)]


def _four_fibre_parts(p: Mapping[str, float]) -> list[Part]:
    parts: list[Part] = [(MATRIX, {"c1": 0.5 * p["c"], "c2": 0.0}, {}, 0.0)]
    for family, angles in (("x", (0.0,)), ("y", (90.0,)), ("d", (p["alpha"], -p["alpha"]))):
        k1, k2 = p[f"k1_{family}"], max(p[f"k2_{family}"], K2_FLOOR)
        # k1 / (4 k2) (exp(k2 E^2) - 1) with E = In - 1: ksi = k1 / 2, alpha = k2, beta = 2
        parts += [
            (FIBRE, {"ksi": 0.5 * k1}, {"alpha": k2, "beta": 2.0}, angle)
            for angle in angles
            if k1 > 0.0
        ]
    return parts


MIXTURES = {
    "fung": Mixture(
        _fung_parts,
        lambda p: 2.0 * p["c0"],
        (
            "Strain energy (isochoric I1 and Green strains E):",
            "  Psi = c0 (I1 - 3) + c/2 (exp(Q) - 1) + U(J)",
            "  Q = b_x E11^2 + b_y E22^2 + 2 b_xy E11 E22 in the plane of the test",
            "c1 of Mooney-Rivlin is the c0 of the fit. E1, E2, v12 are those of the matrix c b.",
            "NOT SEEN BY THE TEST: the shear moduli G12, G23, G31, chosen as "
            "c (b_x + b_y - 2 b_xy)/4, what a plane that is isotropic on average would have; and "
            "E3, v23, v31: the law has no term through the thickness, and E3 is as good as zero.",
            AXES.format("mixture's mat_axis"),
        ),
    ),
    "four-fibre": Mixture(
        _four_fibre_parts,
        lambda p: p["c"],
        (
            "Strain energy (isochoric I1, In): Psi = c/2 (I1 - 3) + U(J)",
            "  + sum k1/(4 k2) (exp(k2 <In - 1>^2) - 1), fibres along x, y and both diagonals",
            "ksi is k1/2 and alpha (of FEBio) is k2 of the fit; beta = 2. Fibres carry no load in "
            "compression, neither in this program nor in the fit. Each fiber vector is given in "
            "the material axes of the mixture.",
            AXES.format("mixture's mat_axis"),
        ),
    ),
}
"""Laws that FEBio has as a mixture, by their name."""


def write_febio(card: Card, version: str) -> str:
    """Text of the card, to copy or for ``<Material from="..."/>``; needs a bulk modulus."""
    if card.bulk_kPa is None:
        raise InputError("FEBio needs a bulk modulus", remedy="give `bulk_ratio`, for example 1000")
    bulk = float(card.stress(card.bulk_kPa))
    root = ElementTree.Element("febio_spec", version="4.0")
    ElementTree.SubElement(root, "Module", type="solid")
    materials = ElementTree.SubElement(root, "Material")
    goh = isinstance(card.material, GOH)
    node = ElementTree.SubElement(
        materials, "material", id="1", name=card.label, type=HGO if goh else MIXTURE
    )
    if goh:
        conventions = HGO_CONVENTIONS
        _add_goh(node, card)
    else:
        conventions = MIXTURES[card.material.law.name].conventions
        _add_mixture(node, card)
    ElementTree.SubElement(node, "k").text = repr(bulk)
    ElementTree.indent(root)
    words = [
        *conventions,
        f"k = {bulk:.6g} {card.units.stress} makes it nearly incompressible; the fit is "
        "incompressible and does not determine k.",
        f'Use: <Material from="FILE"/> in a control file, or copy the material. Name: {card.label}',
    ]
    comment = "\n".join(header_lines(card, version, words))
    while "--" in comment:  # not allowed in an XML comment
        comment = comment.replace("--", "- -")
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f"<!--\n{comment}\n-->\n{ElementTree.tostring(root, encoding='unicode')}\n"
    )


def _add_goh(node: ElementTree.Element, card: Card) -> None:
    material = card.material
    values = {
        "c": 2.0 * card.stress(material.C1_kPa),
        "k1": card.stress(material.k1_kPa),
        "k2": material.k2,
        "gamma": material.alpha_deg,
        "kappa": material.kappa,
    }
    for name, value in values.items():
        ElementTree.SubElement(node, name).text = repr(float(value))
    _add_axes(node)


def _add_mixture(node: ElementTree.Element, card: Card) -> None:
    law = card.material.law
    parameters = dict(zip(law.names, card.material.values, strict=True))
    _add_axes(node)
    for kind, stresses, numbers, angle_deg in MIXTURES[law.name].parts(parameters):
        part = ElementTree.SubElement(node, "solid", type=kind)
        for name, value in ({n: card.stress(v) for n, v in stresses.items()} | numbers).items():
            ElementTree.SubElement(part, name).text = repr(float(value))
        if kind == FIBRE:
            angle = np.radians(angle_deg)
            direction = f"{float(np.cos(angle))!r},{float(np.sin(angle))!r},0"
            ElementTree.SubElement(part, "fiber", type="vector").text = direction


def _add_axes(node: ElementTree.Element) -> None:
    axis = ElementTree.SubElement(node, "mat_axis", type="vector")
    ElementTree.SubElement(axis, "a").text = "1,0,0"
    ElementTree.SubElement(axis, "d").text = "0,1,0"


# --- the card as FEBio reads it ------------------------------------------------------------------


@dataclass(frozen=True)
class FebioCard:
    """A card read back, in its own units."""

    label: str
    type: str  # of the outermost material
    k: float  # bulk modulus
    solids: tuple[Solid, ...]  # their isochoric energies add up; axes in the global system

    def energy(self, F: np.ndarray) -> np.ndarray:
        """Strain energy of deformation gradients of shape (..., 3, 3), real or complex."""
        J = np.linalg.det(F)
        U = (J**2 - 1.0) / 2.0 - np.log(J) if self.type == HGO else np.log(J) ** 2
        return self.isochoric_energy(F) + self.k / 2.0 * U

    def isochoric_energy(self, F: np.ndarray) -> np.ndarray:
        """The energy without its volumetric term, which does no work while J = 1."""
        C = np.swapaxes(F, -1, -2) @ F * np.linalg.det(F)[..., None, None] ** (-2.0 / 3.0)
        parts = (_ENERGIES[s.type](s.values, s.axes, C) for s in self.solids)
        return sum(parts, np.zeros(F.shape[:-2]))


def read_febio(text: str) -> FebioCard:
    """Read a card back; InputError if the text is not a card of this kind."""
    try:
        node = ElementTree.fromstring(text.encode()).find("Material/material")
        kind = "" if node is None else node.get("type", "")
        if node is None or kind not in (HGO, MIXTURE):
            raise ValueError("another material")
        axes = _read_axes(node)
        solids = [_solid(part, axes) for part in node.findall("solid")]
        if kind == HGO:
            solids = [_solid(node, np.eye(3))]
        return FebioCard(node.get("name", ""), kind, float(node.findtext("k", "")), tuple(solids))
    except (ElementTree.ParseError, KeyError, ValueError) as error:
        raise InputError(f"not a material card of this kind ({error})") from None


def _solid(node: ElementTree.Element, outer: np.ndarray) -> Solid:
    """One material; its own axes are given in those of the mixture around it."""
    kind = node.get("type", "")
    if kind not in _ENERGIES:
        raise ValueError(f"a part {kind[:40]!r}")
    values = {c.tag: float(c.text or "") for c in node if c.tag not in ("mat_axis", "fiber")}
    return Solid(kind, values, _read_axes(node) @ outer)


def _read_axes(node: ElementTree.Element) -> np.ndarray:
    """Material axes as rows: e1 along a, e3 along a x d, e2 = e3 x e1; for a fibre its vector."""
    if node.find("fiber") is not None:
        fibre = np.array(node.findtext("fiber", "").split(","), dtype=float).reshape(1, 3)
        return fibre / np.linalg.norm(fibre)
    if node.find("mat_axis") is None:
        return np.eye(3)
    a, d = (
        np.array(node.findtext(f"mat_axis/{name}", "").split(","), dtype=float) for name in "ad"
    )
    e3 = np.cross(a, d)
    axes = np.array([a, np.cross(e3, a), e3])
    return axes / np.linalg.norm(axes, axis=1, keepdims=True)


def _hgo_energy(p: Mapping[str, float], axes: np.ndarray, C: np.ndarray) -> np.ndarray:
    I1 = np.trace(C, axis1=-2, axis2=-1)
    psi = p["c"] / 2.0 * (I1 - 3.0)
    gamma = np.radians(p["gamma"])
    for sign in (1.0, -1.0):
        direction = np.cos(gamma) * axes[0] + sign * np.sin(gamma) * axes[1]
        I4 = np.einsum("i,...ij,j->...", direction, C, direction)
        E = p["kappa"] * (I1 - 3.0) + (1.0 - 3.0 * p["kappa"]) * (I4 - 1.0)
        E = np.where(E.real > 0.0, E, 0.0)
        psi = psi + p["k1"] / (2.0 * p["k2"]) * (np.exp(p["k2"] * E**2) - 1.0)
    return psi


def _matrix_energy(p: Mapping[str, float], axes: np.ndarray, C: np.ndarray) -> np.ndarray:
    I1 = np.trace(C, axis1=-2, axis2=-1)
    I2 = 0.5 * (I1**2 - np.trace(C @ C, axis1=-2, axis2=-1))
    return p["c1"] * (I1 - 3.0) + p["c2"] * (I2 - 3.0)


def _fibre_energy(p: Mapping[str, float], axes: np.ndarray, C: np.ndarray) -> np.ndarray:
    In = np.einsum("i,...ij,j->...", axes[0], C, axes[0])
    E = np.where(In.real > 1.0, In - 1.0, 0.0)
    return p["ksi"] / (p["alpha"] * p["beta"]) * (np.exp(p["alpha"] * E ** p["beta"]) - 1.0)


def _fung_energy(p: Mapping[str, float], axes: np.ndarray, C: np.ndarray) -> np.ndarray:
    G12, G23, G31 = p["G12"], p["G23"], p["G31"]
    mu = np.array([G12 + G31 - G23, G12 - G31 + G23, -G12 + G31 + G23])
    c12, c23, c31 = -p["v12"] / p["E1"], -p["v23"] / p["E2"], -p["v31"] / p["E3"]
    compliance = np.array(
        [
            [1.0 / p["E1"], c12, c31],
            [c12, 1.0 / p["E2"], c23],
            [c31, c23, 1.0 / p["E3"]],
        ]
    )
    lam = np.linalg.inv(compliance) - 2.0 * np.diag(mu)
    E = 0.5 * (C - np.eye(3))
    first = np.einsum("ai,...ij,aj->...a", axes, E, axes)
    second = np.einsum("ai,...ij,aj->...a", axes, E @ E, axes)
    # Q = (1/c) sum_a [2 mu_a M_a:E^2 + sum_b lambda_ab (M_a:E) (M_b:E)]
    Q = 2.0 * second @ mu + np.einsum("...a,ab,...b->...", first, lam, first)
    return 0.5 * p["c"] * (np.exp(Q / p["c"]) - 1.0)


_ENERGIES = {HGO: _hgo_energy, MATRIX: _matrix_energy, FIBRE: _fibre_energy, FUNG: _fung_energy}
