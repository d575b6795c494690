"""Mechanics of the planar biaxial test: no files, no priors, no plots."""
