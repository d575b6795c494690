"""The words of a report, each in half a line, for somebody who is no statistician."""

from __future__ import annotations

from biaxbayes.options import FIT_WORDS

__all__ = ["GLOSSARY", "NATS", "fit_terms"]

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
    "mounting stretch": "stretch of the mounted specimen relative to the unloaded one; what is "
    "measured starts there",
    "verdict": "what the data say of a parameter, in one of the four words that follow",
    "identified": "the data alone say where the parameter is",
    "one-sided": "the data give a largest (or a smallest) value and leave the other end open",
    "only in combination": "the parameter trades with others: each alone is loose, together they "
    "are sharp",
    "not identified": "the data say nothing of it that may be trusted; give it from elsewhere",
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
"""Terms of reports, figures and tables."""


def fit_terms() -> dict[str, str]:
    """The deterministic fits by their names."""
    return dict(FIT_WORDS)
