"""Figures of one run, one file each."""

DRAWING_MODULES = (
    "matplotlib.backends.backend_agg",
    "matplotlib.backends.backend_pdf",
    "biaxbayes.figures.run.bands",
    "biaxbayes.figures.run.corner",
    "biaxbayes.figures.run.identifiability",
    "biaxbayes.reports.explore",
)
"""What the figures of a run need, for who imports it ahead of time."""
