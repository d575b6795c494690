"""From evidence to a verdict, with every threshold in one place."""

from __future__ import annotations

from dataclasses import dataclass, fields

from biaxbayes.findings.edges import Edge
from biaxbayes.findings.partners import Partners

__all__ = [
    "COMBINATION",
    "FIXED",
    "IDENTIFIED",
    "NOT_IDENTIFIED",
    "NO_VERDICT",
    "ONE_SIDED",
    "PRIOR",
    "VERDICTS",
    "Evidence",
    "Thresholds",
    "decide",
]

IDENTIFIED = "identified"
ONE_SIDED = "one-sided"
COMBINATION = "only in combination"
PRIOR = "prior-dominated"
NOT_IDENTIFIED = "not identified"
NO_VERDICT = "no verdict"
FIXED = "fixed"
VERDICTS = (IDENTIFIED, ONE_SIDED, COMBINATION, PRIOR, NOT_IDENTIFIED, NO_VERDICT, FIXED)


@dataclass(frozen=True)
class Thresholds:
    """Every number that a verdict depends on.

    Attributes
    ----------
    edge_support : float
        An end of the range is open where the averaged likelihood there is at least this
        share of its maximum: exp(-1.92), the edge of a 95 % likelihood interval.
    combination_spread : float
        A parameter is traded where knowing its partners cuts its standard deviation to this
        share, or less.
    one_sided_excluded : float
        One-sided needs data that exclude at least this share of the prior.
    contraction, prior_excluded : float
        Prior-dominated where the variance shrinks by less than the first; with separate peaks
        only if the data exclude less than the second of the prior as well. A contraction of 0.75
        is a spread of half the prior's; for normal densities the data then tell three times as
        much as the prior.
    sharp_log, sharp_alpha_deg, sharp_kappa, sharp_mounting_stretch : float
        A 90 % interval narrower than this is sharp: a sharp parameter is known in practice,
        whatever it correlates with. The first is for the ratio of the ends for C1, k1 and k2.
    refit_errors : float
        Where the model misses smoothly, so many times the change of the mounting stretch that
        balances the largest miss near the mounted state are added to the range of the refits.
    refit_share : float
        A mounting stretch is not identified where its interval is less than this share of that
        range.
    """

    edge_support: float = 0.147
    combination_spread: float = 0.5
    one_sided_excluded: float = 0.25
    contraction: float = 0.75
    prior_excluded: float = 0.5
    sharp_log: float = 2.0
    sharp_alpha_deg: float = 15.0
    sharp_kappa: float = 0.1
    sharp_mounting_stretch: float = 0.02
    refit_errors: float = 1.645
    refit_share: float = 0.5

    def sharp(self, kind: str, low: float, high: float) -> bool:
        """Whether a 90 % interval in natural units is sharp for its kind of parameter."""
        if kind in ("C1", "k1", "k2"):
            return high <= self.sharp_log * low
        limit = {"alpha": self.sharp_alpha_deg, "kappa": self.sharp_kappa}
        return high - low <= limit.get(kind, self.sharp_mounting_stretch)

    def items(self) -> list[tuple[str, float]]:
        """Names and values, for the header of a file."""
        return [(f.name, getattr(self, f.name)) for f in fields(self)]


@dataclass(frozen=True)
class Evidence:
    """What is known of a sampled parameter; spreads are on its sampling scale.

    Attributes
    ----------
    kind : str
        C1, k1, k2, alpha, kappa, mounting_stretch_x or mounting_stretch_y.
    median, low, high : float
        Median and 90 % interval, natural units.
    prior_sd, posterior_sd : float
    prior_excluded : float
        Share of the prior where the averaged likelihood is below ``edge_support`` of its maximum.
    edges : tuple of Edge
    partners : Partners
    modes : int
    prior_sensitivity, likelihood_sensitivity : float
        By power-scaling.
    refits : (float, float), optional
        Range of a mounting stretch in fits to parts of a record that the model misses.
    """

    kind: str
    median: float
    low: float
    high: float
    prior_sd: float
    posterior_sd: float
    prior_excluded: float
    edges: tuple[Edge, ...]
    partners: Partners
    modes: int
    prior_sensitivity: float
    likelihood_sensitivity: float
    refits: tuple[float, float] | None = None

    @property
    def contraction(self) -> float:
        """1 - posterior variance / prior variance."""
        return 1.0 - (self.posterior_sd / self.prior_sd) ** 2

    def open_edges(self, thresholds: Thresholds) -> tuple[Edge, ...]:
        """Ends of the range that the data do not exclude."""
        return tuple(e for e in self.edges if e.support >= thresholds.edge_support)


def decide(evidence: Evidence, thresholds: Thresholds, *, isotropy_open: bool = False) -> str:
    """The verdict on a sampled parameter of reliable draws.

    A mounting stretch that the data contradict is not identified, whatever else. Else traded with
    others comes first, unless the interval is sharp: then it is known in practice.

    Parameters
    ----------
    evidence : Evidence
    thresholds : Thresholds
    isotropy_open : bool
        The data do not exclude kappa = 1/3, where an angle has no meaning: no angle is
        excluded then, however narrow its posterior.
    """
    e, t = evidence, thresholds
    if e.refits is not None and e.high - e.low < t.refit_share * (e.refits[1] - e.refits[0]):
        return NOT_IDENTIFIED
    traded = e.partners.spread_given_partners <= t.combination_spread
    if e.kind == "alpha" and isotropy_open:
        return COMBINATION if traded else PRIOR
    if traded and not t.sharp(e.kind, e.low, e.high):
        return COMBINATION
    ends = e.open_edges(t)
    if any(edge.kind != "physical" for edge in ends) or len(ends) == 2:
        return PRIOR
    if ends and e.prior_excluded >= t.one_sided_excluded:
        return ONE_SIDED
    # Two narrow peaks have a wide spread and are no prior: what they exclude tells.
    if e.contraction < t.contraction and (e.modes < 2 or e.prior_excluded < t.prior_excluded):
        return PRIOR
    return ONE_SIDED if ends else IDENTIFIED
