"""Text of quantities and states for pages and LaTeX, and the glossary."""

from __future__ import annotations

from markupsafe import Markup, escape

from biaxbayes.parameters import Quantity
from biaxbayes.text_files import one_line

# --- names on a page and in LaTeX; text from files made safe ------------------------

_LATEX = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    "°": r"$^\circ$",
    "\N{MINUS SIGN}": "$-$",
    **{c: "\\" + c for c in "&%$#_"},
}


def cut(text: object, length: int = 120) -> str:
    """One line without control or direction-changing characters, at most ``length`` long."""
    line = one_line(str(text))
    return line if len(line) <= length else line[: length - 1].rstrip() + "…"


DERIVED = {
    "H": "structure tensor, {}",
    "stiffness_": "tangent stiffness, {}",
    "cauchy_": "Cauchy stress, {}",
}
SMALL_STRAIN = "small-strain stiffness, {}"


def derived_text(name: str) -> str:
    """Text for a derived quantity such as ``cauchy_x at 1.1``; other names unchanged."""
    stem, at, stretch = name.partition(" at ")
    text = DERIVED.get(stem[:-1])
    if text is None or stem[-1:] not in "xyz":
        return name
    if stem.startswith("stiffness_") and stretch in ("", "1"):
        return SMALL_STRAIN.format(stem[-1])
    return text.format(stem[-1]) + (f", at {stretch}" if at else "")


STATES = {
    "converged": "Converged chains: the ensembles agree and hold enough independent draws.",
    "tentative": "Tentative: not converged. Do not publish these numbers; sample longer.",
    "unusable": "Not usable: the ensembles disagree, so the draws must not be used.",
}
"""How far a run can be trusted, by its state."""


def counted(number: int, noun: str) -> str:
    """A number with its noun, as ``2 specimens``."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def as_html(quantity: Quantity | str) -> Markup:
    """Symbol of a quantity as HTML, or a name; what comes from a file is escaped."""
    if isinstance(quantity, str):
        return escape(cut(quantity, 80))
    p = quantity.parameter
    symbol = Markup(p.html) if p.html else escape(p.name)
    label = cut(quantity.state, 40)
    return symbol + (Markup(" <bdi>{}</bdi>").format(label) if label else "")


def as_latex(quantity: Quantity) -> str:
    """Symbol of a quantity as LaTeX."""
    p = quantity.parameter
    symbol = f"${p.symbol}$" if p.symbol else latex_text(p.name, 40)
    return f"{symbol} {latex_text(quantity.state, 40)}".strip()


def latex_text(text: object, length: int = 120) -> str:
    """Text from a file that LaTeX prints as it stands."""
    return "".join(_LATEX.get(c, c) for c in cut(text, length))


# --- glossary ------------------------------------------------------------------------------------

NATS = "0.7 halve the volume of plausible values, 2.3 leave a tenth"
GLOSSARY = {
    "posterior": "what is known of all parameters from the data and the priors together, as a "
    "set of draws; each draw is one possible material",
    "prior": "the distribution of a parameter that is assumed before the data are used",
    "median, 90 % interval": "half of the draws lie below the median, 5 % below and 5 % above "
    "the interval",
    "likelihood": "probability density of the data for given parameters",
    "sd of its logarithm": "width of a lognormal prior: one sd is a factor of 2.7 for 1, a "
    "factor of 7 for 2",
    "mounting stretch": "stretch of the mounted specimen relative to the unloaded one; "
    "measured stretches are relative to the mounted one",
    "verdict": "what the test shows about a parameter, in the terms that follow",
    "identified": "the data determine the parameter from both sides",
    "bounded": "the data give an upper or a lower limit only",
    "only in combination": "the parameter is correlated with others: a combination of them is "
    "known well, each alone is not",
    "not identified": "the data, or the laws that fit them, leave both ends open: no number is "
    "reported",
    "no verdict": "the chains have not converged, so the run shows nothing about the tissue yet",
    "fixed": "a value that was given and not inferred",
    "credible band": "region that contains the curve of the model with 90 % probability",
    "predictive band": "the credible band widened by the inferred error: region that contains a "
    "reading with 90 % probability",
    "stresses to report": "their intervals hold the inferred error and the uncertainty of the "
    "mounting stretch",
    "width": "of the interval, as a share of the median",
    "Cauchy stress, nominal stress": "force per deformed section; force per section of the "
    "state that dimensions refer to (first Piola-Kirchhoff stress)",
    "tangent stiffness, small-strain stiffness": "slope of the stress over the logarithm of "
    "stretch, at a stretch; in the unloaded state",
    "strain energy": "elastic energy per volume of tissue at a stretch",
    "structure tensor": "share of the fibres along each axis; one third each if the fibres "
    "point in all directions equally",
    "exponent": "of the fibres' exponential at the largest tested stretch",
    "corner plot": "distributions of all parameters (diagonal) and of all pairs; a narrow, "
    "slanted cloud is a correlated pair",
    "residual, misfit": "reading minus the curve of the median parameters; its root mean square",
    "trades with": "is correlated with: a change of one is compensated by a change of the other",
    "refits": "range of a mounting stretch in fits to parts of the record, where the law misses it",
    "sensitivity": "how far the posterior moves if the prior, or the data, are weighted slightly "
    "more",
    "end of a range": "a limit of a parameter, such as perfectly aligned fibres; the data cannot "
    "show whether it is exactly reached",
    "contraction": "share of the prior's variance that the data remove: 0 % nothing learnt, "
    "100 % exactly known",
    "reported": "what goes into a paper; for a mounting stretch, what all laws that fit the record "
    "agree on",
    "other laws": "material laws fitted to the same record; one fits as well as another where "
    "their misfits are about equally small",
    "runs": "sequences of residuals of one sign; far fewer than expected mean that the model "
    "misses smoothly",
    "effective readings": "number of independent readings that carry as much information as "
    "the correlated rows",
    "weight of the likelihood": "effective readings over readings; it prevents many correlated "
    "rows from giving too narrow intervals",
    "convergence": "agreement between the ensembles, so that their draws represent the posterior",
    "ensembles, walkers, steps": "independent samplings from dispersed starts; the points that "
    "each ensemble moves; the number of moves",
    "trace": "the values of an ensemble, step by step",
    "effective draws (ESS), bulk and tail": "number of independent draws with the same "
    "information, for the centre and the ends; 400 suffice for an interval",
    "R-hat": "spread between ensembles relative to that within them; above 1.01 they do not agree",
    "converged, tentative, unusable": "the chains agree and are long enough; they agree but "
    "are short; they disagree, and no interval is shown",
    "nats": f"unit of information: {NATS}",
}
"""Terms of a run's report, figures and tables."""
SEVERAL = {
    "within the law": "under the assumption that the material law is exact",
    "sd (standard deviation)": "about two thirds of the values lie within one sd of the mean",
    "factor": "sd of a quantity that varies in ratios: 1.2 means typically 20 % up or down",
    "mean": "of the medians of several specimens; for stiffnesses and exponents the geometric mean",
    "sd between": "spread of the specimens beyond the width of their own posteriors",
    "above zero, below zero": "number of pairs whose 90 % interval of the difference lies "
    "above, or below, zero",
    "difference in sd": "difference of two means over the root of the sum of their variances: "
    "below 1 the posteriors overlap, above 3 hardly",
    "P(larger)": "probability that the quantity is larger in the first specimen",
    "Kolmogorov": "largest difference of two distribution functions: 0 equal, 1 no overlap",
    "overlay": "corner plots of several runs in one figure, one colour per run",
    "population, group": "all specimens of a kind, tested or not; those of one layer, or of "
    "the group that the study file names",
    "alone, pooled": "from the specimen's own test; from all tests of the study together",
    "typical donor": "the centre of the group: half of such a donor's specimens lie below the "
    "value",
    "sd of donors, sd of specimens": "spread between donors; spread between specimens of one "
    "donor and group",
    "new specimen": "a specimen of a donor that was not tested; 90 % of them lie in the interval",
    "new donor": "the median of the specimens of a donor that was not tested; 90 % of them lie "
    "in the interval",
    "ratio": "the second group over the first; 1 is no difference",
    "predictive p": "share of simulated specimens that lie further out than this one; below "
    "0.05 it does not fit its group",
    "donor effect": "the deviation that all specimens of a donor share, whatever their layer",
    "material laws": "formulas for the stress at any stretch, each with its own parameters",
    "weight of a law": "its share in the mixture that predicts left-out protocols best (stacking)",
    "density of what was left out": "probability density of the left-out readings; larger is "
    "better",
}
"""Further terms of pages on several specimens, or laws."""
