"""Tables of a population: groups, specimens, contrasts, and stress of new specimens."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain, combinations
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.comparison.distance import contractions
from biaxbayes.derived.determined import Derived, derived_quantities
from biaxbayes.evenly import evenly_chosen
from biaxbayes.identifiability.verdict import NO_VERDICT
from biaxbayes.mechanics.mounting import mounted_section
from biaxbayes.parameters import MATERIAL, STRETCH, Parameter
from biaxbayes.populations.population_result import NATURAL_DRAWS, PRIOR_DRAWS, Hyper, Population
from biaxbayes.populations.verdicts import (
    derived_verdict,
    in_words,
    mean_verdicts,
    reported_text,
    specimen_verdicts,
    spread_verdicts,
)
from biaxbayes.prediction.draws import protocol_mounting
from biaxbayes.prediction.percentiles import QUANTILES, quantile_columns
from biaxbayes.studies.groups import LARGER, LINEAR, LOG, OPEN, SMALLER, group_contrasts
from biaxbayes.studies.study_result import rows_of_run

SDS = ("sd_donors", "sd_specimens", "sd_total")
PARTS = ("mean", *SDS, "new_specimen", "new_donor")
NEEDS_SEVERAL_PER_DONOR = ("sd_donors", "sd_specimens", "new_donor")
"""Left empty with one specimen per donor, where the prior alone would decide them."""
POPULATION_COLUMNS = (
    *("group", "quantity", "unit"),
    *(f"{part}_{q}" for part in PARTS for q in QUANTILES),
    *("scale", "specimens", "donors", "reported", "verdict", "contraction", "in_words"),
    *(f"{side}_{what}" for side in SDS for what in ("verdict", "contraction")),
)
SPECIMEN_COLUMNS = (
    *("specimen", "group", "donor", "quantity", "unit"),
    *(f"single_{q}" for q in QUANTILES),
    *(f"pooled_{q}" for q in QUANTILES),
    *("single_verdict", "pooled_verdict", "reported"),
    *("predictive_p", "specimen_predictive_p"),
)
CONTRAST_COLUMNS = (
    *("group_a", "group_b", "quantity", "unit", "scale"),
    *(f"difference_{q}" for q in QUANTILES),
    *("probability_positive", "direction"),
)
BAND_POINTS = 41
EQUIBIAXIAL_TOLERANCE = 0.1
"""A record is equibiaxial where its strains differ by less than this share of the larger."""
JOINT_P, SINGLE_P = 0.05, 0.01
"""Posterior predictive p of a specimen, and of one value, below which it contradicts its group."""
DERIVED_DRAWS = 400
SPECIMENS_PER_DRAW, DONORS_PER_DRAW = 60, 30
"""Specimens of the typical donor, and donors, made for each draw of a derived quantity."""


def groups_table(population: Population) -> pd.DataFrame:
    """Table of population.csv."""
    rows: list[dict[str, Any]] = []
    grouping, rng = population.grouping, population.rng(0)
    for g, group in enumerate(grouping.groups):
        counts = grouping.group.count(group), len(grouping.donors_of(group))
        head = {"group": group, "specimens": counts[0], "donors": counts[1]}
        own = chain(_pooled_rows(population, g, rng), _derived_rows(population, g))
        rows += [head | row for row in own]
    return pd.DataFrame(rows, columns=list(POPULATION_COLUMNS))


def _pooled_rows(
    population: Population, g: int, rng: np.random.Generator
) -> Iterator[dict[str, Any]]:
    """Means and spreads of the pooled values of a group, with verdicts."""
    hyper, thinned = population.hyper(), population.hyper(NATURAL_DRAWS * 2)
    typical, location = hyper.typical_median(g), thinned.donors(g, rng)
    donor, new = thinned.median(location, g), thinned.specimens(location, g, rng)
    law, state, top = population.law, population.state, population.largest_stretch
    materials = population.materials(typical)
    means = mean_verdicts(hyper, population.prior[0], g, law, materials, top, state)
    spreads = spread_verdicts(hyper, g, law, state)
    for k, v in enumerate(population.values):
        of_mean = means[v.name]
        verdicts: dict[str, Any] = {"in_words": in_words(of_mean)}
        verdicts["reported"] = reported_text(of_mean)
        for stem, p in {"": of_mean, **{f"{k}_": p for k, p in spreads[v.name].items()}}.items():
            verdicts[f"{stem}verdict"] = p.verdict
            if p.diagnostics is not None:
                verdicts[f"{stem}contraction"] = p.diagnostics.contraction
        sds = (s[:, k] for s in (hyper.sd_donors, hyper.specimen_sd(g), hyper.total_sd(g)))
        mean, *further = (v.from_scale(values[:, k]) for values in (typical, new, donor))
        head = {"quantity": v.name, "unit": v.parameter.unit, "scale": v.scale}
        yield head | _numbers(population, mean, *sds, *further) | verdicts


def _derived_rows(population: Population, g: int) -> Iterator[dict[str, Any]]:
    """Structure tensor, stiffness and stress of a group, draw by draw."""
    hyper, rng = population.hyper(DERIVED_DRAWS), population.rng(1, g)
    typical, medians = _typical(population, hyper, g, rng)
    between, wide = hyper.repeat(DONORS_PER_DRAW), hyper.repeat(4)
    donors = derived_from_values(population, between.median(between.donors(g, rng), g))
    location = wide.donors(g, rng)
    new_specimens = derived_from_values(population, wide.specimens(location, g, rng))
    new_donors = derived_from_values(population, wide.median(location, g))
    prior = population.prior[0].at(evenly_chosen(PRIOR_DRAWS, DERIVED_DRAWS))
    _, before = _typical(population, prior, g, population.rng(700, g))
    shrunk = contractions(before, medians)
    for q, median, contraction, donor, new_specimen, new_donor in zip(
        typical, medians, shrunk, donors, new_specimens, new_donors, strict=True
    ):
        log = bool(q.unit) and min(q.values.min(), donor.values.min()) > 0.0
        verdict: dict[str, Any] = {"verdict": NO_VERDICT}
        if population.state == "converged":
            parameter = Parameter(q.key, unit=q.unit or "1", logarithmic=log)
            verdict = derived_verdict(median.values, contraction, parameter)
        with np.errstate(over="ignore", invalid="ignore"):
            sds = [
                (np.log(v) if log else v).reshape(len(hyper.mu), -1).std(axis=1, ddof=1)
                for v in (donor.values, q.values)
            ]
        parts = (median.values, *sds, np.hypot(*sds), new_specimen.values, new_donor.values)
        head = {"quantity": q.key, "unit": q.unit or "1", "scale": LOG if log else LINEAR}
        yield head | _numbers(population, *parts) | verdict


def derived_from_values(population: Population, theta: np.ndarray) -> list[Derived]:
    """Structure tensor, stiffness and stress of materials; infinite where not computable."""
    # equibiaxial total stretches that every specimen reached: half-way and the largest
    top = min(s.largest_stretch for s in population.sources)
    stretches = [round(1.0 + share * (top - 1.0), 3) for share in (0.5, 1.0)]
    materials = population.materials(theta)
    quantities = derived_quantities(materials, population.law, stretches, [1.0, stretches[-1]])
    return [replace(q, values=np.nan_to_num(q.values, nan=np.inf)) for q in quantities]


def _typical(
    population: Population, hyper: Hyper, g: int, rng: np.random.Generator
) -> tuple[list[Derived], list[Derived]]:
    """Quantities of the typical donor's specimens, and their median draw by draw."""
    within = hyper.repeat(SPECIMENS_PER_DRAW)
    single = derived_from_values(population, within.specimens(within.mu[:, g], g, rng))
    shape = (len(hyper.mu), SPECIMENS_PER_DRAW)
    return single, [replace(q, values=np.median(q.values.reshape(shape), axis=1)) for q in single]


def _numbers(population: Population, *parts: np.ndarray) -> dict[str, float]:
    """Quantiles of the parts, in the order of PARTS, that the specimens can show."""
    out: dict[str, float] = {}
    empty = NEEDS_SEVERAL_PER_DONOR if population.grouping.one_specimen_per_donor else ()
    for part, values in zip(PARTS, parts, strict=True):
        if population.state != "unusable" and part not in empty:
            out |= quantile_columns(part, values)
    return out


def specimens_table(population: Population) -> pd.DataFrame:
    """Table of specimens.csv."""
    rows = []
    theta, hyper = population.specimen_values(NATURAL_DRAWS), population.hyper(NATURAL_DRAWS)
    prior, locations = population.prior
    rng = population.rng(800)
    prior_specimens = [prior.specimens(locations[:, g], g, rng) for g in range(locations.shape[1])]
    grouping = population.grouping
    for i, source in enumerate(population.sources):
        g = grouping.groups.index(grouping.group[i])
        joint, each = hyper.predictive_p(theta[:, i], g, population.rng(100, i))
        single_p = dict(zip([v.name for v in population.values], each.tolist(), strict=True))
        pooled = population.natural(i)
        verdicts = specimen_verdicts(
            source, pd.DataFrame(pooled), population.values, prior_specimens[g], population.state
        )
        single = {row["parameter"]: row for row in source.run.result.to_frame().to_dict("records")}
        kinds = source.posterior.quantities.of_kind(MATERIAL, STRETCH)
        for q in (q for q in kinds if q.name in pooled and q.name in source.run.draws):
            own = single.get(q.name, {})
            row = {
                "specimen": source.label,
                "group": grouping.group[i],
                "donor": grouping.donor[i],
                "quantity": q.name,
                "unit": q.unit,
                "single_verdict": own.get("verdict", ""),
                "pooled_verdict": verdicts.get(q.name, ""),
                "reported": own.get("interval", ""),
            }
            if population.state != "unusable":
                row |= quantile_columns("single", source.run.draws[q.name].to_numpy())
                row |= quantile_columns("pooled", pooled[q.name])
                row |= {"specimen_predictive_p": joint, "predictive_p": single_p.get(q.name)}
            rows.append(row)
    return pd.DataFrame(rows, columns=list(SPECIMEN_COLUMNS))


def contrasts_table(population: Population) -> pd.DataFrame:
    """Table of contrasts.csv: medians of typical donors of group b minus those of group a."""
    rows = []
    hyper, thinned = population.hyper(), population.hyper(DERIVED_DRAWS)
    groups = population.grouping.groups
    for a, b in combinations(range(len(groups)), 2):
        head = {"group_a": groups[a], "group_b": groups[b]}
        apart = hyper.typical_median(b) - hyper.typical_median(a)
        found = [
            (v.name, v.parameter.unit, v.scale, apart[:, k])
            for k, v in enumerate(population.values)
        ]
        pair = (derived_from_values(population, thinned.typical_median(g)) for g in (a, b))
        for q, other in zip(*pair, strict=True):
            x, y = q.values, other.values
            log = bool(q.unit) and min(x.min(), y.min()) > 0.0
            with np.errstate(invalid="ignore", over="ignore"):
                difference = np.log(y) - np.log(x) if log else y - x
            found.append((q.key, q.unit or "1", LOG if log else LINEAR, difference))
        for name, unit, scale, difference in found:
            row: dict[str, Any] = head | {"quantity": name, "unit": unit, "scale": scale}
            if population.state != "unusable":
                values = difference[~np.isnan(difference)]  # stresses beyond all numbers in both
                larger = float((values > 0.0).mean() + 0.5 * (values == 0.0).mean())
                row |= quantile_columns("difference", values) | {"probability_positive": larger}
            if population.state == "converged":
                low, high = row["difference_q05"], row["difference_q95"]
                row["direction"] = LARGER if low > 0.0 else SMALLER if high < 0.0 else OPEN
            rows.append(row)
    return pd.DataFrame(rows, columns=list(CONTRAST_COLUMNS))


def bands_table(population: Population) -> pd.DataFrame:
    """Equibiaxial Cauchy stress of new specimens, by group and total stretch."""
    stretches = np.linspace(1.0, population.largest_stretch, BAND_POINTS)
    parts = []
    for group, table in population.new_specimens().items():
        with np.errstate(over="ignore", invalid="ignore"):
            stress = population.law.material(table).cauchy(stretches[None], stretches[None])
        part = pd.DataFrame({"group": group, "total_stretch": stretches})
        for axis, values in zip("xy", stress, strict=True):
            known = np.nan_to_num(values, nan=np.inf)
            for q, level in QUANTILES.items():
                part[f"cauchy_{axis}_{q}"] = np.quantile(known, level, axis=0)
        parts.append(part)
    return pd.concat(parts, ignore_index=True)


def equibiaxial_records(population: Population) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Equibiaxial records at the median mounting stretch: group, stretches, stresses (rows, 2)."""
    out = []
    for i, source in enumerate(population.sources):
        specimen = source.run.specimen
        draws = pd.DataFrame(population.natural(i, 500))
        for p in specimen.protocols:
            stretch = p.stretch
            lm = np.median(protocol_mounting(draws, p), axis=0)
            off = (stretch * lm)[-1] - 1.0
            if abs(off[0] - off[1]) > EQUIBIAXIAL_TOLERANCE * np.abs(off).max():
                continue
            section = mounted_section(specimen.area, lm, specimen.geometry == "mounted")
            stress = specimen.load(p) * stretch / section
            out.append((population.grouping.group[i], stretch * lm, stress))
    return out


def contradictions(table: pd.DataFrame) -> list[str]:
    """Messages on specimens that contradict their group, from specimens.csv."""
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


def differences_from_study(population: Population, contrasts: pd.DataFrame) -> list[str]:
    """Notes on contrasts that `batch`, specimen by specimen, answers otherwise."""
    if population.state != "converged":
        return []
    names = [v.name for v in population.values]
    rows = [
        {"specimen": source.label, "donor": donor, "layer": group, **row}
        for source, group, donor in zip(
            population.sources, population.grouping.group, population.grouping.donor, strict=True
        )
        for row in rows_of_run(source.run)
        if row["quantity"] in names
    ]
    pooled: dict[tuple[str, str, str], str] = {}
    swapped = {LARGER: SMALLER, SMALLER: LARGER, OPEN: OPEN}
    for r in contrasts.to_dict("records"):
        a, b, name, said = (r[key] for key in ("group_a", "group_b", "quantity", "direction"))
        pooled |= {(a, b, name): said, (b, a, name): swapped[said]}
    notes, words = [], {OPEN: "no difference"}
    for r in group_contrasts(pd.DataFrame(rows)).to_dict("records"):
        a, b, name, own = (r[key] for key in ("group_a", "group_b", "quantity", "direction"))
        said = pooled[a, b, name]
        if isinstance(own, str) and said != own:
            notes.append(
                f"{name}, {b} compared with {a}: batch, parameter by parameter from each "
                f"specimen's own draws, says {words.get(own, own)}; the population, of all "
                f"parameters together with priors of their spread, says {words.get(said, said)}"
            )
    return notes
