"""FEBio: the uncoupled ``Holzapfel-Gasser-Ogden`` material.

FEBio User Manual, "Holzapfel-Gasser-Ogden" (uncoupled materials):

    Psi = c/2 (I1 - 3) + k1/(2 k2) sum_a (exp(k2 <E_a>^2) - 1) + U(J)
    E_a = kappa (I1 - 3) + (1 - 3 kappa) (I4_a - 1)          I1, I4 of the isochoric part of C
    U(J) = k/2 ((J^2 - 1)/2 - ln J)

The families lie at +gamma and -gamma (degrees) from the first material axis, in the plane of
the first two. c is 2 C1; each family counts once, as in ours.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass

import numpy as np

from biaxbayes.cards.card import Card, header_lines
from biaxbayes.errors import InputError

__all__ = ["SUFFIX", "FebioCard", "card_text", "read_febio", "required_bulk", "write_febio"]

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
        J = np.linalg.det(F)
        C = np.swapaxes(F, -1, -2) @ F * J[..., None, None] ** (-2.0 / 3.0)
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
    try:
        root = ElementTree.fromstring(text.encode())
        node = root.find("Material/material")
        if node is None or node.get("type") != TYPE:
            raise ValueError("another material")
        value = {child.tag: child.text or "" for child in node if child.tag != "mat_axis"}
        axes = [node.findtext(f"mat_axis/{name}", "").split(",") for name in "ad"]
        names = ("c", "k1", "k2", "gamma", "kappa", "k")
        c, k1, k2, gamma, kappa, k = (float(value[name]) for name in names)
        return FebioCard(
            node.get("name", ""), c, k1, k2, gamma, kappa, k, np.array(axes, dtype=float)
        )
    except (ElementTree.ParseError, KeyError, ValueError) as error:
        raise InputError(f"not a material card of this kind ({error})") from None
