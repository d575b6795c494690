"""Figures of one run, one file each."""

BACKENDS = ("matplotlib.backends.backend_agg", "matplotlib.backends.backend_pdf")
"""What figures are drawn and written with, whose imports take longer than to draw a small one."""

DRAWING_MODULES = (
    *BACKENDS,
    "biaxbayes.figures.run.bands",
    "biaxbayes.figures.run.corner",
    "biaxbayes.figures.run.identifiability",
    "biaxbayes.reports.explore",
)
"""What the figures of a run need, for who imports it ahead of time."""
