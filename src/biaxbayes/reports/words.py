"""How quantities are called in what is written of a run, and what its words mean."""

from __future__ import annotations

from markupsafe import Markup, escape

from biaxbayes.options import FIT_WORDS
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


def derived_words(name: str) -> str:
    """What follows from parameters in words, as ``cauchy_x at 1.1``; other names as they are."""
    stem, at, stretch = name.partition(" at ")
    words = DERIVED.get(stem[:-1])
    if words is None or stem[-1:] not in "xyz":
        return name
    if stem.startswith("stiffness_") and stretch in ("", "1"):
        return SMALL_STRAIN.format(stem[-1])
    return words.format(stem[-1]) + (f", at {stretch}" if at else "")


def counted(number: int, noun: str) -> str:
    """So many of a thing."""
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


# --- the words of a report, each in half a line, for somebody who is no statistician -------------

NATS = "0.7 halve the volume of plausible values, 2.3 leave a tenth"
GLOSSARY = {
    "posterior": "what the data and the priors together leave of every parameter: many draws, each "
    "a complete set of values that fits",
    "prior": "what is taken to be plausible before the data are looked at",
    "median, 90 % interval": "half of the draws lie below the median; 5 % lie on either side of "
    "the interval",
    "likelihood": "how well a set of values fits the data; its logarithm is what is added up",
    "sd of its logarithm": "width of a lognormal prior: 1 is a factor of 2.7 to either side, 2 a "
    "factor of 7",
    "mounting stretch": "stretch of the mounted specimen relative to the unloaded one, its "
    "prestretch; what is measured starts there",
    "verdict": "what the data say of a parameter, in the words that follow",
    "identified": "the data alone say where the parameter is",
    "one-sided": "the data give a largest (or a smallest) value and leave the other end open",
    "only in combination": "the parameter trades with others: each alone is loose, together they "
    "are sharp",
    "not identified": "a mounting stretch that rests on a toe which the data contradict; only the "
    "range of refits is told",
    "prior-dominated": "the data say little of it: the number is mostly what was taken for "
    "plausible before",
    "no verdict, fixed": "the chains have not converged, so nothing is said; a value that was "
    "given and not inferred",
    "credible band": "where the curve of the model lies with 90 % probability",
    "predictive band": "where the response of the tissue lies: the model's band and the error that "
    "the run inferred",
    "interval of the model, of the tissue": "the same of a single stress: without and with the "
    "error that the run inferred",
    "width": "of the model's interval, as a share of the median: small is sharp",
    "Cauchy stress, nominal stress": "force over the section as it is now; over that of the state "
    "that dimensions refer to (first Piola-Kirchhoff stress)",
    "tangent stiffness, small-strain stiffness": "slope of stress over stretch, at a stretch; in "
    "the unloaded state",
    "strain energy": "work stored in a volume of tissue at a stretch",
    "structure tensor": "share of the fibres that points along an axis; a third each where they "
    "point everywhere",
    "exponent": "of the fibres' stiffening at the largest stretch that was tested",
    "corner plot": "every parameter alone on the diagonal, every pair below it: a narrow slanted "
    "cloud is a pair that trades",
    "residual, misfit": "reading minus the curve of the median model; its root mean square is its "
    "typical size",
    "edge, hypothesis": "an end of a parameter's range, such as fibres that are exactly aligned; "
    "whether it is true the data do not say",
    "stated of the tissue": "what laws that fit the record alike agree on; an interval within the "
    "law holds only if that law is true",
    "other laws, alike": "material laws fitted to the same record; alike where they miss it "
    "by about as much as the best",
    "runs": "stretches of residuals of one sign; far fewer than expected say that the model misses "
    "smoothly",
    "effective readings": "how many independent readings the correlated rows are worth",
    "weight of the likelihood": "effective readings over readings; it keeps many rows from "
    "pretending precision",
    "convergence": "whether the ensembles agree, so that their draws stand for the posterior",
    "ensembles, walkers, steps": "independent samplings that start apart; the points that move "
    "through each; how often they moved",
    "trace": "the values that an ensemble went through, step by step",
    "effective draws (ESS), bulk and tail": "how many independent draws the chains are worth, in "
    "the middle and at the ends; 400 make an interval steady",
    "R-hat": "spread between ensembles over that within them; above 1.01 they have not agreed",
    "converged, tentative, unusable": "the chains agree and are long enough; agree but are short; "
    "disagree, so that the draws say nothing",
    "nats": f"unit of information: {NATS}",
}
"""Terms of a run's report, figures and tables."""
SEVERAL = {
    "determined": "the data narrow the quantity by themselves; where they do not, its number is "
    "none of the tissue",
    "within the law": "as if the material law were true; what is stated of a mounting stretch of "
    "the tissue is not",
    "contraction": "share of the prior's variance that the data take away: 0 % nothing learnt, "
    "100 % known",
    "sd (standard deviation)": "typical distance from the middle; about two thirds lie within one "
    "of it",
    "factor": "an sd of a quantity that varies in ratios: 1.2 is typically 20 % up or down",
    "mean": "of the medians of several specimens; of stiffnesses and exponents the geometric one",
    "sd between": "how much specimens differ beyond the width of their own posteriors",
    "above zero, below zero": "pairs in which the 90 % interval of the difference leaves no doubt "
    "of its sign",
    "difference in sd": "distance of two posteriors over their common width: below 1 they "
    "overlap, from 3 they hardly do",
    "P(larger)": "probability that the one named first is larger; 0.5 says nothing, 0.95 is "
    "rather sure",
    "Kolmogorov": "how far two posteriors are apart: 0 the same, 1 no value in common",
    "overlay": "corner plots of several runs over one another, a colour a run",
    "population, group": "all specimens of a kind, tested or not; those of one layer, or of what "
    "the study file names",
    "alone, pooled": "judged by its own test only; together with the other specimens, which "
    "narrow what it leaves open",
    "typical donor": "the middle of the group: half of such a donor's specimens lie below the "
    "number",
    "sd of donors, sd of specimens": "how much donors differ; how much specimens of one donor and "
    "group do",
    "new specimen": "the next one, of a donor not yet seen: nine of ten lie in the interval",
    "new donor": "the middle of the next donor's specimens: nine of ten lie in the interval",
    "ratio": "the second group over the first; 1 is no difference",
    "predictive p": "share of specimens made by the model that lie further out than this one; "
    "below 0.05 it is no member",
    "donor effect": "what a donor's specimens share, whatever their layer",
    "material laws": "formulas for the stress of tissue at any stretch; each has parameters of its "
    "own",
    "weight of a law": "its share in the mixture that foretells best what was left out (stacking)",
    "density of what was left out": "how probable the parts were that a law was not shown; larger "
    "is better",
}
"""Further terms of pages that speak of several specimens, or laws."""


VERDICT_TERMS = (
    "verdict",
    "identified",
    "one-sided",
    "only in combination",
    "not identified",
    "prior-dominated",
    "no verdict, fixed",
)
"""Of the glossary, what verdicts are told in."""


def chosen_terms(*terms: str) -> list[tuple[str, str]]:
    """Terms of a page with their words, in the order given."""
    known = GLOSSARY | SEVERAL
    return [(term, known[term]) for term in terms]


def fit_terms() -> dict[str, str]:
    """The deterministic fits by their names."""
    return dict(FIT_WORDS)
