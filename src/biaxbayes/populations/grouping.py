"""Runs of a study that a population pools: which can be, their groups and donors, notes on them."""

from __future__ import annotations

from itertools import combinations

from biaxbayes.errors import BiaxbayesError, InputError
from biaxbayes.populations.model import Grouping
from biaxbayes.populations.specimens import Source
from biaxbayes.runs.run import open_run
from biaxbayes.studies.record import StudyRun
from biaxbayes.text_files import first_few

MAX_STRAIN_RATIO = 1.25
"""Ratio of the largest strains of two specimens from which a note says so."""


def open_sources(members: list[StudyRun], *, anyway: bool) -> tuple[list[Source], dict[str, str]]:
    """The runs that can be pooled, and why the others cannot."""
    usable = ("converged", "tentative") if anyway else ("converged",)
    sources, left_out = [], {}
    for member in members:
        if member.state not in usable:
            words = {"tentative": "tentative, not converged", "unusable": "did not converge"}
            reason = words.get(member.state, member.state)
            left_out[member.label] = f"{reason}: {member.reason}" if member.reason else reason
            continue
        try:
            run = open_run(member.folder)
            if run.state not in usable:
                left_out[member.label] = f"its run is {run.state}"
                continue
            sources.append(Source.from_run(member.label, run))
        except BiaxbayesError as error:
            left_out[member.label] = str(error)
    if len(sources) < 2:
        reasons = "; ".join(f"{k}: {v}" for k, v in list(left_out.items())[:3])
        raise InputError(
            f"{len(sources)} of {len(members)} specimens can be pooled, and a population needs "
            f"two{f' ({reasons})' if reasons else ''}",
            remedy="sample longer with a larger max_steps, or add specimens",
        )
    return sources, left_out


def group_sources(members: list[StudyRun], sources: list[Source]) -> tuple[Grouping, list[str]]:
    """Groups and donors of the pooled specimens, and notes that a reader needs first."""
    by_label = {m.label: m for m in members}
    pooled = [by_label[s.label] for s in sources]
    grouping = Grouping(
        tuple(m.label for m in pooled),
        tuple(m.group for m in pooled),
        tuple(m.donor or f"donor of {m.label}" for m in pooled),
    )
    nameless = [m.label for m in pooled if not m.donor]
    donors, split = len(grouping.donors), not grouping.one_specimen_per_donor
    single = [g for g in grouping.groups if grouping.group.count(g) == 1]
    pairs = combinations(grouping.groups, 2)
    apart = [f"{a} and {b}" for a, b in pairs if not grouping.donors_of(a) & grouping.donors_of(b)]
    notes = {
        f"no donor is given for {first_few(nameless, 4)}: each has one of its own": nameless,
        "all specimens are of one donor, so the differences between donors are unknown: sd_donors "
        "is the prior's and widens mean, new_specimen and new_donor": donors == 1,
        "every donor gave one specimen, so the spread cannot be split between donors and "
        "specimens: the spread that is given, and that of new specimens, contain both": not split,
        f"there are {donors} donors: sd_donors depends much on its prior": split and 1 < donors < 4,
        f"there are {len(pooled)} specimens: the sds depend much on their priors": len(pooled) < 4,
        **{
            f"group {group} has one specimen: its mean is that specimen's within the spread that "
            "the other groups show": True
            for group in single
        },
        f"no donor in common: {'; '.join(apart[:3])}: their contrasts include differences between "
        "donors": apart,
    }
    return grouping, [note for note, holds in notes.items() if holds] + _notes_on_runs(sources)


def _notes_on_runs(sources: list[Source]) -> list[str]:
    """Notes on specimens that were tested or sampled differently."""
    out = []
    for key in ("mounting", "noise", "toe", "mounting_stretch"):
        values = {str(getattr(s.posterior.settings, key)) for s in sources}
        if len(values) > 1:
            out.append(f"the runs differ in {key}: {', '.join(sorted(values))}")
    counts = sorted({len(s.run.specimen.protocols) for s in sources})
    if len(counts) > 1:
        fewest = [s.label for s in sources if len(s.run.specimen.protocols) == counts[0]]
        out.append(
            f"specimens were tested with {counts[0]} to {counts[-1]} protocols "
            f"({counts[0]}: {first_few(fewest, 4)})"
        )
    tops = [s.largest_stretch for s in sources]
    low, high = min(tops), max(tops)
    if high - 1.0 > MAX_STRAIN_RATIO * (low - 1.0):
        fewest = [s.label for s, top in zip(sources, tops, strict=True) if top - low < high - top]
        out.append(
            f"specimens were stretched to {low:.3f} to {high:.3f} from the unloaded state "
            f"(least: {first_few(fewest, 4)}): stress and stiffness are given up to {low:.3f}, and "
            "above it the band of a new specimen does not rest on all specimens"
        )
    return out
