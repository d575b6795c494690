"""The GOH law as functions of its parameters (kPa, radians), for the tests that speak of it so."""

import numpy as np

from biaxbayes.laws.goh import GOHLaw
from biaxbayes.laws.materials import Material

GOH_LAW = GOHLaw()
PARAMETERS = GOH_LAW.names
LOWER, UPPER = GOH_LAW.lower, GOH_LAW.upper


def at(*theta, fibre_switch=False) -> Material:
    """The material, or materials, at (C1, k1, k2, alpha in radians, kappa)."""
    return Material(GOHLaw(fibre_switch), theta)


def cauchy_stress(C1, k1, k2, alpha, kappa, *stretch, fibre_switch=False):
    return at(C1, k1, k2, alpha, kappa, fibre_switch=fibre_switch).cauchy(*stretch)


def piola_stress(C1, k1, k2, alpha, kappa, *stretch, fibre_switch=False):
    return at(C1, k1, k2, alpha, kappa, fibre_switch=fibre_switch).piola(*stretch)


def strain_energy(C1, k1, k2, alpha, kappa, *stretch, fibre_switch=False):
    return at(C1, k1, k2, alpha, kappa, fibre_switch=fibre_switch).strain_energy(*stretch)


def stress_response(point, stretch, *, fibre_switch=False):
    return GOHLaw(fibre_switch).response(np.asarray(point), stretch)


def coordinates_of(material):
    return material.law.to_fit_coordinates(material.values)


def material_at(point, *, fibre_switch=False):
    law = GOHLaw(fibre_switch)
    return law.material_at(law.from_fit_coordinates(point))
