"""Fixing kappa over its range and refitting the other four: the paper's own demonstration."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from biaxbayes.fitting.fit import fit
from biaxbayes.laws.published import MATERIALS
from biaxbayes.specimens.specimen import Specimen
from studies.figure import figure
from studies.page import image, table, write_table
from studies.paper.experiments import noisy, table6_specimen, theta, virtual_specimen
from studies.paper.printed import TABLE6, VIRTUAL

__all__ = ["KAPPAS", "Sweep", "section", "sweep"]

KAPPAS = np.linspace(0.0, 1.0 / 3.0, 35)
MISFIT = 0.02
COLOURS = ("#000000", "#E69F00", "#56B4E9", "#009E73", "#0072B2", "#D55E00", "#CC79A7")
STYLES = ("-", "--", "-.", ":", "-", "--", "-.")


@dataclass(frozen=True)
class Sweep:
    """Refits at fixed kappa.

    Attributes
    ----------
    parameters : ndarray, shape (n, 5)
    mounting : ndarray, shape (n, 2)
    misfit : ndarray, shape (n,)
        Root-mean-square force residual over the root-mean-square force.
    r2 : ndarray, shape (n,)
    """

    parameters: np.ndarray
    mounting: np.ndarray
    misfit: np.ndarray
    r2: np.ndarray


def sweep(specimen: Specimen) -> Sweep:
    """Refit with ``constrained`` at every fixed kappa, each from several starts."""
    fits = [fit(specimen, fixed={"kappa": float(kappa)}) for kappa in KAPPAS]
    load = specimen.load(specimen.protocols[0])
    size = np.sqrt((load**2).mean())
    return Sweep(
        np.array([theta(f.material) for f in fits]),
        np.array([f.mounting_stretch[0] for f in fits]),
        np.array([np.sqrt((f.residuals[0] ** 2).mean()) / size for f in fits]),
        np.array([f.r2 for f in fits]),
    )


@cache
def _sweeps(with_noise: bool) -> dict[str, Sweep]:
    rng = np.random.default_rng(8)
    specimens = {
        name: virtual_specimen(MATERIALS[name].material, (1.01, 1.01), total=1.2)
        for name in VIRTUAL
    }
    specimens |= {name: table6_specimen(name) for name in TABLE6}
    if with_noise:
        specimens = {name: noisy(s, rng, misfit=MISFIT) for name, s in specimens.items()}
    return {name: sweep(s) for name, s in specimens.items()}


def _ends(values: np.ndarray, keep: np.ndarray, digits: int) -> list[str]:
    chosen = values[keep]
    return [f"{chosen.min():.{digits}f}", f"{chosen.max():.{digits}f}"]


def section(folder: Path) -> tuple[str, list[str]]:
    """Markdown with the figure drawn, and the disagreements for the summary."""
    rows, short = [], []
    for name, found in _sweeps(False).items():
        good = found.r2 > 0.99
        close = found.misfit < MISFIT
        noise = _sweeps(True)[name]
        level = noise.misfit.min()
        kappas = [_ends(KAPPAS, kept, 2) for kept in (good, close, noise.misfit < 1.05 * level)]
        others = [
            _ends(found.parameters[:, index], close, digits)
            for index, digits in ((0, 2), (2, 1), (3, 0))
        ]
        rows.append([name, *(end for ends in (*kappas, *others) for end in ends)])
        truth = f"{MATERIALS[name].material.kappa:g}"
        short.append([name, truth, *(" to ".join(kappas[k]) for k in (0, 2))])
    quantities = ["kappa_R2_above_0.99", f"kappa_misfit_below_{100 * MISFIT:.0f}_percent"]
    quantities += ["kappa_noisy_within_5_percent_of_least", "C1_kPa", "k2", "alpha_deg"]
    columns = [f"{quantity}_{end}" for quantity in quantities for end in ("low", "high")]
    link = write_table(folder, "paper-kappa", ["specimen", *columns], rows)
    header = ["specimen", "true kappa", "R2 > 0.99", "noisy: misfit within 5 % of its least"]
    least = min(KAPPAS[found.r2 > 0.99].max() for found in _sweeps(False).values())
    missed = sum(not _covers(name) for name in _sweeps(True))
    conclusion = CONCLUSION.format(least=np.floor(100 * least) / 100, missed=missed)
    introduced = INTRODUCTION.format(link=link)
    return "\n".join([introduced, _figure(folder), table(header, short), conclusion]), []


def _covers(name: str) -> bool:
    """Whether the kappas within 5 % of the least misfit of the noisy record hold the true one."""
    found = _sweeps(True)[name]
    kept = KAPPAS[found.misfit < 1.05 * found.misfit.min()]
    step = KAPPAS[1] - KAPPAS[0]
    return bool(kept.min() - step < MATERIALS[name].material.kappa < kept.max() + step)


def _figure(folder: Path) -> str:
    with figure(folder / "figures" / "paper-kappa.png", 2, 2, height=4.4, sharex=True) as (
        drawing,
        axes,
    ):
        for number, (name, found) in enumerate(_sweeps(False).items()):
            look = {"color": COLOURS[number], "ls": STYLES[number], "label": name}
            axes[0, 0].semilogy(KAPPAS, np.maximum(100 * found.misfit, 1e-4), **look)
            axes[0, 1].semilogy(KAPPAS, 100 * _sweeps(True)[name].misfit, **look)
            # Where nothing fits any more, or near isotropy, alpha and k2 mean nothing
            fitting = (found.misfit < 0.05) & (KAPPAS < 1.0 / 3.0)
            axes[1, 0].plot(KAPPAS[fitting], found.parameters[fitting, 3], **look)
            axes[1, 1].semilogy(KAPPAS[fitting], found.parameters[fitting, 2], **look)
        axes[0, 0].axhline(100 * MISFIT, color="0.6", lw=0.8)
        axes[0, 0].text(0.002, 100 * MISFIT * 1.15, "2 % of the force", color="0.4", fontsize=7)
        axes[0, 0].set(ylabel="rms misfit, % of force", ylim=(1e-4, 30), title="noise-free")
        axes[0, 1].set(ylabel="rms misfit, % of force", ylim=(1e-1, 30), title="with noise")
        axes[1, 0].set(ylabel="refitted alpha, degrees", xlabel="fixed kappa", ylim=(-3, 93))
        axes[1, 1].set(ylabel="refitted k2", xlabel="fixed kappa")
        handles, labels = axes[0, 0].get_legend_handles_labels()
        drawing.legend(handles, labels, loc="outside upper center", ncols=4)
    return image(
        "paper-kappa.png",
        "Fits with kappa held. Above: misfit of the force, noise-free and with 0.6 mN and a "
        "smooth 2 %. Below: what alpha and k2 become on the noise-free records, "
        "where the misfit stays below 5 %.",
        "Fits with kappa held",
    )


INTRODUCTION = """### Fixing kappa and refitting the other four

The paper suggests this as a demonstration that parameter sets are not unique, and does not show
it. `constrained`, 35 values of kappa from 0 to 1/3, on two virtual experiments (1 % prestretch) and
the five of Table 6. Misfit is the rms force residual over the rms force; the table has ranges of
kappa ([those with a misfit below 2 %, and C1, k2 and alpha over them]({link})).
"""
CONCLUSION = """
The paper is right, and more so than it says. An R2 above 0.99, its criterion of a high-quality
fit, admits every kappa from 0 to {least:.2f} or more on all seven records, a misfit of 2 % nearly
as much. A noise-free record determines kappa: the misfit falls to zero at the truth. A noisy one
need not: the last column is about a 90 % interval for a record worth 30 independent readings, and
{missed} of 7 miss the truth on this draw of the misfit, which such an interval leaves out.
"""
