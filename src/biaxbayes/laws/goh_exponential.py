r"""GOH fibres in an exponential matrix.

    W = (C1 / b) (exp(b (X + Y + Z - 3)) - 1) + (k1 / k2) (exp(k2 E^2) - 1)
    E = Hx X + Hy Y + Hz Z - 1

with the squared stretches X, Y, Z and the structure tensor of :mod:`biaxbayes.laws.goh`, which is
the case b -> 0. The exponential matrix is that of Demiray (J. Biomech. 5 (1972) 309).
"""

from __future__ import annotations

from typing import ClassVar

from biaxbayes.laws.differentiation import exponential
from biaxbayes.laws.dispersed_fibres import DispersedFibreLaw, structure_tensor
from biaxbayes.laws.goh import GOHLaw
from biaxbayes.parameters import Parameter, positive_parameter


def energy(X, Y, Z, C1, b, k1, k2, cos2, kappa, switch):
    """W in kPa at squared stretches; with the switch (1), no fibres where E is negative."""
    Hx, Hy, Hz = structure_tensor(cos2, kappa)
    E = Hx * X + Hy * Y + Hz * Z - 1.0
    fibres = 1.0 - switch * (E < 0.0)
    return C1 * exponential(b, X + Y + Z - 3.0) + fibres * k1 * exponential(k2, E * E)


class GOHExponentialLaw(DispersedFibreLaw):
    """Gasser-Ogden-Holzapfel fibres in an exponential matrix."""

    energy = staticmethod(energy)
    name = "goh-exponential"
    title = "GOH with an exponential matrix"
    source = (
        "Gasser, Ogden, Holzapfel, J. R. Soc. Interface 3 (2006) 15; "
        "Demiray, J. Biomech. 5 (1972) 309"
    )
    description = f"{GOHLaw.description}, in a matrix that stiffens exponentially with I1"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        GOHLaw.parameters[0],
        positive_parameter(
            "b", "b", "matrix stiffening", "1", 5.0, 2.0, 1e3, "a neo-Hookean matrix"
        ),
        *DispersedFibreLaw.fibre_parameters,
    )
    amplitudes = ("C1", "k1")
    exponents: ClassVar = {"b": "b (I1 - 3)", "k2": "k2 E^2"}
    undefined_at: ClassVar = {"alpha": (("kappa", 1, "kappa = 1/3"), ("k1", 0, "k1 = 0"))}
