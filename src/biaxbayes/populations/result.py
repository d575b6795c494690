"""What a population found, as plain tables: groups, specimens and contrasts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.forward import ForwardModel
from biaxbayes.laws.law import Law
from biaxbayes.parameters import MATERIAL, STRETCH
from biaxbayes.populations.ensemble import Design
from biaxbayes.populations.model import LINEAR, LOG, Grouping, PooledValue
from biaxbayes.populations.predictive import Hyper
from biaxbayes.populations.sampler import History, Sampled
from biaxbayes.populations.specimens import Source
from biaxbayes.populations.verdicts import (
    CURVE_DRAWS,
    derived,
    following,
    mean_verdicts,
    specimen_verdicts,
    spread_verdicts,
)
from biaxbayes.prediction.draws import protocol_mounting

QUANTILES = {"q05": 0.05, "q50": 0.5, "q95": 0.95}
SDS = ("sd_donors", "sd_specimens")
PARTS = ("mean", *SDS, "new_specimen", "new_donor")
POPULATION_COLUMNS = (
    "group",
    "quantity",
    "unit",
    *(f"{part}_{q}" for part in PARTS for q in QUANTILES),
    "scale",
    "specimens",
    "donors",
    "verdict",
    "contraction",
    "in_words",
    *(f"{side}_{what}" for side in SDS for what in ("verdict", "contraction")),
)
SPECIMEN_COLUMNS = (
    "specimen",
    "group",
    "donor",
    "quantity",
    "unit",
    *(f"single_{q}" for q in QUANTILES),
    *(f"pooled_{q}" for q in QUANTILES),
    "single_verdict",
    "pooled_verdict",
    "reported_low",
    "reported_high",
    "reported",
    "predictive_p",
    "specimen_predictive_p",
    "beta",
)
CONTRAST_COLUMNS = (
    "group_a",
    "group_b",
    "quantity",
    "unit",
    "scale",
    *(f"difference_{q}" for q in QUANTILES),
    "probability_positive",
)
NATURAL_DRAWS, PRIOR_DRAWS = 2000, 2**14
BAND_POINTS, EQUIBIAXIAL = 41, 0.1


def judged(
    grouping: Grouping, values: Sequence[PooledValue], history: History
) -> list[dict[str, np.ndarray]]:
    """What the draws are judged by: means, spreads and correlations; then every specimen's values.

    Arrays (ensembles, kept, chains) by name.
    """
    names = [v.name for v in values]
    found: dict[str, np.ndarray] = {}
    for g, group in enumerate(grouping.groups):
        for k, name in enumerate(names):
            found[f"mean {name}, {group}"] = history.mu[..., g, k]
    for k, name in enumerate(names):
        found[f"sd_donors {name}"] = history.sd_donors[..., k]
        for s in range(history.sd.shape[-2]):
            told = f"sd_specimens {name}"
            told += f", {grouping.groups[s]}" if history.sd.shape[-2] > 1 else ""
            found[told] = history.sd[..., s, k]
    for partial in history.partial:
        for side, what in enumerate(("donors", "specimens")):
            for k in range(partial.shape[-1]):
                found[f"correlation {k + 1} of {what}"] = partial[..., side, k]
    own = {
        f"{name} of {label}": history.theta[..., i, k]
        for i, label in enumerate(grouping.labels)
        for k, name in enumerate(names)
    }
    return [found, own]


def _quantiles(part: str, values: np.ndarray) -> dict[str, float]:
    found = np.quantile(values, list(QUANTILES.values()))
    return {f"{part}_{q}": float(v) for q, v in zip(QUANTILES, found, strict=True)}


@dataclass(frozen=True, eq=False)
class Population:
    """A sampled population.

    Attributes
    ----------
    name : str
    sources : tuple of Source
    grouping : Grouping
    values : tuple of PooledValue
    design : Design
    sampled : Sampled
    seed : int
    left_out : dict of str to str
        Reasons by specimen.
    notes : list of str
        What a reader of the numbers must know.
    """

    name: str
    sources: tuple[Source, ...]
    grouping: Grouping
    values: tuple[PooledValue, ...]
    design: Design = field(repr=False)
    sampled: Sampled = field(repr=False)
    seed: int
    left_out: dict[str, str]
    notes: list[str]

    @property
    def law(self) -> Law:
        """The material law."""
        return self.sources[0].posterior.law

    @property
    def state(self) -> str:
        """``converged``, ``tentative`` or ``unusable``."""
        return self.sampled.convergence.state

    @property
    def reason(self) -> str:
        """Why it has not converged."""
        return self.sampled.convergence.reason

    def rng(self, what: int) -> np.random.Generator:
        """Random numbers of one table, whichever else were made."""
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(1000 + what,)))

    def hyper(self, most: int | None = None, *, with_specimens: bool = False) -> Hyper:
        """Draws of means and spreads; those that carry the specimens' values where asked."""
        history = self.sampled.history
        blocks = [columns for columns, _ in self.design.blocks]
        every = history.every if with_specimens else 1
        return Hyper.of(
            history, self.values, self.design.layout.set_of, blocks, every=every, most=most
        )

    def specimen_values(self, most: int) -> tuple[np.ndarray, np.ndarray]:
        """Values (M, n, p) on the scale and coordinates (M, n, dmax), thinned evenly."""
        history = self.sampled.history
        theta = history.theta.reshape(-1, *history.theta.shape[3:])
        u = history.u.reshape(-1, *history.u.shape[3:])
        at = Hyper.rows(len(theta), most)
        return theta[at] + self.design.centre, u[at]

    def natural(self, i: int, most: int = NATURAL_DRAWS) -> dict[str, np.ndarray]:
        """Natural quantities of a specimen after pooling, by the names of ``summary.csv``."""
        _, u = self.specimen_values(most)
        source = self.sources[i]
        own = np.ascontiguousarray(u[:, i, : source.posterior.dimension])
        return source.posterior.natural(own)

    def materials(self, theta: np.ndarray) -> pd.DataFrame:
        """Parameters of the law at values on the scale (M, p); fixed ones as in the runs."""
        columns = {}
        priors = self.sources[0].posterior.priors
        by_name = {v.name: v.from_scale(theta[:, k]) for k, v in enumerate(self.values)}
        for name in self.law.names:
            prior = priors[name]
            if name in by_name:
                columns[name] = by_name[name]
            elif isinstance(prior, int | float):
                columns[name] = np.full(len(theta), float(prior))
        for name in self.law.names:
            tie = priors[name]
            if name not in columns:
                columns[name] = tie.factor * columns[tie.other]  # type: ignore[union-attr]
        return pd.DataFrame(columns)[list(self.law.names)]

    @cached_property
    def prior(self) -> tuple[Hyper, np.ndarray]:
        """Draws of the prior, and locations of each group's specimens."""
        return Hyper.of_prior(self.values, self.design.layout, PRIOR_DRAWS, self.rng(600))

    # --- tables ---

    def groups_table(self) -> pd.DataFrame:
        """population.csv."""
        rows = []
        many, few = self.hyper(), self.hyper(NATURAL_DRAWS * 2)
        rng = self.rng(0)
        for g, group in enumerate(self.grouping.groups):
            head = {
                "group": group,
                "specimens": len(self.grouping.members(group)),
                "donors": self.grouping.donors_of(group),
            }
            typical = many.typical(g)
            location = few.donors(g, rng)
            donor, new = few.median(location, g), few.specimens(location, g, rng)
            verdicts = self._verdicts(many, g)
            for k, v in enumerate(self.values):
                parts = {
                    "mean": v.from_scale(typical[:, k]),
                    "sd_donors": many.sd_donors[:, k],
                    "sd_specimens": many.spread(g)[:, k],
                    "new_specimen": v.from_scale(new[:, k]),
                    "new_donor": v.from_scale(donor[:, k]),
                }
                rows.append(
                    head
                    | {"quantity": v.name, "unit": v.parameter.unit, "scale": v.scale}
                    | self._numbers(parts)
                    | verdicts[v.name]
                )
            for key, unit, scale, parts, told in following(self, g):
                rows.append(
                    head
                    | {"quantity": key, "unit": unit, "scale": scale}
                    | self._numbers(parts)
                    | told
                )
        return pd.DataFrame(rows, columns=list(POPULATION_COLUMNS))

    def _verdicts(self, hyper: Hyper, g: int) -> dict[str, dict[str, Any]]:
        """Verdicts on a group's means and spreads, as columns, by pooled value."""
        means = mean_verdicts(
            hyper,
            self.prior[0],
            g,
            self.law,
            self.materials(hyper.typical(g)),
            self.largest_stretch,
            self.state,
        )
        spreads = spread_verdicts(hyper, g, self.law, self.state)
        out: dict[str, dict[str, Any]] = {}
        for name, mean in means.items():
            row: dict[str, Any] = {"verdict": mean.verdict, "in_words": mean.words}
            for stem, found in {"": mean, **{f"{k}_": v for k, v in spreads[name].items()}}.items():
                row[f"{stem}verdict"] = found.verdict
                if found.evidence is not None:
                    row[f"{stem}contraction"] = found.evidence.contraction
            out[name] = row
        return out

    def _numbers(self, parts: dict[str, np.ndarray]) -> dict[str, float]:
        if self.state == "unusable":
            return {}
        return {k: x for part, values in parts.items() for k, x in _quantiles(part, values).items()}

    def specimens_table(self) -> pd.DataFrame:
        """specimens.csv."""
        rows = []
        theta, _ = self.specimen_values(NATURAL_DRAWS)
        hyper = self.hyper(NATURAL_DRAWS, with_specimens=True)
        names = [v.name for v in self.values]
        prior, locations = self.prior
        rng = self.rng(800)
        of_prior = [
            prior.specimens(locations[:, g], g, rng) for g in range(len(self.grouping.groups))
        ]
        for i, source in enumerate(self.sources):
            g = self.grouping.groups.index(self.grouping.group[i])
            joint, each = hyper.conflict(theta[:, i], g, self.rng(100 + i))
            pooled = self.natural(i)
            verdicts = specimen_verdicts(
                source, pd.DataFrame(pooled), self.values, of_prior[g], self.state
            )
            single = {
                row["parameter"]: row for row in source.run.result.to_frame().to_dict("records")
            }
            kinds = source.posterior.quantities.of_kind(MATERIAL, STRETCH)
            for q in (q for q in kinds if q.name in pooled and q.name in source.run.draws):
                own = single.get(q.name, {})
                numbers = (
                    _quantiles("single", source.run.draws[q.name].to_numpy())
                    | _quantiles("pooled", pooled[q.name])
                    | {"specimen_predictive_p": joint}
                )
                if q.name in names:
                    numbers["predictive_p"] = float(each[names.index(q.name)])
                rows.append(
                    {
                        "specimen": source.label,
                        "group": self.grouping.group[i],
                        "donor": self.grouping.donor[i],
                        "quantity": q.name,
                        "unit": q.unit,
                        "beta": source.run.beta,
                        "single_verdict": own.get("verdict", ""),
                        "pooled_verdict": verdicts.get(q.name, ""),
                        "reported_low": own.get("low", np.nan),
                        "reported_high": own.get("high", np.nan),
                        "reported": own.get("interval", ""),
                    }
                    | (numbers if self.state != "unusable" else {})
                )
        return pd.DataFrame(rows, columns=list(SPECIMEN_COLUMNS))

    def contrasts_table(self) -> pd.DataFrame:
        """contrasts.csv: group b less group a, of the typical donors' medians, on the scale."""
        rows = []
        many, few = self.hyper(), self.hyper(CURVE_DRAWS)
        groups = self.grouping.groups
        for a, b in combinations(range(len(groups)), 2):
            head = {"group_a": groups[a], "group_b": groups[b]}
            first, second = many.typical(a), many.typical(b)
            for k, v in enumerate(self.values):
                rows.append(
                    head
                    | {"quantity": v.name, "unit": v.parameter.unit, "scale": v.scale}
                    | self._difference(second[:, k] - first[:, k])
                )
            pair = (derived(self, few.typical(g)) for g in (a, b))
            for q, other in zip(*pair, strict=True):
                key, unit, x, y = q.key, q.unit or "1", q.values, other.values
                log = unit != "1" and min(x.min(), y.min()) > 0.0
                with np.errstate(invalid="ignore", over="ignore"):
                    difference = np.log(y) - np.log(x) if log else y - x
                rows.append(
                    head
                    | {"quantity": key, "unit": unit, "scale": LOG if log else LINEAR}
                    | self._difference(difference)
                )
        return pd.DataFrame(rows, columns=list(CONTRAST_COLUMNS))

    def _difference(self, values: np.ndarray) -> dict[str, float]:
        if self.state == "unusable":
            return {}
        share = float((values > 0.0).mean() + 0.5 * (values == 0.0).mean())
        return _quantiles("difference", values) | {"probability_positive": share}

    def new_specimens(self, most: int = NATURAL_DRAWS) -> dict[str, pd.DataFrame]:
        """Materials of new specimens of new donors, by group; one a draw."""
        hyper, rng = self.hyper(most), self.rng(500)
        return {
            group: self.materials(hyper.new_specimens(g, rng))
            for g, group in enumerate(self.grouping.groups)
        }

    @property
    def largest_stretch(self) -> float:
        """Largest equibiaxial total stretch that any specimen reached."""
        return max(s.largest_stretch for s in self.sources)

    def bands_table(self) -> pd.DataFrame:
        """Equibiaxial Cauchy stress of new specimens, by group and total stretch."""
        stretches = np.linspace(1.0, self.largest_stretch, BAND_POINTS)
        parts = []
        for group, table in self.new_specimens().items():
            with np.errstate(over="ignore", invalid="ignore"):
                stress = self.law.material(table).cauchy(stretches[None], stretches[None])
            part = pd.DataFrame({"group": group, "total_stretch": stretches})
            for axis, values in zip("xy", stress, strict=True):
                known = np.nan_to_num(values, nan=np.inf)
                for q, level in QUANTILES.items():
                    part[f"cauchy_{axis}_{q}"] = np.quantile(known, level, axis=0)
            parts.append(part)
        return pd.concat(parts, ignore_index=True)

    def records(self) -> list[tuple[str, np.ndarray, np.ndarray]]:
        """Equibiaxial records: group, total stretches and Cauchy stresses, (rows, 2) each.

        At the median mounting stretch of the pooled draws.
        """
        out = []
        for i, source in enumerate(self.sources):
            specimen = source.run.specimen
            draws = pd.DataFrame(self.natural(i, 500))
            for p in specimen.protocols:
                stretch = np.column_stack([p.stretch_x, p.stretch_y])
                lm = np.median(protocol_mounting(draws, p), axis=0)
                off = (stretch * lm)[-1] - 1.0
                if abs(off[0] - off[1]) > EQUIBIAXIAL * np.abs(off).max():
                    continue
                forward = ForwardModel.from_specimen(specimen, source.run.law)
                per_stress = forward.per_stress(stretch.T, lm[:, None]).T
                stress = specimen.load(p) / per_stress
                out.append((self.grouping.group[i], stretch * lm, stress))
        return out

    def contradictions(self, table: pd.DataFrame) -> list[str]:
        """Specimens that contradict their group, in words."""
        out = []
        for label, part in table.groupby("specimen", sort=False):
            joint = float(part["specimen_predictive_p"].iloc[0])
            each = part.dropna(subset=["predictive_p"])
            if not np.isfinite(joint) or each.empty:
                continue
            worst = each.sort_values("predictive_p").to_dict("records")[0]
            alone = float(worst["predictive_p"])
            if joint < JOINT_P or alone < SINGLE_P:
                out.append(
                    f"{label} contradicts its group {part['group'].iloc[0]} (posterior predictive "
                    f"p {joint:.3f}, most by {worst['quantity']}, p {alone:.3f})"
                )
        return out


JOINT_P, SINGLE_P = 0.05, 0.01
