"""Cards of FEBio: its Holzapfel-Gasser-Ogden material, and laws as a mixture of a matrix and more.

FEBio User Manual, "Holzapfel-Gasser-Ogden" (uncoupled materials):

    Psi = c/2 (I1 - 3) + k1/(2 k2) sum_a (exp(k2 <E_a>^2) - 1) + U(J)
    E_a = kappa (I1 - 3) + (1 - 3 kappa) (I4_a - 1)          I1, I4 of the isochoric part of C
    U(J) = k/2 ((J^2 - 1)/2 - ln J)

The families lie at +gamma and -gamma (degrees) from the first material axis, in the plane of
the first two. c is 2 C1; each family counts once, as in ours.

FEBio User Manual, "Uncoupled Solid Mixture", with the isochoric part of C throughout:

    Mooney-Rivlin             c1 (I1 - 3) + c2 (I2 - 3)
    fiber-exp-pow-uncoupled   ksi / (alpha beta) (exp(alpha (In - 1)^beta) - 1) where In > 1, along
                              the first of its own axes
    Fung orthotropic          (c / 2) (exp(Q) - 1),
                              Q = (1/c) sum_a [2 mu_a M_a:E^2 + sum_b lambda_ab (M_a:E) (M_b:E)]

with mu and lambda from Young's moduli, shear moduli and Poisson's ratios. The mixture's own k holds
the volume. The form Q of a planar test has no thickness and no shear: what it cannot see is chosen
here, and the card names it.
"""

from __future__ import annotations

import contextlib
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from biaxbayes.cards.card import K2_FLOOR, Card, header_lines
from biaxbayes.errors import InputError

__all__ = [
    "MIXTURES",
    "SUFFIX",
    "FebioCard",
    "Mixture",
    "MixtureCard",
    "Solid",
    "card_text",
    "read_febio",
    "read_mixture",
    "required_bulk",
    "write_febio",
    "write_mixture",
]


# --- the uncoupled Holzapfel-Gasser-Ogden material -----------------------------------------------

SUFFIX = ".feb"
TYPE = "Holzapfel-Gasser-Ogden"

CONVENTIONS = [
    "Strain energy (isochoric invariants I1, I4; Macaulay brackets <>; two fibre families):",
    "  Psi = c/2 (I1 - 3) + k1/(2 k2) sum (exp(k2 <E>^2) - 1) + k/2 ((J^2 - 1)/2 - ln J)",
    "  E = kappa (I1 - 3) + (1 - 3 kappa) (I4 - 1)",
    "c is 2 C1 of the fit: c is the initial shear modulus of the matrix.",
    "Two families lie at +gamma and -gamma degrees from the first material axis (a), which is the "
    "x axis of the test; d lies in the plane, towards its y axis. Replace mat_axis by the axes of "
    "your geometry.",
    "kappa = 0 means aligned fibres, 1/3 an isotropic distribution; as a dispersion out of the "
    "plane (Holzapfel et al. 2015) it is kappa_op = (1 - kappa) / 2.",
]


@dataclass(frozen=True)
class FebioCard:
    """What a written card says, in its own units.

    Attributes
    ----------
    label : str
    c, k1, k2, gamma, kappa, k : float
        gamma in degrees.
    axes : ndarray, shape (2, 3)
        The vectors a and d of ``mat_axis``.
    """

    label: str
    c: float
    k1: float
    k2: float
    gamma: float
    kappa: float
    k: float
    axes: np.ndarray

    def energy(self, F: np.ndarray) -> np.ndarray:
        """Strain energy of deformation gradients of shape (..., 3, 3), real or complex."""
        J = np.linalg.det(F)
        return self.isochoric_energy(F) + self.k / 2.0 * ((J**2 - 1.0) / 2.0 - np.log(J))

    def isochoric_energy(self, F: np.ndarray) -> np.ndarray:
        """The energy without its volumetric term, which does no work while J = 1."""
        C = _isochoric(F)
        I1 = np.trace(C, axis1=-2, axis2=-1)
        psi = self.c / 2.0 * (I1 - 3.0)
        # Material axes: e1 along a, e3 along a x d, e2 = e3 x e1.
        a, d = self.axes
        e1, e3 = a / np.linalg.norm(a), np.cross(a, d) / np.linalg.norm(np.cross(a, d))
        e2 = np.cross(e3, e1)
        gamma = self.gamma * np.pi / 180.0
        for sign in (1.0, -1.0):
            ar = np.cos(gamma) * e1 + sign * np.sin(gamma) * e2
            I4 = np.einsum("i,...ij,j->...", ar, C, ar)
            E = self.kappa * (I1 - 3.0) + (1.0 - 3.0 * self.kappa) * (I4 - 1.0)
            E = np.where(E.real > 0.0, E, 0.0)
            psi = psi + self.k1 / (2.0 * self.k2) * (np.exp(self.k2 * E**2) - 1.0)
        return psi


def _isochoric(F: np.ndarray) -> np.ndarray:
    """Isochoric part of the right Cauchy-Green tensor C."""
    return np.swapaxes(F, -1, -2) @ F * np.linalg.det(F)[..., None, None] ** (-2.0 / 3.0)


def write_febio(card: Card, version: str) -> str:
    """Text of the card: a file for ``<Material from="..."/>`` or to copy the material from.

    Raises
    ------
    InputError
        If the card has no bulk modulus, which this material needs.
    """
    k = required_bulk(card)
    material = card.material
    node = ElementTree.Element("material", id="1", name=card.label, type=TYPE)
    values = {
        "c": 2.0 * card.stress(material.C1_kPa),
        "k1": card.stress(material.k1_kPa),
        "k2": material.k2,
        "gamma": material.alpha_deg,
        "kappa": material.kappa,
        "k": k,
    }
    for name, value in values.items():
        ElementTree.SubElement(node, name).text = repr(float(value))
    axis = ElementTree.SubElement(node, "mat_axis", type="vector")
    ElementTree.SubElement(axis, "a").text = "1,0,0"
    ElementTree.SubElement(axis, "d").text = "0,1,0"
    return card_text(card, node, version, CONVENTIONS)


def required_bulk(card: Card) -> float:
    """The bulk modulus of a card in its units.

    Raises
    ------
    InputError
        If it has none, which every uncoupled material needs.
    """
    if card.bulk_kPa is None:
        raise InputError("FEBio needs a bulk modulus", remedy="give --bulk-ratio, for example 1000")
    return float(card.stress(card.bulk_kPa))


def card_text(card: Card, node: ElementTree.Element, version: str, conventions: list[str]) -> str:
    """The file of one material: what a reader must know as a comment, and the material.

    Parameters
    ----------
    card : Card
    node : Element
        The material.
    version : str
        Of biaxbayes.
    conventions : list of str
        What FEBio means by its parameters.
    """
    bulk = [
        f"k = {required_bulk(card):.6g} {card.units.stress} makes it nearly incompressible; the "
        "fit is incompressible and does not determine k.",
        f'Use: <Material from="FILE"/> in a control file, or copy the material. Name: {card.label}',
    ]
    root = ElementTree.Element("febio_spec", version="4.0")
    ElementTree.SubElement(root, "Module", type="solid")
    ElementTree.SubElement(root, "Material").append(node)
    ElementTree.indent(root)
    comment = "\n".join(header_lines(card, version, [*conventions, *bulk]))
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f"<!--\n{_comment_safe(comment)}\n-->\n"
        f"{ElementTree.tostring(root, encoding='unicode')}\n"
    )


def _comment_safe(text: str) -> str:
    """An XML comment may not hold two hyphens in a row."""
    while "--" in text:
        text = text.replace("--", "- -")
    return text


def read_febio(text: str) -> FebioCard:
    """Read a card back.

    Raises
    ------
    InputError
        If the text is no card of this kind.
    """
    with _material_in(text, TYPE) as node:
        value = {child.tag: child.text or "" for child in node if child.tag != "mat_axis"}
        axes = [node.findtext(f"mat_axis/{name}", "").split(",") for name in "ad"]
        names = ("c", "k1", "k2", "gamma", "kappa", "k")
        c, k1, k2, gamma, kappa, k = (float(value[name]) for name in names)
        return FebioCard(
            node.get("name", ""), c, k1, k2, gamma, kappa, k, np.array(axes, dtype=float)
        )


@contextlib.contextmanager
def _material_in(text: str, kind: str) -> Iterator[ElementTree.Element]:
    """The material of a card, which is read in the block; what it lacks is an InputError."""
    try:
        node = ElementTree.fromstring(text.encode()).find("Material/material")
        if node is None or node.get("type") != kind:
            raise ValueError("another material")
        yield node
    except (ElementTree.ParseError, KeyError, ValueError) as error:
        raise InputError(f"not a material card of this kind ({error})") from None


# --- laws as an uncoupled solid mixture of a matrix and what is in it ----------------------------

MIXTURE_TYPE = "uncoupled solid mixture"
MATRIX, FIBRE, FUNG = "Mooney-Rivlin", "fiber-exp-pow-uncoupled", "Fung orthotropic"
THICKNESS = 1e-10
"""Young's modulus through the thickness over the smaller one in the plane: FEBio wants it above
zero, and the law has none."""


# --- laws as mixtures ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Solid:
    """One part of a mixture.

    Attributes
    ----------
    type : str
        As FEBio names it.
    stresses, numbers : mapping of str to float
        Its parameters, those that are stresses in kPa.
    angle_deg : float
        Of its first axis from the x axis of the test, towards y.
    """

    type: str
    stresses: Mapping[str, float]
    numbers: Mapping[str, float]
    angle_deg: float = 0.0


class Mixture(NamedTuple):
    """How a law is written: its parts, from parameters by name, and words for the card."""

    solids: Callable[[Mapping[str, float]], list[Solid]]
    matrix_shear_kPa: Callable[[Mapping[str, float]], float]
    conventions: tuple[str, ...]


def _matrix(c1: float) -> Solid:
    return Solid(MATRIX, {"c1": c1, "c2": 0.0}, {})


def _fung(p: Mapping[str, float]) -> list[Solid]:
    b = np.array([[p["b_x"], p["b_xy"]], [p["b_xy"], p["b_y"]]])
    # Q = (1/c) E : C : E with the in-plane block of C = c b; E_a and nu_ab from its inverse
    compliance = np.linalg.inv(p["c"] * b)
    young = 1.0 / np.diag(compliance)
    # as if the plane were isotropic on average: b_x - b_xy = 2 mu / c there
    shear = 0.25 * p["c"] * (p["b_x"] + p["b_y"] - 2.0 * p["b_xy"])
    stresses = {
        "E1": young[0],
        "E2": young[1],
        "E3": THICKNESS * young.min(),
        **dict.fromkeys(("G12", "G23", "G31"), shear),
        "c": p["c"],
    }
    poisson = {"v12": -compliance[0, 1] * young[0], "v23": 0.0, "v31": 0.0}
    return [_matrix(p["c0"]), Solid(FUNG, stresses, poisson)]


def _four_fibre(p: Mapping[str, float]) -> list[Solid]:
    out = [_matrix(0.5 * p["c"])]
    for family, angles in (("x", (0.0,)), ("y", (90.0,)), ("d", (p["alpha"], -p["alpha"]))):
        k1, k2 = p[f"k1_{family}"], max(p[f"k2_{family}"], K2_FLOOR)
        # k1 / (4 k2) (exp(k2 E^2) - 1) with E = In - 1: ksi = k1 / 2, alpha = k2, beta = 2
        out += [
            Solid(FIBRE, {"ksi": 0.5 * k1}, {"alpha": k2, "beta": 2.0}, angle)
            for angle in angles
            if k1 > 0.0
        ]
    return out


AXES = (
    "The first material axis (a) is the x axis of the test; d lies in the plane, towards its y "
    "axis. Replace the mixture's mat_axis by the axes of your geometry."
)
MIXTURES = {
    "fung": Mixture(
        _fung,
        lambda p: 2.0 * p["c0"],
        (
            "Strain energy (isochoric I1 and Green strains E):",
            "  Psi = c0 (I1 - 3) + c/2 (exp(Q) - 1) + U(J)",
            "  Q = b_x E11^2 + b_y E22^2 + 2 b_xy E11 E22 in the plane of the test",
            "c1 of Mooney-Rivlin is the c0 of the fit. E1, E2, v12 are those of the matrix c b.",
            "NOT SEEN BY THE TEST: the shear moduli G12, G23, G31, chosen as "
            "c (b_x + b_y - 2 b_xy)/4, what a plane that is isotropic on average would have; and "
            "E3, v23, v31: the law has no term through the thickness, and E3 is as good as zero.",
            AXES,
        ),
    ),
    "four-fibre": Mixture(
        _four_fibre,
        lambda p: p["c"],
        (
            "Strain energy (isochoric I1, In): Psi = c/2 (I1 - 3) + U(J)",
            "  + sum k1/(4 k2) (exp(k2 <In - 1>^2) - 1), fibres along x, y and both diagonals",
            "ksi is k1/2 and alpha (of FEBio) is k2 of the fit; beta = 2. Fibres carry no load in "
            "compression, in this program and in the fit alike.",
            AXES,
        ),
    ),
}
"""Laws that FEBio has as a mixture, by their name."""


# --- the card ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class MixtureCard:
    """What a written card says, in its own units.

    Attributes
    ----------
    label : str
    k : float
    solids : tuple of (str, dict of float, ndarray of shape (3, 3))
        Type, parameters and axes, one a row, in the global system.
    """

    label: str
    k: float
    solids: tuple[tuple[str, dict[str, float], np.ndarray], ...]

    def energy(self, F: np.ndarray) -> np.ndarray:
        """Strain energy of deformation gradients of shape (..., 3, 3), real or complex."""
        return self.isochoric_energy(F) + self.k / 2.0 * np.log(np.linalg.det(F)) ** 2

    def isochoric_energy(self, F: np.ndarray) -> np.ndarray:
        """The energy without its volumetric term, which does no work while J = 1."""
        C = _isochoric(F)
        parts = (_ENERGIES[kind](value, axes, C) for kind, value, axes in self.solids)
        return sum(parts, np.zeros(F.shape[:-2]))


def _matrix_energy(value: dict[str, float], axes: np.ndarray, C: np.ndarray) -> np.ndarray:
    I1 = np.trace(C, axis1=-2, axis2=-1)
    I2 = 0.5 * (I1**2 - np.trace(C @ C, axis1=-2, axis2=-1))
    return value["c1"] * (I1 - 3.0) + value["c2"] * (I2 - 3.0)


def _fibre_energy(value: dict[str, float], axes: np.ndarray, C: np.ndarray) -> np.ndarray:
    In = np.einsum("i,...ij,j->...", axes[0], C, axes[0])
    E = np.where(In.real > 1.0, In - 1.0, 0.0)
    alpha, beta = value["alpha"], value["beta"]
    return value["ksi"] / (alpha * beta) * (np.exp(alpha * E**beta) - 1.0)


def _fung_energy(value: dict[str, float], axes: np.ndarray, C: np.ndarray) -> np.ndarray:
    E1, E2, E3 = (value[f"E{i}"] for i in (1, 2, 3))
    G12, G23, G31 = (value[f"G{ij}"] for ij in (12, 23, 31))
    v12, v23, v31 = (value[f"v{ij}"] for ij in (12, 23, 31))
    mu = np.array([G12 + G31 - G23, G12 - G31 + G23, -G12 + G31 + G23])
    compliance = np.array(
        [
            [1.0 / E1, -v12 / E1, -v31 / E3],
            [-v12 / E1, 1.0 / E2, -v23 / E2],
            [-v31 / E3, -v23 / E2, 1.0 / E3],
        ]
    )
    lam = np.linalg.inv(compliance) - 2.0 * np.diag(mu)
    E = 0.5 * (C - np.eye(3))
    first = np.einsum("ai,...ij,aj->...a", axes, E, axes)
    second = np.einsum("ai,...ij,aj->...a", axes, E @ E, axes)
    # Q = (1/c) sum_a [2 mu_a M_a:E^2 + sum_b lambda_ab (M_a:E) (M_b:E)]
    Q = 2.0 * second @ mu + np.einsum("...a,ab,...b->...", first, lam, first)
    return 0.5 * value["c"] * (np.exp(Q / value["c"]) - 1.0)


_ENERGIES = {MATRIX: _matrix_energy, FIBRE: _fibre_energy, FUNG: _fung_energy}


def write_mixture(card: Card, version: str) -> str:
    """Text of the card of a law in :data:`MIXTURES`.

    Raises
    ------
    InputError
        If the card has no bulk modulus, which this material needs.
    """
    k = required_bulk(card)
    law = card.material.law
    form = MIXTURES[law.name]
    node = ElementTree.Element("material", id="1", name=card.label, type=MIXTURE_TYPE)
    _axes(node, 0.0)
    ElementTree.SubElement(node, "k").text = repr(k)
    for solid in form.solids(dict(zip(law.names, card.material.values, strict=True))):
        part = ElementTree.SubElement(node, "solid", type=solid.type)
        values = {name: card.stress(v) for name, v in solid.stresses.items()} | dict(solid.numbers)
        for name, value in values.items():
            ElementTree.SubElement(part, name).text = repr(float(value))
        if solid.type != MATRIX:
            _axes(part, solid.angle_deg)
    return card_text(card, node, version, list(form.conventions))


def _axes(node: ElementTree.Element, angle_deg: float) -> None:
    """``mat_axis``, turned by an angle in the plane."""
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    axis = ElementTree.SubElement(node, "mat_axis", type="vector")
    ElementTree.SubElement(axis, "a").text = f"{float(c)!r},{float(s)!r},0"
    ElementTree.SubElement(axis, "d").text = f"{float(0.0 - s)!r},{float(c)!r},0"


def _read_axes(node: ElementTree.Element) -> np.ndarray:
    """The axes of a material or a part, one a row; those of its parent where it has none."""
    if node.find("mat_axis") is None:
        return np.eye(3)
    a, d = (
        np.array(node.findtext(f"mat_axis/{name}", "").split(","), dtype=float) for name in "ad"
    )
    third = np.cross(a, d)
    out = np.array([a, np.cross(third, a), third])
    return out / np.linalg.norm(out, axis=1, keepdims=True)


def read_mixture(text: str) -> MixtureCard:
    """Read a card back.

    Raises
    ------
    InputError
        If the text is no card of this kind.
    """
    with _material_in(text, MIXTURE_TYPE) as node:
        whole = _read_axes(node)
        solids = []
        for part in node.findall("solid"):
            value = {c.tag: float(c.text or "") for c in part if c.tag != "mat_axis"}
            # axes of a part are told in those of the mixture
            solids.append((_known(part.get("type", "")), value, _read_axes(part) @ whole))
        return MixtureCard(node.get("name", ""), float(node.findtext("k", "")), tuple(solids))


def _known(kind: str) -> str:
    if kind not in _ENERGIES:
        raise ValueError(f"a part {kind[:40]!r}")
    return kind
