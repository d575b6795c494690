"""Kinds of test: a new one is a file with a subclass of ``Experiment``, and its name here."""

from biaxbayes.experiments.bulge import Bulge
from biaxbayes.experiments.experiment import Experiment
from biaxbayes.experiments.sheet import Sheet, Strip
from biaxbayes.experiments.tube import Tube

BIAXIAL = Sheet()
EXPERIMENTS: dict[str, Experiment] = {
    test.name: test for test in (BIAXIAL, Strip(0), Strip(1), Tube(), Bulge())
}
"""Kinds of test by the name in a specimen file; those with dimensions have some of a usual size."""
