"""FEBio: its Holzapfel-Gasser-Ogden material, and other laws as a mixture of a matrix and more.

FEBio User Manual, uncoupled materials. Each family counts once, as in our law. A fibre material has
a ``fiber`` vector, which FEBio reads in the axes of the mixture. The outermost material has the
bulk modulus k, with

    U(J) = k/2 ((J^2 - 1)/2 - ln J)  for Holzapfel-Gasser-Ogden,  k/2 (ln J)^2  for a mixture
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from biaxbayes.cards.card import K2_FLOOR, Card, header_lines
from biaxbayes.errors import InputError
from biaxbayes.laws.goh import GOH

SUFFIX = ".feb"
HGO, MIXTURE = "Holzapfel-Gasser-Ogden", "uncoupled solid mixture"
MATRIX, FIBRE, FUNG = "Mooney-Rivlin", "fiber-exp-pow-uncoupled", "Fung orthotropic"

# --- how a law is written ------------------------------------------------------------------------


class Mixture(NamedTuple):
    """A law as a mixture."""

    # from parameters by name: type, FEBio's parameters (stresses in kPa), angle from x (degrees);
    # the matrix first
    parts: Callable[[Mapping[str, float]], list[Part]]
    conventions: tuple[str, ...]


Part = tuple[str, dict[str, float], float]
STRESS_PARAMETERS = ("c", "c1", "c2", "k1", "ksi", "E1", "E2", "E3", "G12", "G23", "G31")
"""Parameters of FEBio that are stresses."""

AXES_COMMENT = (
    "The first material axis (a) is the x axis of the test; d lies in the plane, towards its y "
    "axis. Replace the {} by the axes of your geometry."
)
HGO_CONVENTIONS: tuple[str, ...] = (
    "Strain energy (isochoric invariants I1, I4; Macaulay brackets <>; two fibre families):",
    "  Psi = c/2 (I1 - 3) + k1/(2 k2) sum (exp(k2 <E>^2) - 1) + k/2 ((J^2 - 1)/2 - ln J)",
    "  E = kappa (I1 - 3) + (1 - 3 kappa) (I4 - 1)",
    "c is 2 C1 of the fit: c is the initial shear modulus of the matrix.",
    "Two families lie at +gamma and -gamma degrees from the first material axis (a).",
    AXES_COMMENT.format("mat_axis"),
    "kappa = 0 means aligned fibres, 1/3 an isotropic distribution; as a dispersion out of the "
    "plane (Holzapfel et al. 2015) it is kappa_op = (1 - kappa) / 2.",
)
THROUGH_THICKNESS_RATIO = 1e-10
"""Young's modulus through the thickness over the smaller one in the plane: FEBio wants it above
zero, and the law has none."""


def _fung_parts(p: Mapping[str, float]) -> list[Part]:
    matrix = (MATRIX, {"c1": p["c0"], "c2": 0.0}, 0.0)
    if p["c"] == 0.0:
        return [matrix]
    b = np.array([[p["b_x"], p["b_xy"]], [p["b_xy"], p["b_y"]]])
    # Q = (1/c) E : C : E with the in-plane block of C = c b; E_a and nu_ab from its inverse
    compliance = np.linalg.inv(p["c"] * b)
    young = 1.0 / np.diag(compliance)
    # as if the plane were isotropic on average: b_x - b_xy = 2 mu / c there
    shear = 0.25 * p["c"] * (p["b_x"] + p["b_y"] - 2.0 * p["b_xy"])
    values = {"c": p["c"], "E1": young[0], "E2": young[1]}
    values |= {"E3": THROUGH_THICKNESS_RATIO * np.min(young)}
    values |= dict.fromkeys(("G12", "G23", "G31"), shear)
    values |= {"v12": -compliance[0, 1] * young[0], "v23": 0.0, "v31": 0.0}
    return [matrix, (FUNG, values, 0.0)]


def _four_fibre_parts(p: Mapping[str, float]) -> list[Part]:
    parts: list[Part] = [(MATRIX, {"c1": 0.5 * p["c"], "c2": 0.0}, 0.0)]
    for family, angles in (("x", (0.0,)), ("y", (90.0,)), ("d", (p["alpha"], -p["alpha"]))):
        k1, k2 = p[f"k1_{family}"], max(p[f"k2_{family}"], K2_FLOOR)
        # k1 / (4 k2) (exp(k2 E^2) - 1) with E = In - 1: ksi = k1 / 2, alpha = k2, beta = 2
        fibre = {"ksi": 0.5 * k1, "alpha": k2, "beta": 2.0}
        parts += [(FIBRE, fibre, angle) for angle in angles if k1 > 0.0]
    return parts


MIXTURES = {
    "fung": Mixture(
        _fung_parts,
        (
            "Strain energy (isochoric I1 and Green strains E):",
            "  Psi = c0 (I1 - 3) + c/2 (exp(Q) - 1) + U(J)",
            "  Q = b_x E11^2 + b_y E22^2 + 2 b_xy E11 E22 in the plane of the test",
            "c1 of Mooney-Rivlin is the c0 of the fit. E1, E2, v12 are those of the matrix c b.",
            "NOT SEEN BY THE TEST: the shear moduli G12, G23, G31, chosen as "
            "c (b_x + b_y - 2 b_xy)/4, what a plane that is isotropic on average would have; and "
            "E3, v23, v31: the law has no term through the thickness, and E3 is as good as zero.",
            AXES_COMMENT.format("mixture's mat_axis"),
        ),
    ),
    "four-fibre": Mixture(
        _four_fibre_parts,
        (
            "Strain energy (isochoric I1, In): Psi = c/2 (I1 - 3) + U(J)",
            "  + sum k1/(4 k2) (exp(k2 <In - 1>^2) - 1), fibres along x, y and both diagonals",
            "ksi is k1/2 and alpha (of FEBio) is k2 of the fit; beta = 2. Fibres carry no load in "
            "compression, neither in this program nor in the fit. Each fiber vector is given in "
            "the material axes of the mixture.",
            AXES_COMMENT.format("mixture's mat_axis"),
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
    material, goh = card.material, isinstance(card.material, GOH)
    node = ElementTree.SubElement(
        materials, "material", id="1", name=card.label, type=HGO if goh else MIXTURE
    )
    if goh:
        conventions = HGO_CONVENTIONS
        values = {"c": 2.0 * material.C1_kPa, "k1": material.k1_kPa, "k2": material.k2}
        values |= {"gamma": material.alpha_deg, "kappa": material.kappa}
        _add_values(node, card, values)
    axis = ElementTree.SubElement(node, "mat_axis", type="vector")
    ElementTree.SubElement(axis, "a").text = "1,0,0"
    ElementTree.SubElement(axis, "d").text = "0,1,0"
    if not goh:
        law = material.law
        conventions = MIXTURES[law.name].conventions
        parameters = dict(zip(law.names, material.values, strict=True))
        for kind, values, angle_deg in MIXTURES[law.name].parts(parameters):
            part = ElementTree.SubElement(node, "solid", type=kind)
            _add_values(part, card, values)
            if kind == FIBRE:
                angle = np.radians(angle_deg)
                direction = f"{float(np.cos(angle))!r},{float(np.sin(angle))!r},0"
                ElementTree.SubElement(part, "fiber", type="vector").text = direction
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


def _add_values(node: ElementTree.Element, card: Card, values: Mapping[str, float]) -> None:
    """An element for each parameter, stresses (kPa) in the units of the card."""
    for name, value in values.items():
        number = card.stress(value) if name in STRESS_PARAMETERS else value
        ElementTree.SubElement(node, name).text = repr(float(number))
