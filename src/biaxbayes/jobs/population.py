"""A population in a folder: finished runs in, a hierarchical posterior over specimens out."""

from __future__ import annotations

import hashlib
import io
import json
import platform
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import biaxbayes
from biaxbayes.csv_tables import write_csv
from biaxbayes.errors import BiaxbayesError, InputError, Interrupted, RunError
from biaxbayes.jobs.opening import draw_figure
from biaxbayes.options import PopulationOptions
from biaxbayes.populations.ensemble import Tuning
from biaxbayes.populations.model import (
    Grouping,
    PooledValue,
    PopulationPriors,
    design_of,
    pooled_values,
)
from biaxbayes.populations.result import Population, judged
from biaxbayes.populations.sampler import History, Plan, State, draw
from biaxbayes.populations.specimens import Source, individual_of, pooled_names
from biaxbayes.runs import checkpoint
from biaxbayes.runs.folder import clear_leftovers
from biaxbayes.runs.lock import folder_lock
from biaxbayes.runs.provenance import settings_table, specimen_digest
from biaxbayes.runs.run import open_run
from biaxbayes.sampling.proposal import TransportedMixture
from biaxbayes.sampling.sampler import Progress
from biaxbayes.text_files import atomic_write_bytes, atomic_write_text

__all__ = [
    "RECORD",
    "Member",
    "PopulationFound",
    "PopulationJob",
    "members_of_study",
    "read_population",
]

RECORD = "population.json"
TABLES = {"groups": "population", "specimens": "specimens", "contrasts": "contrasts"}
BANDS = "new-specimen-bands"
FIGURES = ("population-forest", "population-pairs", BANDS)
LOW_WEIGHT = 0.5


# --- the specimens of a finished study -----------------------------------------------------------


@dataclass(frozen=True)
class Member:
    """A specimen of a finished study.

    Attributes
    ----------
    label, donor, group : str
    folder : Path
        Of its run.
    state, reason : str
        As the study has them.
    """

    label: str
    donor: str
    group: str
    folder: Path
    state: str
    reason: str = ""


def members_of_study(folder: Path) -> tuple[str, list[Member]]:
    """Name and specimens of a finished study.

    Raises
    ------
    InputError
        If the folder is no finished study's, or its groups are not stated.
    """
    try:
        record = json.loads((folder / "study.json").read_text(encoding="utf-8"))
        table = pd.read_csv(folder / "study.csv", dtype=str, keep_default_na=False)
        rows = table.drop_duplicates("specimen").to_dict("records")
        names = [str(r["specimen"]) for r in rows]
        columns = [str(c) for c in record.get("columns", [])]
        stated: dict[str, dict[str, str]] = record.get("stated", {})
    except (OSError, ValueError, KeyError, AttributeError, RecursionError):
        raise InputError(
            "is not the folder of a finished study",
            file=folder,
            remedy="run 'biaxbayes batch' first, or give the study file",
        ) from None
    out = []
    for label, row in zip(names, rows, strict=True):
        own = {"layer": str(row["layer"]), "donor": str(row["donor"])} | stated.get(label, {})
        asked = columns or ["layer"]
        if not columns and not any(str(r["layer"]) for r in rows):
            group = "all"
        else:
            for column in asked:
                if not own.get(column):
                    raise InputError(
                        f"{label} states no {column}, which makes its group",
                        file=folder,
                        remedy=f"state {column} in the study file, or name others in columns",
                    )
            group = ", ".join(own[column] for column in asked)
        out.append(
            Member(
                label,
                str(row["donor"]),
                group,
                folder / str(row["folder"]),
                str(row["state"]),
                str(row["reason"]),
            )
        )
    return str(record.get("name", folder.name)), out


# --- what came out -------------------------------------------------------------------------------


@dataclass(frozen=True)
class PopulationFound:
    """A finished population.

    Attributes
    ----------
    name : str
    folder : Path
        Holds ``population.csv``, ``specimens.csv``, ``contrasts.csv`` and ``population.nc``.
    state : str
        ``reliable``, ``tentative`` or ``unusable``; ``reason`` says why.
    reason : str
    groups, specimens, contrasts : DataFrame
        The tables.
    notes : list of str
    left_out : dict of str to str
        Reasons by specimen.
    """

    name: str
    folder: Path
    state: str
    reason: str
    groups: pd.DataFrame = field(repr=False)
    specimens: pd.DataFrame = field(repr=False)
    contrasts: pd.DataFrame = field(repr=False)
    notes: list[str] = field(repr=False)
    left_out: dict[str, str] = field(repr=False)

    def _repr_html_(self) -> str:
        """State and groups, for notebooks."""
        shown = self.groups[[c for c in self.groups if not str(c).startswith("new_")]]
        table = shown.to_html(index=False, float_format=lambda v: f"{v:.4g}", na_rep="–")
        return f"<p>{escape(self.name)}: {escape(self.state)}</p>{table}"


def read_population(folder: Path) -> PopulationFound:
    """A finished population, opened again.

    Raises
    ------
    RunError
        If the folder is none.
    """
    try:
        record = json.loads((folder / RECORD).read_text(encoding="utf-8"))
        tables = {k: pd.read_csv(folder / f"{stem}.csv") for k, stem in TABLES.items()}
        found = PopulationFound(
            name=str(record["name"]),
            folder=folder,
            state=str(record["convergence"]["state"]),
            reason=str(record["convergence"]["reason"]),
            notes=[str(n) for n in record["notes"]],
            left_out={str(k): str(v) for k, v in record["left_out"].items()},
            **tables,
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise RunError(
            f"{folder}: is not the folder of a finished population ({type(error).__name__})"
        ) from None
    return found


# --- the job -------------------------------------------------------------------------------------


@dataclass
class PopulationJob:
    """A population to sample, and the folder it is kept in.

    Attributes
    ----------
    name : str
    members : list of Member
    folder : Path
    options : PopulationOptions
    priors : PopulationPriors
    anyway : bool
        Take specimens that are tentative, too.
    """

    name: str
    members: list[Member]
    folder: Path
    options: PopulationOptions = field(default_factory=PopulationOptions)
    priors: PopulationPriors = field(default_factory=PopulationPriors)
    anyway: bool = False

    def execute(
        self,
        *,
        resume: bool = False,
        progress: Callable[[Progress], None] = lambda p: None,
        stop: Callable[[], int] = lambda: 0,
    ) -> PopulationFound:
        """Sample the population and write every file.

        Raises
        ------
        InputError
            If the specimens make no population.
        RunError
            If the folder is in use or holds something else.
        Interrupted
            If stopped; what was done is saved.
        """
        progress(Progress("reading runs"))
        sources, left_out = self._opened()
        grouping, notes = self._grouped(sources)
        names = pooled_names(sources)
        values = self.priors.applied(
            pooled_values(sources[0].posterior.law, names, mounting=self.options.pool_mounting)
        )
        self._make_folder()
        with folder_lock(self.folder):
            clear_leftovers(self.folder)
            plan = Plan(
                ess=self.options.ess,
                max_steps=self.options.max_steps,
                seed=self.options.seed,
                workers=self.options.threads,
            )
            identity = self._identity(sources, grouping, values, plan)
            state = self._resumed(identity, resume, progress)
            individuals = [individual_of(s, values, plan.ensembles) for s in sources]
            design = design_of(individuals, grouping, values, self.options, self.priors)
            sampled = draw(
                design,
                plan,
                lambda history: judged(grouping, values, history),
                state=state,
                on_block=lambda s: checkpoint.save(self.folder, s, identity, _pack),
                progress=progress,
                stop=stop,
            )
            if sampled.interrupted:
                raise self._interruption(stop())
            progress(Progress("writing"))
            population = Population(
                self.name,
                tuple(sources),
                grouping,
                tuple(values),
                design,
                sampled,
                self.options.seed,
                left_out,
                notes,
            )
            return _write(self.folder, population, identity)

    def _opened(self) -> tuple[list[Source], dict[str, str]]:
        """The runs that can be pooled, and why the others cannot."""
        usable = ("reliable", "tentative") if self.anyway else ("reliable",)
        sources, left_out = [], {}
        for member in self.members:
            if member.state not in usable:
                told = {"tentative": "tentative, not converged", "unusable": "did not converge"}
                reason = told.get(member.state, member.state)
                left_out[member.label] = f"{reason}: {member.reason}" if member.reason else reason
                continue
            try:
                run = open_run(member.folder)
                if run.state not in usable:
                    left_out[member.label] = f"its run is {run.state}"
                    continue
                sources.append(Source.of(member.label, run))
            except BiaxbayesError as error:
                left_out[member.label] = str(error)
        if len(sources) < 2:
            lost = "; ".join(f"{k}: {v}" for k, v in list(left_out.items())[:3])
            raise InputError(
                f"{len(sources)} of {len(self.members)} specimens can be pooled, and a population "
                f"needs two{f' ({lost})' if lost else ''}",
                remedy="sample longer with a larger max_steps, or add specimens",
            )
        return sources, left_out

    def _grouped(self, sources: list[Source]) -> tuple[Grouping, list[str]]:
        """Groups and donors, and what is to be said of them."""
        by_label = {m.label: m for m in self.members}
        kept = [by_label[s.label] for s in sources]
        donors = [m.donor or f"donor of {m.label}" for m in kept]
        grouping = Grouping(
            tuple(m.label for m in kept), tuple(m.group for m in kept), tuple(donors)
        )
        return grouping, _notes(kept, grouping, sources)

    def _make_folder(self) -> None:
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            names = {p.name for p in self.folder.iterdir() if not p.name.startswith(".")}
        except OSError as error:
            raise RunError(
                f"{self.folder}: cannot be used ({error.strerror}); choose another --out"
            ) from None
        if names and not names & {RECORD, checkpoint.NAME, checkpoint.PREVIOUS}:
            raise RunError(
                f"{self.folder}: is a folder that is not a population's; choose another --out"
            )

    def _identity(
        self, sources: list[Source], grouping: Grouping, values: list[PooledValue], plan: Plan
    ) -> dict[str, Any]:
        """What the draws depend on."""
        runs = {}
        for source, group, donor in zip(sources, grouping.group, grouping.donor, strict=True):
            settings = json.dumps(settings_table(source.posterior), sort_keys=True, default=str)
            record = source.run.provenance
            runs[source.label] = {
                "group": group,
                "donor": donor,
                "specimen": specimen_digest(source.run.specimen)[:16],
                "settings": hashlib.sha256(settings.encode()).hexdigest()[:16],
                "beta": source.run.beta,
                "draws": str(record.get("files", {}).get("posterior.nc", ""))[:16],
            }
        options = {k: v for k, v in asdict(self.options).items() if k != "workers"}
        return {
            "biaxbayes": biaxbayes.__version__,
            "options": options,
            "priors": {v.name: _stated(v) for v in values}
            | {"eta": [self.priors.eta_donors, self.priors.eta_specimens]},
            "sampler": {"ensembles": plan.ensembles, "chains": plan.chains},
            "runs": runs,
        }

    def _resumed(
        self, identity: dict[str, Any], resume: bool, tell: Callable[[Progress], None]
    ) -> State | None:
        if not resume:
            return None
        state, note = checkpoint.load(self.folder, identity, _unpack)
        if note:
            tell(Progress("resuming", note=note))
        return state

    def _interruption(self, signal: int) -> Interrupted:
        error = Interrupted(
            f"interrupted, all saved in {self.folder}; the same command with --resume continues"
        )
        if not isinstance(signal, bool) and signal:
            error.exit_code = 128 + signal
        return error


def _stated(value: PooledValue) -> dict[str, float]:
    return {k: v for k, v in vars(value).items() if k != "parameter"}


def _notes(members: list[Member], grouping: Grouping, sources: list[Source]) -> list[str]:
    """What a reader must know of the specimens before the numbers."""
    out = []
    nameless = [m.label for m in members if not m.donor]
    if nameless:
        out.append(
            f"no donor is stated for {_listed(nameless)}: each is taken as a donor of its own"
        )
    donors = len(grouping.donors)
    if donors == 1:
        out.append(
            "all specimens are of one donor: sd_donors, new_specimen and new_donor are those of "
            "the prior, and the groups' means are this donor's"
        )
    elif donors == len(members):
        out.append(
            "every donor gave one specimen: how the spread splits between donors and specimens is "
            "that of the prior; new_specimen holds both"
        )
    elif donors < 4:
        out.append(f"there are {donors} donors: sd_donors rests much on its prior")
    if len(members) < 4:
        out.append(f"there are {len(members)} specimens: the sds rest much on their priors")
    for group in grouping.groups:
        if len(grouping.members(group)) == 1:
            out.append(
                f"group {group} has one specimen: its mean is that specimen's within the spread "
                "that the other groups show"
                if len(grouping.groups) > 1
                else f"group {group} has one specimen"
            )
    out += _apart(grouping)
    out += _unlike(sources)
    weights = np.array([s.run.beta for s in sources])
    if np.median(weights) < LOW_WEIGHT:
        out.append(
            f"the readings of the specimens were weighed by {weights.min():.2g} to "
            f"{weights.max():.2g} because the law misses smoothly: widths of single specimens hold "
            "that misfit, so the sd between specimens comes out too small, and an error of the law "
            "that all specimens share does not average out"
        )
    return out


def _apart(grouping: Grouping) -> list[str]:
    """Groups that share no donor."""
    of = {g: {grouping.donor[i] for i in grouping.members(g)} for g in grouping.groups}
    names = list(of)
    pairs = [(a, b) for k, a in enumerate(names) for b in names[k + 1 :] if not of[a] & of[b]]
    if not pairs:
        return []
    told = "; ".join(f"{a} and {b}" for a, b in pairs[:3])
    return [f"no donor in common: {told}: their contrasts hold the differences of the donors"]


def _unlike(sources: list[Source]) -> list[str]:
    """Specimens that were tested or sampled differently."""
    out = []
    for key in ("mounting", "noise", "mounting_stretch", "noise_growth"):
        found = {str(getattr(s.posterior.settings, key)) for s in sources}
        if len(found) > 1:
            out.append(f"the runs differ in {key}: {', '.join(sorted(found))}")
    counts = sorted({len(s.run.specimen.protocols) for s in sources})
    if len(counts) > 1:
        few = [s.label for s in sources if len(s.run.specimen.protocols) == counts[0]]
        out.append(
            f"specimens were tested with {counts[0]} to {counts[-1]} protocols "
            f"({counts[0]}: {_listed(few)})"
        )
    return out


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - 4} more" if len(names) > 4 else ""
    return ", ".join(names[:4]) + more


# --- files ---------------------------------------------------------------------------------------


def _write(folder: Path, found: Population, identity: dict[str, Any]) -> PopulationFound:
    """Every file of a population, its record last."""
    specimens = found.specimens_table()
    found = replace(found, notes=[*found.notes, *found.contradictions(specimens)])
    tables = {
        "groups": found.groups_table(),
        "specimens": specimens,
        "contrasts": found.contrasts_table(),
    }
    for key, table in tables.items():
        write_csv(folder / f"{TABLES[key]}.csv", table, digits=8)
    atomic_write_bytes(folder / "population.nc", archive(found))
    _draw_figures(folder, found, tables)
    convergence = found.sampled.convergence
    record = {
        "biaxbayes": biaxbayes.__version__,
        "python": platform.python_version(),
        "name": found.name,
        "convergence": {
            "state": convergence.state,
            "reason": convergence.reason,
            "worst_ess": convergence.worst_ess if convergence.names else None,
            "worst_rhat": convergence.worst_rhat if convergence.names else None,
            "kept_sweeps": convergence.steps,
        },
        "law": found.law.name,
        "acceptance": {
            k: [round(float(x), 4) for x in v] for k, v in found.sampled.acceptance.items()
        },
        "pooled": {
            v.name: {
                "scale": v.scale,
                "mean": v.mean_in_words(),
                "sd_donors": f"half-normal({v.donor_scale:.4g})",
                "sd_specimens": f"half-normal({v.specimen_scale:.4g})",
            }
            for v in found.values
        },
        "left_out": found.left_out,
        "notes": found.notes,
        "identity": identity,
    }
    atomic_write_text(folder / RECORD, json.dumps(record, indent=2, ensure_ascii=False) + "\n")
    return PopulationFound(
        found.name,
        folder,
        found.state,
        found.reason,
        **tables,
        notes=found.notes,
        left_out=found.left_out,
    )


def _draw_figures(folder: Path, found: Population, tables: dict[str, pd.DataFrame]) -> None:
    """Forest, pairs and stress bands; none of draws that are unusable."""
    from biaxbayes.figures.population import band_figure, forest_figure, pairs_figure

    if found.state == "unusable":
        for stem in FIGURES:
            for suffix in ("pdf", "png"):
                (folder / f"{stem}.{suffix}").unlink(missing_ok=True)
        return
    specimen = found.sources[0].run.specimen
    parameters = [v.parameter for v in found.values]
    bands = found.bands_table()
    write_csv(folder / f"{BANDS}.csv", bands, digits=8)
    drawn = (
        forest_figure(tables["specimens"], tables["groups"], parameters),
        pairs_figure(found.new_specimens(), tables["specimens"], parameters),
        band_figure(
            bands,
            found.records(),
            directions=(specimen.axis_x or "x", specimen.axis_y or "y"),
        ),
    )
    for stem, figure in zip(FIGURES, drawn, strict=True):
        draw_figure(folder, stem, figure)


def archive(found: Population) -> bytes:
    """population.nc: draws of means and spreads by chain and draw, and of the specimens."""
    import xarray as xr

    history = found.sampled.history
    names = [v.name for v in found.values]
    groups = list(found.grouping.groups)

    def flat(values: np.ndarray) -> np.ndarray:
        # (ensembles, sweeps, chains, ...) to (chain, draw, ...), one chain of an ensemble after
        # the other, as in posterior.nc
        moved = np.moveaxis(values, 2, 1)
        return moved.reshape(moved.shape[0], moved.shape[1] * moved.shape[2], *moved.shape[3:])

    centre = found.design.centre
    dims = ("chain", "draw")
    sets = groups if history.sd.shape[3] > 1 else ["all"]
    common = {
        "mean": ((*dims, "group", "quantity"), flat(history.mu) + centre),
        "sd_donors": ((*dims, "quantity"), flat(history.sd_donors)),
        "sd_specimens": ((*dims, "spread", "quantity"), flat(history.sd)),
    }
    for k, partial in enumerate(history.partial):
        if partial.shape[-1]:
            common[f"partial_correlations_{k}"] = ((*dims, "of", "pair"), flat(partial))
    coords = {"group": groups, "quantity": names, "spread": sets, "of": ["donors", "specimens"]}
    own = {
        "values": ((*dims, "specimen", "quantity"), flat(history.theta) + centre),
        "donor_effect": ((*dims, "donor", "quantity"), flat(history.effect)),
    }
    attributes = {
        "biaxbayes_version": biaxbayes.__version__,
        "convergence": found.state,
        "scale": json.dumps({v.name: v.scale for v in found.values}),
        "every": history.every,
    }
    tree = xr.DataTree.from_dict(
        {
            "/posterior": xr.Dataset(common, coords),
            "/specimens": xr.Dataset(
                own,
                {
                    "specimen": list(found.grouping.labels),
                    "group_of": ("specimen", list(found.grouping.group)),
                    "donor_of": ("specimen", list(found.grouping.donor)),
                    "donor": list(found.grouping.donors),
                    "quantity": names,
                },
            ),
        }
    )
    tree.attrs.update(attributes)
    whole = io.BytesIO()
    tree.to_netcdf(whole, engine="h5netcdf")
    return whole.getvalue()


# --- checkpoints ---------------------------------------------------------------------------------


FORMAT = 1


def _pack(state: State, identity: dict[str, Any]) -> bytes:
    arrays: dict[str, np.ndarray] = {}
    members = []
    for k, member in enumerate(state.members):
        arrays |= {f"m{k}.{n}": v for n, v in member.items() if isinstance(v, np.ndarray)}
        accepted = {n: v.tolist() for n, v in member["accepted"].items()}
        members.append({"rng": member["rng"], "accepted": accepted})
    tuning = state.tuning
    arrays |= {f"archive{i}": a for i, a in enumerate(tuning.archives)}
    for i, q in enumerate(tuning.proposals):
        arrays |= {f"q{i}.{n}": v for n, v in q.arrays().items()}
    arrays |= {"directions": tuning.directions, "steps": tuning.steps}
    if state.history is not None:
        arrays |= {f"h.{n}": v for n, v in state.history.arrays().items()}
    text = json.dumps(
        {
            "format": FORMAT,
            "identity": identity,
            "members": members,
            "specimens": len(tuning.archives),
            "sweeps": state.sweeps,
            "block": state.block,
            "every": state.history.every if state.history is not None else 0,
            "finished": state.finished,
        },
        default=int,
    )
    return checkpoint.sealed(arrays, text)


def _unpack(data: bytes) -> tuple[State, dict[str, Any]]:
    arrays, stored = checkpoint.opened(data)
    try:
        if stored["format"] != FORMAT:
            raise RunError("has the checkpoint of another version; start again without --resume")

        def part(prefix: str) -> dict[str, np.ndarray]:
            return {n.removeprefix(prefix): v for n, v in arrays.items() if n.startswith(prefix)}

        members = []
        for k, plain in enumerate(stored["members"]):
            accepted = {n: np.array(v) for n, v in plain["accepted"].items()}
            members.append({**part(f"m{k}."), "rng": plain["rng"], "accepted": accepted})
        number = int(stored["specimens"])
        tuning = Tuning(
            tuple(arrays[f"archive{i}"] for i in range(number)),
            tuple(TransportedMixture.from_arrays(part(f"q{i}.")) for i in range(number)),
            arrays["directions"],
            arrays["steps"],
        )
        own = part("h.")
        history = History.from_arrays(own, int(stored["every"])) if own else None
        state = State(
            tuning,
            members,
            history,
            int(stored["sweeps"]),
            int(stored["block"]),
            bool(stored["finished"]),
        )
        return state, dict(stored["identity"])
    except (KeyError, ValueError, TypeError, AttributeError) as error:
        raise checkpoint.DamagedCheckpoint(f"is damaged ({type(error).__name__})") from None
