"""A square or rectangle pulled along x and y."""

from biaxbayes.experiments.sheet import Sheet


class Biaxial(Sheet):
    """A square or rectangle pulled along x and y."""

    name = "biaxial"
    meaning = "a square or rectangle pulled along x and y"
    words = "a planar biaxial test"
    is_biaxial = True
