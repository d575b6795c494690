"""Populations of virtual specimens: truths, studies of many kinds, and their tables."""
