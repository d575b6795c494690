"""The statistical model, the fits and the sampler."""

import biaxbayes.mechanics  # noqa: F401  (decides where compiled code is kept)
