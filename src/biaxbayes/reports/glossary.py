"""The words of a report, each in half a line, for somebody who is no statistician."""

from __future__ import annotations

from biaxbayes.options import FIT_WORDS

__all__ = ["GLOSSARY", "fit_terms"]

GLOSSARY = {
    "posterior": "what the data and the priors together leave of every parameter: many draws, each "
    "a complete set of values that fits",
    "prior": "what is taken to be plausible before the data are looked at",
    "median, 90 % interval": "half of the draws lie below the median; 5 % lie on either side of "
    "the interval",
    "mounting stretch": "stretch of the mounted specimen relative to the unloaded one; what is "
    "measured starts there",
    "identified": "the data alone say where the parameter is",
    "one-sided": "the data give a largest (or a smallest) value and leave the other end open",
    "only in combination": "the parameter trades with others: each alone is loose, together they "
    "are sharp",
    "not identified": "the data say nothing of it that may be trusted; give it from elsewhere",
    "credible band": "where the curve of the model lies with 90 % probability",
    "predictive band": "where the response of the tissue lies: the model's band and the error that "
    "the run inferred",
    "corner plot": "every parameter alone on the diagonal, every pair below it: a narrow slanted "
    "cloud is a pair that trades",
    "effective readings": "how many independent readings the correlated rows are worth",
    "weight of the likelihood": "effective readings over readings; it keeps many rows from "
    "pretending precision",
    "effective draws (ESS)": "how many independent draws the chains are worth; 400 make an "
    "interval steady",
    "R-hat": "spread between ensembles over that within them; above 1.01 they have not agreed",
    "reliable, tentative, unusable": "the chains agree and are long enough; agree but are short; "
    "disagree, so that the draws say nothing",
    "nats": "unit of information: 0.7 halve the volume of plausible values, 2.3 leave a tenth",
}
"""Terms of reports, figures and tables."""


def fit_terms() -> dict[str, str]:
    """The deterministic fits by their names."""
    return dict(FIT_WORDS)
