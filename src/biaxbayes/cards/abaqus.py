"""Abaqus: ``*ANISOTROPIC HYPERELASTIC, HOLZAPFEL`` with two local directions.

Abaqus Analysis User's Guide, "Anisotropic hyperelastic behavior", Holzapfel-Gasser-Ogden form, with
the energy that :data:`CONVENTIONS` state. The data line holds C10, D, k1, k2, kappa. Each family
counts once, as in our law.
"""

from __future__ import annotations

import numpy as np

from biaxbayes.cards.card import Card, header_lines

SUFFIX = ".inp"

CONVENTIONS = [
    "Strain energy (isochoric invariants I1, I4; Macaulay brackets <>; two fibre families):",
    "  U = C10 (I1 - 3) + (1/D) ((J^2 - 1)/2 - ln J)",
    "      + k1/(2 k2) sum { exp[k2 <E>^2] - 1 },  E = kappa (I1 - 3) + (1 - 3 kappa) (I4 - 1)",
    "C10 is the C1 of the fit; the initial shear modulus of the matrix is mu = 2 C10.",
    "Two families lie at +alpha and -alpha from the local 1-direction, which is the x axis of the "
    "test; the local 2-direction is its y axis. Replace the first two data lines of *ORIENTATION "
    "by the axes of your geometry and keep the last two.",
    "kappa = 0 means aligned fibres, 1/3 an isotropic distribution.",
]
USE = [
    "Use: *SOLID SECTION (or *MEMBRANE SECTION), MATERIAL={label}, ORIENTATION={label}_ORI, with "
    "NLGEOM=YES. In a file with parts the *ORIENTATION block belongs in the part, the *MATERIAL "
    "block outside it. Abaqus/CAE does not keep oblique local directions: include this file by "
    "keyword."
]


def write_abaqus(card: Card, version: str) -> str:
    """Text of the card, ready for ``*INCLUDE``."""
    material = card.material
    if card.bulk_kPa is None:
        D = 0.0
        bulk = [
            "D = 0: incompressible, as in the fit. Use hybrid elements (or membranes) in "
            "Abaqus/Standard; Abaqus/Explicit needs D > 0 (export with --bulk-ratio)."
        ]
    else:
        D = 2.0 / card.stress(card.bulk_kPa)
        bulk = [
            f"D = 2/K with a bulk modulus K = {card.stress(card.bulk_kPa):.6g} {card.units.stress}"
            ": nearly incompressible; the fit is incompressible and does not determine K."
        ]
    use = [line.format(label=card.label) for line in USE]
    alpha = np.radians(material.alpha_deg)
    stresses = (card.stress(material.C1_kPa), D, card.stress(material.k1_kPa))
    # at most 20 characters, the width that Abaqus reads
    cos, sin = f"{np.cos(alpha):.12E}", f"{np.sin(alpha):.12E}"
    constants = [f"{value:.12E}" for value in (*stresses, material.k2, material.kappa)]
    lines = [
        *(f"** {line}" for line in header_lines(card, version, [*CONVENTIONS, *bulk, *use])),
        f"*ORIENTATION, NAME={card.label}_ORI, SYSTEM=RECTANGULAR, LOCAL DIRECTIONS=2",
        "1., 0., 0., 0., 1., 0.",
        "3, 0.",
        f"{cos}, {sin}, 0.",
        f"{cos}, -{sin}, 0.",
        f"*MATERIAL, NAME={card.label}",
        "*ANISOTROPIC HYPERELASTIC, HOLZAPFEL, LOCAL DIRECTIONS=2",
        ", ".join(constants),
    ]
    return "\n".join(lines) + "\n"
