"""Quantities that follow from the draws: stresses, stiffnesses and fibre structure."""
