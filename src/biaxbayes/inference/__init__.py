"""The statistical model, the fits and the sampler."""
