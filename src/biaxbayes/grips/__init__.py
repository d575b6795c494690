"""Grips of a biaxial test: their geometry, and the loads corrected for them."""
