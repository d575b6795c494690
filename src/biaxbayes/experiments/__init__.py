"""Kinds of test: one object each, in a file of its own.

A new kind is a file with a subclass of :class:`.experiment.Experiment`, and its line here.
"""

from biaxbayes.experiments.biaxial import Biaxial
from biaxbayes.experiments.bulge import Bulge
from biaxbayes.experiments.experiment import Experiment
from biaxbayes.experiments.strip import Strip
from biaxbayes.experiments.tube import Tube

BIAXIAL = Biaxial()
EXPERIMENTS: dict[str, Experiment] = {
    test.name: test for test in (BIAXIAL, Strip(0), Strip(1), Tube(), Bulge())
}
"""Kinds of test by the name in a specimen file; those with dimensions have some of a usual size."""
