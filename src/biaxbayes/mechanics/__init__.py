"""Mechanics of the planar biaxial test: no files, no priors, no plots."""

from biaxbayes.compilation import use_own_cache

use_own_cache()
