"""The verbs, one file each: options, function for Python, command, closing message.

:mod:`biaxbayes.verbs.options` has the options that commands share, :mod:`biaxbayes.verbs.inputs`
opens and checks inputs.
"""

VERBS = {
    "sample": "Joint posterior of material parameters and mounting stretches.",
    "batch": "A whole study: many specimens, layers and donors compared.",
    "population": "Hierarchical posterior over the specimens of a study.",
    "fit": "Deterministic fits, with and without the mounting stretch.",
    "check": "Contents of a specimen file as they are read, and warnings.",
    "convert": "Machine exports to a specimen file.",
    "simulate": "A virtual biaxial test, written as a specimen file.",
    "identify": "Interval or bound, verdict and reason of each parameter.",
    "profile": "Profile likelihood of one parameter.",
    "compare": "Several runs side by side: layers, specimens, settings.",
    "laws": "Material laws compared by their predictions.",
    "design": "Further measurements ranked by their expected benefit.",
    "calibrate": "Simulation-based calibration on your own protocol.",
    "predict": "Stress with bands on any path; thin-walled inflation.",
    "plot": "Figures of a run, sized for a paper.",
    "report": "The report of a run: HTML page or LaTeX table.",
    "export": "Material cards for Abaqus and FEBio.",
    "app": "A page in the browser for all of this.",
}
"""Verbs in the order of the help page; each is a module of this package with its ``command``."""
