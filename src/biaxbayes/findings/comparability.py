"""Whether runs can be compared at all: what else than the tissue differs between them."""

from __future__ import annotations

from collections.abc import Sequence

from biaxbayes.inference.posterior import Posterior
from biaxbayes.inference.priors import Prior, Tie
from biaxbayes.mechanics.goh import PARAMETERS

__all__ = ["differing_settings"]

OPTIONS = {
    "mounting": "the mounting force enters as",
    "noise": "the errors are",
    "mounting_stretch": "the mounted state is",
    "noise_growth": "the noise grows with the load:",
    "fibre_switch": "fibres drop out in compression:",
}


def differing_settings(runs: Sequence[tuple[str, Posterior]]) -> list[str]:
    """One sentence for each difference between runs that is not one of tissue.

    Parameters
    ----------
    runs : sequence of (str, Posterior)
        Labels and posteriors.
    """
    notes = []
    for option, words in OPTIONS.items():
        found = {label: getattr(p.settings, option) for label, p in runs}
        if len(set(found.values())) > 1:
            notes.append(f"different options: {words} {_each(found)}")
    for name in (*PARAMETERS, "mounting_stretch_x", "mounting_stretch_y"):
        stated = {label: _in_words(p, name) for label, p in runs}
        if len({text for text in stated.values() if text}) > 1:
            notes.append(f"different priors of {name}: {_each(stated)}")
    for axis in "xy":
        axes = {label: getattr(p.specimen, f"axis_{axis}") for label, p in runs}
        if len(set(axes.values())) > 1:
            notes.append(f"axis {axis} is not the same direction: {_each(axes)}")
    geometry = {label: p.specimen.geometry for label, p in runs}
    if len(set(geometry.values())) > 1:
        notes.append(f"dimensions and stresses refer to different states: {_each(geometry)}")
    return notes + _same_specimens(runs)


def _each(values: dict) -> str:
    return ", ".join(f"{'not stated' if v is None else v} ({k})" for k, v in values.items())


def _in_words(posterior: Posterior, name: str) -> str:
    """A prior as text; empty where the run has no such unknown."""
    prior = posterior.priors.get(name)
    if prior is None:
        prior = posterior.priors.get(next((k for k in posterior.priors if k.startswith(name)), ""))
    if isinstance(prior, Prior):
        table = prior.as_table()
        family = str(table.pop("distribution"))
        return " ".join([family, *(f"{k} {v:.4g}" for k, v in table.items())])
    if isinstance(prior, Tie):
        return f"tied to {prior.other}"
    return "" if prior is None else f"fixed at {prior:g}"


def _same_specimens(runs: Sequence[tuple[str, Posterior]]) -> list[str]:
    notes = []
    for i, (label, first) in enumerate(runs):
        for other, second in runs[i + 1 :]:
            if first.specimen.protocols == second.specimen.protocols:
                notes.append(
                    f"{label} and {other} are the same measurements: their differences are those "
                    "of the settings, and their draws are not independent evidence"
                )
    return notes
